"""Contacts that rest although they bear all their friction, along both spin components: a part of theorem 9.

What is proven. A contact of C with friction along both components is called *oblique* here (tied_minima.py has the
other words). Its friction is no exact number, as that of other contacts of C is. But often a domain between two others
says what it is: this file finds such contacts, the direction of their friction, and how far they may begin to slip.

Example. A free sphere lies between the bottom, past which it slips, and a sphere at rest above it. Both contacts have
friction 1. Contacts with four further spheres pull it by 1 and -1 along x and by 1 and -1 along y. So the upper contact
has to bear exactly the opposite of the friction of the lower one: all its friction, in a direction that is as little a
round number as that of the slip. It would begin to slip if the sphere moved along the slip of the lower contact. But
one of the four others, which bears all its friction and rests, would slip backwards then. So nothing moves.

Symbols
    a : a slipping contact. n_a : unit vector along its slip at the minimum u*. o : +1 for a contact whose upper sphere
        is in a domain, -1 if the lower one is.
    A pair of domains, one of each component, is *between* if the same contacts with both components of friction act on
    either, and on no other part of it.

The proof
1. *Friction.* In a pair of firm domains that are between, let the contacts of one set slip alike: o n_a is one vector v
   for all of them, or their friction is already known to be mu F_n o v. Let the others be oblique, and let both sets
   have the same friction in all. Let all exactly known pulls on either domain cancel. Then friction - o v mu F_n of the
   oblique contacts balances the pair exactly, and it is at the limit. It is one choice of the friction of u*, which the
   rest of the proof has to put in balance elsewhere (`balance`). A chain of such pairs is solved one after the other.
2. *Slip.* This friction is optimal. So at every minimum an oblique contact slips along it, forward, or not at all.
3. *Motion.* A pair of locked domains that is between, with these contacts alone, can move along v: no slip of S and
   none of these contacts turns. It moves by -lambda v against what it would do with the domain beside the oblique
   contacts, with lambda >= 0, as they do not slip backwards.
4. *Nothing moves* if other contacts of C exclude lambda > 0: if, along one component, a chain of them, each of which
   may only slip forward, says that the pair cannot be behind its neighbour (`blocked`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.curvature import Slipping
from taichi_bearings.proof.enclosure import UP
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.pulls import Pulls


@dataclass(frozen=True)
class Between:
    """A pair of domains, one of each spin component, on which slipping contacts and oblique ones pull with the same
    friction in opposite directions. (Oblique contacts rest, and bear all their friction along both components.)

    sphere : a sphere of both domains.
    contacts : (q,), the contacts of both sets, as indices in the arrays of :class:`Pulls`.
    guide : a slipping contact, as such an index, whose slip has the direction in which the pair is pulled.
    way : +1 or -1: the oblique contacts begin to slip if the pair moves by `way` times a vector along the slip of
        `guide`."""

    sphere: int
    contacts: np.ndarray
    guide: int
    way: int


@dataclass(frozen=True)
class ObliqueLimits:
    """The friction of all oblique contacts of one sample: they rest, and bear all their friction along both components.

    guide : (n,), for each of the n contacts of `Pulls` that is oblique a slipping one, as an index; -1 for others.
    way : (n,), +1 or -1 for oblique contacts: the friction of each is mu F_n times `way` times the unit vector along
        the slip of its guide.
    between : the pairs of domains from which this is known."""

    guide: np.ndarray
    way: np.ndarray
    between: list[Between]

    @classmethod
    def of(cls, pulls: Pulls) -> ObliqueLimits | None:
        """Return the friction of all oblique contacts (step 1 of the proof); None if that of any is not found.

        pulls : the n contacts that bear all their friction."""
        found = cls(np.where(pulls.in_s, np.arange(len(pulls.own)), -1), pulls.in_s.astype(int), [])
        open_ = np.flatnonzero(pulls.oblique)
        alike = _alike(pulls) if len(open_) else (found.guide, found.way)
        known = [pulls.known_pulls_cancel_at(pulls.firm_domain[slot], slot) for slot in range(2)] if len(open_) else []
        while len(open_):
            spheres = np.unique(np.concatenate([pulls.lower[open_], pulls.upper[open_]])).tolist()
            solved = [found._solves(pulls, sphere, alike, known) for sphere in spheres]
            if not any(solved):
                return None
            open_ = open_[found.guide[open_] < 0]
        return found

    def _solves(self, pulls: Pulls, sphere: int, alike: tuple[np.ndarray, np.ndarray], known: list[np.ndarray]) -> bool:
        """Find the friction of the oblique contacts at one pair of firm domains and note it in `guide`, `way` and
        `between`. Return True if that was possible.

        pulls : the n contacts that bear all their friction.
        sphere : a sphere of both domains.
        alike : for each slipping contact the first one that slips alike, (n,), and +1 or -1, (n,), by which the slips
            differ.
        known : by component the mask of the firm domains at which exactly known pulls cancel."""
        firm = [int(of[sphere]) for of in pulls.firm_domain]
        sets = [np.flatnonzero(pulls.uncertain[s] & pulls.crossing(pulls.firm_domain[s], firm[s])) for s in range(2)]
        if any(firm[s] < pulls.imposed_labels(pulls.firm_domain, s) or not known[s][firm[s]] for s in range(2)):
            return False
        contacts = sets[0]
        side = _side(pulls, contacts, pulls.firm_domain, firm)
        if not np.array_equal(sets[0], sets[1]) or side is None:
            return False
        has = self.guide[contacts] >= 0
        if has.all() or not has.any():
            return False
        # v, a number of a class of slips and a sign, from each contact of known friction
        first, differs = alike[0][self.guide[contacts[has]]], alike[1][self.guide[contacts[has]]]
        signs = side[has] * self.way[contacts[has]] * differs
        weight = np.where(has, 1.0, -1.0)[:, None] * pulls.coefficient[contacts]
        if len(np.unique(first)) > 1 or len(np.unique(signs)) > 1 or math.fsum(weight.ravel().tolist()) != 0.0:
            return False
        guide, sign = int(first[0]), int(signs[0])
        self.guide[contacts[~has]], self.way[contacts[~has]] = guide, -side[~has] * sign
        self.between.append(Between(sphere, contacts, guide, -sign))
        return True

    def missed(
        self, network: JudgedNetwork, pulls: Pulls, contacts: Slipping, relative_change: np.ndarray
    ) -> np.ndarray:
        """Return a bound (2, E) on how far the stored friction of each oblique contact may be from that found here, by
        component; 0 for all others of the E contacts.

        network : the sample, with its stored friction.
        pulls : the contacts that bear all their friction.
        contacts : the slipping ones, close to a minimum.
        relative_change : (slipping contacts,), bound on |slip there - slip| / |slip|.
        """
        some = np.flatnonzero(pulls.oblique)
        own, guide, upper = pulls.own[some], self.guide[some], pulls.upper[some]
        found, limit = np.zeros((2, len(network.acts))), network.holding.at(own)
        place = np.searchsorted(contacts.curved, guide)
        for slot, k in enumerate(network.needed):
            exerted = (limit * contacts.direction[slot].at(place)).signed(self.way[some])
            stored = network.moment[k].at(own).signed(network.sign[k][upper])
            # the unit vector along a slip that changes by a share c of its size changes by 2 c at most
            found[slot, own] = ((exerted - stored).most + 2 * relative_change[guide] * limit.most) * UP
        return found


def _alike(pulls: Pulls) -> tuple[np.ndarray, np.ndarray]:
    """Return for each of n contacts that slip in both components the first one, (n,), that connects the same slipless
    domains in both, and +1 or -1, (n,): the slip of the contact is exactly this number times that of the
    other. For all other contacts the numbers have no meaning.

    pulls : the n contacts that bear all their friction."""
    low, high = pulls.same_in_both[pulls.lower], pulls.same_in_both[pulls.upper]
    key = np.where(
        pulls.in_s & pulls.felt.all(axis=0), np.minimum(low, high) * (len(pulls.driven) + 1) + np.maximum(low, high), -1
    )
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    first, sign = first[group.reshape(-1)], np.where(low < high, 1, -1)
    return first, sign * sign[first]


def _side(pulls: Pulls, contacts: np.ndarray, label: np.ndarray, domains: list[int]) -> np.ndarray | None:
    """Return +1 or -1, (q,), for each of q contacts: whether its upper or its lower sphere is in both domains of a
    pair. Return None if that is not the same sphere for both.

    pulls : the contacts.
    contacts : (q,), their indices in `pulls`; exactly one sphere of each is in either domain.
    label : (2, spheres), by component the label of the domain of each sphere.
    domains : the labels of the two domains."""
    up = [label[slot, pulls.upper[contacts]] == domains[slot] for slot in range(2)]
    return np.where(up[0], 1, -1) if np.array_equal(up[0], up[1]) else None


def not_balanced(pulls: Pulls, between: list[Between]) -> np.ndarray:
    """Return the mask (2, spheres), by component, of the firm domains without a driven sphere on which friction is not
    proven to balance. A firm domain is a group of spheres that contacts join which rest and have friction left.

    pulls : the contacts that bear all their friction.
    between : pairs of firm domains that are known to be in balance.

    Let r be what is left over on a firm domain. It obeys two kinds of equations. (1) On a slipless domain without a
    driven sphere, which consists of firm domains, the sum of all r is 0, as it is in balance at the minimum. (2) The
    friction of contacts that is not exactly known acts on both their spheres: it cancels on all firm domains together
    that such contacts connect, a *group*. So if the exactly known friction on these adds up to 0, the sum of all r is
    0, too. A firm domain stands in one equation of either kind. An equation in which a single r is left makes this 0;
    this is repeated until no such equation remains.
    """
    found = np.zeros(pulls.firm_domain.shape, dtype=bool)
    for slot in range(2):
        firm, count = pulls.firm_domain[slot], int(pulls.firm_domain[slot].max()) + 1
        imposed = np.arange(pulls.imposed_labels(pulls.firm_domain, slot))
        joins = pulls.uncertain[slot] & pulls.apart(pulls.firm_domain, slot)
        first, second = firm[pulls.lower[joins]], firm[pulls.upper[joins]]
        # all firm domains with a driven sphere, with the label 0 among them, are joined to one group
        group = pieces(count, np.append(first, 0 * imposed), np.append(second, imposed))
        slipless = np.zeros(count, dtype=int)
        slipless[firm] = pulls.slipless_domain[slot]
        # the equations of both kinds in which r of each firm domain stands: their numbers, and whether they hold
        groups, driven = int(group.max()) + 1, np.arange(pulls.imposed_labels(pulls.slipless_domain, slot))
        equations = np.stack([group, groups + slipless])
        holds = np.append(pulls.known_pulls_cancel_at(group[firm], slot), np.ones(int(slipless.max()) + 1, dtype=bool))
        holds[np.append(group[0], groups + driven)] = False
        left = np.ones(count, dtype=bool)
        left[imposed] = False
        left[[int(firm[pair.sphere]) for pair in between]] = False
        while left.any():
            terms = np.bincount(equations[:, left].ravel(), minlength=len(holds))
            solved = left & (holds & (terms == 1))[equations].any(axis=0)
            if not solved.any():
                break
            left &= ~solved
        # a sum that does not vanish, though all its r seem to, contradicts the others
        wrong = np.flatnonzero(~holds[:groups])
        left |= np.isin(group, wrong[wrong != group[0]])
        left[imposed] = False
        found[slot] = left[firm]
    return found


@dataclass(frozen=True)
class Movable:
    """The m pairs of locked domains that can move along a line, at contacts that rest at their limits.

    labels : (2, m), for both components the label of the locked domain.
    slot : (m,), the component (0 or 1) in which each is held to exclude other motions.
    pairs : what the line is, and which contacts it concerns."""

    labels: np.ndarray
    slot: np.ndarray
    pairs: list[Between]

    @classmethod
    def of(cls, pulls: Pulls, limits: ObliqueLimits, contacts: Slipping) -> Movable:
        """Return those pairs that can move (step 3 of the proof): the same turning contacts connect either domain with
        others, and they are those from which the friction of the pair is known.

        pulls : the contacts that bear all their friction.
        limits : the pairs, with contacts that rest at their limits.
        contacts : the slipping contacts."""
        labels, slots, pairs = [], [], []
        for pair in limits.between:
            own = [int(of[pair.sphere]) for of in pulls.locked_domain]
            turning = [pulls.turned_by[s] & pulls.crossing(pulls.locked_domain[s], own[s]) for s in range(2)]
            driven = any(own[s] < pulls.imposed_labels(pulls.locked_domain, s) for s in range(2))
            same = all(np.array_equal(np.flatnonzero(of), pair.contacts) for of in turning)
            if same and not driven and _side(pulls, pair.contacts, pulls.locked_domain, own) is not None:
                labels.append(own)
                sizes = [part.most[pair.guide] for part in contacts.difference]
                slots.append(int(sizes[1] > sizes[0]))
                pairs.append(pair)
        return cls(np.array(labels, dtype=int).reshape(-1, 2).T, np.array(slots, dtype=int), pairs)

    def signs(self, contacts: Slipping, relative_change: np.ndarray) -> np.ndarray:
        """Return (2, m), by component the sign +1 or -1 of the way in which the oblique contacts of each pair allow it
        to move; 0 where it is not proven.

        contacts : the slipping contacts close to the minimum.
        relative_change : (slipping contacts,), bound on |slip at the minimum - slip| / |slip|.
        """
        guide = np.array([pair.guide for pair in self.pairs], dtype=int)
        change = relative_change[guide] * contacts.size.at(guide).most * UP
        slips = [part.at(guide) for part in contacts.difference]
        way = np.array([pair.way for pair in self.pairs], dtype=int)
        return np.array([np.where(of.least > change, np.sign(of.high) * way, 0) for of in slips]).astype(int)

    def blocked(self, pulls: Pulls, signs: np.ndarray, excluded: np.ndarray) -> np.ndarray:
        """Return the mask (m,) of the pairs that are proven to stand still from one minimum to another (step 4 of the
        proof).

        pulls : the n contacts that bear all their friction.
        signs : (2, m), the way in which the oblique contacts of a pair allow it to move, by component; 0 if not known.
        excluded : (2, spheres) mask of spheres that may move in other ways; contacts at these are not used."""
        found = np.zeros(len(self.pairs), dtype=bool)
        for slot in range(2):
            # nodes: welded domains, which move as a whole; then the pairs, each by itself
            node, locked = pulls.welded_locked[slot].copy(), pulls.locked_domain[slot]
            stays, count = [], int(node.max()) + 1
            for number, label in enumerate(self.labels[slot].tolist()):
                stays.append(int(node[locked == label][0]))
                node[locked == label] = count + number
            # A contact of C with the sign s may only slip forward, s (y_upper - y_lower) >= 0: an edge from the node
            # with the larger y to that with the smaller one.
            rests = ~pulls.in_s & ~pulls.oblique & pulls.felt[slot] & (pulls.sign[slot] != 0)
            rests &= ~(excluded[slot, pulls.lower] | excluded[slot, pulls.upper])
            forward = pulls.sign[slot, rests] > 0
            lower, upper = node[pulls.lower[rests]], node[pulls.upper[rests]]
            larger, smaller = np.where(forward, upper, lower), np.where(forward, lower, upper)
            size = count + len(stays)
            graph = sparse.csr_array((np.ones(len(larger)), (larger, smaller)), shape=(size, size))
            for number, stay in enumerate(stays):
                # moving by `sign` is excluded if y of the pair is at most, or at least, that of its neighbours
                begin, end = (stay, count + number) if signs[slot, number] > 0 else (count + number, stay)
                if signs[slot, number] != 0:
                    found[number] |= end in breadth_first_order(graph, begin, return_predecessors=False)
        return found
