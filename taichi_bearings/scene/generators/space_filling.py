"""Space-filling bearings of discs between two lines: the first family of Herrmann, Mantica and Bessis.

After Phys. Rev. Lett. 65, 3223 (1990). Between the lines y = 0 and y = 1 disc C touches the upper one at x = 0, disc D
the lower one at x = a, and they touch each other at T. Circle I through T, about the place where their common tangent
at T meets the upper line, is orthogonal to that line, to C and to D; and so is J about the place on the lower line.
Reflections in x = 0, x = a, I and J move these discs and lines to all others. They do not overlap if I meets x = a at
the angle 2 pi / (m + 3) and J meets x = 0 at 2 pi / (n + 3): then m + 3 discs, the lower line among them, touch the
upper line and D at equal distances, and n + 3 the lower line and C. With z_m = cos^2(pi / (m + 3))

    a^2 = 1 / (1 / z_m + 1 / z_n - 1),  radius of C = a^2 / (2 z_m),  radius of D = a^2 / (2 z_n),

radii of I and J those of C and D over a. Every contact is an image of one of these, and reflections keep apart the
kinds {C, lower line} and {D, upper line}: no loop is odd, and opposite kinds can turn against each other everywhere.
"""

from math import ceil, cos, pi, sqrt

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.options import finite_number, whole
from taichi_bearings.scene.generators.lattices import Built

LEAST_RADIUS = 1e-4  # of the height of the strip; some 30 000 discs a period
LARGEST_COUNT, MOST_PERIODS = 20, 1000
SAME_DISC = 1e-3  # distance of two copies of a disc, of the least radius
TANGENT = 1e-9  # gap of discs that touch, over the sum of their radii


def built(m: int, n: int, least_radius: float, periods: int) -> tuple[np.ndarray, Built]:
    """Return the discs of a space-filling bearing: radii (spheres N,), and a tuple with places (N, 2), contacts
    (contacts E, 2), normals (E, 2), signs (N,), and driven bodies (N,).

    Signs are +1 and -1 for the two kinds of discs, which turn in opposite senses. Bodies are 0 for discs on the lower
    line, 1 for those on the upper one, -1 for others. Heights are from 0 to 1, x is periodic, and large discs come
    first.

    m, n : numbers that pick a bearing of the family: m + 3 discs touch the upper line and the large disc D, n + 3 the
        lower line and the large disc C (head of this file).
    least_radius : radius of the smallest discs that are kept, in heights of the strip.
    periods : number of periods along x.

    Raises InputError for arguments that are not allowed.
    """
    m, n = (whole(0, LARGEST_COUNT).named(name, value) for name, value in (("m", m), ("n", n)))
    periods = whole(1, MOST_PERIODS).named("periods", periods)
    least = finite_number("least_radius", least_radius)
    if not LEAST_RADIUS <= least <= 0.25:
        raise InputError(
            f"least_radius is {least:g}; it must be from {LEAST_RADIUS:g} to 0.25, as a share of the height of the "
            "strip"
        )
    discs, half = _half_period(m, n, least)
    # Half a period, its mirror image, then all periods.
    inside = (discs[:, 0] > SAME_DISC * least) & (discs[:, 0] < half - SAME_DISC * least)
    discs = np.concatenate([discs, discs[inside] * [-1.0, 1.0, 1.0, 1.0] + [2 * half, 0.0, 0.0, 0.0]])
    discs = np.concatenate([discs + [2 * half * period, 0.0, 0.0, 0.0] for period in range(periods)])
    place, radius, sign = discs[:, :2], discs[:, 2], discs[:, 3]
    # Large discs first; discs that touch a line are driven.
    order = np.lexsort((place[:, 1], place[:, 0], -radius.round(12)))
    place, radius, sign = place[order], radius[order], sign[order]
    contact, normal = _contacts(place, radius, 2 * half * periods)
    side = np.where(place[:, 1] - radius < TANGENT, 0, np.where(place[:, 1] + radius > 1 - TANGENT, 1, -1))
    return radius, (place, contact, normal, sign, side)


def _half_period(m: int, n: int, least: float) -> tuple[np.ndarray, float]:
    """Return the discs of the strip with centres in half a period, x = 0 to a, as (spheres N, 4): x, y, radius, and
    sense of turning, +1 or -1; and the length a. The head of this file has the formulas.

    m, n : numbers of the family.
    least : radius of the smallest discs that are kept.
    """
    z_m, z_n = (cos(pi / (count + 3)) ** 2 for count in (m, n))
    square = 1 / (1 / z_m + 1 / z_n - 1)
    a, c, d = sqrt(square), square / (2 * z_m), square / (2 * z_n)  # half a period, radii of the discs C and D
    # the circles, and the first discs: C, D, and the images of the lower line in I and of the upper line in J
    circles = ((c / a, 1.0, c / a), (a - d / a, 0.0, d / a))  # I and J: centre and radius
    of_lower, of_upper = c * c / square / 2, d * d / square / 2  # radii of the images of the lines in I and J
    seed = [(0.0, 1 - c, c, 1.0), (a, d, d, -1.0)]
    seed += [(c / a, 1 - of_lower, of_lower, 1.0), (a - d / a, of_upper, of_upper, -1.0)]
    found, new = np.empty((0, 4)), _folded(np.array([disc for disc in seed if disc[2] >= least]).reshape(-1, 4), a)
    # reflect the discs that are new in both circles, until all images are too small or there already
    while len(new):
        new = _new_discs(found, new, SAME_DISC * least)
        found = np.concatenate([found, new])
        new = np.concatenate([_folded(_reflected(new, *circle, a, least), a) for circle in circles])
    return found, a


def _folded(discs: np.ndarray, a: float) -> np.ndarray:
    """Return discs (spheres N, 4) moved into half a period, x from 0 to a, by reflections in x = 0 and x = a.

    discs : (N, 4), columns x, y, radius and sense of turning.
    a : half the period, in heights of the strip.
    """
    x = np.mod(discs[:, 0], 2 * a)
    return np.column_stack([np.where(x > a, 2 * a - x, x), discs[:, 1:]])


def _new_discs(found: np.ndarray, new: np.ndarray, tolerance: float) -> np.ndarray:
    """Return those of the new discs that are not among the discs found already, each of them once, (discs, 4).

    found, new : (spheres N, 4), columns x, y, radius and sense of turning.
    tolerance : distance of centres up to which two discs are the same.
    """
    from scipy.spatial import cKDTree  # a tenth of a second that runs do not need

    once = np.ones(len(new), dtype=bool)
    once[cKDTree(new[:, :2]).query_pairs(tolerance, output_type="ndarray")[:, 1]] = False
    if len(found):
        once &= cKDTree(found[:, :2]).query(new[:, :2])[0] > tolerance
    return new[once]


def _reflected(discs: np.ndarray, x: float, y: float, size: float, a: float, least: float) -> np.ndarray:
    """Return mirror images of discs in a circle, (images, 4): columns x, y, radius and sense of turning. They are the
    images of all copies of the discs that lie outside the circle.

    discs : (spheres N, 4), in these columns; copies are made by reflection in x = 0 and by shifts of 2 a.
    x, y, size : centre and radius of the circle.
    a : half the period along x. All lengths are in heights of the strip.
    least : radius of the smallest images that are kept.

    Each disc of the bearing is orthogonal to the circle, inside it or outside. Those inside are images of larger ones
    outside, so none is missed.
    """
    farthest = size * sqrt(discs[:, 2].max(initial=0.0) / least) + 1  # images of discs beyond it are too small
    shifts = 2 * a * np.arange(-ceil(farthest / (2 * a)) - 1, ceil(farthest / (2 * a)) + 2)
    copies = np.concatenate([discs * [side, 1, 1, 1] + [shift, 0, 0, 0] for shift in shifts for side in (1, -1)])
    offset, radius = copies[:, :2] - [x, y], copies[:, 2]
    power = (offset**2).sum(axis=1) - radius**2  # power of the centre of the circle with respect to each disc
    factor = size**2 / np.where(power > 0, power, np.inf)
    kept = (factor < 1 - TANGENT) & (factor * radius >= least * (1 - TANGENT))
    image = np.column_stack([[x, y] + factor[:, None] * offset, factor * radius, copies[:, 3]])
    found: np.ndarray = image[kept]
    return found


def _contacts(place: np.ndarray, radius: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return contacts (contacts E, 2) and normals (E, 2), unit vectors from the first to the second disc, of discs on a
    strip that is periodic along x.

    place : (spheres N, 2), centres. Lengths are in heights of the strip.
    radius : (N,), in descending order.
    length : length of the strip along x.
    """
    from scipy.spatial import cKDTree  # a tenth of a second that runs do not need

    count = len(place)
    copies = np.concatenate([place + [side * length, 0.0] for side in (-1, 0, 1)])
    # a contact is found from its larger disc, the first: the other one is no farther away than twice its radius
    near = cKDTree(copies).query_ball_point(place, 2 * radius * (1 + TANGENT))
    first, copy = np.repeat(np.arange(count), [len(own) for own in near]), np.concatenate(near).astype(np.int64)
    second = copy % count
    vector, reach = copies[copy] - place[first], radius[first] + radius[second]
    size = np.linalg.norm(vector, axis=1)
    kept = (first < second) & (np.abs(size - reach) <= TANGENT * reach)
    first, second, vector, size = first[kept], second[kept], vector[kept], size[kept]
    order = np.lexsort((vector[:, 0], second, first))
    return np.column_stack([first, second])[order], (vector / size[:, None])[order]
