"""What there is to find, and the slips that it makes: rows y = K x + b over the contacts that act.

The unknowns x are spins of the free spheres by component. Of a network of any kind the rows lie along the tangents of
its contacts (:meth:`ContactSystem.of`). Where components do not mix and have no odd loop, signs by which neighbours
differ make differences of the sums of spins, and a row is that of two unknowns (:meth:`ContactSystem.signed`). Of a
lattice such rows follow from its strides (:func:`lattice_system`): staggered spins are measured from the bottom plane
in units of the imposed jump, forces in units of the sample's mean coefficient times the normal force, so that every
number is of order one whatever units the scene is in.

Letters: R samples, N spheres, E contacts, C spin components; of the n contacts of a system d is the most rows that one
has (equations.md). Vectors across contacts are (d, n): a contact with fewer rows has them first, and 0 in the others.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import number_free
from taichi_bearings.numerics.double_double import add, scaled, two_sum
from taichi_bearings.numerics.graphs import odd_pieces
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.network import Network

OF_ROWS = ("operator", "transposed", "across", "feels")  # properties that do not depend on the imposed spins


def _nothing() -> np.ndarray:
    """An empty array, of a system that is not that of a whole network."""
    return np.zeros((0, 0), dtype=np.int64)


@dataclass(frozen=True)
class ContactSystem:
    """n contacts, each with up to d rows, over a vector of unknown spins.

    offset : b, (d, n), what the imposed spins add to the slips. felt : (d, n) mask, the rows that there are.
    ends : (2, d, n), the unknowns whose difference is taken, the one below first; -1 where the spin is imposed. None
    where the slips are any sums of unknowns: `slips`, K, (d*n, unknowns), one row of one contact after the other.

    What follows is empty or None in a system that is not that of a whole network:
    contact : (n,), the numbers of the contacts among the E of the network. slot : (d, n), the spin component or the
    tangent of each row. place : (D, unknowns), where the spins are.
    network : whose contacts these are; None of a lattice in strides. sphere : (unknowns,), that each belongs to.
    moved : (N, C), number of each unknown, -1 where the spin is imposed, or held at 0. known : (N, C), spins
    u = R omega that are no unknowns. sign : (N, C), factors that turn u into unknowns; None for all 1.
    motions : number of motions without slip before a spin of each was held; None if undecided. kept : what methods have
    made of the network, for other coefficients on it.
    """

    unknowns: int
    offset: np.ndarray
    felt: np.ndarray
    ends: Any = None
    slips: sparse.csr_array | None = None
    contact: np.ndarray | None = None
    slot: np.ndarray | None = None
    place: np.ndarray | None = None
    network: Any = None
    sphere: np.ndarray = field(default_factory=_nothing)
    moved: np.ndarray = field(default_factory=_nothing)
    known: np.ndarray = field(default_factory=_nothing)
    sign: np.ndarray | None = None
    motions: int | None = None
    kept: dict[Any, Any] = field(default_factory=dict, compare=False)

    @classmethod
    def of(cls, bearing: Bearing) -> "ContactSystem":
        """Rows along the tangents of all contacts that act in parts which touch a driven sphere: those with a
        coefficient in some sample, and a free end. The unknowns are u of the spheres that these reach, without a spin
        of each motion that slips nowhere."""
        found = cls.before_motions(bearing)
        return found if found.motions is not None else found.without_motions()

    @classmethod
    def before_motions(cls, bearing: Bearing) -> "ContactSystem":
        """As :meth:`of`; where normals are oblique, motions that slip nowhere are still among the unknowns, and their
        number is None."""
        network, contact = bearing.network, bearing.acting
        moves = network.reached(contact)
        contact = contact[moves[network.contact[:, contact]].any(axis=0)]
        known, wanted, number = network.needed(bearing.driven_speed, contact, moves)
        return cls._over(network, contact, known, wanted, number)

    @classmethod
    def _over(
        cls, network: Network, contact: np.ndarray, known: np.ndarray, wanted: np.ndarray, number: int | None
    ) -> "ContactSystem":
        """Rows along the tangents of these contacts over the spins that are `wanted`, (N, C) mask."""
        spins, sphere = known[network.contact[:, contact]].sum(axis=0), np.nonzero(wanted)[0]
        moved = np.where(wanted, np.cumsum(wanted).reshape(wanted.shape) - 1, -1)
        offset = np.einsum("tek,ek->te", network.tangents[:, contact], spins)
        return cls(
            len(sphere),
            offset,
            np.ones(offset.shape, dtype=bool),
            slips=network.operator(contact, moved),
            contact=contact,
            slot=np.broadcast_to(np.arange(len(offset))[:, None], offset.shape),
            place=np.asarray(network.center[sphere].T),
            network=network,
            sphere=sphere,
            moved=moved,
            known=known,
            motions=number,
        )

    def without_motions(self) -> "ContactSystem":
        """The same with one spin held of each motion that slips nowhere, and the number of these."""
        network, moves = self.network, np.any(self.moved >= 0, axis=1)
        found = network.motions(self.operator, self.sphere, self.numbers, moves)
        wanted = (self.moved >= 0) & ~np.isin(self.moved, found.held)
        number = found.number if found.number_is_certain else None
        return ContactSystem._over(network, self.numbers, self.known, wanted, number)

    def with_motions(self, number: int) -> "ContactSystem":
        """The same where it is known how many motions slip nowhere."""
        return self._with(motions=number)

    def _with(self, **changes: Any) -> "ContactSystem":
        """The same rows and spins with other values of some fields; what follows from rows alone is kept."""
        found = replace(self, **changes)
        vars(found).update({name: of for name, of in vars(self).items() if name in OF_ROWS})
        return found

    def signed(self) -> "ContactSystem | None":
        """The same unknowns and contacts, but for those that feel none of them, over signed spins s u, (N, C) signs s;
        None where components mix or have an odd loop. The difference s_j u_j - s_i u_i of a contact is s_j (u_i + u_j).
        """
        network, needed = self.network, np.flatnonzero((self.moved >= 0).any(axis=0))
        if not network.along_axes(self.contact):
            return None
        feels, contact = self.feels, network.contact[:, self.contact]
        sign = np.ones(self.known.shape)
        for k in needed:
            ends = contact[:, feels[:, k]]
            odd, sign[:, k] = odd_pieces(network.spheres, *ends)
            if odd[ends].any():
                return None
        known = sign * self.known
        own, slot, felt = slipping_components(feels[:, needed].T)
        slot, pair = needed[slot], contact[:, own]
        ends, (first, second) = self.moved[pair[:, None], slot], known[pair[:, None], slot]
        offset, ends = np.where(felt, second - first, 0.0), np.where(felt, ends, -1)
        return replace(
            self, offset=offset, felt=felt, ends=ends, slips=None, contact=self.numbers[own], slot=slot, sign=sign
        )

    @property
    def numbers(self) -> np.ndarray:
        """`contact`, of a system of a whole network."""
        assert self.contact is not None
        return self.contact

    @cached_property
    def across(self) -> np.ndarray:
        """Tangents (d, n, C) of the contacts."""
        return np.asarray(self.network.tangents[:, self.contact])

    @cached_property
    def feels(self) -> np.ndarray:
        """(n, C), True for the components of spins that move and make a contact slip."""
        return np.any(self.across, axis=0) & np.any(self.moved >= 0, axis=0)

    def of_contacts(self, bearing: Bearing, sample: int = 0) -> tuple[np.ndarray, ...]:
        """What the functions of the law take of these contacts in one sample, (n,) each."""
        return tuple(values[sample, self.contact] for values in bearing.material)

    def in_units(self, speed: float) -> "ContactSystem":
        """The same with imposed spins in units of a speed."""
        return self._with(offset=self.offset / speed, known=self.known / speed)

    def with_offset(self, offset: np.ndarray) -> "ContactSystem":
        """The same with other slips (d, n) of the imposed spins."""
        return self._with(offset=offset)

    def all_spins(self, spins: np.ndarray) -> np.ndarray:
        """u (N, C) of all spheres from the unknowns (unknowns,)."""
        own = np.append(spins, 0.0)[self.moved]
        return np.where(self.moved >= 0, own if self.sign is None else self.sign * own, self.known)

    def to_all_digits(self, spins: np.ndarray) -> np.ndarray:
        """Slips (d, n) of these spins (unknowns,), to all digits of theirs."""
        if self.ends is not None:
            return self.differences(spins)
        first, second = self.all_spins(spins)[self.network.contact[:, self.contact]]
        high, low = two_sum(first, second)
        parts = [scaled(self.across[..., k], (high[:, k], low[:, k])) for k in range(high.shape[1])]
        return np.asarray(reduce(add, parts)[0])

    def on_contacts(self, forces: np.ndarray) -> np.ndarray:
        """T^T f, (E, C), of forces (d, n) in the rows; 0 on contacts of the network that are not in the system."""
        network: Network = self.network
        found = np.zeros((network.contacts, network.components))
        if self.sign is None:
            found[self.contact] = np.einsum("te,tek->ek", forces, self.across)
            return found
        second = network.contact[1, self.contact]
        assert self.slot is not None
        for row, slot in zip(forces, self.slot, strict=True):
            found[self.contact, slot] += self.sign[second, slot] * row
        return found

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
