"""Compile-time shape of the work: which spin components each contact direction uses, and how sites are blocked."""

from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

from taichi_bearings.lattice.grid import tangential
from taichi_bearings.lattice.layout import Layout


@dataclass(frozen=True)
class Stencil:
    """Constants that a kernel is compiled for.

    spin_axes : components carried, e.g. (2,) in 2D or (0, 1) in 3D driven in the xy plane.
    dimension : 2 or 3; the height is the last axis and runs along memory.
    block : sites a task updates at a time (see Layout).
    periodic : axes that close on themselves.
    """

    spin_axes: tuple[int, ...]
    dimension: int
    block: int
    periodic: tuple[int, ...] = ()

    @property
    def components(self) -> int:
        return len(self.spin_axes)

    @property
    def height(self) -> int:
        return self.dimension - 1

    @property
    def kept(self) -> tuple[tuple[int, ...], ...]:
        """For each axis, the slots of the spin vector that make its contacts slip."""
        return tuple(tangential(axis, self.spin_axes) for axis in range(self.dimension))

    @property
    def slipping_axes(self) -> tuple[int, ...]:
        """Axes whose contacts can slip at all; with one component carried, those along it cannot."""
        return tuple(axis for axis in range(self.dimension) if self.kept[axis])

    @property
    def coupled_sides(self) -> tuple[int, ...]:
        """For each component, the axis beside the height whose contacts couple it; not for one about the height."""
        sides = range(self.height)
        return tuple(next(axis for axis in sides if axis != component) for component in self.spin_axes)

    @property
    def force_components(self) -> int:
        """Numbers that hold the forces of all contacts above a site: the sum of what each axis keeps."""
        return sum(map(len, self.kept))

    def spin_rows(self, first: int) -> tuple[tuple[int, ...], ...]:
        """For each axis, the rows of the components that make its contacts slip, of spins that begin at row `first`."""
        return tuple(tuple(first + slot for slot in slots) for slots in self.kept)

    def force_rows(self, first: int) -> tuple[tuple[int, ...], ...]:
        """For each axis, the rows of the forces of its contacts, of those of all that begin at row `first`."""
        ends = list(accumulate(map(len, self.kept), initial=first))
        return tuple(tuple(range(begin, end)) for begin, end in pairwise(ends))

    def forces_of_contacts(self, stored: np.ndarray, layout: Layout) -> np.ndarray:
        """Force components at the lower spheres (V, R, *N) -> (C, R, E)."""
        force = np.zeros((self.components, stored.shape[1], layout.lattice.all_contacts))
        for axis, (values, rows) in enumerate(zip(layout.lattice.by_axis(force), self.force_rows(0), strict=True)):
            values[list(self.kept[axis])] = layout.from_lower_sphere(stored[list(rows)], axis)
        return force

    def forces_at_lower_sphere(self, force: np.ndarray, layout: Layout) -> np.ndarray:
        """Inverse of :meth:`forces_of_contacts`; 0 where there is no contact."""
        stored = np.zeros((self.force_components, force.shape[1], *layout.shape))
        for axis, (values, rows) in enumerate(zip(layout.lattice.by_axis(force), self.force_rows(0), strict=True)):
            for slot, row in zip(self.kept[axis], rows, strict=True):
                layout.from_lower_sphere(stored[row], axis)[...] = values[slot]
        return stored
