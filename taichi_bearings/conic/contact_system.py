"""The unknown spins of a problem, and the slips that they make: slip = K x + b for each contact.

The unknowns x are components of the spins of free spheres; K is a sparse matrix, and b is what imposed spins
contribute. A row of K belongs to one slip component of one contact. There are three forms of rows:

* in any network a slip component is that along a tangent of the contact (:meth:`ContactSystem.of`);
* where components of the spins do not mix and no loop of contacts is odd, the spins get signs, opposite for neighbours,
  so that a row is the difference of two unknowns (:meth:`ContactSystem.signed`);
* the rows of a lattice are such differences too, and follow from the indices of its spheres (:func:`lattice_system`).
  Staggered spins are measured from the bottom plane, in units of the imposed jump.

Letters: R samples, N spheres, E contacts, C spin components, D dimensions; n contacts of a system, of which d is the
most slip components that one has (equations.md). Vectors across contacts are (d, n): a contact with fewer components
has them first, and 0 in the others. A contact "feels" a component of the spins that makes it slip; u = radius * spin.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from scipy import sparse

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import number_free
from taichi_bearings.numerics.double_double import Pair, add, scaled, subtract
from taichi_bearings.numerics.graphs import odd_pieces, pieces
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.network import Network

# cached properties that stay when imposed spins change
OF_ROWS = ("operator", "transposed", "across", "feels")


def _nothing() -> np.ndarray:
    """Return an empty array (0, 0), the value of fields that only the system of a whole network has."""
    return np.zeros((0, 0), dtype=np.int64)


@dataclass(frozen=True)
class ContactSystem:
    """n contacts, each with up to d slip components (rows), over a vector of unknown spins x: slip = K x + b.

    unknowns : number of unknowns.
    offset : b, (d, n), what the imposed spins contribute to the slips.
    felt : (d, n) mask of the rows that exist: a contact may have fewer than d slip components.
    ends : (2, d, n), the two unknowns whose difference (second less first) is the slip, the lower sphere first; -1
        where the spin is imposed. None where slips are other sums of unknowns.
    slips : K, (d*n, unknowns), where `ends` is None: all first rows of the contacts, then all second ones.

    The other fields are empty or None unless the system is that of a whole network, of N spheres with C spin
    components:

    contact : (n,), numbers of the contacts in the network.
    slot : (d, n), for each row the number of the spin component (normals along the axes) or of the tangent (others).
    place : (D dimensions, unknowns), where the sphere of each unknown is.
    offset_rest : (d, n), low parts of `offset` as sums of two doubles; None where `offset` is exact.
    whole : the network whose contacts these are; None for a lattice, whose neighbours follow from their indices.
    sphere : (unknowns,), the sphere of each unknown.
    moved : (N, C), number of each unknown, -1 where the spin is imposed, or held at 0.
    known : (N, C), u = radius * spin where it is not unknown.
    sign : (N, C), factors +1 and -1 that turn u into unknowns; None for all 1.
    motions : number of independent motions without slip that the spheres would have if one spin of each motion were not
        held at 0; None if they were not counted.
    """

    unknowns: int
    offset: np.ndarray
    felt: np.ndarray
    ends: np.ndarray | None = None
    slips: sparse.csr_array | None = None
    contact: np.ndarray | None = None
    slot: np.ndarray | None = None
    place: np.ndarray | None = None
    offset_rest: np.ndarray | None = None
    whole: Network | None = None
    sphere: np.ndarray = field(default_factory=_nothing)
    moved: np.ndarray = field(default_factory=_nothing)
    known: np.ndarray = field(default_factory=_nothing)
    sign: np.ndarray | None = None
    motions: int | None = None

    @classmethod
    def of(cls, bearing: Bearing) -> "ContactSystem":
        """Return the system of a bearing, with rows along the tangents of contacts.

        Contacts are those with a friction or damping above 0 in some sample and a free sphere, in connected parts that
        touch a driven sphere. The unknowns are u = radius * spin of the free spheres in these parts. For each motion
        that makes no contact slip one spin is held at 0 and left out.
        """
        found = cls.before_motions(bearing)
        return found if found.motions is not None else found.without_motions()

    @classmethod
    def before_motions(cls, bearing: Bearing) -> "ContactSystem":
        """Return the system of a bearing, with rows along the tangents of contacts. If contacts are not all along the
        axes, spheres may still have motions that make no contact slip; then the field `motions` is None."""
        network, contact = bearing.network, bearing.acting
        moves = network.reached(contact)
        contact = contact[moves[network.contact[:, contact]].any(axis=0)]
        known, wanted, number = network.needed(bearing.driven_speed, contact, moves)
        return cls._with_tangents(network, contact, known, wanted, number)

    @classmethod
    def _with_tangents(
        cls, network: Network, contact: np.ndarray, known: np.ndarray, wanted: np.ndarray, number: int | None
    ) -> "ContactSystem":
        """Return the system of some contacts of a network over some of its spins, with rows along the tangents.

        network : the spheres and their contacts.
        contact : (n,), numbers of the n contacts of the system.
        known : (N, C), u = radius * spin of N spheres with C spin components where it is imposed, length/time.
        wanted : (N, C) mask of the spins that are unknown.
        number : number of independent motions that make no contact slip, which were taken out already; None if that is
            undecided.
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
        """Return the system in which one spin of each independent motion of spheres that makes no contact slip is held
        at 0, so that no such motion is left; its field `motions` is their number."""
        network, moves = self.network, np.any(self.moved >= 0, axis=1)
        found = network.motions(self.operator, self.sphere, self.numbers, moves)
        wanted = (self.moved >= 0) & ~np.isin(self.moved, found.held)
        number = found.number if found.number_is_certain else None
        return ContactSystem._with_tangents(network, self.numbers, self.known, wanted, number)

    def with_motions(self, number: int) -> "ContactSystem":
        """Return the same system with its field `motions`, the number of motions of spheres at which no contact slips,
        set to `number`."""
        return self._with(motions=number)

    def _with(self, **changes: Any) -> "ContactSystem":
        """Return a system with the same matrix from spins to slips, and other values of some fields. Properties that
        follow from this matrix alone are not computed anew.

        changes : new values by the names of the fields."""
        found = replace(self, **changes)
        vars(found).update({name: of for name, of in vars(self).items() if name in OF_ROWS})
        return found

    def signed(self) -> "ContactSystem | None":
        """Return the system over signed spins s u, in which every slip is a difference of two unknowns. The signs s =
        +1 or -1 differ between spheres i and j in contact, so that s_j u_j - s_i u_i is s_j (u_i + u_j): the slip, up
        to its sign. Contacts that no unknown makes slip are left out.

        Return None where that is not possible: if a contact is not along an axis, so that its slip mixes components of
        the spins, or if there is a loop of an odd number of contacts.
        """
        network, needed = self.network, np.flatnonzero((self.moved >= 0).any(axis=0))
        if not network.along_axes(self.numbers):
            return None
        feels, contact = self.feels, network.contact[:, self.contact]
        # Signs by which neighbours differ, component by component; an odd loop has none.
        sign = np.ones(self.known.shape)
        for k in needed:
            ends = contact[:, feels[:, k]]
            odd, sign[:, k] = odd_pieces(network.spheres, *ends)
            if odd[ends].any():
                return None
        # A slip is now the difference of two signed spins, or of a signed spin and an imposed one.
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
        """The network whose contacts these are: the field `whole`, which is never None here."""
        assert self.whole is not None
        return self.whole

    @property
    def numbers(self) -> np.ndarray:
        """(n,), numbers of the contacts in the network: the field `contact`, which is never None here."""
        assert self.contact is not None
        return self.contact

    @cached_property
    def across(self) -> np.ndarray:
        """(d, n, C), d unit vectors at each of n contacts, at right angles to its normal: the tangents along which the
        components of its slip are measured. Their C entries belong to the spin components."""
        return np.asarray(self.network.tangents[:, self.contact])

    @cached_property
    def feels(self) -> np.ndarray:
        """(n, C) mask, True where a component of the spins makes the contact slip and is an unknown at one or both of
        its spheres. Letters: n contacts, C spin components."""
        found: np.ndarray = np.any(self.across, axis=0) & np.any(self.moved >= 0, axis=0)
        return found

    def of_contacts(self, bearing: Bearing, sample: int = 0) -> tuple[np.ndarray, ...]:
        """Return the material constants of the n contacts in one sample of a bearing, (n,) each, in the order in which
        functions of the contact law take them: friction times normal force, then viscosity, force * time / length.

        bearing : the spheres and contacts of this system, in one sample or several.
        sample : number of the sample.
        """
        return tuple(values[sample, self.contact] for values in bearing.material)

    def in_units(self, speed: float) -> "ContactSystem":
        """Return the system with imposed radius * spin and slips in units of a speed, length/time."""
        return self._with(offset=self.offset / speed, known=self.known / speed)

    def with_offset(self, offset: np.ndarray) -> "ContactSystem":
        """Return the system in which the imposed spins contribute other slips, `offset` (d, n). Letters: n contacts
        with up to d slip components."""
        return self._with(offset=offset)

    def all_spins(self, spins: np.ndarray) -> np.ndarray:
        """Return u = radius * spin of all spheres, (N, C), from the unknowns `spins` (unknowns,). Letters: C spin
        components, N spheres."""
        own = np.append(spins, 0.0)[self.moved]
        return np.where(self.moved >= 0, own if self.sign is None else self.sign * own, self.known)

    def to_all_digits(self, spins: Pair) -> np.ndarray:
        """Return the slips (d, n) of n contacts with up to d components, correct to all digits of a double even where
        spins nearly cancel. They are computed in sums of two doubles.

        spins : (unknowns,), values of the unknown spins as sums of two doubles.

        With tangents t, which are rounded, t . (u_i + u_j) of spheres i and j would have an error from the part of the
        spins along the normal n. So the slip is computed as (u_i + u_j) x n, and then turned back and projected on t.
        """
        if self.ends is not None:
            return self.precise_differences(spins)
        contact, rest = self.network.contact[:, self.contact], np.append(spins[1], 0.0)[self.moved]
        (first, second), (low_first, low_second) = self.all_spins(spins[0])[contact], rest[contact]
        high, low = add((first, low_first), (second, low_second))
        parts = [(high[:, k], low[:, k]) for k in range(high.shape[1])]
        if len(parts) == 1:
            return np.asarray(self.across[..., 0] * (parts[0][0] + parts[0][1]))
        normal = self.network.normal[self.contact]
        across = [  # (u_i + u_j) x n
            subtract(scaled(normal[:, b], parts[a]), scaled(normal[:, a], parts[b]))
            for a, b in ((1, 2), (2, 0), (0, 1))
        ]
        slip = np.stack([of[0] + of[1] for of in across], axis=1)
        return np.asarray(np.einsum("tek,ek->te", self.across, np.cross(normal, slip)))

    def on_contacts(self, forces: np.ndarray) -> np.ndarray:
        """Return T^T f for each of the E contacts of the network, (E, C) by spin component: the torque over radius that
        the force f exerts on either sphere. T are the tangents, which give the slip T (u_i + u_j) of spheres i and j.
        Contacts that are not in the system have 0.

        forces : f, (d, n), on the n contacts of the system, one component along each of up to d tangents.
        """
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
        """K, (d*n, unknowns), sparse: the part of the slips that is linear in the unknowns, all first rows, then all
        second ones. Letters: n contacts with up to d slip components."""
        if self.ends is None:
            return self.slips
        ends = self.ends.reshape(2, -1).T
        free = ends >= 0
        begins = np.append(0, np.cumsum(free.sum(axis=1)))
        signs = np.broadcast_to([-1.0, 1.0], ends.shape)[free]
        return sparse.csr_array((signs, ends[free], begins), shape=(self.offset.size, self.unknowns))

    @cached_property
    def transposed(self) -> sparse.csr_array:
        """K^T, (unknowns, d*n), sparse: the transpose of `operator`. It gives the torques on the unknown spins from
        forces (d*n,): first components at all n contacts, then second ones."""
        return self.operator.T.tocsr()

    def by_rows(self) -> "ContactSystem":
        """Return the system in which each slip component is a contact of its own, (1, d*n): all first components of the
        n contacts, then all second ones. Where each slip is a difference of two unknowns, different spin components are
        not coupled in its matrices, so that those of a lattice fall apart into planes."""
        ends = None if self.ends is None else self.ends.reshape(2, 1, -1)
        found = ContactSystem(self.unknowns, self.offset.reshape(1, -1), self.felt.reshape(1, -1), ends, self.slips)
        vars(found).update(operator=self.operator, transposed=self.transposed)
        return found

    def copies(self, count: int) -> "ContactSystem":
        """Return a system of `count` copies of the contacts, one for each sample, each over spins of its own. Each slip
        must be a difference of two unknowns (`ends` is not None)."""
        if count == 1:
            return self
        assert self.ends is not None
        shift = np.repeat(self.unknowns * np.arange(count), self.offset.shape[1])
        ends = np.tile(self.ends, count)
        ends = np.where(ends >= 0, ends + shift, -1)
        offset, felt = np.tile(self.offset, count), np.tile(self.felt, count)
        place, rest = (None if of is None else np.tile(of, count) for of in (self.place, self.offset_rest))
        return ContactSystem(self.unknowns * count, offset, felt, ends, place=place, offset_rest=rest)

    def change(self, step: np.ndarray) -> np.ndarray:
        """Return the change of the slips that a change of the spins makes, (d, n), of n contacts with up to d
        components: K times the step, where K is the matrix that turns unknown spins into slips.

        step : (unknowns,), change of the spins; (unknowns, S) of S samples gives (d, n, S).
        """
        found: np.ndarray = (self.operator @ step).reshape(*self.offset.shape, *step.shape[1:])
        return found

    def differences(self, spins: np.ndarray) -> np.ndarray:
        """Return the slips (d, n) of n contacts with up to d components: K, the matrix that turns unknown spins into
        slips, times the spins, plus what imposed spins contribute.

        spins : (unknowns,), values of the unknown spins.
        """
        found: np.ndarray = self.change(spins) + self.offset
        return found

    def precise_differences(self, spins: Pair) -> np.ndarray:
        """Return the slips (d, n) of n contacts with up to d components. If each slip is a difference of two unknowns,
        even a slip far below the rounding of the spins has most of its digits.

        spins : (unknowns,), values of the unknown spins as sums of two doubles.
        """
        rest = self.change(spins[1])
        found: np.ndarray = self.differences(spins[0]) + (rest if self.offset_rest is None else rest + self.offset_rest)
        return found

    def torques(self, forces: np.ndarray) -> np.ndarray:
        """Return the torques (unknowns,) that contact forces exert: K^T times the forces, where K is the matrix that
        turns unknown spins into slips.

        forces : (d, n), on n contacts with up to d slip components; (d, n, S) of S samples gives (unknowns, S).
        """
        found: np.ndarray = self.transposed @ forces.reshape(-1, *forces.shape[2:])
        return found

    def gather_vectors(self, values: np.ndarray, replica: int) -> np.ndarray:
        """Return vectors (d, n) on the n contacts of the system, with up to d slip components, from an array over all
        contacts of the network.

        values : (C, R samples, E), the array, by spin component, sample and contact of the whole network.
        replica : number of the sample that is read.
        """
        return values[self.slot, replica, self.contact]

    def scatter_vectors(self, vectors: np.ndarray, values: np.ndarray, replica: int | slice) -> None:
        """Write vectors on the n contacts of the system into an array over all contacts of the network, in place.

        vectors : (d, n), with up to d slip components, of one sample; or (R samples, d, n) of several.
        values : (C, R, E contacts), the array, by spin component, sample and contact of the whole network.
        replica : number of the sample, or slice of the samples, to which the vectors belong.
        """
        np.moveaxis(values, 1, 0)[replica][..., self.slot, self.contact] = vectors

    def pieces(self, chosen: np.ndarray) -> tuple[int, np.ndarray]:
        """Return the number of connected pieces of the graph in which the contacts of the mask `chosen` (n,) join
        unknowns, and the number of the piece of each unknown, (unknowns,). Each slip must be a difference of two
        unknowns (`ends` is not None)."""
        assert self.ends is not None
        below, above = self.ends.compress(chosen, 2).reshape(2, -1)
        both = (below >= 0) & (above >= 0)
        piece = pieces(self.unknowns, below[both], above[both])
        return int(piece.max(initial=-1)) + 1, piece

    def terms(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return all terms of the matrix K^T S K, as four arrays (terms,). An entry of the matrix is the sum of its
        terms, each a factor times a stiffness.

        K, (d*n, unknowns), turns the unknown spins into slips of n contacts with up to d components. S is block
        diagonal, with one symmetric stiffness (d, d) for each contact. `stacked` stiffnesses are its d (d + 1) / 2
        distinct entries, one after another, each for all contacts.

        returns : four arrays (terms,):
            number of the first unknown, which gives the row of the entry;
            number of the second unknown, which gives its column; each pair of unknowns is in one order only;
            index of the stiffness in the `stacked` stiffnesses;
            factor of the stiffness.
        """
        d, count = self.offset.shape
        # K^T S K sums K[i, first] S[i, j] K[j, second] over pairs i <= j of slip components; off the diagonal of the
        # matrix one term stands for both triangles, on it a pair i < j counts twice
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
        """Return which unknown spins make one slip component of each of n contacts, as a list of pairs of arrays (n,):
        number of a first unknown and its factor, 0 if there is none; a second unknown and its factor; and so on.

        slip : number of the slip component, from 0.
        """
        if self.ends is None:
            count = self.offset.shape[1]
            return _ends(self.operator[slip * count : (slip + 1) * count])
        (below, above), differ = self.ends[:, slip], self.ends[0, slip] != self.ends[1, slip]
        return [
            (np.maximum(end, 0), np.where((end >= 0) & differ, factor, 0.0))
            for end, factor in ((below, -1.0), (above, 1.0))
        ]


def _ends(slips: sparse.csr_matrix) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the entries of a sparse matrix row by row, as a list of pairs of arrays (n,): column of the first entry of
    each row and its value, 0 if there is none; column of the second entry and its value; and so on.

    slips : (n, unknowns), the matrix that turns unknown spins into one slip component of n contacts.
    """
    counts = np.diff(slips.indptr)
    row, most = np.repeat(np.arange(len(counts)), counts), int(counts.max(initial=1))
    place = np.arange(len(row)) - slips.indptr[row]
    unknown, factor = np.zeros((most, len(counts)), dtype=np.int64), np.zeros((most, len(counts)))
    unknown[place, row], factor[place, row] = slips.indices, slips.data
    return list(zip(unknown, factor, strict=True))


def stacked(stiffness: np.ndarray) -> np.ndarray:
    """Return the upper triangles of symmetric matrices as one vector (d (d + 1) / 2 * n,): all entries [0, 0], then all
    [0, 1], and so on. For S samples the result has a last axis more, (..., S).

    stiffness : (d, d, n), stiffness of each of n contacts with up to d slip components; or (d, d, n, S) of S samples.
    """
    parts = [stiffness[i, j] for i in range(len(stiffness)) for j in range(i, len(stiffness))]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def slipping_components(felt: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which of E contacts can slip, and by which spin components, as three arrays: numbers (n,) of the contacts
    that some component makes slip; these components (d, n) of each, where d is the most that one has; and a mask (d,
    n), False where a contact has fewer than d.

    felt : (C, E) mask of the C spin components that make each contact slip.
    """
    contact, most = np.flatnonzero(felt.any(axis=0)), felt.sum(axis=0).max(initial=1)
    slot = np.argsort(~felt[:, contact], axis=0, kind="stable")[:most].astype(np.int8)  # little memory
    return contact, slot, felt[slot, contact]


def free_spins(staggered: np.ndarray) -> np.ndarray:
    """Return the staggered spins of the free spheres of a lattice, (R, unknowns); the component varies fastest.

    staggered : (C, R, *N), spins of all spheres with the sign flipped on every second one, with C components, R samples
        and N the shape of the lattice. The first and the last plane along the last axis are driven, the others free.
    """
    return np.moveaxis(staggered[..., 1:-1], 0, -1).reshape(staggered.shape[1], -1)


def place_free_spins(staggered: np.ndarray, replica: int | slice, spins: np.ndarray) -> None:
    """Write the spins of free spheres into an array over all spheres of a lattice, in place: the inverse of
    :func:`free_spins`.

    staggered : (C, R, *N), the array: spins with the sign flipped on every second sphere, with C components, R samples
        and N the shape of the lattice.
    replica : number of the sample, or a slice of samples.
    spins : (unknowns,) staggered spins of that sample, or (samples, unknowns) of the slice.
    """
    free = staggered[:, replica, ..., 1:-1]
    free[...] = np.moveaxis(spins.reshape(*free.shape[1:], -1), -1, 0)


def lattice_system(
    lattice: Lattice, spin_axes: tuple[int, ...], jump: np.ndarray, jump_rest: np.ndarray | None = None
) -> ContactSystem:
    """Return the system of all contacts of a lattice that can slip, with slips as differences of staggered spins: spins
    with their sign flipped on every second sphere.

    lattice : the spheres and contacts.
    spin_axes : numbers of the C spin components that are unknown. The number of an unknown is that of its free sphere
        times C, plus the position of its component in `spin_axes`.
    jump : (C, *plane), staggered spin of the top, measured from the bottom; (C,) if it is the same on the whole top.
    jump_rest : of the same shape, what the rounding of `jump` leaves out; None for nothing.
    """
    sphere, unknowns = number_free(lattice.shape), int(np.prod(lattice.free_shape)) * len(spin_axes)
    is_top = np.zeros(lattice.shape, dtype=bool)
    is_top[..., -1] = True
    contact, slot, felt = slipping_components(lattice.tangential_mask(spin_axes) & ~lattice.between_driven)
    sphere_at = sphere.ravel()[lattice.ends][:, None, contact]
    ends = np.where((sphere_at >= 0) & felt, sphere_at * len(spin_axes) + slot, -1)
    rises = is_top.ravel()[lattice.ends[1][contact]]  # contacts whose upper sphere is in the top plane

    def slips_by_top(imposed: np.ndarray) -> np.ndarray:
        """Return the slips of the n contacts while all free spheres rest: (d, n), d components of each.

        imposed : (C, *plane) or (C,), spins of the top; the slips have their unit.
        """
        of_columns = np.broadcast_to(imposed.reshape(len(jump), -1), (len(jump), lattice.sites // lattice.shape[-1]))
        return np.where(felt & rises, of_columns[slot, lattice.column[contact]], 0.0)

    offset, rest = slips_by_top(jump), None if jump_rest is None else slips_by_top(jump_rest)
    indices = np.indices(lattice.free_shape, dtype=np.int32)  # little memory
    place = np.repeat(indices.reshape(lattice.dimension, -1), len(spin_axes), axis=1)
    return ContactSystem(unknowns, offset, felt, ends, contact=contact, slot=slot, place=place, offset_rest=rest)
