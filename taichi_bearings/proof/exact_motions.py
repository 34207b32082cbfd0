"""Motions of spheres that let contacts roll exactly, where these close many loops: steps of theorems 3 and 7.

Why. Contacts that close more loops than their spheres have freedom for roll together only if the directions of their
normals agree exactly, as those of a lattice do. The least rounding breaks it, so it takes a proof without any rounding.

Symbols
    N spheres, E contacts. A : number of the contacts that are looked at. n : number of unknowns, the components of the
    spins of free spheres.
    K : matrix (3 A, n); K x are the slips of these contacts. Its kernel is all x without slip.
    J : some of the unknowns, chosen so that all others follow from them.
    q : number of *choices*, the numbers from which all spins follow: the values of J, and the imposed spins.
    s : proven floor of the singular values of K for the unknowns outside J, in units of their own (curvature.Floor).

The proof
1. An elimination in doubles finds J: the unknowns at which a pivot is nearly 0.
2. To each unknown of J belongs a motion: it is 1 there, 0 at the rest of J, and lets no contact slip. Least squares
   guess it in doubles. Where it looks like fractions, these are taken, multiplied by their common denominator, and
   products without rounding decide whether no contact slips.
3. If that holds for all of J, these motions span the kernel of K: by s > 0 nothing outside J can move alone.
4. How large friction on these contacts has to be to exert torques r that it can exert at all. It is proven that
   |K x| >= s |x / unit| for all x that are 0 on J, with a unit for each unknown. Some friction f = K x exerts r, and x
   may be taken to be 0 on J, as motions of the kernel make no slip. Then |f|^2 = r . x <= |unit r| |x / unit|, so |f|
   is no larger than |unit r| / s. Here r are the whole torques, in the range of K^T. A bound on r without its part
   along motions of the kernel is not enough, as units are 0 on J (borne.py, step 4).
5. In the same way spins that let contacts with driven spheres roll follow from each imposed spin.

Contacts join free spheres to *parts*. A part that has no more conditions than unknowns outside J needs no such proof
and is left out. Spheres whose motion is not exact are left out, too, and the other spheres are tried again.

Example. Four equal spheres in a square ring, normals along x and y. With the spins about z (1, -1, 1, -1) no contact
slips, as u_i + u_j = 0. J has the z spin of the first sphere, and the fractions are 1 and -1. It takes four contacts,
but only three can be independent in z: the fourth rolls because the numbers agree exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy import sparse

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.curvature import Floor
from taichi_bearings.proof.enclosure import UP, Enclosure, grouped_sum, joined
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.rounded_elimination import Elimination, Factor
from taichi_bearings.proof.springs import numbered, rounding_of, slip_rows

FAINT = 1e-100  # size of factors above which no part of a product underflows
# How motions are guessed. A wrong guess makes the proof fail, as what it says is checked without rounding.
NULL_PIVOT = 1e-8  # pivot up to which an unknown is put into J
DENOMINATORS = 720  # largest denominator of the fractions that are guessed
# How far a number may be off the integer that it is taken for, and the size up to which integers are allowed, so that
# sums and products of them in doubles are exact.
WHOLE, LARGEST = 1e-6, 2.0**40
LEFT_SLIP = 1e-12  # slip, of motions in which one spin is 1, that is left over and no reason to solve once more
MOST_ROUNDS = 12  # number of times that spheres are left out and the rest is tried again
MOST_EXACT_SPHERES = 20_000  # free spheres beyond which exact motions take longer than finding the minimum
# Motions that are solved for at once; most choices of one part whose motions are solved for as one sum; share of the
# choices that such sums may leave without a motion, before each choice is solved for alone.
SLOTS_AT_ONCE, CHOICES_IN_A_SUM, WORTH_A_ROUND = 64, 32, 0.5


@dataclass(frozen=True)
class ExactMotions:
    """Contacts of R samples of a packing that can all roll together, none of them with any slip, and the motions in
    which they do. There are N spheres and E contacts in all.

    spheres : (N,) mask of the free spheres that these contacts join.
    contacts : (E,) mask of these contacts: among these spheres, and with driven ones.
    floor, unit : (R,) and (N, 3), for a bound on friction: if friction on these contacts can exert given torques at
        all, some of a size of at most |unit * torque| / floor does (step 4 at the head of this file). The floor is
        infinite for samples without any such sphere. Units are 0 for spin components that are no unknowns, or from
        which the others follow (J).
    motions : how the spins of these spheres follow from a few of them and from imposed spins, such that no contact
        slips; None if there is no such contact.
    """

    spheres: np.ndarray
    contacts: np.ndarray
    floor: np.ndarray
    unit: np.ndarray
    motions: _Motions | None = None

    @classmethod
    def of(cls, network: JudgedNetwork, number: np.ndarray, rests: np.ndarray) -> ExactMotions:
        """Return a large set of contacts that can all roll at once, and the motions in which they do, proven in exact
        arithmetic. First all contacts of `rests` are tried; as long as that fails some spheres are left out, up to
        MOST_ROUNDS times. Where there are too many free spheres the set is empty.

        network : N spheres and E contacts of R samples of a packing.
        number : (N, 3), the index of each spin component among the unknowns, -1 for those that are none.
        rests : (E,) mask of the contacts that shall roll.

        The result is stored in `network.kept`, since a second proof asks for it again where a first one has failed."""
        key = number.tobytes() + rests.tobytes()
        if key not in network.kept:
            network.kept.clear()
            network.kept[key] = cls._found(network, number, rests)
        return cast(ExactMotions, network.kept[key])

    @classmethod
    def _found(cls, network: JudgedNetwork, number: np.ndarray, rests: np.ndarray) -> ExactMotions:
        """Return a large set of contacts that can all roll at once, and the motions in which they do (:meth:`of`
        without its store).

        First all spheres are tried whose motions the network needs. In each round parts of them in which nothing has
        to be proven are left out; then spheres whose motion is not exact are. The result is empty (:meth:`none`) if no
        sphere is left after MOST_ROUNDS rounds, or if there are more than MOST_EXACT_SPHERES in a sample.

        network : N spheres and E contacts of R samples of a packing.
        number : (N, 3), the index of each spin component among the unknowns, -1 for those that are none.
        rests : (E,) mask of the contacts that may be among those that roll.
        """
        spheres, (first, second) = network.reached, network.graph.contact
        following: np.ndarray | None = None  # (N, 3) mask: unknowns that follow from others, once it is known
        for _ in range(MOST_ROUNDS if spheres.sum() <= MOST_EXACT_SPHERES * network.count else 0):
            # Contacts between these spheres, and between them and driven ones; spheres without any are left out.
            or_driven = spheres | ~network.free
            contacts = rests & or_driven[first] & or_driven[second]
            touched = np.zeros(len(spheres), dtype=bool)
            touched[network.graph.contact[:, contacts]] = True
            spheres = spheres & touched
            if not spheres.any():
                break
            parts = _Parts.of(network, spheres[:, None] & (number >= 0), contacts)
            follows = parts.following() if following is None else following[parts.free]
            idle = parts.with_nothing_to_prove(follows)
            if idle.any():  # whole parts, so that unknowns of the others follow as before
                following, spheres = np.zeros(parts.free.shape, dtype=bool), spheres & ~idle
                following[parts.free] = follows
                continue
            # Either all of them can roll exactly, or some spheres are left out and the others are tried again.
            found = parts.floor_and_motions(follows)
            if isinstance(found, tuple):
                return cls(spheres, contacts, *found)
            following, spheres = None, spheres & ~found
        return cls.none(network)

    @classmethod
    def none(cls, network: JudgedNetwork) -> ExactMotions:
        """Return the empty result for a network: of none of its contacts it is proven that it can roll exactly."""
        spheres, contacts = (np.zeros(of.shape, dtype=bool) for of in (network.free, network.counts))
        return cls(spheres, contacts, np.full(network.count, np.inf), np.zeros((len(spheres), 3)))

    def rolling(self, spin: list[Enclosure]) -> list[Enclosure]:
        """Return spins times radius by component, 3 enclosures (N,), length/time, close to the given ones, at which all
        contacts of the mask `contacts` roll exactly. They are the given ones if there is no such contact.

        spin : given spins times radius by component, 3 enclosures (N,), sums of two doubles. They are kept for all
            spheres that these contacts do not join, and for a few unknowns of the others (chosen in `motions`). The
            other unknowns follow from these and from the imposed spins.
        """
        return spin if self.motions is None else self.motions.spin(spin)


@dataclass(frozen=True)
class _Parts:
    """A number of contacts, A of them, that shall roll, and the parts into which they divide free spheres with n
    unknown spin components. A part is what the contacts connect through free spheres; driven spheres connect nothing.

    network : all N spheres and E contacts.
    free : (N, 3) mask of the unknowns among the spin components of all N spheres.
    ends : (2, A), indices of both spheres of each contact.
    normal : (A, 3), unit normals of the contacts.
    rows : (3 A, n), the matrix that gives slips from the unknowns: x components of all slips, then y, then z.
    of_unknown, of_contact : (n,) and (A,), the number of the part of each, 0 to count - 1.
    count : number of parts."""

    network: JudgedNetwork
    free: np.ndarray
    ends: np.ndarray
    normal: np.ndarray
    rows: sparse.csr_array
    of_unknown: np.ndarray
    of_contact: np.ndarray
    count: int

    @classmethod
    def of(cls, network: JudgedNetwork, free: np.ndarray, contacts: np.ndarray) -> _Parts:
        """Return the contacts that shall roll with the free spheres they join, divided into parts: groups of free
        spheres that these contacts connect.

        network : N spheres and E contacts.
        free : (N, 3) mask of the spin components that are unknowns.
        contacts : (E,) mask of the contacts that shall roll."""
        ends = network.graph.contact[:, contacts]
        rows = sparse.csr_array(slip_rows(network, numbered(free))[np.flatnonzero(np.tile(contacts, 3))])
        rows.eliminate_zeros()
        first, second = ends[:, network.free[ends].all(axis=0)]
        label = pieces(len(free), first, second)
        parts, of_unknown = np.unique(label[np.nonzero(free)[0]], return_inverse=True)
        of_contact = np.searchsorted(parts, label[np.where(network.free[ends[0]], *ends)])
        return cls(network, free, ends, network.graph.normal[contacts], rows, of_unknown, of_contact, len(parts))

    def following(self) -> np.ndarray:
        """Choose some unknowns such that no pivot of the others is nearly 0, and return the mask (n,) of these others,
        which follow from the chosen ones. Nothing about it is proven."""
        sphere = np.nonzero(self.free)[0]
        place, parts = self.network.graph.place[sphere].T, self.network.parts_of(sphere)
        matrix, samples = (self.rows.T @ self.rows).tocsc(), self.network.samples_of(sphere)
        return ~Elimination.of(matrix, place, parts, samples).dependent(NULL_PIVOT)

    def with_nothing_to_prove(self, follows: np.ndarray) -> np.ndarray:
        """Return the mask (N,) of the spheres that need no proof in exact arithmetic: those of parts (free spheres that
        contacts connect) with at most as many conditions, two for each contact, as unknowns that follow from others,
        and of samples in which no unknown follows.

        follows : (n,) mask of the unknowns that follow from others.
        """
        samples = self.network.samples_of(np.nonzero(self.free)[0])
        conditions = 2 * np.bincount(self.of_contact, minlength=self.count)
        enough = conditions <= np.bincount(self.of_unknown, follows, self.count)
        none = np.bincount(samples.of, follows, samples.count) == 0
        return self._spheres(enough[self.of_unknown] | none[samples.of])

    def floor_and_motions(self, follows: np.ndarray) -> tuple[np.ndarray, np.ndarray, _Motions] | np.ndarray:
        """Try to prove that all A contacts can roll exactly at once.

        Returns, if that is proven, a tuple with the fields `floor` (R,), `unit` (N, 3) and `motions` of
        :class:`ExactMotions`. Else a mask (N,) of the spheres, at least one, to leave out of the next try.

        follows : (n,) mask of the unknowns that follow from others, as a guess."""
        all_spheres, sphere = np.asarray(self.free.any(axis=1)), np.nonzero(self.free)[0]
        network, place = self.network, self.network.graph.place[sphere].T
        samples = network.samples_of(sphere)
        place_in_order = np.empty(len(follows), dtype=np.intp)
        place_in_order[np.concatenate([part.nodes for part in network.parts_of(sphere)])] = np.arange(len(follows))
        # The matrix of the slips from the unknowns that follow, and its factor.
        rows, choices = sparse.csr_array(self.rows[:, follows]), _Choices.of(self, np.flatnonzero(~follows))
        parts, followers = network.parts_of(sphere[follows]), network.samples_of(sphere[follows])
        elimination = Elimination.of((rows.T @ rows).tocsc(), place[:, follows], parts, followers)
        factor = elimination.factorised_samples()
        if choices is None:
            return all_spheres
        if factor.failed.any():
            return self._spheres(factor.failed[samples.of])
        # The motions of all choices in fractions, and, if no contact slips in them, a floor for the other unknowns.
        motions, no_fraction = _Motions.of(self, choices, np.flatnonzero(follows), rows, factor, place_in_order)
        slipping = motions.slipping_contacts()
        if not len(slipping):
            floor = Floor.of(rows, rounding_of(rows), elimination, factor)
            if not floor.tau.all():
                return self._spheres((floor.tau == 0)[samples.of])
            unit = np.zeros(self.free.shape)
            unit[tuple(of[follows] for of in np.nonzero(self.free))] = floor.unit
            return np.sqrt(floor.tau) / UP, unit, motions
        # Leave out spheres with a number that is no fraction, and both ends of contacts that slip though all numbers
        # are fractions.
        left_out = self._spheres(no_fraction)
        all_fractions = ~left_out[self.ends[:, slipping]].any(axis=0)
        left_out[self.ends[:, slipping[all_fractions]]] = True
        result: tuple[np.ndarray, np.ndarray, _Motions] | np.ndarray = left_out & all_spheres
        return result

    def _spheres(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the mask (N,) of the spheres to which any of the unknowns in the mask `unknowns` (n,) belongs."""
        found = np.zeros_like(self.free)
        found[self.free] = unknowns
        return np.asarray(found.any(axis=1))


@dataclass(frozen=True)
class _Choices:
    """The q numbers from which the spins of rolling spheres follow, the *choices*: first some chosen unknown spin
    components; then the absolute values of imposed spin components, one for each value that occurs in a part. A part is
    a group of free spheres that contacts connect.

    chosen : (k,), indices of the chosen unknowns.
    imposed : (q - k,), the imposed absolute values (spin times radius), an enclosure with an entry for each pair of a
        part and a value that occurs in it.
    owner : (q,), the part to which each number belongs.
    slot : (q,), its place, from 0, among the numbers of this part.
    sums : (3 A, q), what a unit of each number contributes to u_i + u_j, the sum of the spins of both spheres (times
        radius), for A contacts: x components first, then y, then z."""

    chosen: np.ndarray
    imposed: Enclosure
    owner: np.ndarray
    slot: np.ndarray
    sums: sparse.csr_array

    @classmethod
    def of(cls, parts: _Parts, chosen: np.ndarray) -> _Choices | None:
        """Return the numbers from which spins follow; None if some imposed spin is too small for exact products.

        parts : the contacts, their unknowns, and the parts into which they fall.
        chosen : (k,), indices of the chosen unknowns."""
        network, contacts = parts.network, len(parts.of_contact)
        high, low, error = (
            np.stack(values, axis=1) for values in zip(*(p.parts for p in network.imposed), strict=True)
        )
        # Distinct sizes of imposed components, as exact sums of two doubles.
        moves = high != 0
        sizes = np.stack([np.abs(high), np.sign(high) * low])[:, moves]
        size, which = np.unique(sizes, axis=1, return_inverse=True)
        if not ((size[0] > FAINT).all() and (error[~moves] == 0).all()):
            return None
        # What a unit of each size contributes to u_i + u_j: imposed components of one size have either sign.
        sign_of_size = sparse.csr_array((np.sign(high[moves]), (np.arange(moves.sum()), which.ravel())),
                                        shape=(moves.sum(), size.shape[1]))  # fmt: skip
        by_size = sparse.coo_array(_sum_of_spins(parts.ends, numbered(moves)) @ sign_of_size)
        row, value = by_size.coords
        # Give `sums` a column for each pair of a part and an imposed size that occurs in it.
        pairs, column = np.unique(parts.of_contact[row % contacts] + parts.count * value, return_inverse=True)
        # Number the choices of each part from 0.
        owner = np.append(parts.of_unknown[chosen], pairs % parts.count)
        order = np.argsort(owner, kind="stable")
        slot = np.empty_like(order)
        slot[order] = np.arange(len(order)) - np.searchsorted(owner[order], owner[order])
        by_imposed = sparse.csr_array((by_size.data, (row, column)), shape=(3 * contacts, len(pairs)))
        sums = sparse.hstack([_sum_of_spins(parts.ends, numbered(parts.free))[:, chosen], by_imposed], format="csr")
        imposed = Enclosure.exact(*size[:, pairs // parts.count])
        return cls(chosen, imposed, owner, slot, sparse.csr_array(sums))


@dataclass
class _Solved:
    """Solver for motions without slip, in doubles by least squares. All spins follow from q numbers, the *choices*. The
    motion of a choice is what the other unknowns are if this number is 1 and all other choices are 0. Motions are the
    columns of a matrix, one column for one choice or for the sum of several.

    parts : A contacts, their n unknowns, and the parts: groups of free spheres that the contacts connect.
    choices : the q numbers.
    follow : (f,), indices of the unknowns that follow from the choices.
    rows : (3 A, f), the matrix that gives slips from these unknowns.
    factor : Cholesky factor of rows^T rows.
    fewer : True if choices of one part shall no longer share a column, since too many of their motions overlapped."""

    parts: _Parts
    choices: _Choices
    follow: np.ndarray
    rows: sparse.csr_array
    factor: Factor
    fewer: bool = False

    def columns(self, chosen: np.ndarray) -> tuple[np.ndarray, bool]:
        """Return for each of k choices (numbers from which all spins follow) the column (k,) in which its motion is to
        be computed; and True if a column may hold several choices of one part (spheres that contacts connect).

        Choices of different parts share columns, since their motions do not overlap. Choices of one part do so, too,
        unless they are imposed spins, which move many spheres; or there are columns enough; or `fewer` is set.

        chosen : (k,), indices of the choices; either all are imposed spins, or none."""
        owner = self.choices.owner[chosen]
        order, size = np.argsort(owner, kind="stable"), np.bincount(owner)
        slot = np.empty_like(order)
        slot[order] = np.arange(len(order)) - np.repeat(np.cumsum(size) - size, size)
        columns = max(SLOTS_AT_ONCE, -(-int(size.max()) // CHOICES_IN_A_SUM))
        imposed = chosen[0] >= len(self.choices.chosen)
        if imposed or self.fewer or columns >= size.max():
            return slot, False
        return slot % columns, True

    def motions(self, chosen: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return for each column the sum of the motions of its choices, (f, columns).

        A choice is a spin component that can be set freely; the f unknowns in `follow` then have to take certain values
        if no contact is to slip. The motion of a choice is these values, (f,), if this choice is 1 and all others are
        0. Slips that are more than rounding are solved for once more; entries that are not finite are set to 0.

        chosen : (k,), indices of the choices.
        column : (k,), the column that each choice belongs to."""
        in_columns = sparse.csr_array((np.ones(len(chosen)), (np.arange(len(chosen)), column)))
        # The slips (u_i + u_j) x n that the choices of each column give; then K x = -slips by least squares.
        sums = (self.choices.sums[:, chosen] @ in_columns).toarray()
        normal = self.parts.normal.T[..., None]
        slips = np.cross(sums.reshape(3, -1, sums.shape[1]), normal, axis=0).reshape(sums.shape)
        x = -self.factor.solve(self.rows.T @ slips)
        left = self.rows @ x + slips
        if not np.abs(left).max(initial=0.0) < LEFT_SLIP:
            x -= self.factor.solve(self.rows.T @ left)
        return np.where(np.isfinite(x), x, 0.0)

    def one_of_each_part(self, x: np.ndarray, chosen: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the motions of single choices, from columns that hold at most one choice of each part (a group of
        spheres that contacts connect). A choice is a spin component that can be set freely; its motion is how the f
        other unknowns follow. Returns two arrays:

        1. (3, entries), a column for each number of x that is not nearly 0: which of the f unknowns moves, the index of
           the choice, and by how much;
        2. (0,), the choices for which this fails: none.

        x : (f, columns), each column the sum of the motions of several choices.
        chosen : (k,), indices of the choices.
        column : (k,), the column of x that each choice belongs to."""
        choice = np.full((self.parts.count, x.shape[1]), -1)
        choice[self.choices.owner[chosen], column] = chosen
        unknown, place = np.nonzero(np.abs(x) > WHOLE)
        mover = choice[self.parts.of_unknown[self.follow[unknown]], place]
        known = mover >= 0
        return np.stack([unknown[known], mover[known], x[unknown[known], place[known]]]), chosen[:0]

    def split(self, x: np.ndarray, chosen: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the motions of single choices, from sums of motions; and the choices for which this fails.

        A choice is a spin component that can be set freely; its motion is how the f other unknowns follow. In a sum,
        moving spheres that contacts connect form a set. If a set contains one choice, it makes no contact slip and is 1
        at this choice alone; so it is the motion of this choice. Sets with several choices fail.

        The first result is an array (3, entries) with a column for each number of x that is not nearly 0: which of the
        f unknowns moves, the index of the choice, and by how much. The second, (failed,), has indices of choices.

        x : (f, columns), each column the sum of the motions of several choices.
        chosen : (k,), indices of the choices.
        column : (k,), the column of x that each choice belongs to."""
        width, sphere = x.shape[1], np.nonzero(self.parts.free)[0]
        unknown, place = np.nonzero(np.abs(x) > WHOLE)
        # A node is a sphere in a column. A contact joins two nodes if both spheres move in this column.
        node = sphere[self.follow[unknown]] * width + place
        node_of_choice = sphere[self.choices.chosen[chosen]] * width + column
        moves = np.zeros((len(self.parts.free), width), dtype=bool)
        moves.flat[node] = moves.flat[node_of_choice] = True
        first, second = self.parts.ends[:, self.parts.network.free[self.parts.ends].all(axis=0)]
        contact, inside = np.nonzero(moves[first] & moves[second])
        label = pieces(moves.size, first[contact] * width + inside, second[contact] * width + inside)
        is_alone = np.bincount(label[node_of_choice], minlength=moves.size)[label[node_of_choice]] == 1
        choice = np.full(moves.size, -1)
        choice[label[node_of_choice[is_alone]]] = chosen[is_alone]
        mover = choice[label[node]]
        known = mover >= 0
        return np.stack([unknown[known], mover[known], x[unknown[known], place[known]]]), chosen[~is_alone]


@dataclass(frozen=True)
class _Motions:
    """How n unknown spin components follow from q numbers, the *choices*, so that no contact slips: a unit of choice c
    adds motion[:, c] / unit[c] to them.

    parts : A contacts, their n unknowns, and the parts: groups of free spheres that the contacts connect.
    choices : the q numbers: some of the unknowns, and absolute values of imposed spins.
    motion : (n, q), integers as doubles.
    unit : (q,), common denominators, integers as doubles."""

    parts: _Parts
    choices: _Choices
    motion: sparse.csr_array
    unit: np.ndarray

    @classmethod
    def of(
        cls,
        parts: _Parts,
        choices: _Choices,
        follow: np.ndarray,
        rows: sparse.csr_array,
        factor: Factor,
        place: np.ndarray,
    ) -> tuple[_Motions, np.ndarray]:
        """Return guesses of the motions without slip in which one of the q numbers in `choices` is 1 and all others are
        0, as fractions; and a mask (n,) of the unknowns at which some motion is no fraction. Whether contacts really do
        not slip is checked by `slipping_contacts`.

        Motions mostly move a few spheres, so those of several choices are found together, as one sum. It divides into
        sets of moving spheres that contacts connect. A set with one choice is the motion of this choice; where a set
        has several choices, these are tried again in sums of fewer.

        parts : A contacts and their n unknowns.
        choices : the q numbers.
        follow : (f,), indices of the unknowns that are not chosen.
        rows : (3 A, f), their columns of the matrix of slips.
        factor : Cholesky factor of rows^T rows.
        place : (n,), place of each unknown in an order in which unknowns close in space are mostly near each other."""
        count, chosen = len(choices.slot), len(choices.chosen)
        solver = _Solved(parts, choices, follow, rows, factor)
        found = [np.zeros((3, 0))]
        # First the imposed spins, then the chosen unknowns; `waiting` are those whose motion is not known yet.
        for waiting in (np.arange(chosen, count), np.argsort(place[choices.chosen])):
            while len(waiting):
                column, together = solver.columns(waiting)
                tried, failed = len(waiting), [waiting[:0]]
                for begin in range(0, int(column.max()) + 1, SLOTS_AT_ONCE):
                    in_batch = (column >= begin) & (column < begin + SLOTS_AT_ONCE)
                    batch = waiting[in_batch], column[in_batch] - begin
                    x = solver.motions(*batch)
                    entries, overlapping = (solver.split if together else solver.one_of_each_part)(x, *batch)
                    found.append(entries)
                    failed.append(overlapping)
                waiting = np.concatenate(failed)
                solver.fewer = len(waiting) > WORTH_A_ROUND * tried
        at, choice, x = np.concatenate(found, axis=1)
        at, choice = follow[at.astype(int)], choice.astype(int)
        # Multiply the numbers of each motion by their common denominator, and round to integers.
        unit, no_fraction = _common_denominators(x, choice, count), np.zeros(len(parts.of_unknown), dtype=bool)
        x = x * unit[choice]
        no_fraction[at[np.abs(x - np.round(x)) > WHOLE]] = True
        at, choice = np.append(at, choices.chosen), np.append(choice, np.arange(chosen))
        x = np.append(np.round(x), unit[:chosen])
        motion = sparse.csr_array((x, (at, choice)), shape=(len(no_fraction), count))
        motion.eliminate_zeros()
        return cls(parts, choices, motion, unit), no_fraction

    def slipping_contacts(self) -> np.ndarray:
        """Return the indices of those of the A contacts that may slip in these motions. The others are proven to roll
        exactly, whatever the q numbers are from which the spins follow. If integers are too large for exact sums, all A
        contacts are returned."""
        count, chosen = len(self.parts.normal), len(self.choices.chosen)
        if not (np.abs(self.motion.data) < LARGEST).all():
            return np.arange(count)
        # u_i + u_j of every contact and choice, in integers, without rounding. A contact rolls if it is along n.
        by_imposed = self.choices.sums[:, chosen:] @ sparse.diags_array(self.unit[chosen:])
        by_unknowns = _sum_of_spins(self.parts.ends, numbered(self.parts.free)) @ self.motion
        entries = sparse.coo_array(by_unknowns + sparse.hstack([0 * self.choices.sums[:, :chosen], by_imposed]))
        row, choice = entries.coords
        # the pairs of a contact and a choice that moves it, with a column of `sums` for each
        pairs, column = np.unique(row % count * len(self.unit) + choice, return_inverse=True)
        sums = np.zeros((3, len(pairs)))
        sums[row // count, column] = entries.data
        contact = pairs // max(len(self.unit), 1)
        return np.unique(contact[~_rolls(sums, self.parts.normal[contact].T)])

    def spin(self, given: list[Enclosure]) -> list[Enclosure]:
        """Return spins times radius at which none of these contacts slips: by component, 3 enclosures (N,), computed
        from the chosen unknowns and the imposed spins.

        given : spins times radius by component, 3 enclosures (N,). Of these the chosen unknowns are read, and the spins
            of spheres without unknowns, which stay as they are."""
        free, choices, motion = self.parts.free, self.choices, sparse.coo_array(self.motion)
        high, low = (np.stack([getattr(part, name) for part in given], axis=1)[free] for name in ("high", "low"))
        value_of_choice = joined([Enclosure.exact(high[choices.chosen], low[choices.chosen]), choices.imposed])
        # An unknown is the sum over the choices of value * motion / unit.
        unknown, choice = motion.coords
        terms = value_of_choice.at(choice).times(motion.data) / Enclosure.exact(self.unit[choice])
        total, (sphere, component), found = grouped_sum(terms, unknown, len(high)), np.nonzero(free), []
        for k, part in enumerate(given):
            found.append(part.where(~np.asarray(free.any(axis=1))))
            found[k].put(sphere[component == k], total.at(np.flatnonzero(component == k)))
        return found


def _sum_of_spins(ends: np.ndarray, number: np.ndarray) -> sparse.csr_array:
    """Return the matrix (3 A, n) of 0 and 1 that gives u_i + u_j, the sum of the spins (times radius) of both spheres,
    for A contacts from n unknowns: x components first, then y, then z.

    ends : (2, A), indices of the spheres of the contacts.
    number : (N spheres, 3), the index of each spin component among the n unknowns; -1 for one that is taken as 0."""
    at = number[ends].transpose(0, 2, 1).reshape(2, -1)
    end, row = np.nonzero(at >= 0)
    return sparse.csr_array((np.ones(len(row)), (row, at[end, row])), shape=(at.shape[1], number.max(initial=-1) + 1))


def _common_denominators(x: np.ndarray, owner: np.ndarray, count: int) -> np.ndarray:
    """Return for each of `count` groups of numbers, taken as fractions, their least common denominator, (count,); 1
    where it is too large.

    x : (k,), numbers. Those that are close to no fraction with a denominator up to DENOMINATORS are ignored.
    owner : (k,), the group to which each number belongs, 0 to count - 1."""
    rest, before, below = x - np.round(x), np.zeros_like(x), np.ones_like(x)
    # Continued fractions of all numbers at once: the denominators of successive convergents, the next one being
    # round(1 / rest) * below + before, until each number is found or its denominator is too large.
    while True:
        goes_on = (np.abs(x * below - np.round(x * below)) > WHOLE) & (np.abs(below) <= DENOMINATORS)
        if not goes_on.any():
            break
        inverse = 1 / rest
        rest = inverse - np.round(inverse)
        before, below = np.where(goes_on, below, before), np.where(goes_on, np.round(inverse) * below + before, below)
    denominator = np.where(np.abs(below) <= DENOMINATORS, np.abs(below), 1).astype(np.int64)
    found, order = np.ones(count, dtype=np.int64), np.argsort(owner, kind="stable")
    present, begin = np.unique(owner[order], return_index=True)
    if len(order):
        found[present] = np.lcm.reduceat(denominator[order], begin)
    return np.where((found < 1) | (found > LARGEST), 1, found).astype(float)


def _rolls(sums: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return a mask (k,), True where the cross product of a vector with a normal is proven to be exactly 0, so that the
    contact rolls. It is a difference of two products in each component; these are equal as exact sums of two doubles.

    sums : (3, k), the vectors, sums of the spins of both spheres of a contact: integers as doubles.
    normal : (3, k), doubles."""
    found = np.asarray(((normal == 0) | (np.abs(normal) > FAINT)).all(axis=0) | (sums == 0).all(axis=0))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        first, second = (Enclosure.exact(sums[i]).times(normal[j]) for i, j in ((a, b), (b, a)))
        found &= (first.high == second.high) & (first.low == second.low)
    return found
