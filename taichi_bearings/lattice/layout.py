"""The place of sphere (r, i, j, k) in a field: flat, height fastest, with margins so that no stencil leaves the field.

Every field is one-dimensional in sites: p = margin + ((r * nx + i) * ny + j) * nz + k. The upper neighbour along an
axis is p + stride. A sphere on a side has no upper contact there: its coefficient is 0, so what lies at p + stride (the
other side, the next replica or the margin) does not matter as long as it is finite. Hence kernels have no branch for
the boundary, treat 2D, 3D and replicas alike, and their inner loops run along memory (docs/decisions.md, 2). On the
upper side of a periodic axis the neighbour is at p + stride less the spheres around the axis; only kernels of periodic
lattices compute that.

Letters: C components, R replicas, N the shape of the lattice, D = 2 or 3 axes, E contacts.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from taichi_bearings.lattice.grid import Lattice


class Rows(NamedTuple):
    """The places in memory of the numbers of an array (C, *shape): C rows, one for each component.

    length : how many numbers lie from the beginning of one row to that of the next.
    margin : numbers before the first one of a row.
    shape : shape of one component.
    order : for each place in a row, the number of the sphere or contact there; by default the numbers rise by 1.
    """

    length: int
    margin: int
    shape: tuple[int, ...]
    order: slice | np.ndarray = slice(None)


@dataclass(frozen=True)
class Layout:
    """Flat layout of several lattices of one shape in memory, one after another.

    replicas : number of lattices (samples).
    shape : shape of each, height last.
    block : number of sites, the places of spheres, that a kernel works on together.
    periodic : axes that close on themselves.
    """

    replicas: int
    shape: tuple[int, ...]
    block: int
    periodic: tuple[int, ...] = ()

    @cached_property
    def lattice(self) -> Lattice:
        """The lattice of one sample, with its shape and periodic axes; all samples have the same."""
        return Lattice(self.shape, periodic=self.periodic)

    @property
    def sites(self) -> int:
        """Number of spheres of all lattices."""
        return self.replicas * int(np.prod(self.shape))

    @property
    def strides(self) -> tuple[int, ...]:
        """Distance in sites of the upper neighbour along each axis."""
        return tuple(int(np.prod(self.shape[axis + 1 :])) for axis in range(len(self.shape)))

    @property
    def margin(self) -> int:
        """Number of sites before the first one: the largest stride, so that every lower neighbour lies in the array,
        rounded up to whole blocks, which are aligned in memory."""
        return -(-max(self.strides[0], 1) // self.block) * self.block

    @property
    def blocks(self) -> int:
        """Number of blocks, of `block` sites each, that hold all sites."""
        return -(-self.sites // self.block)

    @property
    def length(self) -> int:
        """Number of sites in a row, its margins and some unused ones included. It is 5 blocks more than a multiple of
        32 blocks: if it were a multiple, the same site of all rows would share few places of the processor's cache.
        """
        blocks = self.blocks + 2 * (self.margin // self.block)
        return (blocks + (5 - blocks) % 32) * self.block

    @cached_property
    def measures(self) -> tuple[int, int, int, int, int, int]:
        """Integers that kernels need, in this order: length of a row; margin, the sites before the first one; number of
        blocks that hold all sites; stride to the neighbour along x; stride along y (in 2D along the height); number of
        sites of a replica, by which neighbours along a periodic x wrap around."""
        stride_x, stride_y = (*self.strides, 1)[:2]
        return self.length, self.margin, self.blocks, stride_x, stride_y, self.sites // self.replicas

    def parts(self, spec: object) -> list[tuple[Any, Rows]]:
        """Return pairs of a spec of fields and the place of their rows in memory. On a lattice all fields have the
        shape (C components, R samples, *N spheres), so there is one pair.

        spec : names of the fields, each with its number of components C.
        """
        return [(spec, Rows(self.length, self.margin, (self.replicas, *self.shape)))]

    def at_lower_sphere(self, contacts: np.ndarray) -> np.ndarray:
        """Return values on contacts as an array over the spheres, (D axes, R samples, *N spheres): for each axis, each
        value stands at the lower sphere of its contact, and 0 where there is none.

        contacts : (R, E contacts), the values.
        """
        full = np.zeros((len(self.shape), self.replicas, *self.shape))
        for axis, values in enumerate(self.lattice.by_axis(contacts)):
            self.from_lower_sphere(full[axis], axis)[...] = values
        return full

    def from_lower_sphere(self, full: np.ndarray, axis: int) -> np.ndarray:
        """Return the part (..., R samples, *contacts) that belongs to contacts along an axis, of values (..., R, *N
        spheres) that stand at the lower sphere of each contact.

        full : (..., R, *N), the values.
        axis : number of the axis.
        """
        return np.asarray(full[(Ellipsis,) + tuple(map(slice, self.lattice.contact_shape(axis)))])
