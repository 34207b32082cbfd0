"""Contacts that rest although their friction is at its limit, with friction along both spin components: a part of
theorem 9.

What is proven. A contact of C with friction along both components is called *oblique* here (tied_minima.py defines the
other words). Its friction is no exactly known number, unlike that of other contacts of C. But it often follows from the
balance of forces on a pair of domains between two others. This file finds the direction of such friction, and whether
these contacts may begin to slip.

Example. A free sphere lies between the bottom, past which it slips, and a sphere at rest above it. Both contacts have
friction 1. Contacts with four further spheres pull it by 1 and -1 along x and by 1 and -1 along y. So the friction of
the upper contact is exactly the opposite of that of the lower one: it is at its limit, in the direction of a slip. The
upper contact would begin to slip if the sphere moved along the slip of the lower one. But one of the four others, which
rests at its limit, would slip backwards then. So nothing moves.

Symbols
    a : a slipping contact. n_a : unit vector along its slip at the minimum u*. o : +1 for a contact whose upper sphere
        is in a domain, -1 if the lower one is.
    between : said of a pair of domains, one of each component, if the contacts with both components of friction at
        either domain are the same, and all of them act on spheres of both domains.

The proof
1. *Friction.* Take a pair of firm domains that is between. Let the contacts of one set slip alike: o n_a is the same
   vector v for all of them, or their friction is already known to be mu F_n o v. Let the others be oblique, and let
   both sets have the same total friction limit. Let all exactly known pulls on either domain cancel. Then the friction
   -o v mu F_n of the oblique contacts balances the pair exactly, and it is at the limit. It is one choice of the
   friction of u*; `not_balanced` checks the balance elsewhere. A chain of such pairs is solved one after the other.
2. *Slip.* This friction is optimal. So at every minimum an oblique contact slips along it, forward, or not at all.
3. *Motion.* A pair of locked domains that is between, with these contacts alone, can move along v: no slip of S and
   none of these contacts turns. Relative to the domain beside the oblique contacts it moves by -lambda v, with
   lambda >= 0, as these do not slip backwards.
4. *Nothing moves* if other contacts of C exclude lambda > 0: a chain of them along one component, each of which may
   only slip forward, from which it follows that the pair cannot move against its neighbour (`blocked`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import breadth_first_order

from taichi_bearings.numerics.graphs import graph_of, pieces
from taichi_bearings.proof.curvature import Slipping
from taichi_bearings.proof.enclosure import UP
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.pulls import Pulls


@dataclass(frozen=True)
class Between:
    """A pair of domains (groups of spheres that turn as one in a component), one of each spin component, in balance
    between two sets of contacts that pull it in opposite directions, with the same total friction limit. Those of the
    second set are *oblique*: they rest at their friction limit, with friction along both components.

    sphere : a sphere of both domains.
    contacts : (q,), indices of the contacts of both sets in the arrays of :class:`Pulls`.
    guide : index of a slipping contact there; all these forces are along its slip.
    way : +1 or -1. The oblique contacts begin to slip if the pair moves along `way` times the slip of `guide`."""

    sphere: int
    contacts: np.ndarray
    guide: int
    way: int


@dataclass(frozen=True)
class ObliqueLimits:
    """The friction of all oblique contacts of one sample: those that rest at their friction limit, with friction along
    both components. It is mu F_n times `way` times the unit vector along the slip of a slipping contact, its *guide*.

    guide : (n,), the index of the guide of each of the n contacts of :class:`Pulls` that is oblique. Slipping contacts
        are their own guides; all others have -1.
    way : (n,), +1 or -1 for oblique contacts, 1 for slipping ones.
    between : the pairs of domains whose balance gives this friction."""

    guide: np.ndarray
    way: np.ndarray
    between: list[Between]

    @classmethod
    def of(cls, pulls: Pulls) -> ObliqueLimits | None:
        """Return the friction of all oblique contacts (step 1 of the proof); None if that of any is not found. Spheres
        are tried again as long as a round finds friction, since that of one pair of domains may be needed at another.

        pulls : the n contacts whose friction is at its limit."""
        found = cls(np.where(pulls.in_s, np.arange(len(pulls.own)), -1), pulls.in_s.astype(int), [])
        unsolved = np.flatnonzero(pulls.oblique)
        alike = _alike(pulls) if len(unsolved) else (found.guide, found.way)
        cancel = [pulls.known_pulls_cancel_at(pulls.firm_domain[k], k) for k in range(2)] if len(unsolved) else []
        while len(unsolved):
            spheres = np.unique(np.concatenate([pulls.lower[unsolved], pulls.upper[unsolved]])).tolist()
            solved = [found._find_at(sphere, pulls, alike, cancel) for sphere in spheres]
            if not any(solved):
                return None
            unsolved = unsolved[found.guide[unsolved] < 0]
        return found

    def _find_at(
        self, sphere: int, pulls: Pulls, alike: tuple[np.ndarray, np.ndarray], cancel: list[np.ndarray]
    ) -> bool:
        """Write the friction of the oblique contacts at a pair of firm domains to `guide`, `way` and `between`. Return
        True if it was found: if neither domain has a driven sphere, and the balance of both gives this friction.

        sphere : a sphere of both domains. Firm domains are groups of spheres that contacts below their limits join.
        pulls : the n contacts whose friction is at its limit.
        alike : the two arrays that `_alike` returns.
        cancel : by component the mask of the firm domains on which exactly known pulls cancel."""
        firm = [int(label[sphere]) for label in pulls.firm_domain]
        if any(firm[s] < pulls.imposed_labels(pulls.firm_domain, s) or not cancel[s][firm[s]] for s in range(2)):
            return False
        # The contacts without exactly known friction have to be the same at both domains, each with one end in both.
        at = [np.flatnonzero(pulls.uncertain[s] & pulls.crossing(pulls.firm_domain[s], firm[s])) for s in range(2)]
        contacts, side = at[0], _side(pulls, at[0], pulls.firm_domain, firm)
        if not np.array_equal(at[0], at[1]) or side is None:
            return False
        known = self.guide[contacts] >= 0
        if known.all() or not known.any():
            return False
        # Contacts of known friction have to pull along one direction v: one first contact with this slip, and one sign.
        guides = self.guide[contacts[known]]
        first, signs = alike[0][guides], side[known] * self.way[contacts[known]] * alike[1][guides]
        if len(np.unique(first)) > 1 or len(np.unique(signs)) > 1:
            return False
        # Their limits have to add up exactly to those of the others, which then pull along -v.
        signed_limit = np.where(known, 1.0, -1.0)[:, None] * pulls.coefficient[contacts]
        if math.fsum(signed_limit.ravel().tolist()) != 0.0:
            return False
        guide, sign = int(first[0]), int(signs[0])
        self.guide[contacts[~known]], self.way[contacts[~known]] = guide, -side[~known] * sign
        self.between.append(Between(sphere, contacts, guide, -sign))
        return True

    def missed(
        self, network: JudgedNetwork, pulls: Pulls, contacts: Slipping, relative_change: np.ndarray
    ) -> np.ndarray:
        """Return a bound (2, E) on the difference between the stored friction of each oblique contact and that at the
        minimum, by component; 0 for all others of the E contacts.

        network : the sample, with its stored friction.
        pulls : the contacts whose friction is at its limit.
        contacts : the slipping ones, close to a minimum.
        relative_change : (slipping contacts,), bound on |slip at the minimum - slip| / |slip|.
        """
        oblique = np.flatnonzero(pulls.oblique)
        index, guide, upper = pulls.own[oblique], self.guide[oblique], pulls.upper[oblique]
        found, limit = np.zeros((2, len(network.acts))), network.friction_limit.at(index)
        place = np.searchsorted(contacts.curved, guide)
        for slot, k in enumerate(network.needed):
            along_guide = (limit * contacts.direction[slot].at(place)).signed(self.way[oblique])
            stored = network.moment[k].at(index).signed(network.sign[k][upper])
            # the unit vector along a slip that changes by a share c of its size changes by 2 c at most
            found[slot, index] = ((along_guide - stored).most + 2 * relative_change[guide] * limit.most) * UP
        return found


def _alike(pulls: Pulls) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays (n,) about the contacts that slip in both components: the first contact with the same slip but
    for a sign, and this sign, +1 or -1. Slips are the same at contacts between the same two groups of spheres that turn
    as one in both components. For all other contacts the numbers have no meaning.

    pulls : the n contacts whose friction is at its limit."""
    low, high = pulls.same_in_both[pulls.lower], pulls.same_in_both[pulls.upper]
    key = np.where(
        pulls.in_s & pulls.felt.all(axis=0), np.minimum(low, high) * (len(pulls.driven) + 1) + np.maximum(low, high), -1
    )
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    first, sign = first[group.reshape(-1)], np.where(low < high, 1, -1)
    return first, sign * sign[first]


def _side(pulls: Pulls, contacts: np.ndarray, label: np.ndarray, domains: list[int]) -> np.ndarray | None:
    """Return for each of q contacts +1 if its upper, -1 if its lower sphere is in both domains of a pair, (q,). Return
    None if a contact has different spheres in the two domains.

    pulls : the contacts.
    contacts : (q,), their indices in `pulls`; exactly one sphere of each is in either domain.
    label : (2, spheres), by component the label of the domain of each sphere.
    domains : the labels of the two domains."""
    up = [label[slot, pulls.upper[contacts]] == domains[slot] for slot in range(2)]
    return np.where(up[0], 1, -1) if np.array_equal(up[0], up[1]) else None


def not_balanced(pulls: Pulls, between: list[Between]) -> np.ndarray:
    """Return the mask (2, spheres), by component, of the spheres in firm domains on which friction is not proven to
    balance. Contacts below their friction limits join spheres to firm domains; those with a driven sphere are left out.

    pulls : the contacts whose friction is at its limit.
    between : pairs of firm domains that are known to be in balance.

    Let r be the torque left over on a firm domain. Two kinds of equations say that a sum of r is 0:
    1. over the firm domains in a slipless domain without a driven sphere, as that is in balance at the minimum;
    2. over a *group*, firm domains that contacts without exactly known friction connect. This friction cancels in the
       sum, so the equation is true if the exactly known friction on the group adds up to 0.
    Each r stands in one equation of either kind. A true equation with one unknown r makes it 0, until none is left."""
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
        # for each firm domain the numbers of its equations of both kinds; and which equations are true
        groups, driven = int(group.max()) + 1, np.arange(pulls.imposed_labels(pulls.slipless_domain, slot))
        equations = np.stack([group, groups + slipless])
        is_true = np.append(
            pulls.known_pulls_cancel_at(group[firm], slot), np.ones(int(slipless.max()) + 1, dtype=bool)
        )
        is_true[np.append(group[0], groups + driven)] = False
        unsolved = np.ones(count, dtype=bool)
        unsolved[imposed] = False
        unsolved[[int(firm[pair.sphere]) for pair in between]] = False
        while unsolved.any():
            terms = np.bincount(equations[:, unsolved].ravel(), minlength=len(is_true))
            solved = unsolved & (is_true & (terms == 1))[equations].any(axis=0)
            if not solved.any():
                break
            unsolved &= ~solved
        # a group on which the known friction does not add up to 0 contradicts that all its r are 0
        wrong = np.flatnonzero(~is_true[:groups])
        unsolved |= np.isin(group, wrong[wrong != group[0]])
        unsolved[imposed] = False
        found[slot] = unsolved[firm]
    return found


@dataclass(frozen=True)
class Movable:
    """The m pairs of locked domains, one of each component, that can move along a line: along the friction of the
    oblique contacts of the pair. (`Pulls.locked_domain` says which spheres a locked domain has.)

    labels : (2, m), for both components the label of the locked domain.
    slot : (m,), the component (0 or 1) in which the pair is held so that one minimum is left.
    pairs : m objects with the direction of the line and the contacts of the pair."""

    labels: np.ndarray
    slot: np.ndarray
    pairs: list[Between]

    @classmethod
    def of(cls, pulls: Pulls, limits: ObliqueLimits, contacts: Slipping) -> Movable:
        """Return the pairs that can move (step 3 of the proof): pairs of locked domains without a driven sphere. The
        turning contacts between either domain and others have to be those of a pair in `limits`.

        pulls : the contacts whose friction is at its limit.
        limits : the friction of the oblique contacts, with pairs of firm domains.
        contacts : the slipping contacts."""
        labels, slots, pairs = [], [], []
        for pair in limits.between:
            locked = [int(label[pair.sphere]) for label in pulls.locked_domain]
            turning = [pulls.turned_by[s] & pulls.crossing(pulls.locked_domain[s], locked[s]) for s in range(2)]
            is_driven = any(locked[s] < pulls.imposed_labels(pulls.locked_domain, s) for s in range(2))
            same = all(np.array_equal(np.flatnonzero(mask), pair.contacts) for mask in turning)
            if same and not is_driven and _side(pulls, pair.contacts, pulls.locked_domain, locked) is not None:
                labels.append(locked)
                # hold it in the component in which the line is longer
                sizes = [part.most[pair.guide] for part in contacts.difference]
                slots.append(int(sizes[1] > sizes[0]))
                pairs.append(pair)
        return cls(np.array(labels, dtype=int).reshape(-1, 2).T, np.array(slots, dtype=int), pairs)

    def signs(self, contacts: Slipping, relative_change: np.ndarray) -> np.ndarray:
        """Return the signs (2, m), +1 or -1, of the only direction in which each pair can move without making its
        oblique contacts slip backwards, by component; 0 where a sign is not proven.

        contacts : the slipping contacts close to the minimum.
        relative_change : (slipping contacts,), bound on |slip at the minimum - slip| / |slip|.
        """
        guide = np.array([pair.guide for pair in self.pairs], dtype=int)
        change = relative_change[guide] * contacts.size.at(guide).most * UP
        slips = [part.at(guide) for part in contacts.difference]
        way = np.array([pair.way for pair in self.pairs], dtype=int)
        return np.array([np.where(of.least > change, np.sign(of.high) * way, 0) for of in slips]).astype(int)

    def blocked(self, pulls: Pulls, signs: np.ndarray, excluded: np.ndarray) -> np.ndarray:
        """Return the mask (m,) of the pairs of domains (step 1 of the proof) that at no minimum move against the rest
        of their locked domain (step 4): in one of the two spin components, a chain of contacts excludes the only
        direction in which the pair may move. Each contact of the chain may only slip forward.

        pulls : the contacts whose friction is at its limit, slipping ones (S) and resting ones (C); chains are of C.
        signs : (2, m), sign of that direction in each component; 0 if it is not known.
        excluded : (2, spheres) mask of spheres that may move in other ways; contacts at these are not used."""
        found = np.zeros(len(self.pairs), dtype=bool)
        for slot in range(2):
            # Nodes with motions y: welded domains, which move as a whole; then the pairs, taken out of their domains.
            node, locked = pulls.welded_locked[slot].copy(), pulls.locked_domain[slot]
            rest_of_domain, count = [], int(node.max()) + 1
            for number, label in enumerate(self.labels[slot].tolist()):
                rest_of_domain.append(int(node[locked == label][0]))
                node[locked == label] = count + number
            # A contact of C with the sign s may only slip forward, s (y_upper - y_lower) >= 0: an edge from the node
            # with the larger y to that with the smaller one.
            rests = ~pulls.in_s & ~pulls.oblique & pulls.felt[slot] & (pulls.sign[slot] != 0)
            rests &= ~(excluded[slot, pulls.lower] | excluded[slot, pulls.upper])
            forward = pulls.sign[slot, rests] > 0
            lower, upper = node[pulls.lower[rests]], node[pulls.upper[rests]]
            larger, smaller = np.where(forward, upper, lower), np.where(forward, lower, upper)
            size = count + len(rest_of_domain)
            graph = graph_of(size, larger, smaller)
            for number, rest in enumerate(rest_of_domain):
                # A pair that may only move ahead of the rest of its domain stands still if a path leads from the rest
                # to the pair, so that its y is no larger; one that may only fall behind if a path leads back.
                begin, end = (rest, count + number) if signs[slot, number] > 0 else (count + number, rest)
                if signs[slot, number] != 0:
                    found[number] |= end in breadth_first_order(graph, begin, return_predecessors=False)
        return found
