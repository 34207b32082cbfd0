"""Predicts how many numbers a factorisation of a lattice holds, from its dissection, before anything of it is made."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky.dissection import Region, divide
from taichi_bearings.numerics.cholesky.tuning import GROVE_NUMBERS, LAUNCH_UNKNOWNS, LEAF_UNKNOWNS, SHEET_COLUMNS

# measured: updates take so much more memory, as fronts are joined and several branches are eliminated at once
JOINED = 2.0


class Tree(NamedTuple):
    """Memory that the elimination of a region of the lattice takes, in doubles.

    factor : size of the columns of the factor.
    most : the most that is in use at one time, for columns and updates. (An update is what is added to later unknowns.)
    updates : total size of the updates at each depth of the dissection, beginning with that of the region itself.
    """

    factor: float
    most: float
    updates: tuple[float, ...]


@lru_cache(maxsize=64)
def factor_numbers(lattice: Lattice, spin_axes: tuple[int, ...]) -> float:
    """Predict, to some 15 percent, the most doubles that a factorisation of the free spins of a lattice takes at one
    time: columns of the factor, and updates (what fronts leave for later ones).

    lattice : the lattice of spheres.
    spin_axes : axes of the spin components that are unknown.
    """
    shape, known = lattice.free_shape, dict[tuple[object, ...], Tree]()

    def tree(region: Region) -> Tree:
        """Return the memory that the elimination of a region takes, computed once for all regions that are shifted
        copies of each other and have equal borders.

        region : for each spin component a box of spheres.
        """
        corner = np.min([low for low, _ in region.values()], axis=0)
        moved = [(c, *np.subtract(box, corner).ravel().tolist()) for c, box in region.items()]
        border = _border(region, lattice)
        alike = (*moved, border)
        if alike not in known:
            known[alike] = divided(region, border)
        return known[alike]

    def divided(region: Region, border: float) -> Tree:
        """Return the memory that the elimination of a region takes: first of both halves, then of the separator between
        them. A region with few unknowns is not divided.

        region : for each spin component a box of spheres.
        border : number of unknowns outside that contacts couple to the region.
        """
        inside, update = unknowns(region), border * (border + 1) / 2
        division = divide(region, len(shape)) if inside > LEAF_UNKNOWNS else None
        if division is None:
            return Tree(inside * (inside + border), inside * (inside + border) + update, (update,))
        below, separator, above = division
        parts, own = [tree(side) for side in (below, above) if side], unknowns(separator)
        if not own:  # parts that nothing couples have no update in common
            update = sum(part.updates[0] for part in parts)
        depths = max(len(part.updates) for part in parts)
        levels = [update, *(sum(part.updates[n] for part in parts if n < len(part.updates)) for n in range(depths))]
        columns = sum(part.factor for part in parts) + own * (own + border) - own * max(0.0, own - SHEET_COLUMNS) / 2
        if sum(levels) <= grove:  # small: eliminated depth by depth, so updates of two depths are alive
            most = max(above + below for above, below in zip(levels, [*levels[1:], 0.0], strict=True))
            return Tree(columns, columns + JOINED * most, tuple(levels))
        # large: one half after the other; factor and update of the first are kept until the second is done
        before = np.cumsum([0.0, *(part.factor + part.updates[0] for part in parts)])
        most = max(*(wait + part.most for wait, part in zip(before, parts, strict=False)), columns + levels[1] + update)
        return Tree(columns, most, tuple(levels))

    low = {c: tuple(int(a in lattice.periodic and a != c) for a in range(len(shape))) for c in spin_axes}
    whole = {
        c: (first, tuple(shape)) for c, first in low.items() if all(a < b for a, b in zip(first, shape, strict=True))
    }
    size = len(spin_axes) * float(np.prod(shape))
    last = size - unknowns(whole)  # the planes where periodic axes are cut open
    grove = GROVE_NUMBERS if size >= LAUNCH_UNKNOWNS else -1  # smaller matrices are eliminated front by front
    return (tree(whole).most if whole else 0.0) + last**2


def _border(region: Region, lattice: Lattice) -> float:
    """Return the number of unknowns outside a region that a contact couples to unknowns inside.

    region : for each spin component a box of spheres.
    lattice : the whole lattice.
    """
    shape, total = lattice.free_shape, 0
    for component, (low, high) in region.items():
        sides = [b - a for a, b in zip(low, high, strict=True)]
        for axis in {*range(len(shape))} - {component}:
            closed = axis in lattice.periodic
            around = closed and sides[axis] == shape[axis] - 1  # one plane is next to both of its ends
            ends = 1 if around else (low[axis] > 0 or closed) + (high[axis] < shape[axis] or closed)
            total += ends * int(np.prod(sides)) // sides[axis]
    return float(total)


def unknowns(region: Region) -> float:
    """Return the number of unknowns in a region, which has a box of spheres for each spin component."""
    return float(sum(np.prod([b - a for a, b in zip(*box, strict=True)]) for box in region.values()))
