"""Completes packings whose contacts or driven bodies are not given: both are found from centres and radii.

Letters: N spheres, E contacts, D = 2 or 3 dimensions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.errors import InputError
from taichi_bearings.options import finite_number
from taichi_bearings.scene.array_files import own_array
from taichi_bearings.scene.checks import GAP, bodies, places, sizes
from taichi_bearings.scene.scene import imposed_direction
from taichi_bearings.scene.touching import images, near_pairs
from taichi_bearings.words import counted, shown

TOLERANCE = 1e-3  # of the sum of the radii
SIDES = 2  # bodies: the bottom is 0, the top 1


Lengths = Sequence[float | None] | np.ndarray | None
"""Length of the periodic side along each axis, 0 or None for other axes; None if no axis is periodic."""


@dataclass(frozen=True)
class Sides:
    """How the two driven bodies of a packing are driven: the bottom, number 0, and the top, number 1.

    spin_bottom, spin_top : imposed spins, 1/time.
    direction : their common axis, of any length but 0; ignored for discs.
    """

    spin_bottom: float = 0.0
    spin_top: float = 1.0
    direction: Sequence[float] = (1.0, 1.0, 0.0)

    def spins(self, driven: np.ndarray, dimension: int) -> np.ndarray:
        """Return the imposed spins, (spheres N, 3) of spheres or (N,) of discs, 1/time. Raises InputError for a body
        that is neither bottom nor top.

        driven : (N,), number of the body of each sphere, -1 for free ones.
        dimension : 2 or 3.
        """
        if (beyond := driven >= SIDES).any():
            own = int(np.argmax(beyond))
            body = driven[own]
            raise InputError(
                f"driven of sphere {own} is {body}; without an array `spin` it must be -1 (free), 0 (bottom) or 1 (top)"
            )
        rate = np.array([finite_number(name, getattr(self, name)) for name in ("spin_bottom", "spin_top")])
        spin = np.where(driven >= 0, rate[np.maximum(driven, 0)], 0.0)
        if dimension == 2:
            return spin
        axis = np.array(imposed_direction(self.direction))
        return np.asarray(spin[:, None] * (axis / np.linalg.norm(axis)))


def from_centers(
    center: ArrayLike,
    radius: ArrayLike,
    tolerance: float,
    given: Mapping[str, Any],
    sides: Sides,
    periodic: Lengths = None,
) -> dict[str, np.ndarray]:
    """Return the arrays of a packing, by name, whose spheres touch where |d - R_i - R_j| <= tolerance (R_i + R_j), with
    the distance d of two centres.

    center : (spheres N, dimensions D), length.
    radius : (N,) or one for all, length.
    tolerance : relative gap or overlap of spheres that touch.
    given : arrays that are known already, by name: `driven`, (N,), or `spin`. Without `driven`, spheres within
        `tolerance` radii of the lowest and of the highest one along the last axis are driven.
    sides : how these two bodies are driven, unless `spin` is given.
    periodic : (D,), lengths of the periodic sides, 0 or None along other axes.

    Raises InputError for spheres that overlap by more, and if nothing touches or it is not clear what is driven.
    """
    center = places(center)
    count, dimension = center.shape
    radius = sizes("radius", radius, count, "sphere")
    share = finite_number("tolerance", tolerance)
    if not 0 <= share <= GAP:
        raise InputError(
            f"tolerance is {shown(tolerance)}; it must be from 0 to {GAP:g}, a share of the sum of two radii"
        )
    length = _lengths(periodic, dimension, float(radius.max()) * (1 + share))
    contact, normal = _contacts(center, radius, share, length)
    driven = given.get("driven")
    driven = _bodies_at_ends(center, radius, share, length) if driven is None else bodies(driven, count)
    spin = given.get("spin")
    spin = sides.spins(driven, dimension) if spin is None else spin
    return {"center": center, "contact": contact, "driven": driven, "spin": spin, "radius": radius, "normal": normal}


def completed(
    found: Mapping[str, Any], tolerance: float, sides: Sides, periodic: Lengths = None
) -> dict[str, np.ndarray]:
    """Return the arrays of a packing, by name, from those of tables: contacts and driven bodies are found if missing.

    found : arrays of the tables by name, center and radius among them.
    tolerance : relative gap or overlap of spheres that touch.
    sides : spins of the lowest and the highest spheres, which are driven if `found` does not say which.
    periodic : (dimensions D,), lengths of the periodic sides, 0 or None along other axes.
    """
    if "contact" not in found:
        rest = {name: values for name, values in found.items() if name not in ("center", "radius")}
        return rest | from_centers(found["center"], found["radius"], tolerance, rest, sides, periodic)
    center = places(found["center"])
    radius = sizes("radius", found["radius"], len(center), "sphere")
    driven = found.get("driven")
    driven = _bodies_at_ends(center, radius, tolerance, np.zeros(1)) if driven is None else bodies(driven, len(center))
    spin = found.get("spin")
    spin = sides.spins(driven, center.shape[1]) if spin is None else spin
    return {**found, "radius": radius, "driven": driven, "spin": spin}


def contact_summary(contact: np.ndarray, spheres: int, tolerance: float) -> tuple[str, int]:
    """Return a sentence on the contacts that were found, for a log, and the number of spheres without a contact.

    contact : (contacts E, 2), spheres of each contact.
    spheres : their number.
    tolerance : gap or overlap, relative to the sum of two radii, up to which spheres touch.
    """
    alone = spheres - len(np.unique(contact))
    pairs = f"{counted(len(contact), 'contact')} found between {counted(spheres, 'sphere')}"
    rule = f"where gap or overlap is at most {tolerance:g} of the sum of two radii"
    none = (
        f"{counted(alone, 'sphere')} touch{'es' if alone == 1 else ''} nothing"
        if alone
        else "every sphere touches another"
    )
    return f"{pairs}, {rule}; {none}", alone


def _lengths(periodic: Lengths, dimension: int, largest: float) -> np.ndarray:
    """Return the lengths (dimensions D,) of the periodic sides, 0 along other axes; raise InputError for anything else.

    periodic : what the user has passed, or None.
    dimension : D.
    largest : the largest radius; sides must be longer than spheres.
    """
    if periodic is None:
        return np.zeros(dimension)
    values = [0.0 if value is None else value for value in np.atleast_1d(np.array(periodic, dtype=object)).tolist()]
    length = own_array("lengths of periodic sides", values)
    if length.shape != (dimension,) or not (np.abs(length) < np.inf).all() or (length < 0).any():
        raise InputError(
            f"periodic is {shown(periodic)}; it must be {dimension} lengths, with 0 or None for an axis that is not "
            "periodic"
        )
    if ((length > 0) & (length <= 2 * largest)).any():
        raise InputError(
            f"periodic is {shown(periodic)}; each length must exceed the largest diameter, {2 * largest:g}"
        )
    return length


def _contacts(
    center: np.ndarray, radius: np.ndarray, share: float, length: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the contacts (contacts E, 2) of spheres that touch, ordered by their spheres, and the normals (E,
    dimensions D).

    center : (spheres N, D), length.
    radius : (N,), length.
    share : largest gap or overlap, relative to the sum of two radii.
    length : (D,), lengths of the periodic sides, 0 along other axes.

    Raises InputError if spheres overlap by more, or if none touch.
    """
    # all spheres, and their images across periodic sides that may touch one; pairs that touch are found among all
    inside, closed = np.array(center), length > 0
    inside[:, closed] = np.mod(inside[:, closed], length[closed])
    number, shift = images(inside, radius, np.diag(length)[closed], 1 + share)
    place = inside[number] + shift
    found = list(near_pairs(inside, radius, place, radius[number], 1 + share))
    first, image = (np.concatenate(part) for part in zip(*found, strict=True))
    second = number[image]
    normal = place[image] - inside[first]
    # Each contact is found from both of its spheres; one of the two is kept.
    leads_up = _leads_up(shift[image])
    kept = (first < second) | ((first == second) & leads_up)
    first, second, normal = first[kept], second[kept], normal[kept]
    size, reach = np.linalg.norm(normal, axis=1), radius[first] + radius[second]
    # Refuse overlaps beyond the tolerance, and a packing without contacts.
    if (deep := size < (1 - share) * reach).any():
        own = int(np.argmin(np.where(deep, size / reach, np.inf)))
        like = "; radii look like diameters" if abs((size / reach).min() / 0.5 - 1) < 0.1 else ""
        one, other, distance, radii = first[own], second[own], f"{size[own]:.6g}", f"{reach[own]:.6g}"
        overlap = f"{1 - size[own] / reach[own]:.2g}"
        raise InputError(
            f"spheres {one} and {other} are {distance} apart and their radii add up to {radii}: "
            f"they overlap by {overlap} of that, more than the tolerance {share:g}{like}"
        )
    if not len(first):
        raise InputError(
            f"no two spheres touch within the tolerance {share:g} (a share of the sum of their radii); check that "
            "radii and centres have the same unit"
        )
    order = np.lexsort((*normal.T, second, first))
    return np.stack([first[order], second[order]], axis=1), (normal / size[:, None])[order]


def _leads_up(shift: np.ndarray) -> np.ndarray:
    """Return a mask (shifts,), True where the last component of the shift that is not 0 is positive.

    shift : (shifts, dimensions D), vectors from spheres to their periodic images. Two spheres that touch across a
        periodic side do so by two opposite shifts; the mask picks one of them.
    """
    up = np.zeros(len(shift), dtype=bool)
    for component in shift.T:
        up = np.where(component != 0, component > 0, up)
    return up


def _bodies_at_ends(center: np.ndarray, radius: np.ndarray, share: float, length: np.ndarray) -> np.ndarray:
    """Return the driven body of each sphere, (spheres N,): 0 for the lowest ones along the last axis, 1 for the
    highest, -1 for others.

    center : (N, dimensions D), length.
    radius : (N,), length.
    share : spheres within so many of their radii of the lowest or highest centre are driven.
    length : (D,), lengths of the periodic sides, 0 along other axes.

    Raises InputError if the last axis is periodic, or if all spheres are at one height.
    """
    height, name = center[:, -1], "xyz"[center.shape[1] - 1]
    if length[-1]:
        raise InputError(
            f"the height {name} is periodic, so there is no bottom and no top; give a column or an array `driven`"
        )
    low, high = height - height.min() <= share * radius, height.max() - height <= share * radius
    if (low & high).any():
        raise InputError(
            f"all spheres lie at one height {name}, so there is no bottom and no top; give a column or an array "
            "`driven`"
        )
    return np.where(high, 1, np.where(low, 0, -1))
