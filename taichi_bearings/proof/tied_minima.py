"""Which contacts slip at every minimum, at none, or at some, where there are many minima: theorem 9.

What is proven. Where frictions cancel exactly, groups of spheres can move without changing the power, and the minima
are a polyhedron of motions. This file finds one minimum u*, then all others, for one sample with two spin components
that matter, in which each component of a slip depends on one of them: lattices, and packings with normals along the
axes.

Symbols
    S : the contacts that slip in the stored spins. C : those that do not slip and yet bear all their friction mu F_n.
        T : all others. Contacts of C bear it along one component; those with friction along both are *oblique*
        (oblique_limits.py).
    n : number of contacts of S and C together. E : of all contacts of the sample.
    u* : a minimum. t : slip of a contact at u*; 0 for C. y : a motion, from u* to another minimum.
    pull : the force of a contact on its spheres along one component.

A *domain* is a group of spheres that a set of contacts joins in one component, so that they move as one there. Four
sets of contacts make four kinds of domains:
    firm domain : joined by T. It cannot be torn at any minimum, as its contacts have friction left.
    locked domain : joined by T and by those contacts of C that bear no friction along this component, which therefore
        never begin to slip along it. From one minimum to another it moves as one.
    slipless domain : joined by T and C, so by all contacts that do not slip at u*.
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
1. *What can move at no cost.* A welded domain without a driven sphere is pulled by its other contacts with their whole
   friction, one way or the other. If these pulls, added exactly, cancel, then the balance of all its members but one
   implies that of the last one: so one equation is redundant, and one member can be held without loss. The same is true
   of domains between two others that pull them with the same total friction in opposite directions: on the line between
   these nothing changes (between_two.py). One of those that move together is held in one component.
2. *One minimum.* With these domains held there is one minimum u* nearby (curvature.py, `nearest_minimum`).
3. *It is one of the whole power.* Friction that agrees with u* can be put in balance. Contacts of C bear exactly mu
   F_n along one component, and oblique ones exactly what balances one slip beside them. Then friction has to balance on
   each firm domain. It does if all pulls on it are known and, added exactly, cancel. Pulls of contacts with friction
   along both components are not known exactly; but they cancel on all firm domains together that these contacts
   connect, and each free slipless domain is in balance as a whole (oblique_limits.py, `not_balanced`). Contacts of T
   bear the rest, inside all discs (curvature.py, `bearable`). So T rests at every minimum (theorem 4).
4. *All minima.* They share this friction. So each differs from u* by a motion that keeps T at rest, turns no slip of S,
   and lets C slip only along its friction, forward. But for the sign at C, two kinds of motions do so: of welded
   domains (of locked ones) as a whole, and of domains along the lines between two others. There are no further ones.
   For such motions can be subtracted until one locked domain of each welded one stands still, and one of the domains
   that move together along lines. What is left turns no slip of S and none that an oblique contact would begin with, so
   the power has no curvature along it, with oblique contacts counted as if they slipped; but it is proven to have
   curvature along every motion with these domains held (curvature.py, `rises`). So nothing is left. Contacts at which
   motions along lines act are left undecided, unless it is proven that these do not move. All others have the minima of
   motions y of welded domains for which no contact of S and C slips backwards: t + y_upper - y_lower >= 0, with signs.
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
# after the other: where friction of full size is 1e-6 across one contact, another one may miss this. Then contacts that
# miss more than SURELY_FULL leave C again where friction would not balance: a contact that balances one which slips
# along it but for 1e-4 has 5e-9 of its friction left. Friction is taken to be along one component if the other one is
# below the root of MISSED_ACROSS times the share, 1.4 times the most that friction of full size can have there. Wrong
# choices only make the proof fail.
MISSED_LIMIT = 1e-6
MISSED_LIMITS = (MISSED_LIMIT, 1e-5)
MISSED_ACROSS, SURELY_FULL = 4, 1e-12
PATH_ROUNDING = 1 + 1e-12  # factor that covers the rounding of a few products, and of sums along a path of 1000 slips


@dataclass(frozen=True)
class Constraints:
    """What limits how far minima of the power can differ along one spin component. From one minimum to another groups
    of spheres (*welded domains*) shift as a whole. The n contacts between such groups slip more or less then, but none
    may slip backwards.

    own : (n,), indices of these contacts in the arrays of :class:`Pulls`.
    lower, upper : (n,), number of the welded domain at either end; 0 for what does not move.
    sign : (n,), +1 or -1: whether a motion of the upper end lengthens or shortens the slip.
    same_slip : (n,), equal numbers for contacts that have the same slip at the minimum from which groups shift."""

    own: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    sign: np.ndarray
    same_slip: np.ndarray

    def sharing_a_domain(self, mask: np.ndarray) -> np.ndarray:
        """Return the mask (n,) of the contacts that are connected with given ones, directly or through other contacts,
        by welded domains (groups of spheres that move together) that can move; the given ones included.

        mask : (n,) mask of the given contacts.
        """
        size = int(max(self.lower.max(initial=0), self.upper.max(initial=0))) + 1
        inner = (self.lower > 0) & (self.upper > 0)
        joins = self.lower[inner], self.upper[inner]
        piece = pieces(size, *joins)[np.maximum(self.lower, self.upper)]
        return np.isin(piece, piece[mask])

    def limits(self, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return three masks (n,) of the contacts: those that rest at some minimum, those that slip at all minima, and
        those that slip at some.

        From one minimum to another groups of spheres shift along one component, as far as no contact slips backwards.
        So a contact can lose its slip unless other contacts that connect the same two groups, one after the other, have
        a smaller sum of slips. That is a question of shortest paths in a graph with the groups as nodes, the contacts
        as edges, and their slips as lengths.

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
        shortest, longest = (
            dijkstra(_graph_of_shortest(tail, head, low)),
            dijkstra(_graph_of_shortest(tail, head, high)),
        )
        # A path visits each node once, so that its length is a sum of fewer slips than nodes, none of them negative:
        # its relative rounding is below nodes * EPS / 2. Twice EPS for a node also covers that of the products here.
        rounding = max(PATH_ROUNDING, 1 + 2 * EPS * len(shortest))
        slips_at_all = longest[tail, head] * rounding < low
        slips_at_some = (low > 0) | (shortest[head, tail] > 0)
        rests_at_some = high == 0
        # A slipping contact rests at some minimum if no path without the contacts of its group is shorter than its
        # slip. Paths through one of them are as long as that slip alone, at least.
        for number in np.unique(group[~slips_at_all & ~rests_at_some]):
            own = np.flatnonzero(group == number)
            left, starts, limit = group != number, np.unique(tail[own]), high[own] * rounding
            others = _graph_of_shortest(tail[left], head[left], low[left], len(shortest))
            around = dijkstra(others, indices=starts, limit=float(limit.max()))  # beyond the limit: infinite
            rests_at_some[own] = limit <= around[np.searchsorted(starts, tail[own]), head[own]]
        return rests_at_some, slips_at_all, slips_at_some


def _graph_of_shortest(tail: np.ndarray, head: np.ndarray, length: np.ndarray, size: int = 0) -> sparse.csr_array:
    """Return a directed graph as a sparse matrix (size, size) of lengths. Of several edges from one node to another the
    shortest is kept. A stored 0 is an edge of length 0; where nothing is stored there is no edge.

    tail, head, length : (edges,), first and last node of each edge, numbers from 0, and its length.
    size : least number of nodes; there are more if the edges need more."""
    size = max(size, int(max(tail.max(initial=0), head.max(initial=0))) + 1)
    order = np.lexsort((length, head, tail))
    first = np.append(True, (np.diff(tail[order]) != 0) | (np.diff(head[order]) != 0))[: len(order)]
    kept = order[first]
    begin = np.searchsorted(tail[kept], np.arange(size + 1))
    return sparse.csr_array((length[kept], head[kept].astype(np.int32), begin.astype(np.int32)), shape=(size, size))


def tied_states(motion: Motion, contacts: Slipping) -> tuple[np.ndarray, bool | None] | None:
    """Prove the states of all E contacts of one sample that may have many minima.

    motion : the stored spins of the sample and which contacts rest. Each component of a slip depends on one component
        of the spins; no loop of contacts is odd. Nothing is proven unless two components matter.
    contacts : those that slip.

    Returns None if nothing is proven. Else the states (E,), SLIPLESS, SLIPPING (at every minimum), TIED (at some), or
    UNDECIDED; and True if there is only one minimum, False if there are more, None if that is not known."""
    if len(motion.network.needed) != 2:  # three, where spheres are driven inside a packing
        return None
    coefficient = motion.network.exact_limits
    if coefficient is None or motion.torn.any() or not (contacts.size.least > 0).all():
        return None
    for missed in MISSED_LIMITS:
        saturated: Saturated | None = Saturated.of(motion, missed)
        while saturated is not None:
            pulls = _pulls(contacts, saturated, coefficient)
            limits = ObliqueLimits.of(pulls)
            if limits is None:
                break
            wrong = not_balanced(pulls, limits.between)
            found = None if wrong.any() else _tied_states(motion, contacts, saturated, pulls, limits)
            if found is not None:
                return found
            saturated = saturated.without(wrong)
    return None


def _tied_states(
    motion: Motion, contacts: Slipping, saturated: Saturated, pulls: Pulls, limits: ObliqueLimits
) -> tuple[np.ndarray, bool | None] | None:
    """Prove the states of all E contacts of one sample, as :func:`tied_states` does, with given saturated contacts.

    motion : the stored spins of the sample and which contacts rest.
    contacts : those that slip.
    saturated : those that rest and are taken to bear all their friction. On all firm domains the friction balances.
    pulls : both together.
    limits : the friction of those of them that bear it along both components."""
    # Hold one slipless domain of each welded domain, for one minimum; and one locked domain, to exclude other motions.
    between, movable = BetweenTwo.of(pulls, contacts), Movable.of(pulls, limits, contacts)
    held = _spheres_to_hold(pulls, pulls.slipless_domain, pulls.welded_slipless, between)
    held_locked = _spheres_to_hold(pulls, pulls.locked_domain, pulls.welded_locked, between, movable)
    if held is None or held_locked is None or not (held.any() or not pulls.in_s.all()):
        return None
    # The minimum with these held; then the curvature that excludes other motions; then what shortest paths say.
    near = _minimum_with_held(motion, pulls, between, held, saturated, limits)
    if near is None:
        return None
    found, relative_change = near
    if not pulls.in_s.all():
        undecided = _undecided(pulls, between, movable, near)
        if undecided is None or not rises(*_with_oblique(motion, pulls, limits, held_locked, near)):
            return None
        between = replace(between, undecided=undecided)
    return _states_by_paths(pulls, between, found, relative_change, bool(held_locked.any()), len(motion.rests))


@dataclass(frozen=True)
class Saturated:
    """The saturated contacts of one sample: they do not slip in the stored spins, yet bear all their friction mu F_n,
    most of them along one spin component.

    Two spin components make contacts slip in such a sample; their numbers are `network.needed`, and `slot` 0 or 1 says
    which of the two is meant.

    motion : the stored spins of the sample, with E contacts, and which of them rest.
    mask : (E,), which contacts these are.
    along : (2, E) mask, for either component those of them that bear friction along it.
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
        """The motion in which none of these contacts is taken to rest."""
        return self.without_rest(self.mask)

    @classmethod
    def of(cls, motion: Motion, missed: float) -> Saturated:
        """Return the resting contacts of a motion that bear nearly all their friction, each with the component along
        which it bears more, or with both components.

        motion : stored spins of one sample, with the contacts that rest and the friction of all.
        missed : the largest share of mu F_n that such a contact does not bear.
        """
        network, strength = motion.network, motion.network.holding.value
        parts = np.abs([network.moment[k].high for k in network.needed])
        mask = motion.rests & (np.hypot(*parts) >= (1 - missed) * strength) & network.counts
        along = (parts == parts.max(axis=0)) | (parts > (MISSED_ACROSS * missed) ** 0.5 * strength)
        return cls(motion, mask, mask & along)

    @property
    def oblique(self) -> np.ndarray:
        """(E,) mask of the saturated contacts that bear friction along both components."""
        return np.asarray(self.along.all(axis=0))

    def without(self, wrong: np.ndarray) -> Saturated | None:
        """Return these contacts without those that would have to be saturated for friction to balance, and may well not
        be: they miss more than SURELY_FULL of their friction. Return None if there are none of these.

        wrong : (2, spheres) mask, by component, of spheres on which the friction does not balance if they are."""
        strength, first, second = self.network.holding.value, *self.network.graph.contact
        parts = [self.network.moment[k].high for k in self.network.needed]
        at = [self.along[slot] & (wrong[slot, first] | wrong[slot, second]) for slot in range(2)]
        leave = (at[0] | at[1]) & (np.hypot(*parts) < (1 - SURELY_FULL) * strength)
        return Saturated(self.motion, self.mask & ~leave, self.along & ~leave) if leave.any() else None

    def friction(self, slot: int) -> Enclosure:
        """Return an enclosure (n,), for each of n saturated contacts the moment n x F, in units of force, that it has
        to exert along component `slot` (0 or 1). That is mu F_n with the sign of the stored moment, or 0 if the contact
        bears its friction along the other component. It has no meaning for oblique contacts but its sign."""
        own = np.flatnonzero(self.mask)
        sign = np.sign(self.network.moment[self.network.needed[slot]].high[own])
        return self.network.holding.at(own).signed(sign * self.along[slot, own])

    def without_rest(self, moves: np.ndarray) -> Motion:
        """Return the motion in which some contacts are no longer taken to rest.

        moves : (E,) mask of these contacts."""
        return Motion(self.network, self.motion.rests & ~moves) if moves.any() else self.motion

    def missing_friction(self, of_oblique: np.ndarray) -> dict[int, np.ndarray]:
        """Return by spin component k that matters, as a dictionary, a bound (spheres,) on an error of the torque over
        radius on each sphere, in units of force. A saturated contact should exert exactly mu F_n along one component,
        or what is known of an oblique one. Its stored moment differs a little from that; the bound is the sum of the
        sizes of these differences over the contacts of a sphere.

        of_oblique : (2, E), bounds on the differences of oblique contacts."""
        own, network = np.flatnonzero(self.mask), self.network
        found = {k: np.zeros(len(network.free)) for k in network.needed}
        for slot, k in enumerate(network.needed):
            missing = np.where(
                self.oblique[own], of_oblique[slot, own], (self.friction(slot) - network.moment[k].at(own)).most
            )
            missing[~network.feels[k][own]] = 0.0
            for end in network.graph.contact[:, own]:
                found[k] += np.bincount(end, missing, len(found[k]))
        return found


def _pulls(contacts: Slipping, saturated: Saturated, coefficient: np.ndarray) -> Pulls:
    """Return the contacts of one sample that bear all their friction, and the domains (groups of spheres that turn as
    one) that these and the resting contacts make.

    contacts : those that slip.
    saturated : those that do not slip and yet bear all their friction.
    coefficient : (E, p), friction limits of all E contacts, in exact proportions, as sums of p doubles."""
    motion, network, in_c = saturated.motion, saturated.network, np.flatnonzero(saturated.mask)
    components = len(network.needed)
    own = np.append(contacts.own, in_c)
    lower, upper = network.graph.contact[:, own]
    signs_of_c = np.array([np.sign(saturated.friction(slot).high) * network.sign[k][network.graph.contact[1, in_c]]
                     for slot, k in enumerate(network.needed)])  # fmt: skip
    signs = np.array([np.sign(part.high) for part in contacts.difference])
    slipless_domain, firm_domain, locked_domain = (
        np.array([_numbered(own, k) for own, k in zip(motions, network.needed, strict=True)])
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


def _numbered(motion: Motion, k: int) -> np.ndarray:
    """Return a label (spheres,) for each sphere, equal for those that resting contacts of a motion join in spin
    component k. The smallest numbers, 0, 1, ..., are for what turns with a driven sphere, one number for all that are
    driven alike; larger ones are for all others.

    motion : the network, and which of its contacts rest. These join no driven spheres that are driven differently."""
    network, label = motion.network, motion.domain[k]
    driven = np.flatnonzero(~network.free)
    group = network.graph.driven_alike(k, network.imposed[k].signed(network.sign[k]), driven)
    found = np.full(int(label.max()) + 1, -1)
    found[label[driven]] = group
    others = np.unique(label[found[label] < 0])
    found[others] = group.max() + 1 + np.arange(len(others))
    of_spheres: np.ndarray = found[label]
    return of_spheres


def _spheres_to_hold(
    pulls: Pulls, label: np.ndarray, welded_domain: np.ndarray, between: BetweenTwo, movable: Movable | None = None
) -> np.ndarray | None:
    """Choose spheres to be held where they are, so that only one minimum is left: the mask (2, spheres) of them for
    either spin component; None if that cannot be done.

    A *domain* is a group of spheres that turn as one; a *welded domain* consists of domains that can only move
    together. Two kinds of groups can move at no cost, and are held:

    * Of each welded domain without a driven sphere one domain is held. It must not be one of `between` or `movable`; if
      all are, the result is None.
    * Of the domains of `between` those are held that it chooses, each pair of `movable` in the component that this
      chooses.

    pulls : the contacts that bear all their friction.
    label : (2, spheres), for either component the label of the domain of each sphere.
    welded_domain : (2, spheres), the number of its welded domain: 0 for those that contain a driven sphere, then 1, 2,
        ...
    between : domains that move on lines between two neighbours, which pull them with the same friction.
    movable : pairs of locked domains that can move along a line, if `label` has locked domains.
    """
    held = np.zeros(label.shape, dtype=bool)
    for slot in range(2):
        welded, inner = welded_domain[slot], np.isin(pulls.slipless_domain[slot], between.labels[slot])
        if movable is not None:
            inner |= np.isin(label[slot], movable.labels[slot])
            held[slot] |= np.isin(label[slot], movable.labels[slot][movable.slot == slot])
        for number in range(1, int(welded.max()) + 1):
            some = label[slot][(welded == number) & ~inner]
            if not len(some):
                return None
            held[slot] |= label[slot] == some[0]
        for domain in between.held[slot]:
            held[slot] |= label[slot] == label[slot][pulls.slipless_domain[slot] == domain][0]
    return held


def _labels_of_moving(motion: Motion, label: np.ndarray, held: np.ndarray) -> dict[int, np.ndarray]:
    """Return a dictionary: for each of the two spin components k that matter the labels (spheres,) of domains, with 0,
    the label of a driven domain, for spheres that are held where they are.

    motion : says which components these are.
    label : (2, spheres), for either component the label of the domain (group of spheres that turn as one) of a sphere.
    held : (2, spheres) mask of the spheres that are held."""
    return {k: np.where(h, 0, own) for k, own, h in zip(motion.network.needed, label, held, strict=True)}


def _minimum_with_held(
    motion: Motion,
    pulls: Pulls,
    between: BetweenTwo,
    held: np.ndarray,
    saturated: Saturated,
    limits: ObliqueLimits,
) -> tuple[Slipping, np.ndarray] | None:
    """Prove two things: near the stored spins there is one minimum if some domains (groups of spheres that turn as one)
    are held where they are; and it is a minimum without holding them, too. For the latter, known forces have to cancel
    on the held domains, and friction of the resting contacts, below their limits, has to balance all other torques.

    Return None if that is not proven; else the slipping contacts at spins close to that minimum, and for each a bound
    on |slip there - slip| / |slip|.

    motion : the stored spins of one sample, and which contacts rest.
    pulls : the contacts that bear all their friction.
    between : domains that two neighbours pull with the same friction.
    held : (2, spheres) mask of the spheres whose domain is held, for either component.
    saturated : contacts without slip that bear all their friction.
    limits : the friction of those of them that bear it along both components."""
    near = nearest_minimum(Slipping.of(motion, _labels_of_moving(motion, pulls.slipless_domain, held)))
    if near is None:
        return None
    found, relative_change = near
    # The pulls that were taken as known keep their signs at u* and cancel, and T bears the rest.
    known = pulls.felt & ~pulls.turned_by & pulls.in_s
    signs = np.array([np.sign(part.high) for part in found.difference])
    same = (signs == pulls.sign[:, : len(relative_change)]) | ~known[:, : len(relative_change)]
    # No other force could balance the known pulls on welded domains without a driven sphere, which have labels above 0.
    cancel = all(pulls.known_pulls_cancel_at(pulls.welded_slipless[slot], slot)[1:].all() for slot in range(2))
    if not (same.all() and cancel and between.lie_between(pulls, found, relative_change)):
        return None
    missing = saturated.missing_friction(limits.missed(motion.network, pulls, found, relative_change))
    return near if bearable(saturated.firm, found, relative_change, missing) else None


def _with_oblique(
    motion: Motion, pulls: Pulls, limits: ObliqueLimits, held: np.ndarray, near: tuple[Slipping, np.ndarray]
) -> tuple[Slipping, np.ndarray]:
    """Return the contacts whose slip may not turn from one minimum to another, with slips of the right directions, and
    for each a bound on the relative change of its slip up to the minimum. These are the slipping contacts, and the
    oblique ones with the slip of the contact that says what their friction is. The unknowns are locked domains.

    motion : the stored spins of one sample, and which contacts rest.
    pulls : the contacts that bear all their friction, among them oblique ones, which rest and bear it along both
        components.
    limits : the directions of the friction of the latter.
    held : (2, spheres) mask of the spheres whose domain is held, for either component.
    near : the slipping contacts close to the minimum, and for each the bound."""
    found, relative_change = near
    rests, some = motion.rests.copy(), np.flatnonzero(pulls.in_s | pulls.oblique)
    rests[pulls.own[pulls.oblique]] = False
    moving = Motion(motion.network, rests) if pulls.oblique.any() else motion
    whole = Slipping.of(moving, _labels_of_moving(motion, pulls.locked_domain, held))
    some = some[np.argsort(pulls.own[some])]  # the order of the contacts in `whole`
    guide, way = limits.guide[some], limits.way[some]
    first, second = (part.at(guide).signed(way) for part in found.difference)
    return replace(whole, difference=(first, second)), relative_change[guide]


def _undecided(
    pulls: Pulls, between: BetweenTwo, movable: Movable, near: tuple[Slipping, np.ndarray]
) -> np.ndarray | None:
    """Return the mask (n,) of the contacts whose slips change by motions along lines, so that their states are not
    proven here; None if the direction of such a line is not known well enough.

    pulls : the n contacts that bear all their friction.
    between, movable : what can move along lines.
    near : the slipping contacts close to the minimum, and for each a bound on |slip at the minimum - slip| / |slip|.
    """
    signs = movable.signs(*near)
    undecided: np.ndarray = between.undecided.copy()
    if not signs[movable.slot, np.arange(len(movable.slot))].all():
        return None
    excluded = np.array([np.isin(pulls.slipless_domain[slot], between.labels[slot]) for slot in range(2)])
    blocked = movable.blocked(pulls, signs, excluded)
    for number in np.flatnonzero(~blocked).tolist():
        undecided[movable.pairs[number].contacts] = True
        for slot, own in enumerate(movable.labels[:, number].tolist()):
            changes = pulls.felt[slot] & ~pulls.turned_by[slot]
            undecided |= changes & pulls.touches(pulls.locked_domain[slot], own)
    return undecided


def _states_by_paths(
    pulls: Pulls, between: BetweenTwo, contacts: Slipping, relative_change: np.ndarray, may_differ: bool, count: int
) -> tuple[np.ndarray, bool | None]:
    """Return the states (E,) of all contacts of a sample, and whether there is only one minimum: True, False, or None
    if that is not known. At one minimum contacts may slip less or more than at another, but never backwards; shortest
    paths along slips say how far.

    pulls : the n contacts that bear all their friction.
    between : domains (groups of spheres) that two neighbours pull with the same friction.
    contacts, relative_change : the slipping contacts at spins close to a minimum, and for each a bound on |slip there -
        slip| / |slip|.
    may_differ : True if some domain can move at no cost, so that minima may differ. If nothing is tied there is one
        minimum all the same, as a motion between minima goes on until a slip vanishes, at a contact that is tied then.
    count : E, number of contacts."""
    rest = len(pulls.in_s) - len(relative_change)
    # Bounds of t: the slips of S with what they may differ at u*, 0 for C.
    least = np.append(contacts.size.least * (1 - relative_change) / PATH_ROUNDING, np.zeros(rest))
    most = np.append(contacts.size.most * (1 + relative_change) * PATH_ROUNDING, np.zeros(rest))
    state = np.where(pulls.in_s, SLIPPING, SLIPLESS)
    state[between.undecided] = UNDECIDED
    # TIED, SLIPPING or SLIPLESS where shortest paths decide; undecided with all that shares a domain with BetweenTwo.
    for of_component in _constraints(pulls):
        own = of_component.own
        rests_at_some, slips_at_all, slips_at_some = of_component.limits(least[own], most[own])
        known = np.where(slips_at_all, SLIPPING, np.where(rests_at_some, SLIPLESS, UNDECIDED))
        known[rests_at_some & slips_at_some] = TIED
        undecided = of_component.sharing_a_domain(between.undecided[own])
        state[own] = np.where(undecided & (known != TIED), UNDECIDED, known)
    found = np.full(count, SLIPLESS)
    found[pulls.own] = state
    tied, unproven = (found == TIED).any(), (found == UNDECIDED).any()
    return found, False if tied else True if not may_differ or not unproven else None


def _constraints(pulls: Pulls) -> list[Constraints]:
    """Return for each of the two spin components the contacts whose slips along it may differ between minima. They slip
    along this component alone, or could begin to, and lie between two welded domains: groups of spheres that move
    together from one minimum to another.

    A :class:`Constraints` holds of n such contacts: their indices in `pulls`; the numbers of the welded domains at
    their lower and upper ends; the signs of their slips; and numbers that are equal for contacts with the same slip.

    pulls : the contacts that bear all their friction, slipping ones (`in_s`) and others. It knows the spin components
        that make each slip (`felt`), and for each sphere, by component, its domain: the spheres that contacts without
        slip join to it (`slipless_domain`)."""
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
