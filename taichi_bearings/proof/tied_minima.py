"""Which contacts slip at every minimum, at none, or at some, where there are many minima: theorem 9.

What is proven. Where frictions cancel exactly, groups of spheres can move without changing the power, and the minima
are a polyhedron of motions. This file finds one minimum u*, then all others, for one sample with two spin components
that matter, in which each component of a slip depends on one of them: lattices, and packings with normals along the
axes.

Symbols
    S : the contacts that slip in the stored spins. C : those that do not slip and yet bear all their friction mu F_n,
        along one component. T : all others.
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
        component, too.

A turning contact turns its slip as soon as one of its ends moves alone in one component, and minima do not differ in
the directions of slips. So from one minimum to another its ends move together, and a welded domain moves as a whole.
The exception are motions along the slip itself (`BetweenTwo`).

Drawing of the four kinds. Five spheres in a row, looked at in the first component::

    1 --T-- 2 --C, friction along the second-- 3 --C, friction along the first-- 4 --S, slip in both-- 5

Firm: {1, 2}, {3}, {4}, {5}. Locked: {1, 2, 3}, {4}, {5}. Slipless: {1, 2, 3, 4}, {5}. Welded, of slipless ones: all
five; of locked ones: {1, 2, 3}, {4, 5}.

The proof
1. *What can move at no cost.* A welded domain without a driven sphere is pulled by its other contacts with their whole
   friction, one way or the other. If these pulls, added exactly, cancel, then the balance of all its members but one
   implies that of the last one: so one equation is redundant, and one member can be held without loss. The same is true
   of a domain between two others that pull it with the same total friction in opposite directions (`BetweenTwo`): on
   the line between them nothing changes. It is held in the component that is longer along this line; in the other
   component it may move and finds its balance.
2. *One minimum.* With these domains held there is one minimum u* nearby (curvature.py, `nearest_minimum`).
3. *It is one of the whole power.* Friction that agrees with u* can be put in balance. Contacts of C bear exactly mu
   F_n: then the pulls on each firm domain, added exactly, have to cancel. One firm domain of each free slipless domain
   may be pulled by turning contacts, too, whose pull is not known exactly; it is in balance because the whole slipless
   domain is, and all its other firm domains are. Contacts of T bear the rest, inside all discs (curvature.py,
   `bearable`). So T rests at every minimum (theorem 4).
4. *All minima.* They share this friction. So each differs from u* by a motion that keeps T at rest, turns no slip of S,
   and lets C slip only along its friction, forward. But for the sign at C, two kinds of motions do so: of welded
   domains (of locked ones) as a whole, and of a domain along the line between two others. There are no further ones.
   For such motions can be subtracted until one locked domain of each welded one stands still, and each domain between
   two others in its held component. What is left turns no slip of S either, so the power has no curvature along it; but
   it is proven to have curvature along every motion with these domains held (curvature.py, `rises`). So nothing is
   left. Contacts at which motions between two others act are left undecided. All others have the minima of motions y of
   welded domains for which no contact of S and C slips backwards: t + y_upper - y_lower >= 0, with signs.
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

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.curvature import Slipping, bearable, nearest_minimum, rises
from taichi_bearings.proof.enclosure import UP, Enclosure
from taichi_bearings.proof.judged_network import JudgedNetwork, Motion
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, TIED, UNDECIDED

# A contact is put into C if its stored friction misses mu F_n by no more than this share, and if the share that is not
# along one component is below MISSED_DIRECTION. Friction of full size that is along one component but for MISSED_LIMIT
# has up to (2 MISSED_LIMIT) ** 0.5 = 1.4e-3 across it. Wrong choices only make the proof fail.
MISSED_LIMIT = 1e-6
MISSED_DIRECTION = 2e-3
EPS = np.finfo(np.float64).eps  # distance from 1 to the next double
PATH_ROUNDING = 1 + 1e-12  # factor that covers the rounding of a few products, and of sums along a path of 1000 slips


@dataclass(frozen=True)
class Pulls:
    """The n contacts of one sample that bear all their friction, and the direction of the force (*pull*) of each along
    the two spin components that matter. These are numbered 0 and 1, in arguments `slot` and on the first axis of arrays
    (2, ...).

    First come the contacts that slip (S), then those that do not slip (C). T are the contacts that neither slip nor
    bear all their friction. A *domain* is a group of spheres that some set of contacts joins in one component.

    own : (n,), indices of the contacts among all of the network.
    lower, upper : (n,), indices of their two spheres.
    felt : (2, n) mask, True where a component of the spins makes the contact slip.
    sign : (2, n), sign of the slip along each component: of the spin at `upper` less that at `lower`, times signs that
        differ between neighbours. For C it is the sign of the slip that its friction would go with, and 0 along the
        component in which it bears nothing.
    coefficient : (n, p), friction limits in exact proportions: that of a contact is the exact sum of its p numbers.
    in_s : (n,) mask of the contacts of S.
    slipless_domain : (2, spheres), by component the label of the domain of each sphere if T and C join spheres. The
        smallest labels, 0, 1, ..., are those of domains with a driven sphere, which are imposed.
    firm_domain : (2, spheres), such labels if T alone joins spheres.
    locked_domain : (2, spheres), such labels if T joins spheres, and those of C that bear nothing along the
        component.
    driven : (spheres,) mask of the driven spheres."""

    own: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    felt: np.ndarray
    sign: np.ndarray
    coefficient: np.ndarray
    in_s: np.ndarray
    slipless_domain: np.ndarray
    firm_domain: np.ndarray
    locked_domain: np.ndarray
    driven: np.ndarray

    def imposed_labels(self, label: np.ndarray, slot: int) -> int:
        """Return the number of domains with a driven sphere in component `slot` (0 or 1). These have the labels 0, 1,
        ... up to this number less 1.

        label : (2, spheres), the label of the domain of each sphere: one of the fields `slipless_domain`, `firm_domain`
            and `locked_domain`.
        """
        return int(label[slot][self.driven].max()) + 1

    def apart(self, label: np.ndarray, slot: int) -> np.ndarray:
        """Return the mask (n,) of the contacts whose two spheres have different labels in component `slot` (0 or 1).

        label : (2, spheres), a label of each sphere for either component, such as that of its domain."""
        found: np.ndarray = label[slot, self.lower] != label[slot, self.upper]
        return found

    def touches(self, label: np.ndarray, value: int) -> np.ndarray:
        """Return the mask (n,) of the contacts whose slip may change when one domain moves: slipping contacts of which
        exactly one sphere is in it, and contacts without slip of which any sphere is in it.

        label : (spheres,), the label of the domain (group of spheres that move together) of each sphere.
        value : the label of the domain that moves."""
        ends = label[self.lower] == value, label[self.upper] == value
        found: np.ndarray = np.where(self.in_s, ends[0] != ends[1], ends[0] | ends[1])
        return found

    @cached_property
    def turned_by(self) -> np.ndarray:
        """(2, n) mask, for either component True for a *turning* contact: it slips along the other component, so that
        its slip changes its direction as soon as one of its spheres moves in this component."""
        both = self.felt.all(axis=0)
        return np.array([both & self.apart(self.slipless_domain, 1), both & self.apart(self.slipless_domain, 0)])

    def turned_at(self, domain: int, slot: int) -> np.ndarray:
        """Return the mask (n,) of the turning contacts that lead from a domain to another one.

        domain : label of the domain in `slipless_domain`, for component `slot` (0 or 1)."""
        ends = self.slipless_domain[slot, self.lower] == domain, self.slipless_domain[slot, self.upper] == domain
        found: np.ndarray = self.in_s & self.turned_by[slot] & (ends[0] != ends[1])
        return found

    @cached_property
    def welded_slipless(self) -> np.ndarray:
        """(2, spheres), for either component the number of the welded domain of each sphere, where slipless domains are
        welded: 0 for a welded domain with a driven sphere, then 1, 2, ... (:meth:`_welded_domains` says what that is).
        """
        return np.array([self._welded_domains(self.slipless_domain, slot) for slot in range(2)])

    @cached_property
    def welded_locked(self) -> np.ndarray:
        """(2, spheres), for either component the number of the welded domain of each sphere, where locked domains are
        welded: 0 for a welded domain with a driven sphere, then 1, 2, ... (:meth:`_welded_domains` says what that is).
        """
        return np.array([self._welded_domains(self.locked_domain, slot) for slot in range(2)])

    def _welded_domains(self, label: np.ndarray, slot: int) -> np.ndarray:
        """Return the number (spheres,) of the welded domain of each sphere in component `slot` (0 or 1): 0 for those
        that contain a driven sphere, then 1, 2, ...

        A domain is a group of spheres that turn as one in a component. Some domains have to move together from one
        minimum of the power to another, since otherwise the slip of a contact between them would change its direction.
        Such domains together are a welded domain.

        label : (2, spheres), labels of the domains of which welded ones are made: `slipless_domain` or `locked_domain`.
        """
        domain = label[slot]
        joins = self.turned_by[slot] & self.apart(label, slot)
        first, second = domain[self.lower[joins]], domain[self.upper[joins]]
        # all domains with a driven sphere count as joined, as none of them can move; label 0 is one of them
        imposed = np.arange(self.imposed_labels(label, slot))
        first, second = np.append(first, 0 * imposed), np.append(second, imposed)
        joined = pieces(int(domain.max()) + 1, first, second)
        found = np.zeros(int(joined.max()) + 1, dtype=bool)
        found[0], found[joined[domain]] = True, True
        of_spheres: np.ndarray = (np.cumsum(found) - 1)[joined][domain]
        return of_spheres

    @cached_property
    def same_in_both(self) -> np.ndarray:
        """(spheres,), a label of each sphere. Two spheres have equal labels if they turn as one in both spin
        components: if they have equal `slipless_domain`, since contacts that do not slip join them, directly or through
        others."""
        return np.unique(self.slipless_domain, axis=1, return_inverse=True)[1].reshape(-1)

    def known_pulls_cancel_at(self, owner: np.ndarray, slot: int) -> np.ndarray:
        """Return a mask (labels,): for each label True if the exactly known forces along component `slot` (0 or 1) add
        up to 0 on the spheres with this label. It is True for labels without any such force.

        The force of a contact is known, plus or minus mu F_n, if it slips along this component alone (or does not slip,
        but bears all its friction along it). Contacts within one domain pull it both ways and are left out.

        owner : (spheres,), the label of each sphere, such as the number of its domain.
        """
        exact = self.felt[slot] & ~self.turned_by[slot] & np.where(
            self.in_s, self.apart(self.slipless_domain, slot), self.apart(self.firm_domain, slot)
        )  # fmt: skip
        pull = self.sign[slot, exact, None] * self.coefficient[exact]
        of = np.repeat(np.concatenate([owner[self.upper[exact]], owner[self.lower[exact]]]), pull.shape[1])
        values, size = np.concatenate([pull, -pull]).ravel(), int(owner.max()) + 1
        total, sizes, terms = (np.bincount(of, v, size) for v in (values, np.abs(values), np.ones_like(values)))
        # A sum in doubles is off by less than its terms times EPS times the sum of their sizes, so that most labels
        # need no exact sum.
        found: np.ndarray = np.abs(total) <= terms * EPS * sizes
        for label in np.flatnonzero(found & (terms > 0)).tolist():
            found[label] = math.fsum(values[of == label].tolist()) == 0.0
        return found


@dataclass(frozen=True)
class Constraints:
    """What limits how far minima of the power can differ along one spin component. From one minimum to another groups
    of spheres (*welded domains*) shift as a whole. The n contacts between such groups slip more or less then, but none
    may slip backwards.

    own : (n,), indices of these contacts in the arrays of :class:`Pulls`.
    lower, upper : (n,), number of the welded domain at either end; 0 for what does not move.
    sign : (n,), +1 or -1: whether a motion of the upper end lengthens or shortens the slip.
    same_slip : (n,), equal numbers for contacts that have the same slip at every minimum."""

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


@dataclass(frozen=True)
class BetweenTwo:
    """The m domains (groups of spheres that turn as one) that lie between two others. Only two sets of contacts pull
    such a domain, one towards either neighbour, with the same total friction. So it can move along the line between
    both at no cost.

    labels : (2, m), their labels in `Pulls.slipless_domain`, for both spin components.
    slot : (m,), the component (0 or 1) in which each is held where it is, so that one minimum is left.
    sets : m arrays with the contacts of both sets, as indices in the arrays of :class:`Pulls`.
    undecided : (n,) mask of the contacts of `Pulls` of which no state is proven: those in `sets`, and those at such a
        domain that slip along one component alone, as their slips change when it moves."""

    labels: np.ndarray
    slot: np.ndarray
    sets: list[np.ndarray]
    undecided: np.ndarray

    @classmethod
    def of(cls, pulls: Pulls, contacts: Slipping) -> BetweenTwo:
        """Return the domains (groups of spheres that turn as one) that lie between two others which pull them with the
        same friction in opposite directions.

        pulls : the n contacts that bear all their friction.
        contacts : slips of those of them that slip."""
        label = pulls.same_in_both  # of each sphere: its domain in both components at once
        known = [pulls.known_pulls_cancel_at(pulls.slipless_domain[slot], slot) for slot in range(2)]
        # contacts that slip in both components, between two domains in either
        spans = pulls.in_s & pulls.turned_by.all(axis=0)
        spans &= pulls.apart(pulls.slipless_domain, 0) & pulls.apart(pulls.slipless_domain, 1)
        # domains that such contacts join to two others
        ends = label[np.stack([pulls.lower[spans], pulls.upper[spans]])]
        pairs = np.unique(np.concatenate([ends, ends[::-1]], axis=1), axis=1)
        inner = np.bincount(pairs[0], minlength=int(label.max()) + 1) == 2
        labels, slots, sets, undecided = [], [], [], np.zeros(len(spans), dtype=bool)
        for sphere in np.unique(label, return_index=True)[1][inner]:
            own = [int(pulls.slipless_domain[slot, sphere]) for slot in range(2)]
            # The same turning contacts must pull the domain in both components, and nothing may drive it.
            driven = [of < pulls.imposed_labels(pulls.slipless_domain, slot) for slot, of in enumerate(own)]
            chosen, others = (np.flatnonzero(pulls.turned_at(own[slot], slot)) for slot in range(2))
            if any(driven) or not np.array_equal(chosen, others):
                continue
            up = label[pulls.upper[chosen]] == label[sphere]
            mine = up | (label[pulls.lower[chosen]] == label[sphere])
            other = label[np.where(up, pulls.lower[chosen], pulls.upper[chosen])]
            # They must lead to just two other domains, and slip in both components.
            sides = np.unique(other)
            if not (spans[chosen].all() and mine.all() and len(sides) == 2):
                continue
            # Both sets must have the same friction in all, exactly, and all other pulls on the domain must cancel.
            weight = np.where(other == sides[0], 1.0, -1.0)[:, None] * pulls.coefficient[chosen]
            if math.fsum(weight.ravel().tolist()) != 0.0 or not all(
                cancels[domain] for cancels, domain in zip(known, own, strict=True)
            ):
                continue
            parts = [part.at(chosen) for part in contacts.difference]
            slot = int(np.median(parts[1].most) > np.median(parts[0].most))
            # The domain must lie between both: along the longer component it slips ahead of the one, behind the other.
            ahead = np.sign(parts[slot].high) * np.where(up, 1, -1) * np.where(other == sides[0], 1, -1)
            if len(np.unique(ahead)) != 1:
                continue
            labels.append(own)
            slots.append(slot)
            sets.append(chosen)
            undecided[chosen] = True
            for s in range(2):
                undecided |= pulls.felt[s] & ~pulls.turned_by[s] & pulls.touches(pulls.slipless_domain[s], own[s])
        return cls(np.array(labels, dtype=int).reshape(-1, 2).T, np.array(slots, dtype=int), sets, undecided)

    def lie_between(self, pulls: Pulls, contacts: Slipping, relative_change: np.ndarray) -> bool:
        """Return True if each of these domains (groups of spheres that turn as one) is proven to lie between its two
        neighbours at the minimum as well. It does so in the stored spins. The proof is that, along the component in
        which the domain is held, none of its slips changes its sign from there to the minimum.

        pulls : the contacts that bear all their friction, with the signs of the slips in the stored spins.
        contacts : the slipping contacts at spins close to the minimum.
        relative_change : (slipping contacts,), bound on |slip at the minimum - slip| / |slip|.
        """
        for own, slot in zip(self.sets, self.slot, strict=True):
            slip, change = contacts.difference[slot].at(own), relative_change[own] * contacts.size.at(own).most * UP
            if not ((np.sign(slip.high) == pulls.sign[slot, own]) & (slip.least > change)).all():
                return False
        return True


def tied_states(motion: Motion, contacts: Slipping) -> tuple[np.ndarray, bool | None] | None:
    """Prove the states of all E contacts of one sample that may have many minima.

    motion : the stored spins of the sample and which contacts rest. Each component of a slip depends on one component
        of the spins; no loop of contacts is odd. Nothing is proven unless two components matter.
    contacts : those that slip.

    Returns None if nothing is proven. Else the states (E,), SLIPLESS, SLIPPING (at every minimum), TIED (at some), or
    UNDECIDED; and True if there is only one minimum, False if there are more, None if that is not known."""
    if len(motion.network.needed) != 2:  # three, where spheres are driven inside a packing
        return None
    saturated, coefficient = Saturated.of(motion), motion.network.exact_limits
    if saturated is None or coefficient is None or motion.torn.any() or not (contacts.size.least > 0).all():
        return None
    # Hold one slipless domain of each welded domain, for one minimum; and one locked domain, to exclude other motions.
    firm = saturated.motion_of(motion, None)
    pulls = _pulls(motion, firm, contacts, saturated, coefficient)
    between = BetweenTwo.of(pulls, contacts)
    held = _spheres_to_hold(pulls, pulls.slipless_domain, pulls.welded_slipless, between)
    held_locked = _spheres_to_hold(pulls, pulls.locked_domain, pulls.welded_locked, between)
    if held is None or held_locked is None or not (held.any() or not pulls.in_s.all()):
        return None
    # The minimum with these held; then the curvature that excludes other motions; then what shortest paths say.
    near = _minimum_with_held(motion, firm, pulls, between, held, saturated)
    if near is None:
        return None
    found, relative_change = near
    if not pulls.in_s.all():
        of_locked = Slipping.of(motion, _labels_of_moving(motion, pulls.locked_domain, held_locked))
        if not rises(replace(of_locked, difference=found.difference), relative_change):
            return None
    return _states_by_paths(pulls, between, found, relative_change, bool(held_locked.any()), len(motion.rests))


@dataclass(frozen=True)
class Saturated:
    """The saturated contacts of one sample: they do not slip in the stored spins, yet bear all their friction mu F_n,
    along one spin component.

    Two spin components make contacts slip in such a sample; their numbers are `network.needed`, and `slot` 0 or 1 says
    which of the two is meant.

    network : the sample, with E contacts.
    mask : (E,), which contacts these are.
    along : (E,), the slot (0 or 1) of the component along which each of them bears its friction; no meaning for others.
    """

    network: JudgedNetwork
    mask: np.ndarray
    along: np.ndarray

    @classmethod
    def of(cls, motion: Motion) -> Saturated | None:
        """Return the resting contacts of a motion that bear nearly all their friction, at least the share 1 -
        MISSED_LIMIT of mu F_n, each with the component along which it bears more. Return None if at one of these
        contacts both components of the friction exceed MISSED_DIRECTION times the limit: then it is not clear in which
        direction it would begin to slip.

        motion : stored spins of one sample, with the contacts that rest and the friction of all.
        """
        network, strength = motion.network, motion.network.holding.value
        parts = np.abs([network.moment[k].high for k in network.needed])
        mask = motion.rests & (np.hypot(*parts) >= (1 - MISSED_LIMIT) * strength) & network.counts
        if (parts.min(axis=0)[mask] > MISSED_DIRECTION * strength[mask]).any():
            return None
        return cls(network, mask, np.argmax(parts, axis=0))

    def friction(self, slot: int) -> Enclosure:
        """Return an enclosure (n,), for each of n saturated contacts the moment n x F, in units of force, that it has
        to exert along component `slot` (0 or 1). That is mu F_n with the sign of the stored moment, or 0 if the contact
        bears its friction along the other component."""
        own = np.flatnonzero(self.mask)
        sign = np.sign(self.network.moment[self.network.needed[slot]].high[own])
        return self.network.holding.at(own).signed(sign * (self.along[own] == slot))

    def motion_of(self, motion: Motion, slot: int | None) -> Motion:
        """Return `motion` with saturated contacts no longer taken to rest.

        slot : 0 or 1 for those saturated contacts only that bear their friction along this component; None for all.
        """
        moves = self.mask if slot is None else self.mask & (self.along == slot)
        return Motion(self.network, motion.rests & ~moves) if moves.any() else motion

    def missing_friction(self) -> dict[int, np.ndarray]:
        """Return by spin component k that matters, as a dictionary, a bound (spheres,) on an error of the torque over
        radius on each sphere, in units of force. A saturated contact should exert exactly mu F_n along one component.
        Its stored moment differs a little from that; the bound is the sum of the sizes of these differences over the
        contacts of a sphere."""
        own, network = np.flatnonzero(self.mask), self.network
        found = {k: np.zeros(len(network.free)) for k in network.needed}
        for slot, k in enumerate(network.needed):
            missing = self.friction(slot).plus(-network.moment[k].high[own]).most
            missing[~network.feels[k][own]] = 0.0
            for end in network.graph.contact[:, own]:
                found[k] += np.bincount(end, missing, len(found[k]))
        return found


def _pulls(motion: Motion, firm: Motion, contacts: Slipping, saturated: Saturated, coefficient: np.ndarray) -> Pulls:
    """Return the contacts of one sample that bear all their friction, and the domains (groups of spheres that turn as
    one) that these and the resting contacts make.

    motion : the sample, and which of its contacts rest.
    firm : the same, in which saturated contacts are not taken to rest.
    contacts : those that slip.
    saturated : those that do not slip and yet bear all their friction.
    coefficient : (E, p), friction limits of all E contacts, in exact proportions, as sums of p doubles."""
    network, in_c = motion.network, np.flatnonzero(saturated.mask)
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
            [firm] * components,
            [saturated.motion_of(motion, slot) for slot in range(components)],
        )
    )
    return Pulls(
        own, lower, upper, np.array([network.feels[k][own] for k in network.needed]),
        np.concatenate([signs, signs_of_c], axis=1), coefficient[own], np.arange(len(own)) < len(contacts.own),
        slipless_domain, firm_domain, locked_domain, ~network.free,
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
    pulls: Pulls, label: np.ndarray, welded_domain: np.ndarray, between: BetweenTwo
) -> np.ndarray | None:
    """Choose spheres to be held where they are, so that only one minimum is left: the mask (2, spheres) of them for
    either spin component; None if that cannot be done.

    A *domain* is a group of spheres that turn as one; a *welded domain* consists of domains that can only move
    together. Two kinds of groups can move at no cost, and are held:

    * Of each welded domain without a driven sphere one domain is held. It must not be one of `between`; if all are, the
      result is None.
    * Each domain of `between` is held in one component, which `between` chooses.

    pulls : the contacts that bear all their friction.
    label : (2, spheres), for either component the label of the domain of each sphere.
    welded_domain : (2, spheres), the number of its welded domain: 0 for those that contain a driven sphere, then 1, 2,
        ...
    between : domains that two neighbours pull with the same friction, so that they can move on the line between them.
    """
    held = np.zeros(label.shape, dtype=bool)
    for slot in range(2):
        welded, inner = welded_domain[slot], np.isin(pulls.slipless_domain[slot], between.labels[slot])
        for number in range(1, int(welded.max()) + 1):
            some = label[slot][(welded == number) & ~inner]
            if not len(some):
                return None
            held[slot] |= label[slot] == some[0]
        for domain in between.labels[slot][between.slot == slot]:
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
    firm: Motion,
    pulls: Pulls,
    between: BetweenTwo,
    held: np.ndarray,
    saturated: Saturated,
) -> tuple[Slipping, np.ndarray] | None:
    """Prove two things: near the stored spins there is one minimum if some domains (groups of spheres that turn as one)
    are held where they are; and it is a minimum without holding them, too. For the latter, known forces have to cancel
    on the held domains, and friction of the resting contacts, below their limits, has to balance all other torques.

    Return None if that is not proven; else the slipping contacts at spins close to that minimum, and for each a bound
    on |slip there - slip| / |slip|.

    motion : the stored spins of one sample, and which contacts rest.
    firm : the same, in which saturated contacts are not taken to rest.
    pulls : the contacts that bear all their friction.
    between : domains that two neighbours pull with the same friction.
    held : (2, spheres) mask of the spheres whose domain is held, for either component.
    saturated : contacts without slip that bear all their friction."""
    near = nearest_minimum(Slipping.of(motion, _labels_of_moving(motion, pulls.slipless_domain, held)))
    if near is None:
        return None
    found, relative_change = near
    # The pulls that were taken as known keep their signs at u* and cancel, and T bears the rest.
    known = pulls.felt & ~pulls.turned_by & pulls.in_s
    signs = np.array([np.sign(part.high) for part in found.difference])
    same = (signs == pulls.sign[:, : len(relative_change)]) | ~known[:, : len(relative_change)]
    known_well = same.all() and _known_pulls_cancel(pulls) and between.lie_between(pulls, found, relative_change)
    return near if known_well and bearable(firm, found, relative_change, saturated.missing_friction()) else None


def _known_pulls_cancel(pulls: Pulls) -> bool:
    """Return True if the exactly known forces add up to 0 wherever no other force could balance them. Exactly known are
    the forces of contacts that bear all their friction in a direction that cannot turn.

    This is asked of two kinds of groups of spheres:
    * welded domains without a driven sphere: groups that move together from one minimum to another;
    * firm domains without a driven sphere: spheres that resting contacts with friction left join. One is excepted in
      each slipless domain (spheres that all contacts without slip join): the one, if any, on which contacts act that
      may turn their slip. It is in balance once the whole slipless domain and its other firm domains are.

    pulls : the contacts that bear all their friction, and the domains that they and resting contacts make.
    """
    # For both components: welded domains; which firm domains are pulled by turning contacts; all other firm domains.
    for slot in range(2):
        if not pulls.known_pulls_cancel_at(pulls.welded_slipless[slot], slot)[1:].all():
            return False
        firm, slipless = pulls.firm_domain[slot], pulls.slipless_domain[slot]
        turning = pulls.in_s & pulls.turned_by[slot] & pulls.apart(pulls.slipless_domain, slot)
        ends = np.concatenate([pulls.lower[turning], pulls.upper[turning]])
        pulled = np.unique(np.array([firm[ends], slipless[ends]]), axis=1)
        imposed = pulls.imposed_labels(pulls.firm_domain, slot)
        pulled = pulled[:, pulled[0] >= imposed]
        # The slipless domain of none of these may have a driven sphere, and none may have two of them.
        if (pulled[1] < pulls.imposed_labels(pulls.slipless_domain, slot)).any() or len(
            np.unique(pulled[1])
        ) < pulled.shape[1]:
            return False
        cancels = pulls.known_pulls_cancel_at(firm, slot)
        cancels[pulled[0]] = True
        if not cancels[imposed:].all():
            return False
    return True


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
