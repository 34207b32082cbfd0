"""Pairs of spheres that touch, found from centres and radii by trees of places, one tree for each octave of radii.

An octave holds the radii from a power of two up to the next. D is the dimension, 2 or 3.
"""

from collections.abc import Iterator
from itertools import chain

import numpy as np

SEARCHED_AT_ONCE = 50_000  # spheres whose neighbours are looked for together; each list of them takes memory


def near_pairs(
    places: np.ndarray, sizes: np.ndarray, center: np.ndarray, radius: np.ndarray, factor: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield pairs of a sphere of a first set and one of a second set that are near each other, piece by piece: two
    arrays (pairs,), the numbers of the first and of the second spheres.

    places, sizes : centres (A, dimensions D) and radii (A,) of the first set, length.
    center, radius : centres (B, D) and radii (B,) of the second set, length.
    factor : two spheres are near if their centres are no farther apart than this factor times the sum of their radii.

    The second set is divided into octaves: radii that differ by less than a factor of 2. Each octave is searched no
    farther than its own largest radius demands. So the neighbourhood of a large sphere does not grow because some other
    sphere is large, too.
    """
    if not len(center):
        return
    from scipy.spatial import cKDTree  # a tenth of a second that runs do not need

    octave = np.floor(np.log2(radius)).astype(int)
    for one in np.unique(octave):
        chosen = np.flatnonzero(octave == one)
        tree, largest = cKDTree(center[chosen]), radius[chosen].max()
        for start in range(0, len(places), SEARCHED_AT_ONCE):
            part = slice(start, start + SEARCHED_AT_ONCE)
            lists = tree.query_ball_point(places[part], factor * (sizes[part] + largest) * (1 + 1e-12))
            counts = np.fromiter(map(len, lists), dtype=np.int64, count=len(lists))
            second = chosen[np.fromiter(chain.from_iterable(lists), dtype=np.int64, count=counts.sum())]
            first = np.repeat(np.arange(start, start + len(lists)), counts)
            distance = np.linalg.norm(center[second] - places[first], axis=1)
            near = distance <= factor * (sizes[first] + radius[second])
            yield first[near], second[near]


def images(center: np.ndarray, radius: np.ndarray, periods: np.ndarray, factor: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the images of spheres that may touch a sphere: their spheres' numbers (I,), and shifts (I, dimensions D),
    length.

    An image is a copy of a sphere shifted by a sum of periods; the spheres themselves, with shift 0, are among them.

    center : (spheres N, D), length, at most half a period from the middle.
    radius : (N,), length.
    periods : (k, D), length, along axes, each longer than the largest sphere.
    factor : spheres touch up to this factor times the sum of their radii.
    """
    number, shift = np.arange(len(center)), np.zeros_like(center)
    margin, low, high = 2 * factor * radius.max(), center.min(axis=0), center.max(axis=0)
    for period in periods:
        # all images so far, and their copies on either side that are near enough to touch a sphere
        parts = [(number, shift)]
        for moved in (shift - period, shift + period):
            place = center[number] + moved
            near = ((place >= low - margin) & (place <= high + margin)).all(axis=1)
            parts.append((number[near], moved[near]))
        number, shift = (np.concatenate(part) for part in zip(*parts, strict=True))
    return number, shift
