"""Contacts of one sample as flat lists: differences, torques, and the weighted Laplacian of the Newton steps.

Staggered spins are measured from the bottom plane in units of the imposed jump, forces in units of the sample's mean
coefficient times the normal force, so that every number is of order one whatever units the scene is in. Contacts with
as many slipping components form a group: the vectors (d, n) across its n contacts have d components (equations.md).
"""

from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.conic.grouped import Arrays, Grouped
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import number_free


@dataclass(frozen=True)
class ContactGroup:
    """n contacts, each with d slipping components.

    below, above : (d, n), the unknown at either end; -1 where the spin is imposed.
    offset : (d, n), what the imposed spins add to the difference.
    unknowns : length of a vector of spins.
    """

    below: np.ndarray
    above: np.ndarray
    offset: np.ndarray
    unknowns: int

    @cached_property
    def operator(self) -> sparse.csr_matrix:
        """(d*n, unknowns): the part of the differences that is linear in the spins."""
        row = np.arange(self.below.size)
        ends = [(self.below.ravel(), -1.0), (self.above.ravel(), 1.0)]
        rows = np.concatenate([row[end >= 0] for end, _ in ends])
        columns = np.concatenate([end[end >= 0] for end, _ in ends])
        signs = np.concatenate([np.full((end >= 0).sum(), sign) for end, sign in ends])
        return sparse.csr_matrix((signs, (rows, columns)), shape=(self.below.size, self.unknowns))

    @cached_property
    def transposed(self) -> sparse.csr_matrix:
        return self.operator.T.tocsr()

    def copies(self, count: int) -> "ContactGroup":
        """The same contacts so many times, each time over spins of their own."""
        shift = self.unknowns * np.arange(count)[:, None]
        below, above = (
            np.where(end[:, None] >= 0, end[:, None] + shift, -1).reshape(len(end), -1)
            for end in (self.below, self.above)
        )
        return ContactGroup(below, above, np.tile(self.offset, count), self.unknowns * count)

    def with_one_more(self, column: np.ndarray) -> "ObliqueGroup":
        """The same contacts over one unknown more, the last, of which a unit adds column (d, n) to the differences;
        nothing is imposed."""
        operator = sparse.csr_array(sparse.hstack([self.operator, sparse.csr_array(column.reshape(-1, 1))]))
        return ObliqueGroup(operator, np.zeros_like(column))


@dataclass(frozen=True)
class ObliqueGroup:
    """n contacts whose slips are any sums of the unknowns at their ends.

    operator : (d*n, unknowns), slips of the spins. offset : as of ContactGroup.
    """

    operator: sparse.csr_array
    offset: np.ndarray

    @cached_property
    def transposed(self) -> sparse.csr_array:
        return self.operator.T.tocsr()


@dataclass(frozen=True)
class Places:
    """Where the n contacts of a group are in flat arrays.

    contact : (n,), their numbers. slot : (d, n), the spin component of each row.
    """

    contact: np.ndarray
    slot: np.ndarray


@dataclass(frozen=True)
class ContactSystem:
    """Groups of contacts, all of them ContactGroup or ObliqueGroup, over a common vector of unknown spins.

    places : where they are on a lattice, a group each; place : (D, unknowns), where the spins are. None of a system
    that is not that of a whole lattice.
    """

    unknowns: int
    groups: tuple[Any, ...]
    places: tuple[Places, ...] = ()
    place: np.ndarray | None = None

    @cached_property
    def offset(self) -> Arrays:
        """What the imposed spins add to the differences, (d, n) a group."""
        return Grouped(group.offset for group in self.groups)

    @cached_property
    def operator(self) -> sparse.csr_matrix:
        """(rows, unknowns): what is linear in the spins, one component of one contact a row."""
        return sparse.csr_matrix(sparse.vstack([group.operator for group in self.groups]))

    @cached_property
    def _rows(self) -> list[tuple[slice, tuple[int, ...]]]:
        ends = np.cumsum([offset.size for offset in self.offset]).tolist()
        return [(slice(end - offset.size, end), offset.shape) for end, offset in zip(ends, self.offset, strict=True)]

    def copies(self, count: int) -> "ContactSystem":
        """So many samples as parts of one system that no contact joins, one after the other in every group."""
        if count == 1:
            return self
        groups = tuple(group.copies(count) for group in self.groups)
        place = None if self.place is None else np.tile(self.place, count)
        return ContactSystem(self.unknowns * count, groups, place=place)

    def change(self, step: np.ndarray) -> Arrays:
        """Change of the differences (d, n) a group that a change of the spins (unknowns,) makes; or of S samples."""
        rows = self.operator @ step
        return Grouped(rows[own].reshape(*shape, *rows.shape[1:]) for own, shape in self._rows)

    def differences(self, spins: np.ndarray) -> Arrays:
        """Difference of the spins across each contact, (d, n) a group."""
        return self.change(spins) + self.offset

    def torques(self, forces: Arrays) -> np.ndarray:
        """Transpose of the differences: (unknowns,) from (d, n) a group, or (unknowns, S) from (d, n, S)."""
        pairs = zip(self.groups, forces, strict=True)
        return reduce(np.add, (group.transposed @ force.reshape(-1, *force.shape[2:]) for group, force in pairs))

    def gather(self, values: np.ndarray, replica: int) -> Arrays:
        """Values (n,) a group of one sample; values : (R, E)."""
        return Grouped(values[replica][places.contact] for places in self.places)

    def gather_vectors(self, values: np.ndarray, replica: int) -> Arrays:
        """Vectors (d, n) a group of one sample; values : (C, R, E)."""
        return Grouped(values[places.slot, replica, places.contact] for places in self.places)

    def scatter(self, numbers: Arrays, values: np.ndarray, replica: int | slice) -> None:
        """Inverse of :meth:`gather`: write the numbers into the values, or those (R, n) of several samples."""
        for places, new in zip(self.places, numbers, strict=True):
            values[replica][..., places.contact] = new

    def scatter_vectors(self, vectors: Arrays, values: np.ndarray, replica: int | slice) -> None:
        """The same of vectors, inverse of :meth:`gather_vectors`, or of those (R, d, n) of several samples."""
        by_replica = np.moveaxis(values, 1, 0)
        for places, new in zip(self.places, vectors, strict=True):
            by_replica[replica][..., places.slot, places.contact] = new

    def pieces(self, chosen: Arrays) -> tuple[int, np.ndarray]:
        """Number of the pieces that the chosen contacts, (n,) masks a group, join the spins to, and that of each."""
        below, above = (
            np.concatenate([values.ravel() for values in Grouped(ends)[chosen]])
            for ends in ([g.below for g in self.groups], [g.above for g in self.groups])
        )
        both, size = (below >= 0) & (above >= 0), (self.unknowns, self.unknowns)
        graph = sparse.coo_matrix((np.ones(both.sum(), dtype=np.int8), (below[both], above[both])), shape=size)
        count, piece = connected_components(graph, directed=False)
        return count, piece

    def terms(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """All terms of the Laplacian, each pair once: first, second unknown, place in `stacked` stiffness, factor."""
        found, start = [], 0
        for group in self.groups:
            d, count = group.offset.shape
            ends = [_ends(group.operator[slip * count : (slip + 1) * count]) for slip in range(d)]
            for i, j in combinations_with_replacement(range(d), 2):
                several = product(ends[i], ends[j]) if i != j else combinations_with_replacement(ends[i], 2)
                for (first, of_first), (second, of_second) in several:
                    factor = of_first * of_second * np.where((first == second) & (i != j), 2.0, 1.0)
                    free = np.flatnonzero(factor)
                    found.append((first[free], second[free], start + free, factor[free]))
                start += count
        first, second, source, factor = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return first, second, source, factor


def _ends(slips: sparse.csr_matrix) -> list[tuple[np.ndarray, np.ndarray]]:
    """The first unknown (n,) of each of these slips, and its factor, 0 where there is none; the second, and so on."""
    counts = np.diff(slips.indptr)
    row, most = np.repeat(np.arange(len(counts)), counts), int(counts.max(initial=1))
    place = np.arange(len(row)) - slips.indptr[row]
    unknown, factor = np.zeros((most, len(counts)), dtype=np.int64), np.zeros((most, len(counts)))
    unknown[place, row], factor[place, row] = slips.indices, slips.data
    return list(zip(unknown, factor, strict=True))


def stacked(stiffness: Arrays) -> np.ndarray:
    """Upper triangles of the stiffnesses, (d, d, n) a group, in the order that `terms` counts them."""
    return np.concatenate([k[i, j] for k in stiffness for i in range(len(k)) for j in range(i, len(k))])


def free_spins(staggered: np.ndarray) -> np.ndarray:
    """Spins (R, unknowns) of the free spheres; staggered : (C, R, *N)."""
    return np.moveaxis(staggered[..., 1:-1], 0, -1).reshape(staggered.shape[1], -1)


def place_free_spins(staggered: np.ndarray, replica: int | slice, spins: np.ndarray) -> None:
    """Inverse of :func:`free_spins`: write the spins (unknowns,) of one sample, or those (R, unknowns) of several."""
    free = staggered[:, replica, ..., 1:-1]
    free[...] = np.moveaxis(spins.reshape(*free.shape[1:], -1), -1, 0)


def lattice_system(lattice: Lattice, spin_axes: tuple[int, ...], jump: np.ndarray) -> ContactSystem:
    """All contacts of a lattice that can slip; unknown = free sphere * components + position in `spin_axes`.

    jump : (C, *plane), staggered spin of the top, measured from the bottom; (C,) if it is the same on all of it.
    """
    sphere, free = number_free(lattice.shape), int(np.prod(lattice.free_shape))
    is_top = np.zeros(lattice.shape, dtype=bool)
    is_top[..., -1] = True
    unknowns, felt = free * len(spin_axes), lattice.felt(spin_axes)
    (below, above), rises = sphere.ravel()[lattice.ends], is_top.ravel()[lattice.ends[1]]
    imposed = np.broadcast_to(jump.reshape(len(jump), -1), (len(jump), lattice.sites // lattice.shape[-1]))
    groups, places = [], []
    for count in range(1, len(spin_axes) + 1):
        contact = np.flatnonzero(~lattice.between_driven & (felt.sum(axis=0) == count))
        if not len(contact):
            continue
        slot = np.nonzero(felt[:, contact].T)[1].reshape(-1, count).T
        first, second = (
            np.where(end >= 0, end * len(spin_axes) + slot, -1) for end in (below[contact], above[contact])
        )
        top = imposed[slot, lattice.column[contact]]
        groups.append(ContactGroup(first, second, top * rises[contact], unknowns))
        places.append(Places(contact, slot))
    place = np.repeat(np.indices(lattice.free_shape).reshape(lattice.dimension, -1), len(spin_axes), axis=1)
    return ContactSystem(unknowns, tuple(groups), tuple(places), place)
