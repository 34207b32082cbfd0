"""Contacts of one sample as flat lists: differences, torques, and the weighted Laplacian of the Newton steps.

Staggered spins are measured from the bottom plane in units of the imposed jump, forces in units of the sample's mean
coefficient times the normal force, so that every number is of order one whatever units the scene is in. Vectors across
the n contacts are (d, n), where d is the most slipping components that one has (equations.md): a contact with fewer has
them first, and 0 in the others.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import number_free


@dataclass(frozen=True)
class ContactSystem:
    """n contacts, each with up to d slipping components, over a vector of unknown spins.

    offset : (d, n), what the imposed spins add to the differences. felt : (d, n) mask, the components that there are.
    ends : (2, d, n), the unknowns whose difference is taken, the one below first; -1 where the spin is imposed. None
    where the slips are any sums of unknowns: `slips`, (d*n, unknowns), one component of one contact a row.

    contact : (n,), the numbers of the contacts in flat arrays, and slot : (d, n), the spin component of each row; place
    : (D, unknowns), where the spins are. None of a system that is not that of a whole network.
    """

    unknowns: int
    offset: np.ndarray
    felt: np.ndarray
    ends: Any = None
    slips: sparse.csr_array | None = None
    contact: np.ndarray | None = None
    slot: np.ndarray | None = None
    place: np.ndarray | None = None

    @cached_property
    def operator(self) -> sparse.csr_array:
        """(d*n, unknowns): the part of the differences that is linear in the spins, one component after the other."""
        if self.ends is None:
            return self.slips
        ends = self.ends.reshape(2, -1)
        side, row = np.nonzero(ends >= 0)
        entries = np.where(side == 0, -1.0, 1.0), (row, ends[side, row])
        return sparse.csr_array(entries, shape=(self.offset.size, self.unknowns))

    @cached_property
    def transposed(self) -> sparse.csr_array:
        return self.operator.T.tocsr()

    def copies(self, count: int) -> "ContactSystem":
        """The same contacts so many times, each time over spins of their own: samples, one after the other, as parts of
        one system that no contact joins."""
        if count == 1:
            return self
        shift = np.repeat(self.unknowns * np.arange(count), self.offset.shape[1])
        ends = np.tile(self.ends, count)
        ends = np.where(ends >= 0, ends + shift, -1)
        offset, felt = np.tile(self.offset, count), np.tile(self.felt, count)
        place = None if self.place is None else np.tile(self.place, count)
        return ContactSystem(self.unknowns * count, offset, felt, ends, place=place)

    def change(self, step: np.ndarray) -> np.ndarray:
        """Change of the differences (d, n) that a change of the spins (unknowns,) makes; or (d, n, S) of S samples."""
        return (self.operator @ step).reshape(*self.offset.shape, *step.shape[1:])

    def differences(self, spins: np.ndarray) -> np.ndarray:
        """Difference of the spins across each contact, (d, n)."""
        return self.change(spins) + self.offset

    def torques(self, forces: np.ndarray) -> np.ndarray:
        """Transpose of the differences: (unknowns,) from (d, n), or (unknowns, S) from (d, n, S)."""
        return self.transposed @ forces.reshape(-1, *forces.shape[2:])

    def gather_vectors(self, values: np.ndarray, replica: int) -> np.ndarray:
        """Vectors (d, n) of one sample; values : (C, R, E)."""
        return values[self.slot, replica, self.contact]

    def scatter_vectors(self, vectors: np.ndarray, values: np.ndarray, replica: int | slice) -> None:
        """Inverse of :meth:`gather_vectors`: write vectors (d, n) into the values, or (R, d, n) of several samples."""
        np.moveaxis(values, 1, 0)[replica][..., self.slot, self.contact] = vectors

    def pieces(self, chosen: np.ndarray) -> tuple[int, np.ndarray]:
        """Number of the pieces that the chosen contacts, (n,) mask, join the spins to, and that of each."""
        below, above = self.ends[:, :, chosen].reshape(2, -1)
        both, size = (below >= 0) & (above >= 0), (self.unknowns, self.unknowns)
        graph = sparse.coo_matrix((np.ones(both.sum(), dtype=np.int8), (below[both], above[both])), shape=size)
        count, piece = connected_components(graph, directed=False)
        return count, piece

    def terms(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """All terms of the Laplacian, each pair once: first, second unknown, place in `stacked` stiffness, factor."""
        d, count = self.offset.shape
        found, ends = [], [self._unknowns_of(slip) for slip in range(d)]
        for number, (i, j) in enumerate(combinations_with_replacement(range(d), 2)):
            several = product(ends[i], ends[j]) if i != j else combinations_with_replacement(ends[i], 2)
            for (first, of_first), (second, of_second) in several:
                factor = of_first * of_second * np.where((first == second) & (i != j), 2.0, 1.0)
                free = np.flatnonzero(factor)
                found.append((first[free], second[free], number * count + free, factor[free]))
        first, second, source, factor = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return first, second, source, factor

    def _unknowns_of(self, slip: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """The first unknown (n,) of this slip of each contact, and its factor, 0 where there is none; the second, and
        so on."""
        if self.ends is None:
            count = self.offset.shape[1]
            return _ends(self.operator[slip * count : (slip + 1) * count])
        (below, above), differ = self.ends[:, slip], self.ends[0, slip] != self.ends[1, slip]
        return [
            (np.maximum(end, 0), np.where((end >= 0) & differ, factor, 0.0))
            for end, factor in ((below, -1.0), (above, 1.0))
        ]


def _ends(slips: sparse.csr_matrix) -> list[tuple[np.ndarray, np.ndarray]]:
    """The first unknown (n,) of each of these slips, and its factor, 0 where there is none; the second, and so on."""
    counts = np.diff(slips.indptr)
    row, most = np.repeat(np.arange(len(counts)), counts), int(counts.max(initial=1))
    place = np.arange(len(row)) - slips.indptr[row]
    unknown, factor = np.zeros((most, len(counts)), dtype=np.int64), np.zeros((most, len(counts)))
    unknown[place, row], factor[place, row] = slips.indices, slips.data
    return list(zip(unknown, factor, strict=True))


def stacked(stiffness: np.ndarray) -> np.ndarray:
    """Upper triangles of the stiffnesses (d, d, n), in the order that `terms` counts them."""
    return np.concatenate([stiffness[i, j] for i in range(len(stiffness)) for j in range(i, len(stiffness))])


def slipping_components(felt: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contacts (n,) that feel any of the C components, mask (C, E); slots (d, n), those that each feels first; and
    which of these it feels, (d, n)."""
    contact, most = np.flatnonzero(felt.any(axis=0)), felt.sum(axis=0).max(initial=1)
    slot = np.argsort(~felt[:, contact], axis=0, kind="stable")[:most]
    return contact, slot, felt[slot, contact]


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
    sphere, unknowns = number_free(lattice.shape), int(np.prod(lattice.free_shape)) * len(spin_axes)
    is_top = np.zeros(lattice.shape, dtype=bool)
    is_top[..., -1] = True
    contact, slot, felt = slipping_components(lattice.tangential_mask(spin_axes) & ~lattice.between_driven)
    sphere_at = sphere.ravel()[lattice.ends][:, None, contact]
    ends = np.where((sphere_at >= 0) & felt, sphere_at * len(spin_axes) + slot, -1)
    imposed = np.broadcast_to(jump.reshape(len(jump), -1), (len(jump), lattice.sites // lattice.shape[-1]))
    rises = is_top.ravel()[lattice.ends[1][contact]]
    offset = np.where(felt & rises, imposed[slot, lattice.column[contact]], 0.0)
    place = np.repeat(np.indices(lattice.free_shape).reshape(lattice.dimension, -1), len(spin_axes), axis=1)
    return ContactSystem(unknowns, offset, felt, ends, contact=contact, slot=slot, place=place)
