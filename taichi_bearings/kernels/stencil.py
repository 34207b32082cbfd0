"""Constants that kernels are compiled for: spin components of each contact direction, and sites of a block.

Letters: C spin components, R replicas (samples solved together), N the shape of the lattice, E contacts, V force
components of a site.
"""

from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

from taichi_bearings.lattice.grid import tangential
from taichi_bearings.lattice.layout import Layout


@dataclass(frozen=True)
class Stencil:
    """Constants that a kernel is compiled for. The last axis is the height; neighbours along it are neighbours in
    memory.

    spin_axes : spin components that are computed, by number of their axis, e.g. (2,) in 2D or (0, 1) in 3D driven in
        the xy plane.
    dimension : 2 or 3.
    block : number of sites that are worked on together: neighbours in memory, 1 on a GPU.
    periodic : axes that close on themselves."""

    spin_axes: tuple[int, ...]
    dimension: int
    block: int
    periodic: tuple[int, ...] = ()

    @property
    def components(self) -> int:
        """C, the number of spin components that are computed."""
        return len(self.spin_axes)

    @property
    def height(self) -> int:
        """Number of the axis along the height: the last one."""
        return self.dimension - 1

    @property
    def slip_components(self) -> tuple[tuple[int, ...], ...]:
        """For each axis, the positions in `spin_axes` of the components that make its contacts slip.

        A spin about the axis of a contact does not slide it, so that for each axis those about the other axes are left.
        """
        return tuple(tangential(axis, self.spin_axes) for axis in range(self.dimension))

    @property
    def slipping_axes(self) -> tuple[int, ...]:
        """Axes whose contacts can slip at all: with one spin component, all axes but the one it turns about."""
        return tuple(axis for axis in range(self.dimension) if self.slip_components[axis])

    @property
    def coupled_sides(self) -> tuple[int, ...]:
        """For each spin component the horizontal axis along which contacts couple it, 0 for x or 1 for y. (Contacts
        along a spin's own axis do not.) Not to be used if spins about the height are computed, which contacts along
        both couple."""
        sides = range(self.height)
        return tuple(next(axis for axis in sides if axis != component) for component in self.spin_axes)

    @property
    def force_components(self) -> int:
        """V, how many numbers the forces of all contacts above a site have: for each axis, one for each component that
        makes its contacts slip.
        """
        return sum(map(len, self.slip_components))

    def spin_rows(self, first: int) -> tuple[tuple[int, ...], ...]:
        """Return for each axis a tuple of the rows of the spin components that make its contacts slip; a row is one
        number of every site.

        first : row of the first spin component."""
        return tuple(tuple(first + slot for slot in slots) for slots in self.slip_components)

    def force_rows(self, first: int) -> tuple[tuple[int, ...], ...]:
        """Return for each axis a tuple of the rows of its contact forces, one for each spin component that makes them
        slip; a row is one number of every site.

        first : row of the first component of the first axis; those of the other axes follow."""
        ends = list(accumulate(map(len, self.slip_components), initial=first))
        return tuple(tuple(range(begin, end)) for begin, end in pairwise(ends))

    def forces_of_contacts(self, stored: np.ndarray, layout: Layout) -> np.ndarray:
        """Return forces by contact, (C components, R samples, E contacts), from forces by site. Components that do not
        make a contact slip are 0.

        stored : (V, R, *N spheres), at each site the forces of the contacts to its upper neighbours; V counts, axis by
            axis, the components that make contacts slip.
        layout : the order of the sites in memory.
        """
        force = np.zeros((self.components, stored.shape[1], layout.lattice.all_contacts))
        for axis, (values, rows) in enumerate(zip(layout.lattice.by_axis(force), self.force_rows(0), strict=True)):
            values[list(self.slip_components[axis])] = layout.from_lower_sphere(stored[list(rows)], axis)
        return force

    def forces_at_lower_sphere(self, force: np.ndarray, layout: Layout) -> np.ndarray:
        """Return forces by site, (V, R samples, *N spheres): those of each contact at its lower sphere, 0 where there
        is no upper neighbour.

        force : (C components, R, E contacts), forces by contact.
        layout : the order of the sites in memory. V has an entry for each axis and component that makes its contacts
            slip.
        """
        stored = np.zeros((self.force_components, force.shape[1], *layout.shape))
        for axis, (values, rows) in enumerate(zip(layout.lattice.by_axis(force), self.force_rows(0), strict=True)):
            for slot, row in zip(self.slip_components[axis], rows, strict=True):
                layout.from_lower_sphere(stored[row], axis)[...] = values[slot]
        return stored
