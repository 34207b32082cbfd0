"""Proof that contacts which can roll exactly rest at every minimum, even where they touch loops of contacts that cannot
roll exactly: part of theorem 8.

What is proven. Some contacts, called X, can all roll at once, exactly (exact_motions.py). They rest at every minimum if
some friction G on X, below every friction limit, can replace the optimal friction F* there: it exerts the same torques
on free spheres (resting.py). Contacts beside X may belong to loops of which only bounds on the friction are known
(loops.py). So G is sought for all friction that these bounds allow, at once.

Symbols
    N spheres, E contacts. X : the contacts that can roll exactly, q of them, on spheres with n unknowns.
    K : (3 q, n), slips of X from the unknowns; K^T G are the torques of friction G on X.
    Z : (n, z), all motions of the spheres of X in which X does not slip: K Z = 0.
    s, unit : of exact_motions.py, for X. Units are 0 for the unknowns J from which the others follow.
    F : friction at hand. F* : optimal friction. f = F* - F, on the k other contacts known by a bound on its size alone.
    c : (m,), friction that circulates along loops beside X, known to lie in intervals (loops.py).
    L : loads, the torques on the unknowns of X by a unit of each component of f on other contacts, directly and by what
        it changes in the loops, and by a unit of each c.
    R_f, R_c : (3 q, 2 k) and (3 q, m), friction on X that bears each load: K^T (R_f, R_c) = -L but for a residual.

The proof
1. Without any R: contacts of loops rest if the bound on |F*| that loops.py gives is below mu F_n
   (`at_rest_beside_loops`).
2. For each load, without its part along Z, find R_f or R_c by springs at the contacts of X. Any friction that balances
   the load is valid; springs that are weaker where a contact has less friction left make the bounds of step 3 better,
   so several stiffnesses are tried for the loads of loops. Before that, friction that balances a loop is sought on
   contacts close to it, separately for both ends of its interval (nearby_friction.py). In between a mixture of both
   balances it, and sizes of mixtures are no larger than those at the ends.
3. Then G = F + R_f f + R_c c. Its size at a contact of X is at most |F + R_c (middles of c)| + sum of |R_c| (half
   lengths of c) + sum of |R_f| (bounds on f).
4. G does not quite balance. Let the torques of G - F* on the unknowns of X be v + Z a: a is what step 2 has left out of
   the loads along Z, and v, known by a bound on each entry, is all else that is left, and rounding. These torques lie
   in the range of K^T, so they are orthogonal to Z. Hence Z a cancels the part of v along Z, and they are P v, with P
   the projection at right angles to Z. A correction of G takes P v away; by exact_motions.py it is no larger than |unit
   P v| / s. Where a part has motions Z, P brings v from unknowns with unit 0 (those of J) to others, so that |unit v|
   is no bound; but P lengthens nothing, so |unit P v| <= (largest unit) |v| (`residual_unit`). Without Z it is |unit
   v|.
5. X falls into parts that share no free sphere. All contacts of a part rest if all of them stay below mu F_n.

Example. A sphere of X has two contacts of X that have 3 and 1 of their friction left, F = 0, and both can bear the same
force of a third contact, of which only |f| <= 3 is known. Equal springs take 1.5 each, more than the second contact has
left. Springs in proportion to the squares of the friction left, 9 to 1, take 2.7 and 0.3: both contacts rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.numerics.blas import DENSE
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.enclosure import UP, length
from taichi_bearings.proof.exact_motions import ExactMotions
from taichi_bearings.proof.listed import ROUNDED_NORMAL
from taichi_bearings.proof.loops import FrictionBounds, Piece, block_norms, tangent_rows, weighted_lengths
from taichi_bearings.proof.nearby_friction import friction_within_limits, spheres_nearby
from taichi_bearings.proof.resting import known_friction
from taichi_bearings.proof.rounded_elimination import EPS, Elimination, Factor
from taichi_bearings.proof.springs import numbered, slip_rows

# Choices of which R_f and R_c to try. Nothing that is proven depends on them, as any are valid.
FORCES_AT_ONCE = 64  # other contacts for whose loads R_f is computed at once
# number of trials of R_c; springs are weakened by (load of a contact / friction left) to this power from trial to trial
MOST_TRIALS, SPARED = 10, 0.7
# For contacts that load X little no R_f is computed: their loads are taken away together with residuals (step 4). These
# are as many as add at most this share of the least friction left, and all but so many others.
FAINT_LOADS, MOST_OTHERS = 0.5, 512
# spheres near a loop whose contacts bear its load; loops beyond which friction is not sought for each of them
MOST_NEARBY, MOST_BORNE_LOOPS = 150, 100
UNLOADED = 1e-9  # torque of a load over its largest one, up to which a sphere counts as not loaded
WORTH_A_TRIAL = 0.99  # factor by which a trial has to lower the largest (friction / limit) for another one to be made
LEAST_MARGIN = 1e-4  # friction left over the largest of all contacts; contacts with less count as having this much
LEAST_BORNE = 1e-2  # load of a contact over the largest; smaller loads count as this large
YIELDING, CARRYING_STEPS = -1e-13, 3  # minus what is added to the diagonal, to hold motions; steps that correct it


@np.errstate(all="ignore")  # what is not finite proves nothing
def at_rest_beside_loops(bounds: Bounds, far: np.ndarray) -> np.ndarray:
    """Return the mask (E,) of the contacts that are proven to rest at every minimum, in a packing with E contacts whose
    normals have any direction. There are two ways to prove it:

    * A contact of a loop rests if a bound on its friction at every minimum is below its limit mu F_n.
    * Contacts that can all roll exactly at once rest if friction at them, below all their limits, can exert the same
      torques as their friction at the minimum.

    bounds : bounds on the power, with the friction in which forces of fictitious springs at the contacts have balanced
        all torques. If no springs were made (`unknown` is None) nothing is proven.
    far : (E,), bound on |slip at any minimum - given slip|, in units of the network; infinite where none is known.
    """
    network, unknown = bounds.network, bounds.unknown
    found = np.zeros(len(network.acts), dtype=bool)
    longest = np.linalg.norm(network.graph.normal, axis=1).max(initial=0.0)  # the proof takes normals for unit vectors
    if unknown is None or not longest < UP:
        return found
    known, most_change = known_friction(bounds, far)
    rests = network.counts & ~known & ((network.friction_limit - length(bounds.friction)).lower() > 0)
    # Contacts that can roll exactly are sought among those with friction left. Optimal friction is at most mu F_n, and
    # with damping eta (slip + far) more.
    limit = network.friction_limit.most + np.where(
        network.damping.high > 0, network.damping.most * (network.slip.most + far), 0.0
    )
    number = numbered(unknown)
    exact = ExactMotions.of(network, number, rests)
    friction_bounds = FrictionBounds(network, number, exact, bounds.friction, known, most_change * UP, limit * UP)
    # Contacts in loops rest where the bound on their friction is below the limit.
    loop_pieces = friction_bounds.split_into_pieces()
    for piece in loop_pieces:
        found[piece.contacts] = piece.largest < (1 - ROUNDED_NORMAL) * network.friction_limit.least[piece.contacts]
    found &= rests
    if exact.contacts.any():
        found[exact.contacts] = ExactlyRolling(friction_bounds, loop_pieces).rests()
    return found


@dataclass(frozen=True)
class ExactlyRolling:
    """The q contacts that can all roll exactly at once, on spheres with n unknown spin components. It is to be proven
    that friction on them, below its limits, can balance the torques of the friction at the other contacts, which
    changes from the stored one to that at a minimum.

    friction_bounds : for all contacts of the packing, bounds on the size of the friction at minima, and of its change.
    loop_pieces : groups of other contacts that form loops. For each loop an interval is known that contains the
        friction which circulates along it."""

    friction_bounds: FrictionBounds
    loop_pieces: list[Piece]

    @cached_property
    def columns(self) -> np.ndarray:
        """(n,), the numbers, among all unknown spin components of the packing, of those that belong to spheres of the
        exactly rolling contacts."""
        return np.flatnonzero(self.friction_bounds.exact.spheres[self.friction_bounds.sphere])

    @cached_property
    def contacts(self) -> np.ndarray:
        """(q,), indices, among all contacts of the packing, of those that can all roll exactly at once."""
        return np.flatnonzero(self.friction_bounds.exact.contacts)

    @cached_property
    def rows(self) -> sparse.csr_array:
        """Matrix (3 q, n), without rounding, that gives the slips of the q exactly rolling contacts from the n unknown
        spin components of their spheres; the three rows of a contact follow each other."""
        whole = slip_rows(self.friction_bounds.network, self.friction_bounds.number)
        at = self.contacts[:, None] + np.arange(3) * len(self.friction_bounds.most_change)
        return sparse.csr_array(whole[at.ravel()][:, self.columns])

    @cached_property
    def residual_unit(self) -> np.ndarray:
        """(n,), a unit for each unknown: friction that balances torques of at most v along the unknowns need be no
        larger than |unit * v| / `exact.floor` (step 4 at the head of this file). The unit is `exact.unit`; but in parts
        that can move without slip all unknowns have the largest unit of their part. A part is what the exactly rolling
        contacts connect through free spheres."""
        exact, number = self.friction_bounds.exact, self.friction_bounds.number
        unit: np.ndarray = exact.unit[number >= 0][self.columns]
        largest, has_motions = np.zeros(int(self.part.max()) + 1), np.zeros(int(self.part.max()) + 1, dtype=bool)
        np.maximum.at(largest, self.part, unit)
        has_motions[self.part[np.diff(self.motions.indptr) > 0]] = True
        return np.where(has_motions[self.part], largest[self.part], unit)

    @cached_property
    def motions(self) -> sparse.csr_array:
        """Matrix (n, z): each column is a motion of the n unknown spin components in which no exactly rolling contact
        slips. There are z independent ones; all others are sums of them."""
        exact = self.friction_bounds.exact.motions
        if exact is None:
            return sparse.csr_array((len(self.columns), 0))
        return sparse.csr_array(exact.motion[:, : len(exact.choices.chosen)])

    @cached_property
    def products(self) -> tuple[np.ndarray, np.ndarray]:
        """The scalar products of the z motions in `motions`, a matrix (z, z), as its factors by SciPy's `lu_factor`."""
        found: tuple[np.ndarray, np.ndarray] = DENSE.lu_factor((self.motions.T @ self.motions).toarray())
        return found

    @cached_property
    def part(self) -> np.ndarray:
        """(n,), number of the part of each of the n unknown spin components. Parts are what the exactly rolling
        contacts connect through free spheres."""
        network = self.friction_bounds.network
        first, second = network.graph.contact[:, self.contacts]
        inner = network.free[first] & network.free[second]
        found: np.ndarray = pieces(len(network.free), first[inner], second[inner])[
            self.friction_bounds.sphere[self.columns]
        ]
        return found

    @cached_property
    def part_of_contact(self) -> np.ndarray:
        """(q,), for each exactly rolling contact the number of the part to which it belongs."""
        network = self.friction_bounds.network
        of_sphere = np.zeros(len(network.free), dtype=np.intp)
        of_sphere[self.friction_bounds.sphere[self.columns]] = self.part
        first, second = network.graph.contact[:, self.contacts]
        found: np.ndarray = of_sphere[np.where(network.free[first], first, second)]
        return found

    @cached_property
    def tangential_rows(self) -> sparse.csr_array:
        """Matrix (2 q, n) that gives both tangential components of the slips of the q exactly rolling contacts from the
        n unknown spin components of their spheres."""
        return sparse.csr_array(self.friction_bounds.rows[tangent_rows(self.contacts)][:, self.columns])

    @cached_property
    def bounded_contacts(self) -> np.ndarray:
        """(k,), indices of the contacts of which only a bound on |change of friction| is known. The change is that from
        the stored friction to the friction at a minimum.

        These are all contacts that can dissipate, except those that can roll exactly, and except those in
        `loop_pieces`: there the friction that circulates along each loop is known to lie in an interval."""
        found = self.friction_bounds.network.counts & ~self.friction_bounds.exact.contacts
        for piece in self.loop_pieces:
            found[piece.contacts] = False
        return np.flatnonzero(found)

    @cached_property
    def loads(self) -> tuple[sparse.csc_array, sparse.csc_array]:
        """Two matrices that map unknown friction at other contacts to torques on the n unknown spin components at the
        exactly rolling contacts.

        First, (n, 2 k): from changes of friction at the k `bounded_contacts`, two tangential components each. Such a
        change also changes the friction on loops; these torques are included.
        Second, (n, m): from the friction that circulates along each of m loops.
        """
        rows, bounded = self.friction_bounds.rows[:, self.columns], tangent_rows(self.bounded_contacts)
        place = np.full(rows.shape[0], -1)  # number of a row among those of `bounded_contacts`
        place[bounded] = np.arange(len(bounded))
        by_bounded, by_loops = [rows[bounded].T], [sparse.csr_array((len(self.columns), 0))]
        for piece in self.loop_pieces:
            to_torques, at = rows[tangent_rows(piece.contacts)].T, place[tangent_rows(piece.others)]
            row, column = np.indices(piece.by_others.shape).reshape(2, -1)
            shape = (len(piece.by_others), len(bounded))
            by_others = sparse.csr_array((piece.by_others.ravel(), (row, at[column])), shape=shape)
            by_bounded.append(to_torques @ by_others)
            by_loops.append(sparse.csr_array(to_torques @ piece.loops))
        return sparse.csc_array(sum(by_bounded[1:], by_bounded[0])), sparse.csc_array(sparse.hstack(by_loops))

    @cached_property
    def intervals(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles (m,) and half lengths (m,) of the intervals of the friction that circulates along each of m loops."""
        middle, half_length = [of.middle for of in self.loop_pieces], [of.half_length for of in self.loop_pieces]
        return np.concatenate([np.zeros(0), *middle]), np.concatenate([np.zeros(0), *half_length])

    @cached_property
    def rounding(self) -> float:
        """Bound on the rounding error of any sum in this class, relative to the sum of the sizes of its terms. No sum
        has more than 2 k + n + 64 terms, for k `bounded_contacts` and n unknowns; 4 roundings are allowed for each."""
        return float(4 * (2 * len(self.bounded_contacts) + len(self.columns) + 64) * EPS)

    @cached_property
    def unknown_torques(self) -> np.ndarray:
        """(n,), bound on the size of the torques on each of n unknown spin components that `loads` leave out: what the
        stored friction leaves over, and the rounding of the loads."""
        rounded = self.rounding * self.friction_bounds.most_change
        for piece in self.loop_pieces:
            # terms of the sums that make the loads: friction off the loops, and that along each of them
            terms = piece.most_off_loops + weighted_lengths(piece.loops, np.abs(piece.middle) + piece.half_length)
            rounded[piece.contacts] += piece.by_rounding + self.rounding * terms
        found: np.ndarray = (self.friction_bounds.left_over + self.friction_bounds.sum_at_spheres(rounded))[
            self.friction_bounds.sphere[self.columns]
        ] * UP
        return found

    @cached_property
    def margin(self) -> np.ndarray:
        """(q,), for each exactly rolling contact the friction that it has left: its limit mu F_n less the size of the
        stored friction."""
        limit = self.friction_bounds.network.friction_limit.least[self.contacts]
        return np.asarray(limit - np.linalg.norm(self.friction_bounds.friction[self.contacts], axis=1))

    def rests(self) -> np.ndarray:
        """Return the mask (q,) of the exactly rolling contacts that are proven to rest at every minimum.

        These are steps 2 to 5 at the head of this file, with its symbols. Changes of friction at other contacts exert
        torques, the loads. Springs at the exactly rolling contacts find friction R that balances each load. A part
        (what these contacts connect) rests if the stored friction and all R, for the largest loads, stay below every
        limit in it. Else springs are made weaker where they bear much, and tried again, up to MOST_TRIALS times."""
        margin = np.maximum(self.margin, LEAST_MARGIN * self.margin.max())
        springs = SpringsUnderLoad.of(self, margin**2)
        most_change = self.friction_bounds.most_change[self.bounded_contacts]
        found, last = np.zeros(len(margin), dtype=bool), np.inf
        limit = self.friction_bounds.network.friction_limit.least[self.contacts]
        if springs is None:
            return found
        # Small loads of other contacts are left to one last correction.
        is_faint, by_others = self._with_faint_torques(most_change), np.zeros(len(margin))
        residual = self.unknown_torques + abs(self.loads[0]) @ np.repeat(np.where(is_faint, most_change, 0.0), 2) * UP
        # Sum of |R_f| (bounds on f): the friction that balances the loads of other contacts, whatever their direction.
        others = np.flatnonzero(~is_faint)
        for begin in range(0, len(others), FORCES_AT_ONCE):
            batch = others[begin : begin + FORCES_AT_ONCE]
            most_f, columns = most_change[batch], (2 * batch[:, None] + np.arange(2)).ravel()
            force, left = springs.forces_for(self.loads[0][:, columns].toarray(), np.repeat(most_f, 2))
            by_others += block_norms(force, 3) @ most_f
            residual += left
        middle, half_length = self.intervals
        if 0 < len(middle) <= MOST_BORNE_LOOPS:
            found |= self._borne_nearby(by_others, residual)
        for _ in range(0 if found.all() else MOST_TRIALS):
            force, left = springs.forces_for(self.loads[1].toarray(), np.abs(middle) + half_length)
            # |F + R_c (middles of c)| + sum of |R_c| (half lengths of c)
            by_middles, by_lengths = (force @ middle).reshape(-1, 3), weighted_lengths(force, half_length, 3)
            largest = np.linalg.norm(self.friction_bounds.friction[self.contacts] + by_middles, axis=1) + by_lengths
            found |= self._stay_below_limits(largest + by_others, residual + left)
            worst = float(((largest + by_others) / limit)[~found].max(initial=0.0))
            if found.all() or not len(half_length) or not worst < WORTH_A_TRIAL * last:
                break
            last = worst
            # Try again with weaker springs where the loads of loops take much of the friction that is left.
            left_by_others = np.maximum(margin - by_others, LEAST_MARGIN * margin)
            share = (np.linalg.norm(by_middles, axis=1) + by_lengths) / left_by_others
            weaker = springs.weight * np.maximum(share / share.max(), LEAST_BORNE) ** -SPARED
            springs = SpringsUnderLoad.of(self, weaker)
            if springs is None:
                break
        return found

    def _borne_nearby(self, by_others: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Return the mask (q,) of the exactly rolling contacts that are proven to rest because friction on contacts
        close to each loop can balance the friction that may circulate along it. All are False if such friction is not
        found for every loop.

        The friction along a loop lies in an interval. Friction that balances one end of it is sought, then friction for
        the other end. A mixture of both balances any value in between, and is nowhere larger than the larger of the
        two. At contacts close to several loops the sizes for all of these are added.

        by_others : (q,), friction at each contact that balances the loads of other contacts.
        residual : (n,), bound on the torque on each unknown that a last correction has to balance.
        """
        network, none = self.friction_bounds.network, np.zeros(len(by_others), dtype=bool)
        friction, (middle, half_length) = self.friction_bounds.friction[self.contacts], self.intervals
        # The size of the friction with all loops so far, what it may be, and the contacts that bear a loop already.
        largest, is_used = np.linalg.norm(friction, axis=1), none.copy()
        limit = (
            (1 - 2 * ROUNDED_NORMAL) * network.friction_limit.least[self.contacts]
            - by_others
            - self._corrected(residual)
        )
        for loop in range(len(middle)):
            load = self.loads[1][:, [loop]].toarray().ravel()
            spheres, close = self._close_to(load)
            if not len(close):  # no exactly rolling contact is near, and the load is rounding
                residual = residual + (abs(middle[loop]) + half_length[loop]) * np.abs(load) * UP
                continue
            # The first loop at a contact changes the stored friction; sizes for further loops are added to that.
            given = np.where(is_used[close, None], 0.0, friction[close])
            most = limit[close] - np.where(is_used[close], largest[close], 0.0)
            if not (most > 0).all():
                return none
            size = np.zeros(len(close))
            for c in (middle[loop] - half_length[loop], middle[loop] + half_length[loop]):
                change, left = self._change_nearby(spheres, close, (given, most), c * load)
                size, residual = np.maximum(size, np.linalg.norm(given + change, axis=1)), residual + left
            if not (size < most).all():
                return none
            largest[close] = size + np.where(is_used[close], largest[close], 0.0)
            is_used[close] = True
        return self._stay_below_limits(largest + by_others, residual)

    def _close_to(self, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the mask (N,) of the spheres on which a load acts, and of others close to them; and the indices, among
        the q exactly rolling contacts, of those between these spheres or between them and driven ones.

        load : (n,), torques on the unknown spin components."""
        free, sphere = self.friction_bounds.network.free, self.friction_bounds.sphere[self.columns]
        ends = self.friction_bounds.network.graph.contact[:, self.contacts]
        rolls, loaded = np.zeros((2, len(free)), dtype=bool)
        rolls[sphere] = True
        loaded[sphere[np.abs(load) > UNLOADED * np.abs(load).max(initial=0.0)]] = True
        near = spheres_nearby(ends, rolls, loaded, MOST_NEARBY)
        return near, np.flatnonzero((near | ~free)[ends].all(axis=0) & near[ends].any(axis=0))

    def _change_nearby(
        self, spheres: np.ndarray, close: np.ndarray, before: tuple[np.ndarray, np.ndarray], load: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a change of friction (k, 3) at k contacts that balances a load, and a bound (n,) on the torques left
        over. The changed friction is within its limits, unless no such change is found.

        spheres : (N,) mask of the spheres near the load.
        close : (k,), indices, among the exactly rolling contacts, of those between these spheres.
        before : the friction (k, 3) before, and the limits (k,) that it shall not exceed.
        load : (n,), torques on the unknown spin components.
        """
        given, most = before
        columns = np.flatnonzero(spheres[self.friction_bounds.sphere[self.columns]])
        rows = self.tangential_rows[tangent_rows(close)][:, columns].toarray()
        tangents = self.friction_bounds.tangents[self.contacts[close]]
        along = np.einsum("cak,ck->ca", tangents, given)
        change_along = friction_within_limits(rows, along, most, load[columns]) - along
        change = np.einsum("ca,cak->ck", change_along, tangents)
        # Torques of the change by the matrix without rounding, with the rounding of these sums.
        exact = self.rows[(3 * close[:, None] + np.arange(3)).ravel()].T
        rounded = self.rounding * (np.abs(load) + abs(exact) @ np.abs(change).ravel())
        return change, (np.abs(load + exact @ change.ravel()) + rounded) * UP

    def _with_faint_torques(self, most_change: np.ndarray) -> np.ndarray:
        """Return the mask (k,) of those `bounded_contacts` whose changes of friction exert only small torques on the
        exactly rolling contacts. One correction balances all these torques together; those of other contacts are
        balanced one by one.

        Contacts are taken, beginning with the smallest torques, as long as the correction needs at most FAINT_LOADS
        times the least friction left at an exactly rolling contact. At most MOST_OTHERS contacts are not taken.

        most_change : (k,), bound on the change of the friction of each of the k contacts, force.
        """
        loads = sparse.diags_array(self.residual_unit) @ self.loads[0]
        squares = np.asarray(loads.power(2).sum(axis=0)).reshape(-1, 2).sum(axis=1) * most_change**2
        order, floor = np.argsort(squares), self.friction_bounds.exact.floor[0]
        faint = np.zeros(len(most_change), dtype=bool)
        faint[order] = np.sqrt(np.cumsum(squares[order])) <= FAINT_LOADS * floor * self.margin.min()
        faint[order[: max(len(order) - MOST_OTHERS, 0)]] = True
        return faint

    def _stay_below_limits(self, largest: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Return the mask (q,) of the exactly rolling contacts that lie in parts all of whose contacts stay below their
        friction limits. (A part is what these contacts connect through free spheres.)

        largest : (q,), bound on the size of the friction of each contact before the last correction.
        residual : (n,), bound on the torque on each unknown that the last correction has to balance. Torques along
            motions without slip are left out, as they cancel (step 4 at the head of this file).
        """
        limit, part = self.friction_bounds.network.friction_limit.least[self.contacts], self.part_of_contact
        is_below = (largest + self._corrected(residual)) * UP < (1 - ROUNDED_NORMAL) * limit
        return np.asarray(np.bincount(part, ~is_below)[part] == 0)

    def _corrected(self, residual: np.ndarray) -> np.ndarray:
        """Return a bound (q,) on the change of the friction of each exactly rolling contact by the last correction
        (step 4 at the head of this file).

        residual : (n,), bound on the torque on each unknown that the correction has to balance, without torques along
            motions that make no contact slip.
        """
        squares = np.bincount(self.part, (self.residual_unit * residual) ** 2)
        found: np.ndarray = np.sqrt(squares)[self.part_of_contact] / self.friction_bounds.exact.floor[0] * UP
        return found


@dataclass(frozen=True)
class SpringsUnderLoad:
    """Fictitious springs at the q exactly rolling contacts. They find friction there that balances a load, which is a
    torque on each of the n unknown spin components.

    loaded : the exactly rolling contacts, with the matrix K (3 q, n) that gives their slips.
    weight : (q,), stiffness of the spring at each contact.
    scale : (n,), factors that give the factorised matrix a diagonal of 1.
    factor : Cholesky factor of the scaled matrix K^T weight K."""

    loaded: ExactlyRolling
    weight: np.ndarray
    scale: np.ndarray
    factor: Factor

    @classmethod
    def of(cls, loaded: ExactlyRolling, weight: np.ndarray) -> SpringsUnderLoad | None:
        """Make springs at the q exactly rolling contacts, and factorise the matrix by which they are solved; None if
        that fails.

        loaded : the exactly rolling contacts, with the matrix of their slips.
        weight : (q,), stiffness of the spring at each."""
        rows = sparse.csr_array(sparse.diags_array(np.sqrt(np.repeat(weight, 3))) @ loaded.rows)
        squares = np.bincount(rows.indices, rows.data**2, rows.shape[1])
        scale = 1 / np.sqrt(np.where(squares > 0, squares, 1.0))
        rows = sparse.csr_array(rows @ sparse.diags_array(scale))
        network, sphere = loaded.friction_bounds.network, loaded.friction_bounds.sphere[loaded.columns]
        elimination = Elimination.of((rows.T @ rows).tocsc(), network.graph.place[sphere].T, network.parts_of(sphere))
        factor = elimination.factorised(YIELDING)
        return None if factor is None else cls(loaded, weight, scale, factor)

    def forces_for(self, load: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return friction forces at the q contacts that balance each of m loads, and a bound on the torques left over.

        load : (n, m), each column a load, torques on the n unknown spin components. The true load is the sum of a_j
            times column j, with numbers a_j that are not known.
        most : (m,), bounds on |a_j|.

        Returns the friction (3 q, m) that balances each column, the three components of a contact after each other; and
        the largest torque (n,) that such a sum can leave on each unknown. The part of a load along motions without slip
        is left out: no friction can balance it, and in the true load these parts cancel.
        """
        rows, weight, scale = self.loaded.rows, np.repeat(self.weight, 3)[:, None], self.scale[:, None]
        force, (left, amounts) = np.zeros((rows.shape[0], load.shape[1])), self._without_motions(load)
        for _ in range(CARRYING_STEPS):  # each step balances the torques that the one before has left over
            force -= weight * (rows @ (scale * self.factor.solve(scale * left)))
            left, amounts = self._without_motions(load + rows.T @ force)
        # Rounding: the sizes of all terms of these sums, times the bound on the relative error of a sum.
        motions = self.loaded.motions
        summed = abs(rows).T @ (np.abs(force) @ most) + np.abs(load) @ most + abs(motions) @ (np.abs(amounts) @ most)
        return force, np.abs(left) @ most + (self.loaded.rounding + 2 * motions.shape[1] * EPS) * summed

    def _without_motions(self, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Split each of m loads (torques on n unknowns) into two parts: a sum of the z motions in which no exactly
        rolling contact slips, and a rest at right angles to them. No friction at these contacts can balance the first
        part. Return the rest (n, m), and how much of each motion was taken out, (z, m).

        load : (n, m)."""
        motions = self.loaded.motions
        if not motions.shape[1]:
            return load, np.zeros((0, load.shape[1]))
        amounts = DENSE.lu_solve(self.loaded.products, motions.T @ load, check_finite=False)
        return load - motions @ amounts, amounts
