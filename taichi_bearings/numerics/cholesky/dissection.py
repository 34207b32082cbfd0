"""Nested dissection of the spins of a lattice, by planes of spheres: an order of elimination with little fill.

An unknown is a spin component of a free sphere. Contacts along axis a couple all components but the one along a, so the
unknowns of a plane normal to a, *without component a*, separate what lies below from what lies above; component a of
that plane may stay with either side. A region is therefore one box for each component. A periodic axis is first cut
open at its first plane.
"""

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky.tuning import LEAF_UNKNOWNS

Box = tuple[tuple[int, ...], tuple[int, ...]]  # lower corner, upper corner (exclusive)
Region = dict[int, Box]  # spin component -> box of spheres


def dissect(lattice: Lattice, spin_axes: tuple[int, ...], leaf: int = LEAF_UNKNOWNS) -> np.ndarray:
    """Return an order of elimination (unknowns,) for the spins of the free spheres of a lattice, which makes few new
    entries.

    lattice : of spheres.
    spin_axes : axes of the spin components that are unknown. The number of an unknown is that of its free sphere times
        the number of components, plus the position of its component in `spin_axes`.
    leaf : regions of at most so many unknowns are not divided.

    Regions come before the plane of unknowns that separates them.
    """
    shape = lattice.free_shape
    sphere = np.arange(int(np.prod(shape))).reshape(shape)
    known: dict[tuple[object, ...], np.ndarray] = {}

    def numbers(region: Region) -> np.ndarray:
        """Return the numbers (n,) of all unknowns in a region, which has a box of spheres for each spin component."""
        found = [np.zeros(0, dtype=np.int64)]
        for component, (low, high) in region.items():
            inside = sphere[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
            found.append(inside.ravel() * len(spin_axes) + spin_axes.index(component))
        return np.concatenate(found)

    def eliminated(region: Region) -> np.ndarray:
        """Return the order of elimination (n,) of the n unknowns in a region: a box of spheres for each spin component.
        It is made once for all regions that are shifted copies of each other."""
        corner = tuple(np.min([low for low, _ in region.values()], axis=0).tolist())
        moved = {c: (_less(low, corner), _less(high, corner)) for c, (low, high) in region.items()}
        alike = tuple(moved.items())
        if alike not in known:
            known[alike] = divided(moved)
        result: np.ndarray = known[alike] + sphere[corner] * len(spin_axes)
        return result

    def divided(region: Region) -> np.ndarray:
        """Return the order of elimination (n,) of the n unknowns in a region, which has a box of spheres for each spin
        component: one side, the other side, then the unknowns that separate them. Unknowns of a small region stay in
        the order of their numbers."""
        division = divide(region, len(shape)) if _size(region) > leaf else None
        if division is None:
            return numbers(region)
        below, separator, above = division
        return np.concatenate([*(eliminated(side) for side in (below, above) if side), numbers(separator)])

    # without the first plane across each periodic axis
    closed = {c: tuple(int(axis in lattice.periodic and axis != c) for axis in range(len(shape))) for c in spin_axes}
    inside = {c: (low, tuple(shape)) for c, low in closed.items()}
    order = eliminated(_without_empty(inside))
    last = np.ones(len(spin_axes) * sphere.size, dtype=bool)
    last[order] = False
    return np.concatenate([order, np.flatnonzero(last)])


def divide(region: Region, dimension: int) -> tuple[Region, Region, Region] | None:
    """Divide a region of a lattice by the middle plane of spheres whose unknowns are fewest; None if no plane divides
    it.

    region : for each spin component a box of spheres: its lower corner, and its upper corner (exclusive).
    dimension : number of axes of the lattice.
    returns : the region below the plane, the separator (the plane without the component along its normal), the region
        above.
    """
    best: tuple[Region, Region, Region] | None = None
    least = None
    for axis in range(dimension):
        coupled = [component for component in region if component != axis]
        boxes = [region[component] for component in coupled or region]
        first, last = min(low[axis] for low, _ in boxes), max(high[axis] for _, high in boxes)
        if last - first < (3 if coupled else 2):
            continue
        middle = (first + last) // 2 - (not coupled)  # uncoupled planes fall apart without a separator
        separator = {c: _cut(region[c], axis, middle, middle + 1) for c in coupled}
        below = {c: _cut(box, axis, box[0][axis], middle + (c == axis)) for c, box in region.items()}
        above = {c: _cut(box, axis, middle + 1, box[1][axis]) for c, box in region.items()}
        cost = (_size(separator), first - last)
        if least is None or cost < least:
            best, least = (_without_empty(below), _without_empty(separator), _without_empty(above)), cost
    return best


def _cut(box: Box, axis: int, first: int, last: int) -> Box:
    """Return the part of a box of spheres whose coordinate along an axis is at least `first` and below `last`.

    box : lower corner, and upper corner (exclusive).
    axis : number of the axis.
    """
    low, high = list(box[0]), list(box[1])
    low[axis], high[axis] = max(low[axis], first), min(high[axis], last)
    return tuple(low), tuple(high)


def _less(corner: tuple[int, ...], other: tuple[int, ...]) -> tuple[int, ...]:
    """Return the coordinates of `corner` relative to those of `other`, axis by axis."""
    return tuple(a - b for a, b in zip(corner, other, strict=True))


def _box_size(box: Box) -> int:
    """Return the number of spheres in a box (lower corner, upper corner, exclusive), 0 if it is empty."""
    return int(np.prod([max(b - a, 0) for a, b in zip(*box, strict=True)]))


def _size(region: Region) -> int:
    """Return the number of unknowns in a region: for each of its spin components the spheres of a box."""
    return sum(_box_size(box) for box in region.values())


def _without_empty(region: Region) -> Region:
    """Return a region without the spin components whose boxes are empty."""
    return {component: box for component, box in region.items() if _box_size(box)}
