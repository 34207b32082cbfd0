"""The unknown spins of a problem, and the slips that they make: rows y = K x + b over the contacts that act.

The unknowns x are components of the spins of free spheres. In a network of any kind the rows lie along the tangents of
its contacts (:meth:`ContactSystem.of`). Where components do not mix and no loop is odd, signs by which neighbours
differ turn sums of spins into differences, and a row is the difference of two unknowns (:meth:`ContactSystem.signed`).
For a lattice such rows follow from its strides (:func:`lattice_system`): staggered spins are measured from the bottom
plane in units of the imposed jump, forces in units of the sample's mean coefficient times the normal force, so that
every number is of order one whatever units the scene is in.

Letters: R samples, N spheres, E contacts, C spin components, D dimensions; n contacts of a system, of which d is the
most rows that one has (equations.md). Vectors across contacts are (d, n): a contact with fewer rows has them first, and
0 in the others. A contact "feels" a component of the spins that makes it slip.
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
    """An empty array, for fields that only the system of a whole network has."""
    return np.zeros((0, 0), dtype=np.int64)


@dataclass(frozen=True)
class ContactSystem:
    """n contacts, each with up to d rows, over a vector of unknown spins.

    unknowns : their number.
    offset : b, (d, n), what the imposed spins contribute to the slips.
    felt : (d, n) mask of the rows that exist.
    ends : (2, d, n), the unknowns whose difference is taken, the one below first; -1 where the spin is imposed. None
        where slips are other sums of unknowns.
    slips : K, (d*n, unknowns), where `ends` is None: all first rows of the contacts, then all second ones.

    The other fields are empty or None unless the system is that of a whole network:

    contact : (n,), numbers of the contacts among the E of the network.
    slot : (d, n), the spin component or the tangent of each row.
    place : (D, unknowns), where the spins are.
    whole : the network whose contacts these are; None for a lattice in strides.
    sphere : (unknowns,), the sphere of each unknown.
    moved : (N, C), number of each unknown, -1 where the spin is imposed, or held at 0.
    known : (N, C), spins u = R omega that are not unknown.
    sign : (N, C), factors that turn u into unknowns; None for all 1.
    motions : number of motions without slip before one spin of each was held; None if undecided.
    kept : what methods have made of the network, for other coefficients on it.
    """

    unknowns: int
    offset: np.ndarray
    felt: np.ndarray
    ends: np.ndarray | None = None
    slips: sparse.csr_array | None = None
    contact: np.ndarray | None = None
    slot: np.ndarray | None = None
    place: np.ndarray | None = None
    whole: Network | None = None
    sphere: np.ndarray = field(default_factory=_nothing)
    moved: np.ndarray = field(default_factory=_nothing)
    known: np.ndarray = field(default_factory=_nothing)
    sign: np.ndarray | None = None
    motions: int | None = None
    kept: dict[object, Any] = field(default_factory=dict, compare=False)

    @classmethod
    def of(cls, bearing: Bearing) -> "ContactSystem":
        """The system of a bearing: rows along the tangents of all contacts that act (with a coefficient in some sample,
        and a free end) in parts which touch a driven sphere. The unknowns are u of the spheres in these parts; of each
        motion that makes no contact slip one spin is left out."""
        found = cls.before_motions(bearing)
        return found if found.motions is not None else found.without_motions()

    @classmethod
    def before_motions(cls, bearing: Bearing) -> "ContactSystem":
        """The system as :meth:`of` makes it, except that with oblique normals motions that make no contact slip are
        still among the unknowns; then `motions` is None."""
        network, contact = bearing.network, bearing.acting
        moves = network.reached(contact)
        contact = contact[moves[network.contact[:, contact]].any(axis=0)]
        known, wanted, number = network.needed(bearing.driven_speed, contact, moves)
        return cls._over(network, contact, known, wanted, number)

    @classmethod
    def _over(
        cls, network: Network, contact: np.ndarray, known: np.ndarray, wanted: np.ndarray, number: int | None
    ) -> "ContactSystem":
        """Rows along the tangents of some contacts over some spins.

        contact : numbers (n,) of the contacts. known : (N, C), spins that are imposed. wanted : (N, C) mask of the
            unknowns. number : `motions`.
        """
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
            whole=network,
            sphere=sphere,
            moved=moved,
            known=known,
            motions=number,
        )

    def without_motions(self) -> "ContactSystem":
        """The system in which one spin of each motion that makes no contact slip is held at 0, with the number of such
        motions."""
        network, moves = self.network, np.any(self.moved >= 0, axis=1)
        found = network.motions(self.operator, self.sphere, self.numbers, moves)
        wanted = (self.moved >= 0) & ~np.isin(self.moved, found.held)
        number = found.number if found.number_is_certain else None
        return ContactSystem._over(network, self.numbers, self.known, wanted, number)

    def with_motions(self, number: int) -> "ContactSystem":
        """The same system with a known number of motions that make no contact slip."""
        return self._with(motions=number)

    def _with(self, **changes: Any) -> "ContactSystem":
        """A system with the same rows and unknowns, and other values of some fields; properties that follow from rows
        alone are kept."""
        found = replace(self, **changes)
        vars(found).update({name: of for name, of in vars(self).items() if name in OF_ROWS})
        return found

    def signed(self) -> "ContactSystem | None":
        """The system over signed spins s u, with signs s (N, C), without contacts that feel no unknown; None where
        components mix or have an odd loop. The difference s_j u_j - s_i u_i of a contact between spheres i and j is s_j
        (u_i + u_j)."""
        network, needed = self.network, np.flatnonzero((self.moved >= 0).any(axis=0))
        if not network.along_axes(self.numbers):
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
    def network(self) -> Network:
        """`whole`, for the system of a whole network."""
        assert self.whole is not None
        return self.whole

    @property
    def numbers(self) -> np.ndarray:
        """`contact` (n,), for the system of a whole network."""
        assert self.contact is not None
        return self.contact

    @cached_property
    def across(self) -> np.ndarray:
        """Tangents (d, n, C) of the contacts."""
        return np.asarray(self.network.tangents[:, self.contact])

    @cached_property
    def feels(self) -> np.ndarray:
        """(n, C) mask, true for the components of spins that are unknown for some sphere and make a contact slip."""
        return np.any(self.across, axis=0) & np.any(self.moved >= 0, axis=0)

    def of_contacts(self, bearing: Bearing, sample: int = 0) -> tuple[np.ndarray, ...]:
        """Material constants of these contacts in one sample, as the functions of the contact law take them, (n,)
        each."""
        return tuple(values[sample, self.contact] for values in bearing.material)

    def in_units(self, speed: float) -> "ContactSystem":
        """The system with imposed spins in units of a speed."""
        return self._with(offset=self.offset / speed, known=self.known / speed)

    def with_offset(self, offset: np.ndarray) -> "ContactSystem":
        """The system with other slips (d, n) from the imposed spins."""
        return self._with(offset=offset)

    def all_spins(self, spins: np.ndarray) -> np.ndarray:
        """u (N, C) of all spheres from the unknowns (unknowns,)."""
        own = np.append(spins, 0.0)[self.moved]
        return np.where(self.moved >= 0, own if self.sign is None else self.sign * own, self.known)

    def to_all_digits(self, spins: np.ndarray) -> np.ndarray:
        """Slips (d, n) for these unknowns (unknowns,), with the relative precision of doubles even where terms
        cancel."""
        if self.ends is not None:
            return self.differences(spins)
        first, second = self.all_spins(spins)[self.network.contact[:, self.contact]]
        high, low = two_sum(first, second)
        parts = [scaled(self.across[..., k], (high[:, k], low[:, k])) for k in range(high.shape[1])]
        return np.asarray(reduce(add, parts)[0])

    def on_contacts(self, forces: np.ndarray) -> np.ndarray:
        """Vectors T^T f, (E, C), with T the tangents, of forces f (d, n) in the rows; 0 on contacts that are not in the
        system."""
        network = self.network
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
        """The matrix K, (d*n, unknowns): the part of the slips that is linear in the unknowns, all first rows, then all
        second ones."""
        if self.ends is None:
            return self.slips
        ends = self.ends.reshape(2, -1)
        side, row = np.nonzero(ends >= 0)
        entries = np.where(side == 0, -1.0, 1.0), (row, ends[side, row])
        return sparse.csr_array(entries, shape=(self.offset.size, self.unknowns))

    @cached_property
    def transposed(self) -> sparse.csr_array:
        """The transpose of `operator`, (unknowns, d*n)."""
        return self.operator.T.tocsr()

    def copies(self, count: int) -> "ContactSystem":
        """`count` copies of the contacts, each over spins of its own: samples as parts of one system that no contact
        joins."""
        if count == 1:
            return self
        assert self.ends is not None
        shift = np.repeat(self.unknowns * np.arange(count), self.offset.shape[1])
        ends = np.tile(self.ends, count)
        ends = np.where(ends >= 0, ends + shift, -1)
        offset, felt = np.tile(self.offset, count), np.tile(self.felt, count)
        place = None if self.place is None else np.tile(self.place, count)
        return ContactSystem(self.unknowns * count, offset, felt, ends, place=place)

    def change(self, step: np.ndarray) -> np.ndarray:
        """Change of the slips (d, n) for a change `step` (unknowns,) of the spins; or (d, n, S) for (unknowns, S)."""
        return (self.operator @ step).reshape(*self.offset.shape, *step.shape[1:])

    def differences(self, spins: np.ndarray) -> np.ndarray:
        """Slips (d, n) for spins (unknowns,): the differences of spins across contacts."""
        return self.change(spins) + self.offset

    def torques(self, forces: np.ndarray) -> np.ndarray:
        """Torques (unknowns,) of forces (d, n), or (unknowns, S) of forces (d, n, S): K^T times the forces."""
        return self.transposed @ forces.reshape(-1, *forces.shape[2:])

    def gather_vectors(self, values: np.ndarray, replica: int) -> np.ndarray:
        """Vectors (d, n) of one sample, read from values (C, R, E)."""
        return values[self.slot, replica, self.contact]

    def scatter_vectors(self, vectors: np.ndarray, values: np.ndarray, replica: int | slice) -> None:
        """Write vectors (d, n) of one sample, or (R, d, n) of several, into values (C, R, E): the inverse of
        :meth:`gather_vectors`."""
        np.moveaxis(values, 1, 0)[replica][..., self.slot, self.contact] = vectors

    def pieces(self, chosen: np.ndarray) -> tuple[int, np.ndarray]:
        """Number of the pieces that the contacts of the mask `chosen` (n,) make of the unknowns, and the number
        (unknowns,) of the piece of each unknown."""
        assert self.ends is not None
        below, above = self.ends[:, :, chosen].reshape(2, -1)
        both, size = (below >= 0) & (above >= 0), (self.unknowns, self.unknowns)
        graph = sparse.coo_matrix((np.ones(both.sum(), dtype=np.int8), (below[both], above[both])), shape=size)
        count, piece = connected_components(graph, directed=False)
        return count, piece

    def terms(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """All terms of the Laplacian K^T (stiffness) K, each pair of unknowns once, as four arrays: first and second
        unknown, place in the `stacked` stiffness, factor."""
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
        """For row `slip` (0 to d - 1) of every contact, a list of pairs of arrays (n,): its first unknown and the
        factor of that, 0 if it has none; then its second, and so on."""
        if self.ends is None:
            count = self.offset.shape[1]
            return _ends(self.operator[slip * count : (slip + 1) * count])
        (below, above), differ = self.ends[:, slip], self.ends[0, slip] != self.ends[1, slip]
        return [
            (np.maximum(end, 0), np.where((end >= 0) & differ, factor, 0.0))
            for end, factor in ((below, -1.0), (above, 1.0))
        ]


def _ends(slips: sparse.csr_matrix) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each row of the matrix `slips` (n, unknowns) the list that :meth:`ContactSystem._unknowns_of` describes."""
    counts = np.diff(slips.indptr)
    row, most = np.repeat(np.arange(len(counts)), counts), int(counts.max(initial=1))
    place = np.arange(len(row)) - slips.indptr[row]
    unknown, factor = np.zeros((most, len(counts)), dtype=np.int64), np.zeros((most, len(counts)))
    unknown[place, row], factor[place, row] = slips.indices, slips.data
    return list(zip(unknown, factor, strict=True))


def stacked(stiffness: np.ndarray) -> np.ndarray:
    """Upper triangles of the stiffnesses (d, d, n), as one vector, in the order in which :meth:`ContactSystem.terms`
    counts them."""
    return np.concatenate([stiffness[i, j] for i in range(len(stiffness)) for j in range(i, len(stiffness))])


def slipping_components(felt: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contacts (n,) that feel any component; the components (d, n) that each feels, first; and a mask (d, n) that is
    false where fewer than d are felt. felt : (C, E) mask of the components that each contact feels."""
    contact, most = np.flatnonzero(felt.any(axis=0)), felt.sum(axis=0).max(initial=1)
    slot = np.argsort(~felt[:, contact], axis=0, kind="stable")[:most]
    return contact, slot, felt[slot, contact]


def free_spins(staggered: np.ndarray) -> np.ndarray:
    """Spins (R, unknowns) of the free spheres, from staggered spins (C, R, *N) of all."""
    return np.moveaxis(staggered[..., 1:-1], 0, -1).reshape(staggered.shape[1], -1)


def place_free_spins(staggered: np.ndarray, replica: int | slice, spins: np.ndarray) -> None:
    """Write spins (unknowns,) of one sample, or (R, unknowns) of several, into staggered spins (C, R, *N): the inverse
    of :func:`free_spins`."""
    free = staggered[:, replica, ..., 1:-1]
    free[...] = np.moveaxis(spins.reshape(*free.shape[1:], -1), -1, 0)


def lattice_system(lattice: Lattice, spin_axes: tuple[int, ...], jump: np.ndarray) -> ContactSystem:
    """The system of all contacts of a lattice that can slip. The number of an unknown is that of its free sphere times
    the number of components, plus its position in `spin_axes`.

    jump : (C, *plane), staggered spin of the top, measured from the bottom; (C,) if it is the same on the whole top.
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
