"""Which spheres touch, out of their centres and radii: by trees of places, one for each octave of radii."""

from collections.abc import Iterator
from itertools import chain

import numpy as np

SEARCHED_AT_ONCE = 50_000  # spheres whose neighbours are looked for together; each list of them takes memory


def near_pairs(
    places: np.ndarray, sizes: np.ndarray, center: np.ndarray, radius: np.ndarray, factor: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of a sphere a of the first set and b of the second, in pieces (pairs,) and (pairs,), that are no farther
    apart than `factor` times the sum of their radii.

    places (A, D), sizes (A,) : centres and radii of the first set, length. center (B, D), radius (B,) : of the second.

    A sphere looks for neighbours up to the largest radius of an octave, so a large sphere never counts all the small
    ones that would fit around another large one.
    """
    if not len(center):
        return
    from scipy.spatial import cKDTree  # a tenth of a second that runs do not need

    octave = np.floor(np.log2(radius)).astype(int)
    for own in np.unique(octave):
        chosen = np.flatnonzero(octave == own)
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
    """Numbers (I,) of spheres and shifts (I, D), length, by sums of periods, of all images that may touch a sphere.

    center : (N, D), at most half a period from the middle. periods : (k, D), along axes, each longer than spheres.
    """
    number, shift = np.arange(len(center)), np.zeros_like(center)
    margin, low, high = 2 * factor * radius.max(), center.min(axis=0), center.max(axis=0)
    for period in periods:
        moved = [(number, shift + sign * period) for sign in (-1, 1)]
        parts = [(number, shift)]
        for own, by in moved:
            place = center[own] + by
            near = ((place >= low - margin) & (place <= high + margin)).all(axis=1)
            parts.append((own[near], by[near]))
        number, shift = (np.concatenate(part) for part in zip(*parts, strict=True))
    return number, shift
