"""Which contacts slip at every minimum, at none, or at some, where there are many minima: theorem 9.

What is proven. Where frictions cancel exactly, groups of spheres can move without changing the power, and the minima
are a polyhedron of motions. This file finds one minimum u*, then all others, for one sample with two spin components
that matter, in which each component of a slip depends on one of them: lattices, and packings with normals along the
axes.

Symbols
    S : the contacts that slip in the stored spins. C : those that do not slip although their friction is at its limit
        mu F_n, mostly along one component; those with friction along both are *oblique* (oblique_limits.py).
        T : all others.
    n : number of contacts of S and C together. E : of all contacts of the sample.
    u* : a minimum. t : slip of a contact at u*; 0 for C. y : a motion, from u* to another minimum.
    pull : the force of a contact on its spheres along one component.

A *domain* is a group of spheres that a set of contacts joins in one component, so that they move as one in it. Four
sets of contacts make four kinds of domains:
    firm domain : joined by T. It moves as one at every minimum, as its contacts are below their friction limits.
    locked domain : joined by T and by those contacts of C without friction along this component, which therefore never
        begin to slip along it. From one minimum to another it moves as one.
    slipless domain : joined by T and C, that is by all contacts that do not slip at u*.
    welded domain : slipless (or locked) domains that *turning* contacts join: contacts of S whose slip has the other
        component, too, and oblique ones.

A turning contact turns its slip as soon as one of its ends moves alone in one component, and minima do not differ in
the directions of slips. So from one minimum to another its ends move together, and a welded domain moves as a whole.
The exception are motions along the slip itself (between_two.py, and oblique_limits.py for oblique contacts).

Drawing of the four kinds. Five spheres in a row, looked at in the first component::

    1 --T-- 2 --C, friction along the second-- 3 --C, friction along the first-- 4 --S, slip in both-- 5

Firm: {1, 2}, {3}, {4}, {5}. Locked: {1, 2, 3}, {4}, {5}. Slipless: {1, 2, 3, 4}, {5}. Welded, of slipless ones: all
five; of locked ones: {1, 2, 3}, {4, 5}.

The proof
1. *What can move at no cost.* The other contacts of a welded domain pull it with their friction limits, along this
   component, with one sign or the other. Let it have no driven sphere, and let these pulls, added exactly, cancel. Then
   the balance of all its members but one implies that of the last one: so this one can be held without loss. The same
   is true of domains between two others that pull them with the same total friction in opposite directions: a motion
   on the line between these costs nothing (between_two.py). One of those that move together is held in one component.
2. *One minimum.* With these domains held there is one minimum u* nearby (curvature.py, `nearest_minimum`).
3. *It is one of the whole power.* Some friction by the law at u* is in balance. For contacts of C it is exactly mu F_n
   along one component; for oblique ones it exactly balances the friction of a slipping contact. Then it has to balance
   on each firm domain. It does if all pulls on it are known and, added exactly, cancel. Pulls of contacts with friction
   along both components are not known exactly; but they cancel in the sum over all firm domains that these contacts
   connect, and each free slipless domain is in balance as a whole (oblique_limits.py, `not_balanced`). Friction of T,
   below all limits, balances the other torques (curvature.py, `bearable`). So T rests at every minimum (theorem 4).
4. *All minima.* They share this friction. So each differs from u* by a motion that keeps T at rest, turns no slip of S,
    and lets C slip only along its friction, forward. But for the sign at C, two kinds of motions do so: of welded
    domains (made of locked ones) as a whole, and of domains along the lines between two others. There are no others.
    Without oblique contacts the reason is this. The equations of `not_balanced` prove the balance of each firm domain,
    one after the other. So every motion of firm domains is a sum of two: s moves slipless domains as a whole, g groups.
    g changes no slip that has both components, as its ends are in one group. If a slip has one of them, g does not
    change the other one: the whole motion must not, and s does not, as both ends are in one slipless domain. So s turns
    no slip, either, and the power is constant along it. By step 2 it is a sum of motions of welded domains and along
    lines. The whole motion less those along lines then changes no slip of a turning contact in its component, and so
    moves welded domains as a whole. With oblique contacts, motions of both kinds are subtracted until one locked domain
    of each welded one stands still, and one of the domains that move together along lines. The rest of the motion turns
    no slip of S and of no oblique contact. But it is proven that the power, with oblique contacts counted as if they
    slipped, has curvature along every motion with these domains held (curvature.py, `rises`). So the rest is 0.
    Contacts whose slips change by motions along lines stay undecided, unless it is proven that the domains do not move.
    For all others the minima are the motions y of welded domains in which no contact of S and C slips backwards:
    t + y_upper - y_lower >= 0, with signs.
5. *States.* These are constraints of shortest paths. A contact is an edge of length t: from the welded domain at its
   upper end to that at its lower end, or the other way round if its slip is negative (tail and head in the code). A
   contact of S rests at some minimum if no other path from its tail to its head is shorter than t, and at none if one
   is. A contact of C (t = 0) slips at some minimum unless a path of length 0 leads back. Contacts that rest at some
   minima and slip at others are *tied*.

Example. One domain lies between bottom and top, joined to the bottom by a contact with t = 0.3 and to the top by one
with t = 0.7, both with friction 1. Its motion y costs nothing while 0.3 + y >= 0 and 0.7 - y >= 0: at y = -0.3 the
first contact rests, at y = 0.7 the second one. Both are tied. Now let it be a welded domain of two members, which a
turning contact joins, each with a contact of friction 1/2 to the top, with t = 0.7 and 0.5. Then y <= 0.5, so the
contact with 0.7 keeps a slip of 0.2 or more: it slips at every minimum, as the path by 0.5 is shorter. The other two
are tied.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.between_two import BetweenTwo
from taichi_bearings.proof.curvature import Slipping, bearable, nearest_minimum, rises
from taichi_bearings.proof.enclosure import Enclosure
from taichi_bearings.proof.judged_network import JudgedNetwork, Motion
from taichi_bearings.proof.oblique_limits import Movable, ObliqueLimits, not_balanced
from taichi_bearings.proof.pulls import EPS, Pulls
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, TIED, UNDECIDED

# A contact is put into C if its stored friction misses mu F_n by no more than one of these shares, which are tried one
# after the other. Contacts that miss more than SURELY_FULL leave C again where friction would not balance. Friction is
# taken to be along one component if the other one is below the share MOST_ACROSS of mu F_n. Wrong choices only make the
# proof fail.
MISSED_SHARES, SURELY_FULL, MOST_ACROSS = (1e-9, 1e-5), 1e-12, 2e-3
PATH_ROUNDING = 1 + 1e-12  # factor that covers the rounding of a few products, and of sums along a path of 1000 slips


@dataclass(frozen=True)
class Constraints:
    """The constraints on how far minima of the power can differ along one spin component. From one minimum to another
    groups of spheres (*welded domains*) move as a whole. That changes the slips of the n contacts between such groups,
    but none may slip backwards.

    own : (n,), indices of these contacts in the arrays of :class:`Pulls`.
    lower, upper : (n,), number of the welded domain at either end; 0 for those that do not move.
    sign : (n,), +1 or -1: whether a positive motion of the upper end lengthens or shortens the slip.
    same_slip : (n,), equal numbers for contacts that have the same slip at the minimum from which groups move."""

    own: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    sign: np.ndarray
    same_slip: np.ndarray

    def sharing_a_domain(self, mask: np.ndarray) -> np.ndarray:
        """Return the mask (n,) of the given contacts and of all others that are connected with them through contacts
        and through welded domains (groups of spheres that move together) that can move.

        mask : (n,) mask of the given contacts.
        """
        size = int(max(self.lower.max(initial=0), self.upper.max(initial=0))) + 1
        both_move = (self.lower > 0) & (self.upper > 0)
        label = pieces(size, self.lower[both_move], self.upper[both_move])
        piece = label[np.maximum(self.lower, self.upper)]
        return np.isin(piece, piece[mask])

    def limits(self, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return three masks (n,) of the contacts: those that rest at some minimum, those that slip at all minima, and
        those that slip at some.

        From one minimum to another groups of spheres move along one component, as far as no contact slips backwards. So
        a contact can lose its slip unless other contacts that connect the same two groups, one after the other, have a
        smaller sum of slips. Shortest paths decide this, in a graph with the groups as nodes, the contacts as edges,
        and their slips as lengths.

        least, most : (n,), bounds of the slip at one minimum, both 0 for contacts that do not slip there."""
        # With t the slip of a contact and y a motion: it does not slip backwards if y[head] - y[tail] <= t.
        tail, head = np.where(self.sign > 0, (self.upper, self.lower), (self.lower, self.upper))
        group = np.unique(self.same_slip, return_inverse=True)[1]
        # Contacts of one group have one slip: the tightest bounds of all hold for each. Then shortest paths, with lower
        # bounds of the slips as lengths and with upper bounds: the true lengths lie between them.
        low, high = np.zeros(group.max(initial=0) + 1), np.full(group.max(initial=0) + 1, np.inf)
        np.maximum.at(low, group, least)
        np.minimum.at(high, group, most)
        low, high = low[group], high[group]
        graph = _Graph.of(tail, head)
        shortest, longest = dijkstra(graph.with_lengths(low)), dijkstra(graph.with_lengths(high))
        # A path visits each node once, so that its length is a sum of fewer slips than nodes, none of them negative:
        # its relative rounding is below nodes * EPS / 2. Twice EPS for a node also covers that of the products here.
        rounding = max(PATH_ROUNDING, 1 + 2 * EPS * len(shortest))
        slips_at_all = longest[tail, head] * rounding < low
        slips_at_some = (low > 0) | (shortest[head, tail] > 0)
        rests_at_some = high == 0
        # A slipping contact rests at some minimum if no path without the contacts of its group is shorter than its
        # slip. Paths through one of them are at least as long as that slip.
        for number in np.unique(group[~slips_at_all & ~rests_at_some]):
            members = np.flatnonzero(group == number)
            starts, limit = np.unique(tail[members]), high[members] * rounding
            without = graph.with_lengths(np.where(group == number, np.inf, low))
            distance = dijkstra(without, indices=starts, limit=float(limit.max()))  # beyond the limit: infinite
            rests_at_some[members] = limit <= distance[np.searchsorted(starts, tail[members]), head[members]]
        return rests_at_some, slips_at_all, slips_at_some


@dataclass(frozen=True)
class _Graph:
    """A directed graph whose edges have lengths. Of several edges from one node to another the shortest counts.

    joined : sparse matrix (nodes, nodes) with an entry for each pair of nodes that edges join, from row to column.
    pair : (edges,), for each edge the number of its entry."""

    joined: sparse.csr_array
    pair: np.ndarray

    @classmethod
    def of(cls, tail: np.ndarray, head: np.ndarray) -> _Graph:
        """Return the graph of edges (edges,) from the nodes `tail` to the nodes `head`, numbers 0, 1, ..."""
        nodes = int(max(tail.max(initial=0), head.max(initial=0))) + 1
        pairs, pair = np.unique(tail * nodes + head, return_inverse=True)
        row, column = np.divmod(pairs, nodes)
        begin = np.searchsorted(row, np.arange(nodes + 1)).astype(np.int32)
        joined = sparse.csr_array((np.ones(len(pairs)), column.astype(np.int32), begin), shape=(nodes, nodes))
        return cls(joined, pair)

    def with_lengths(self, length: np.ndarray) -> sparse.csr_array:
        """Return the matrix (nodes, nodes) of lengths for SciPy's searches. A stored 0 is an edge of length 0; where
        nothing is stored there is no edge, and a stored infinity is as good as none.

        length : (edges,), the length of each edge; infinite for an edge that is left out."""
        found = copy(self.joined)  # SciPy's constructor would check all places again, which takes longer
        found.data = np.full(len(found.data), np.inf)
        np.minimum.at(found.data, self.pair, length)
        return found


def tied_states(motion: Motion, contacts: Slipping) -> tuple[np.ndarray, bool | None] | None:
    """Return the proven states of all E contacts of one sample that may have many minima.

    motion : the stored spins of the sample and which contacts rest. Each component of a slip depends on one component
        of the spins; no loop has an odd number of contacts. Nothing is proven unless minima may slip along just two
        components.
    contacts : those that slip.

    Returns None if nothing is proven. Else the states (E,), SLIPLESS, SLIPPING (at every minimum), TIED (at some), or
    UNDECIDED; and True if there is only one minimum, False if there are more, None if that is not known."""
    if len(motion.network.needed) != 2:  # three, where spheres are driven inside a packing
        return None
    coefficient = motion.network.exact_limits
    if coefficient is None or motion.cannot_rest.any() or not (contacts.size.least > 0).all():
        return None
    # Guess which contacts are saturated; where friction does not balance some of them are left out for another try.
    for missed in MISSED_SHARES:
        saturated: Saturated | None = Saturated.of(motion, missed)
        while saturated is not None:
            pulls = _pulls(contacts, saturated, coefficient)
            limits = ObliqueLimits.of(pulls)
            if limits is None:
                break
            unbalanced = not_balanced(pulls, limits.between)
            found = None if unbalanced.any() else _tied_states(motion, contacts, saturated, pulls, limits)
            if found is not None:
                return found
            saturated = saturated.without(unbalanced)
    return None


def _tied_states(
    motion: Motion, contacts: Slipping, saturated: Saturated, pulls: Pulls, limits: ObliqueLimits
) -> tuple[np.ndarray, bool | None] | None:
    """Return the states (E,) of one sample and whether it has one minimum, as `tied_states` does, if the saturated
    contacts prove them; else None.

    motion : the stored spins of one sample and which contacts rest.
    contacts : those that slip.
    saturated : those that rest with friction taken to be at its limit. On all firm domains the friction balances.
    pulls : the slipping and the saturated contacts together, with the domains that they make.
    limits : the friction of the oblique saturated contacts, those with friction along both components."""
    # Choose domains to hold: slipless ones, so that one minimum is left; and locked ones, for the proof of step 4.
    between, movable = BetweenTwo.of(pulls, contacts), Movable.of(pulls, limits, contacts)
    held = _spheres_to_hold(pulls, pulls.slipless_domain, pulls.welded_slipless, between)
    held_locked = _spheres_to_hold(pulls, pulls.locked_domain, pulls.welded_locked, between, movable)
    if held is None or held_locked is None or not (held.any() or not pulls.in_s.all()):
        return None
    # Prove the minimum (steps 1 to 3); with oblique contacts the curvature that excludes other motions (step 4).
    near = _minimum_with_held(contacts, pulls, between, held, saturated, limits)
    if near is None:
        return None
    found, relative_change = near
    if pulls.oblique.any():
        undecided = _undecided(pulls, between, movable, near)
        if undecided is None or not rises(*_with_oblique(motion, pulls, limits, held_locked, near)):
            return None
        between = replace(between, undecided=undecided)
    return _states_by_paths(pulls, between, found, relative_change, bool(held_locked.any()), len(motion.rests))


@dataclass(frozen=True)
class Saturated:
    """The saturated contacts of one sample: they do not slip in the stored spins, yet their friction is at its limit
    mu F_n, of most of them along one spin component.

    Two spin components make contacts slip in such a sample; their numbers are `network.needed`, and `slot` is 0 or 1
    for the first or the second of them.

    motion : the stored spins of the sample, with E contacts, and which of them rest.
    mask : (E,), which contacts these are.
    along : (2, E) mask, for either component those of them with friction along it.
    """

    motion: Motion
    mask: np.ndarray
    along: np.ndarray

    @property
    def network(self) -> JudgedNetwork:
        """The sample."""
        return self.motion.network

    @cached_property
    def firm(self) -> Motion:
        """The motion in which no saturated contact is taken to rest."""
        return self.without_rest(self.mask)

    @classmethod
    def of(cls, motion: Motion, missed: float) -> Saturated:
        """Return the resting contacts of a motion with friction nearly at its limit, each with the component along
        which it is larger, or with both components.

        motion : stored spins of one sample, with the contacts that rest and the friction of all.
        missed : the largest share of mu F_n by which the friction of such a contact is below its limit.
        """
        network, strength = motion.network, motion.network.friction_limit.value
        parts = np.abs([network.moment[k].high for k in network.needed])
        mask = motion.rests & (np.hypot(*parts) >= (1 - missed) * strength) & network.counts
        along = (parts == parts.max(axis=0)) | (parts > MOST_ACROSS * strength)
        return cls(motion, mask, mask & along)

    @property
    def oblique(self) -> np.ndarray:
        """(E,) mask of the saturated contacts with friction along both components."""
        return np.asarray(self.along.all(axis=0))

    def without(self, unbalanced: np.ndarray) -> Saturated | None:
        """Return the saturated contacts without those on whose spheres friction does not balance and which may well
        not be saturated: they miss more than SURELY_FULL of their friction. Return None if there are none to leave out.

        unbalanced : (2, spheres) mask, by component, of spheres on which the friction does not balance with them."""
        limit, first, second = self.network.friction_limit.value, *self.network.graph.contact
        parts = [self.network.moment[k].high for k in self.network.needed]
        at = [self.along[slot] & (unbalanced[slot, first] | unbalanced[slot, second]) for slot in range(2)]
        left_out = (at[0] | at[1]) & (np.hypot(*parts) < (1 - SURELY_FULL) * limit)
        return Saturated(self.motion, self.mask & ~left_out, self.along & ~left_out) if left_out.any() else None

    def moment_at_limit(self, slot: int) -> Enclosure:
        """Return for each of the q saturated contacts the moment n x F (n the normal, F the friction) along component
        `slot` (0 or 1) at the minimum, an enclosure (q,): mu F_n with the sign of the stored moment, or 0 if the
        friction is along the other component. For oblique contacts only the sign has a meaning."""
        saturated = np.flatnonzero(self.mask)
        sign = np.sign(self.network.moment[self.network.needed[slot]].high[saturated])
        return self.network.friction_limit.at(saturated).signed(sign * self.along[slot, saturated])

    def without_rest(self, moves: np.ndarray) -> Motion:
        """Return the motion in which some contacts are no longer taken to rest.

        moves : (E,) mask of these contacts."""
        return Motion(self.network, self.motion.rests & ~moves) if moves.any() else self.motion

    def missing_friction(self, of_oblique: np.ndarray) -> dict[int, np.ndarray]:
        """Return a bound (spheres,) on the error of the torque over radius on each sphere, force, for each spin
        component k in `network.needed`, as a dictionary. The error is the sum over the saturated contacts of the sphere
        of |moment at the minimum - stored moment|.

        of_oblique : (2, E), bounds on these differences at oblique contacts. At others the moment is exactly known."""
        saturated, network = np.flatnonzero(self.mask), self.network
        found = {k: np.zeros(len(network.free)) for k in network.needed}
        for slot, k in enumerate(network.needed):
            of_others = (self.moment_at_limit(slot) - network.moment[k].at(saturated)).most
            difference = np.where(self.oblique[saturated], of_oblique[slot, saturated], of_others)
            difference[~network.feels[k][saturated]] = 0.0
            for end in network.graph.contact[:, saturated]:
                found[k] += np.bincount(end, difference, len(found[k]))
        return found


def _pulls(contacts: Slipping, saturated: Saturated, coefficient: np.ndarray) -> Pulls:
    """Return the contacts of one sample with friction at its limit, and the domains (groups of spheres that turn as
    one) that these and the resting contacts make.

    contacts : those that slip.
    saturated : those that do not slip although their friction is at its limit.
    coefficient : (E, p), friction limits of all E contacts, in exact proportions, as sums of p doubles."""
    motion, network, in_c = saturated.motion, saturated.network, np.flatnonzero(saturated.mask)
    components = len(network.needed)
    own = np.append(contacts.own, in_c)
    lower, upper = network.graph.contact[:, own]
    signs_of_c = np.array([np.sign(saturated.moment_at_limit(slot).high) * network.sign[k][upper[len(contacts.own) :]]
                     for slot, k in enumerate(network.needed)])  # fmt: skip
    signs = np.array([np.sign(part.high) for part in contacts.difference])
    driven = np.flatnonzero(~network.free)
    alike = [network.graph.driven_alike(k, network.imposed[k].signed(network.sign[k]), driven) for k in network.needed]
    # By component the motion whose resting contacts join spheres to domains of each kind.
    slipless_domain, firm_domain, locked_domain = (
        np.array([_numbered(joining, k, of) for joining, k, of in zip(motions, network.needed, alike, strict=True)])
        for motions in (
            [motion] * components,
            [saturated.firm] * components,
            [saturated.without_rest(along) for along in saturated.along],
        )
    )
    return Pulls(
        own, lower, upper, np.array([network.feels[k][own] for k in network.needed]),
        np.concatenate([signs, signs_of_c], axis=1), coefficient[own], np.arange(len(own)) < len(contacts.own),
        saturated.oblique[own], slipless_domain, firm_domain, locked_domain, ~network.free,
    )  # fmt: skip


def _numbered(motion: Motion, k: int, driven_alike: np.ndarray) -> np.ndarray:
    """Return a label (spheres,) for each sphere, equal for those that resting contacts of a motion join in spin
    component k. The smallest labels, 0, 1, ..., are for spheres joined to driven ones, one label for each imposed spin;
    larger ones are for all others.

    motion : the network, and which of its contacts rest. These join no driven spheres that are driven differently.
    driven_alike : (driven spheres,), 0, 1, ...: equal numbers for those with the same imposed spin."""
    label = motion.domain[k]
    found = np.full(int(label.max()) + 1, -1)
    found[label[~motion.network.free]] = driven_alike
    others = np.unique(label[found[label] < 0])
    found[others] = driven_alike.max() + 1 + np.arange(len(others))
    of_spheres: np.ndarray = found[label]
    return of_spheres


def _spheres_to_hold(
    pulls: Pulls, label: np.ndarray, welded_domain: np.ndarray, between: BetweenTwo, movable: Movable | None = None
) -> np.ndarray | None:
    """Return the mask (2, spheres), for either spin component, of spheres that are held where they are so that only one
    minimum is left; None if no such spheres are found.

    A *domain* is a group of spheres that turn as one. A *welded domain* consists of domains that can only move
    together; it may move if it has no driven sphere. Domains of `between` and `movable` may move along lines. Held are:
    * in each welded domain without a driven sphere one domain that moves along no line (None if there is none);
    * of the domains that move along lines those of `between.held`, and the pairs of `movable` in one component each.

    pulls : the contacts whose friction is at its limit.
    label : (2, spheres), for either component the label of the domain of each sphere.
    welded_domain : (2, spheres), the number of its welded domain: 0 for all with a driven sphere, then 1, 2, ...
    between : domains that move on lines between two neighbours, which pull them with the same friction.
    movable : pairs of locked domains that can move along a line; None if `label` has no locked domains.
    """
    held = np.zeros(label.shape, dtype=bool)
    for slot in range(2):
        welded, moves_along_line = welded_domain[slot], np.isin(pulls.slipless_domain[slot], between.labels[slot])
        if movable is not None:
            moves_along_line |= np.isin(label[slot], movable.labels[slot])
            held[slot] |= np.isin(label[slot], movable.labels[slot][movable.slot == slot])
        for number in range(1, int(welded.max()) + 1):
            candidates = label[slot][(welded == number) & ~moves_along_line]
            if not len(candidates):
                return None
            held[slot] |= label[slot] == candidates[0]
        for domain in between.held[slot]:
            held[slot] |= label[slot] == label[slot][pulls.slipless_domain[slot] == domain][0]
    return held


def _labels_of_moving(motion: Motion, label: np.ndarray, held: np.ndarray) -> dict[int, np.ndarray]:
    """Return a dictionary: for each of the two spin components k along which minima may slip the labels (spheres,) of
    domains, with 0, the label of a driven domain, for spheres that are held where they are.

    motion : the sample, with the numbers of these components.
    label : (2, spheres), for either component the label of the domain (group of spheres that turn as one) of a sphere.
    held : (2, spheres) mask of the spheres that are held."""
    return {k: np.where(h, 0, own) for k, own, h in zip(motion.network.needed, label, held, strict=True)}


def _minimum_with_held(
    contacts: Slipping,
    pulls: Pulls,
    between: BetweenTwo,
    held: np.ndarray,
    saturated: Saturated,
    limits: ObliqueLimits,
) -> tuple[Slipping, np.ndarray] | None:
    """Return the slipping contacts at spins close to a minimum, and for each a bound on |slip at the minimum - slip| /
    |slip|; None if no minimum is proven.

    With some domains (groups of spheres that turn as one) held where they are, just one minimum is near the stored
    spins. It is a minimum without holding them, too: the exactly known forces cancel on the held domains, and friction
    of other resting contacts, below their limits, balances all other torques.

    contacts : the contacts that slip in the stored spins.
    pulls : the contacts whose friction is at its limit.
    between : domains that two neighbours pull with the same friction.
    held : (2, spheres) mask of the spheres whose domain is held, for either component.
    saturated : contacts without slip whose friction is at its limit.
    limits : the friction of the oblique saturated contacts, those with friction along both components."""
    motion = saturated.motion
    near = nearest_minimum(contacts.over(motion.network, _labels_of_moving(motion, pulls.slipless_domain, held)))
    if near is None:
        return None
    found, relative_change = near
    # The pulls of slipping contacts that count as exactly known have the signs of the stored spins at the minimum, too.
    known = pulls.felt & ~pulls.turned_by & pulls.in_s
    signs = np.array([np.sign(part.high) for part in found.difference])
    keep_signs = (signs == pulls.sign[:, : len(relative_change)]) | ~known[:, : len(relative_change)]
    # All known pulls cancel on welded domains without a driven sphere, which have numbers above 0.
    cancel = all(pulls.known_pulls_cancel_at(pulls.welded_slipless[slot], slot)[1:].all() for slot in range(2))
    if not (keep_signs.all() and cancel and between.lie_between(pulls, found, relative_change)):
        return None
    # Friction of the contacts below their limits balances the other torques.
    unsure = saturated.missing_friction(limits.missed(motion.network, pulls, found, relative_change))
    return near if bearable(saturated.firm, found, relative_change, unsure) else None


def _with_oblique(
    motion: Motion, pulls: Pulls, limits: ObliqueLimits, held: np.ndarray, near: tuple[Slipping, np.ndarray]
) -> tuple[Slipping, np.ndarray]:
    """Return the slipping and the oblique contacts of one sample as if all of them slipped, and for each a bound on
    |slip at the minimum - slip| / |slip|. Oblique contacts rest with friction along both components. Each gets the slip
    of its guide, a slipping contact whose slip has the direction of this friction. The unknowns are the spins of locked
    domains.

    motion : the stored spins of the sample, and which contacts rest.
    pulls : the contacts whose friction is at its limit, the oblique ones among them.
    limits : the guides of the oblique contacts.
    held : (2, spheres) mask of the spheres whose domain is held, for either component.
    near : the slipping contacts close to the minimum, and for each the bound."""
    found, relative_change = near
    rests, some = motion.rests.copy(), np.flatnonzero(pulls.in_s | pulls.oblique)
    rests[pulls.own[pulls.oblique]] = False
    label = _labels_of_moving(motion, pulls.locked_domain, held)
    slipping = Slipping.of(Motion(motion.network, rests)).over(motion.network, label)
    some = some[np.argsort(pulls.own[some])]  # the order of the contacts in `slipping`
    guide, way = limits.guide[some], limits.way[some]
    first, second = (part.at(guide).signed(way) for part in found.difference)
    return replace(slipping, difference=(first, second)), relative_change[guide]


def _undecided(
    pulls: Pulls, between: BetweenTwo, movable: Movable, near: tuple[Slipping, np.ndarray]
) -> np.ndarray | None:
    """Return the mask (n,) of the contacts whose states are not proven, as their slips change when domains move along
    lines; None if the direction of a line is not known closely enough.

    pulls : the n contacts whose friction is at its limit.
    between : the domains that can move along lines between two others, and the contacts whose slips this changes.
    movable : the pairs of domains that can move along the friction of oblique contacts.
    near : the slipping contacts close to the minimum, and for each a bound on |slip at the minimum - slip| / |slip|.
    """
    signs = movable.signs(*near)
    undecided: np.ndarray = between.undecided.copy()
    if not signs[movable.slot, np.arange(len(movable.slot))].all():
        return None
    excluded = np.array([np.isin(pulls.slipless_domain[slot], between.labels[slot]) for slot in range(2)])
    blocked = movable.blocked(pulls, signs, excluded)
    # Add the contacts of each pair that may move, and those at it that slip, or would, along one component alone.
    for number in np.flatnonzero(~blocked).tolist():
        undecided[movable.pairs[number].contacts] = True
        for slot, label in enumerate(movable.labels[:, number].tolist()):
            changes = pulls.felt[slot] & ~pulls.turned_by[slot]
            undecided |= changes & pulls.touches(pulls.locked_domain[slot], label)
    return undecided


def _states_by_paths(
    pulls: Pulls, between: BetweenTwo, contacts: Slipping, relative_change: np.ndarray, may_differ: bool, count: int
) -> tuple[np.ndarray, bool | None]:
    """Return the states (E,) of all contacts of a sample; and True if there is only one minimum, False if there are
    more, None if that is not known. From one minimum to another contacts slip less or more, but never backwards;
    shortest paths along slips say how far that can go.

    pulls : the n contacts whose friction is at its limit.
    between : domains (groups of spheres) that two neighbours pull with the same friction.
    contacts : the slipping contacts at spins close to a minimum.
    relative_change : (slipping contacts,), bound on |slip at this minimum - slip| / |slip|.
    may_differ : True if some domain can move at no cost, so that minima may differ. There is one minimum all the same
        if no contact is tied: a motion between minima could go on until a slip is 0, at a contact that is tied.
    count : E, number of contacts."""
    of_c = len(pulls.in_s) - len(relative_change)  # number of contacts that do not slip
    # Bounds of the slips at this minimum: a slip with its largest change, or 0.
    least = np.append(contacts.size.least * (1 - relative_change) / PATH_ROUNDING, np.zeros(of_c))
    most = np.append(contacts.size.most * (1 + relative_change) * PATH_ROUNDING, np.zeros(of_c))
    state = np.where(pulls.in_s, SLIPPING, SLIPLESS)
    state[between.undecided] = UNDECIDED
    # TIED, SLIPPING or SLIPLESS where shortest paths decide; UNDECIDED if connected with domains that move along lines.
    for constraints in _constraints(pulls):
        own = constraints.own
        rests_at_some, slips_at_all, slips_at_some = constraints.limits(least[own], most[own])
        known = np.where(slips_at_all, SLIPPING, np.where(rests_at_some, SLIPLESS, UNDECIDED))
        known[rests_at_some & slips_at_some] = TIED
        if between.undecided.any():
            undecided = constraints.sharing_a_domain(between.undecided[own])
            known[undecided & (known != TIED)] = UNDECIDED
        state[own] = known
    found = np.full(count, SLIPLESS)
    found[pulls.own] = state
    tied, unproven = (found == TIED).any(), (found == UNDECIDED).any()
    return found, False if tied else True if not may_differ or not unproven else None


def _constraints(pulls: Pulls) -> list[Constraints]:
    """Return for each of the two spin components the contacts whose slips along it may differ between minima, with the
    welded domains (groups of spheres that move together from one minimum to another) at both ends. They slip along this
    component alone, or could begin to, and lie between two welded domains.

    pulls : the contacts whose friction is at its limit, slipping ones (`in_s`) and others, and the domains that they
        and resting contacts make."""
    found, size = [], pulls.slipless_domain.shape[1] + 2
    for slot in range(2):
        # contacts that this component makes slip, and that do not slip along the other one (`turned_by`)
        welded = pulls.welded_locked[slot]
        ends = welded[pulls.lower], welded[pulls.upper]
        own = np.flatnonzero(pulls.felt[slot] & ~pulls.turned_by[slot] & (ends[0] != ends[1]))
        sign = pulls.sign[slot, own]
        # Slipping contacts between the same two domains have the same slip if its sign is the same, or if sign and ends
        # are exchanged; their key is the pair of domains. Any other contact has a key of its own.
        low, high = (pulls.slipless_domain[slot, end[own]] for end in (pulls.lower, pulls.upper))
        same_slip = np.where(sign > 0, low * size + high, high * size + low)
        same_slip = np.where(pulls.in_s[own], same_slip, size * size + own)
        found.append(Constraints(own, ends[0][own], ends[1][own], sign, same_slip))
    return found
