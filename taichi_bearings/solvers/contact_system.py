"""Contacts of one sample as flat lists: differences, torques, and the weighted Laplacian of the Newton steps.

Staggered spins are measured from the bottom plane in units of the imposed jump, forces in units of the sample's mean
coefficient times the normal force, so that every number is of order one whatever units the scene is in. Contacts of one
lattice axis form a group: the vectors (d, n) across its n contacts have d components (PHYSICS 3).
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import lower, tangential, upper
from taichi_bearings.scene import Scene


@dataclass(frozen=True)
class ContactGroup:
    """The contacts along one lattice axis that can slip.

    axis : lattice axis. slots : positions in `spin_axes` of the d components that slip.
    acting : mask over the contacts of the axis, (*contacts), True for the n contacts listed.
    below, above : number of the free sphere at either end, (n,); -1 where it is driven.
    difference : (d*n, unknowns); offset : (d, n), what the driven planes add to the differences.
    """

    axis: int
    slots: tuple[int, ...]
    acting: np.ndarray
    below: np.ndarray
    above: np.ndarray
    difference: sparse.csr_matrix
    offset: np.ndarray
    transposed: sparse.csr_matrix

    def differences(self, spins: np.ndarray) -> np.ndarray:
        """Difference of the spins across each contact, (d, n), from the free spins (unknowns,)."""
        return (self.difference @ spins).reshape(self.offset.shape) + self.offset


class ContactSystem:
    """What all samples on one lattice with one driving share. Unknown number = free sphere * components + slot."""

    def __init__(self, lattice: Lattice, spin_axes: tuple[int, ...], jump: np.ndarray) -> None:
        """jump : (C,), staggered spin of the top minus that of the bottom, in units of the whole jump."""
        self.lattice, self.spin_axes = lattice, spin_axes
        self.free_shape = (*lattice.shape[:-1], lattice.shape[-1] - 2)
        self.components = len(spin_axes)
        self.unknowns = int(np.prod(self.free_shape)) * self.components
        sphere = np.full(lattice.shape, -1)
        sphere[..., 1:-1] = np.arange(self.unknowns // self.components).reshape(self.free_shape)
        self.groups = tuple(
            group for axis in range(lattice.dimension) if (group := self._group(axis, sphere, jump)) is not None
        )

    def _group(self, axis: int, sphere: np.ndarray, jump: np.ndarray) -> ContactGroup | None:
        slots = tangential(axis, self.spin_axes)
        if not slots:
            return None
        dimension = self.lattice.dimension
        acting = ~self.lattice.between_driven(axis)
        below, above = lower(sphere, axis, dimension)[acting], upper(sphere, axis, dimension)[acting]
        at_top = upper(np.broadcast_to(np.arange(sphere.shape[-1]), sphere.shape), axis, dimension)[acting]
        ends_at_top = (above < 0) & (at_top == sphere.shape[-1] - 1)
        count = len(below)
        rows, columns, signs = [], [], []
        for component, slot in enumerate(slots):
            for ends, sign in ((below, -1.0), (above, 1.0)):
                free = np.flatnonzero(ends >= 0)
                rows.append(component * count + free)
                columns.append(ends[free] * self.components + slot)
                signs.append(np.full(len(free), sign))
        difference = sparse.csr_matrix(
            (np.concatenate(signs), (np.concatenate(rows), np.concatenate(columns))),
            shape=(len(slots) * count, self.unknowns),
        )
        offset = jump[list(slots)][:, None] * ends_at_top
        return ContactGroup(axis, slots, acting, below, above, difference, offset, difference.T.tocsr())

    def torques(self, forces: list[np.ndarray]) -> np.ndarray:
        """Transpose of the differences: (unknowns,) from one array (d, n) a group."""
        return np.sum([g.transposed @ f.ravel() for g, f in zip(self.groups, forces, strict=True)], axis=0)

    def couplings(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of unknowns that some contact couples."""
        first, second = [], []
        for group, i, j, _ in self._blocks():
            for a, b in ((group.below, group.below), (group.above, group.above)):
                if i != j:
                    first.append(a[a >= 0] * self.components + group.slots[i])
                    second.append(b[b >= 0] * self.components + group.slots[j])
            inner = (group.below >= 0) & (group.above >= 0)
            for p, q in ((i, j), (j, i)):
                first.append(group.below[inner] * self.components + group.slots[p])
                second.append(group.above[inner] * self.components + group.slots[q])
        return np.concatenate(first), np.concatenate(second)

    def _blocks(self):  # type: ignore[no-untyped-def]
        """(group, i, j, start) for each entry i <= j of the d x d stiffness of a group, stacked in this order."""
        start = 0
        for group in self.groups:
            for i in range(len(group.slots)):
                for j in range(i, len(group.slots)):
                    yield group, i, j, start
                    start += len(group.below)

    def laplacian_map(self, entry) -> sparse.csr_matrix:  # type: ignore[no-untyped-def]
        """Matrix from the stacked stiffnesses of all contacts to the stored entries of the weighted Laplacian.

        entry : function (first unknowns, second unknowns) -> places of the stored entries.
        """
        places, sources, signs = [], [], []

        def add(first: np.ndarray, second: np.ndarray, source: np.ndarray, sign: float) -> None:
            places.append(entry(first, second))
            sources.append(source)
            signs.append(np.full(len(first), sign))

        columns = 0
        for group, i, j, start in self._blocks():
            source = start + np.arange(len(group.below))
            columns = start + len(group.below)
            p, q = group.slots[i], group.slots[j]
            for ends in (group.below, group.above):
                free = ends >= 0
                add(ends[free] * self.components + p, ends[free] * self.components + q, source[free], 1.0)
            inner = (group.below >= 0) & (group.above >= 0)
            low, high = group.below[inner] * self.components, group.above[inner] * self.components
            add(low + p, high + q, source[inner], -1.0)
            if i != j:
                add(low + q, high + p, source[inner], -1.0)
        where = (np.concatenate(places), np.concatenate(sources))
        shape = (int(where[0].max()) + 1, columns)
        return sparse.csr_matrix((np.concatenate(signs), where), shape=shape)


def stacked(stiffness: list[np.ndarray]) -> np.ndarray:
    """Upper triangles of the stiffnesses, one array (d, d, n) a group, in the order that `laplacian_map` expects."""
    return np.concatenate([k[i, j] for k in stiffness for i in range(len(k)) for j in range(i, len(k))])


def jump_of(scene: Scene) -> np.ndarray:
    """(C,) imposed jump of the components that the minimum needs, in units of the whole jump."""
    bottom, top = scene.driven_values(scene.minimum_spin_axes)
    return (top - bottom) / (scene.jump or 1.0)
