"""Which contacts slip at every minimum, at none, or at some, where there are many minima: theorem 9.

Two components are needed here. Letters: S the contacts that slip as stored; C those that do not slip and yet bear all
their friction, along one component; T the others that do not slip. n contacts of S and C, E of the sample; u* a
minimum, t the slip of a contact at u*, y motions. A *domain* is what T and C join in a component, a *part* what T joins
alone, and a *body* what T joins together with those of C that bear nothing along the component.

1. A contact of S with slip along both components turns its slip as soon as one domain moves. What such contacts join in
   a component without a driven plane is a *cluster*. Moving it as a whole turns no slip, and its other contacts pull it
   by their whole friction, one way or the other. If these pulls, added exactly, cancel, then the balance of all its
   domains but one implies that of the last one: so one may be held where it is. The same is true of a domain *between*
   two sets of contacts that pull it in opposite directions, each set from one other domain, with the same friction in
   all: held in one component, and in balance in the other one, it is pulled along one line.
2. With these domains held there is one minimum nearby (curvature.py), u*. It is a minimum of the whole power if T and C
   can bear what is left to them.
3. Friction that agrees with u* can be put in balance: on C exactly at its limit, if the pulls on each part, added
   exactly, cancel. One part of each free domain may be excepted, on which others act: its balance is that of the
   domain. On T it stays inside all discs (curvature.py). So u* is a minimum of the whole power, and T rests at every
   minimum.
4. All minima share that friction. So they differ from u* by motions of bodies that keep T at rest, turn no slip of S
   and let C slip along its friction alone. Clusters of bodies that move as a whole are such motions. So are motions of
   what lies between two sets, along the line, which leaves these slips undecided. By the curvature with one body of
   each held (rises) there are no others. So minima are all motions y of clusters for which no contact of S and C slips
   backwards: t + y_b - y_a >= 0, where t is 0 on C. How far a slip can go is the length of a shortest path. A contact
   of S rests at some minimum if t is no longer than any other path, and at none if one is shorter; one of C slips at
   some minimum unless a path of length 0 leads back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from taichi_bearings.proof.curvature import Slipping, bearable, nearest_minimum, rises
from taichi_bearings.proof.enclosure import UP, Enclosure
from taichi_bearings.proof.judged_network import JudgedNetwork, Motion
from taichi_bearings.proof.slices import slices
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, TIED, UNDECIDED

MISSED_LIMIT = 1e-6  # share of the friction by which a contact at its limit may miss it
# friction across a component over the limit, that may be none: above (2 MISSED_LIMIT) ** 0.5
MISSED_DIRECTION = 2e-3
PATH_ROUNDING = 1 + 1e-12  # factor that covers the rounding of sums along a path


@dataclass(frozen=True)
class Pulls:
    """The contacts of S, then those of C, of one sample: n in all, and what they pull.

    own : (n,), their numbers among all contacts.
    lower, upper : (n,), numbers of their spheres.
    felt : (2, n) mask, whether each of the two needed components makes a contact slip.
    sign : (2, n), sign of the difference of signed spins; on C, of the difference that would go with its friction.
    coefficient : (n,), friction in exact proportions.
    slips : (n,) mask of S.
    domain, part, body : (2, spheres), by component the number of what each sphere belongs to; 0 and 1 for what moves
        with the bottom and with the top.
    """

    own: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    felt: np.ndarray
    sign: np.ndarray
    coefficient: np.ndarray
    slips: np.ndarray
    domain: np.ndarray
    part: np.ndarray
    body: np.ndarray

    def apart(self, label: np.ndarray, slot: int) -> np.ndarray:
        """(n,) mask of the contacts whose ends have different labels. label : (2, spheres). slot : 0 or 1, the
        component."""
        return label[slot, self.lower] != label[slot, self.upper]

    def touches(self, label: np.ndarray, value: int, slot: int) -> np.ndarray:
        """(n,) mask of contacts of C with an end in the domain `value`, and of contacts of S with exactly one end in
        it. label : (spheres,), numbers of domains."""
        ends = label[self.lower] == value, label[self.upper] == value
        return np.where(self.slips, ends[0] != ends[1], ends[0] | ends[1])

    @cached_property
    def turns(self) -> np.ndarray:
        """(2, n) masks: a motion of one end in this component turns the slip of the contact, since it slips in the
        other one too."""
        both = self.felt.all(axis=0)
        return np.array([both & self.apart(self.domain, 1), both & self.apart(self.domain, 0)])

    def clusters(self, label: np.ndarray, slot: int) -> np.ndarray:
        """(spheres,), number of the cluster of each sphere in component `slot`; 0 for what is joined to a plane. label
        : (2, spheres), the domains or bodies that form clusters."""
        own = label[slot]
        joins = self.turns[slot] & self.apart(label, slot)
        first, second = own[self.lower[joins]], own[self.upper[joins]]
        first, second = np.append(first, 0), np.append(second, 1)  # one plane cannot move past the other
        size = int(own.max()) + 1
        graph = sparse.coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(max(size, 2),) * 2)
        joined = connected_components(graph, directed=False)[1]
        found = np.where(joined == joined[0], -1, joined)[own]
        return np.unique(np.append(found, -1), return_inverse=True)[1][:-1]

    @cached_property
    def pairs(self) -> np.ndarray:
        """(spheres,), equal numbers for spheres that are in one domain in both components."""
        return np.unique(self.domain, axis=1, return_inverse=True)[1].reshape(-1)

    def sums(self, owner: np.ndarray, slot: int) -> dict[int, bool]:
        """For each owner, whether the pulls along component `slot` that are known exactly cancel. owner : (spheres,), a
        number for each sphere."""
        known = self.felt[slot] & ~self.turns[slot] & np.where(
            self.slips, self.apart(self.domain, slot), self.apart(self.part, slot)
        )  # fmt: skip
        found: dict[int, list[float]] = {}
        pull = self.sign[slot] * self.coefficient
        for end, sign in ((self.upper, 1.0), (self.lower, -1.0)):
            for number, value in zip(owner[end[known]].tolist(), (sign * pull[known]).tolist(), strict=True):
                found.setdefault(number, []).append(value)
        return {number: math.fsum(values) == 0.0 for number, values in found.items()}


@dataclass(frozen=True)
class Line:
    """The n contacts whose slips change where minima differ along one component.

    own : (n,), their numbers.
    lower, upper : (n,), number of the cluster at either end; 0 for what does not move.
    sign : (n,), by which the motion of the upper end lengthens the slip.
    twin : (n,), equal numbers for contacts with equal slips.
    """

    own: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    sign: np.ndarray
    twin: np.ndarray

    def with_others(self, some: np.ndarray) -> np.ndarray:
        """(n,) mask of the contacts `some` (n,), and of all that share a moving cluster with them, directly or through
        others."""
        size = int(max(self.lower.max(initial=0), self.upper.max(initial=0))) + 1
        inner = (self.lower > 0) & (self.upper > 0)
        joins = self.lower[inner], self.upper[inner]
        graph = sparse.coo_array((np.ones(len(joins[0]), dtype=np.int8), joins), shape=(size, size))
        piece = connected_components(graph, directed=False)[1][np.maximum(self.lower, self.upper)]
        return np.isin(piece, piece[some])

    def limits(self, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Three masks (n,): the contact rests at some minimum; slips at every one; slips at some. least, most : (n,),
        bounds of the slip at one minimum, both 0 for C."""
        # the slip t of a contact leaves y[head] - y[tail] <= t
        tail, head = np.where(self.sign > 0, (self.upper, self.lower), (self.lower, self.upper))
        twins = np.unique(self.twin, return_inverse=True)[1]
        # Twins share the tightest bounds; shortest paths with lower and with upper bounds as lengths.
        low, high = np.zeros(twins.max(initial=0) + 1), np.full(twins.max(initial=0) + 1, np.inf)
        np.maximum.at(low, twins, least)
        np.minimum.at(high, twins, most)
        low, high = low[twins], high[twins]
        shortest, longest = dijkstra(_edges(tail, head, low)), dijkstra(_edges(tail, head, high))
        always = longest[tail, head] * PATH_ROUNDING < low
        some = (low > 0) | (shortest[head, tail] > 0)
        rests = high == 0
        for one in np.unique(twins[~always & ~rests]):
            own = np.flatnonzero(twins == one)  # a path that slips by one of these is no shorter than the one alone
            left, starts = twins != one, np.unique(tail[own])
            around = dijkstra(_edges(tail[left], head[left], low[left], len(shortest)), indices=starts)
            rests[own] = high[own] * PATH_ROUNDING <= around[np.searchsorted(starts, tail[own]), head[own]]
        return rests, always, some


def _edges(tail: np.ndarray, head: np.ndarray, length: np.ndarray, size: int = 0) -> sparse.csr_array:
    """Directed graph (size, size) of the shortest of parallel edges, kept even if their length is 0. tail, head, length
    : of each edge."""
    size = max(size, int(max(tail.max(initial=0), head.max(initial=0))) + 1)
    order = np.lexsort((length, head, tail))
    first = np.append(True, (np.diff(tail[order]) != 0) | (np.diff(head[order]) != 0))[: len(order)]
    kept = order[first]
    begin = np.searchsorted(tail[kept], np.arange(size + 1))
    return sparse.csr_array((length[kept], head[kept].astype(np.int32), begin.astype(np.int32)), shape=(size, size))


@dataclass(frozen=True)
class Between:
    """The m domains that only two sets of contacts with equal friction pull, in opposite directions.

    labels : (2, m), their numbers in both components.
    slot : (m,), the component in which each is held.
    sets : for each, the numbers of the contacts of both sets.
    unclear : (n,) mask of all these contacts, and of those along which such a domain slides.
    """

    labels: np.ndarray
    slot: np.ndarray
    sets: list[np.ndarray]
    unclear: np.ndarray

    @classmethod
    def of(cls, pulls: Pulls, contacts: Slipping) -> Between:
        """Find these domains. contacts : those of S."""
        pair, known = pulls.pairs, [pulls.sums(pulls.domain[slot], slot) for slot in range(2)]
        spans = pulls.slips & pulls.turns.all(axis=0)
        spans &= pulls.apart(pulls.domain, 0) & pulls.apart(pulls.domain, 1)
        at = {slot: _touching(pulls.domain[slot], pulls, pulls.slips & pulls.turns[slot]) for slot in range(2)}
        labels, slots, sets, unclear = [], [], [], np.zeros(len(spans), dtype=bool)
        for sphere in np.unique(pair, return_index=True)[1]:
            own = [int(pulls.domain[slot, sphere]) for slot in range(2)]
            some = at[0].get(own[0], set())
            # The same contacts must pull the domain in both components, and no plane may drive it.
            if min(own) < 2 or not some or some != at[1].get(own[1], set()):
                continue
            chosen = np.array(sorted(some))
            up = pair[pulls.upper[chosen]] == pair[sphere]
            mine = up | (pair[pulls.lower[chosen]] == pair[sphere])
            other = pair[np.where(up, pulls.lower[chosen], pulls.upper[chosen])]
            # They come from just two other domains, and slip in both components.
            sides = np.unique(other)
            if not (spans[chosen].all() and mine.all() and len(sides) == 2):
                continue
            # Both sets have the same friction in all, exactly.
            weight = np.where(other == sides[0], 1.0, -1.0) * pulls.coefficient[chosen]
            if math.fsum(weight.tolist()) != 0.0 or not all(
                k.get(label, True) for k, label in zip(known, own, strict=True)
            ):
                continue
            parts = [part.at(chosen) for part in contacts.difference]
            slot = int(np.median(parts[1].most) > np.median(parts[0].most))
            ahead = np.sign(parts[slot].high) * np.where(up, 1, -1) * np.where(other == sides[0], 1, -1)
            if len(np.unique(ahead)) != 1:  # the domain does not lie between them
                continue
            labels.append(own)
            slots.append(slot)
            sets.append(chosen)
            unclear[chosen] = True
            for s in range(2):
                unclear |= pulls.felt[s] & ~pulls.turns[s] & pulls.touches(pulls.domain[s], own[s], s)
        return cls(np.array(labels, dtype=int).reshape(-1, 2).T, np.array(slots, dtype=int), sets, unclear)

    def lie_between(self, contacts: Slipping, turn: np.ndarray) -> bool:
        """True if near the minimum the contacts of the sets surely slip along the component in which their domain is
        held. turn : (n,), share by which each slip may differ there."""
        for own, slot in zip(self.sets, self.slot, strict=True):
            if not (contacts.difference[slot].at(own).least > turn[own] * contacts.size.at(own).most * UP).all():
                return False
        return True


def _touching(label: np.ndarray, pulls: Pulls, some: np.ndarray) -> dict[int, set[int]]:
    """For each label the numbers of contacts with an end of that label and another label at the other end. label :
    (spheres,). some : (n,) mask of the contacts that are looked at."""
    found: dict[int, set[int]] = {}
    own = np.flatnonzero(some & (label[pulls.lower] != label[pulls.upper]))
    for end in (pulls.lower, pulls.upper):
        for one, number in zip(label[end[own]].tolist(), own.tolist(), strict=True):
            found.setdefault(one, set()).add(number)
    return found


def tied_states(motion: Motion, contacts: Slipping) -> tuple[np.ndarray, bool | None] | None:
    """States (E,) of the contacts of one sample of a lattice with two needed components, and whether there is only one
    minimum; None if nothing is proven. contacts : those that slip."""
    limit = Limit.of(motion)
    if limit is None or motion.torn.any() or not (contacts.size.least > 0).all():
        return None
    # Step 1: hold one domain, and one body, of each cluster.
    pulls = _pulls(motion, contacts, limit)
    between = Between.of(pulls, contacts)
    held, held_bodies = (_held(pulls, label, between) for label in (pulls.domain, pulls.body))
    if held is None or held_bodies is None or not (held.any() or not pulls.slips.all()):
        return None
    # Steps 2 and 3, then 4.
    near = _balanced(motion, pulls, between, held, limit)
    if near is None:
        return None
    found, turn = near
    if not pulls.slips.all():
        of_bodies = Slipping.of(motion, _still_labels(motion, pulls.body, held_bodies))
        if not rises(replace(of_bodies, difference=found.difference), turn):
            return None
    return _states_along_lines(pulls, between, found, turn, bool(held_bodies.any()), len(motion.rests))


@dataclass(frozen=True)
class Limit:
    """The contacts C of one sample.

    full : (E,) mask of them.
    along : (E,), the place (0 or 1) of the needed component along which they bear all their friction.
    """

    network: JudgedNetwork
    full: np.ndarray
    along: np.ndarray

    @classmethod
    def of(cls, motion: Motion) -> Limit | None:
        """Find the contacts C of a motion; None if some contact bears its full friction along both components."""
        network, strength = motion.network, motion.network.holding.value
        parts = np.abs([network.moment[k].high for k in network.needed])
        full = motion.rests & (np.hypot(*parts) >= (1 - MISSED_LIMIT) * strength) & network.counts
        if (parts.min(axis=0)[full] > MISSED_DIRECTION * strength[full]).any():
            return None
        return cls(network, full, np.argmax(parts, axis=0))

    def friction(self, slot: int) -> Enclosure:
        """What the contacts of C have to bear along component `slot`, exactly, with the sign of their moment; 0 where
        they bear along the other one."""
        own = np.flatnonzero(self.full)
        said = np.sign(self.network.moment[self.network.needed[slot]].high[own])
        return self.network.holding.at(own).signed(said * (self.along[own] == slot))

    def others(self, motion: Motion, slot: int | None) -> Motion:
        """The motion in which only T rests; if `slot` is given, also those of C that bear nothing along that
        component."""
        return Motion(self.network, motion.rests & ~(self.full if slot is None else self.full & (self.along == slot)))

    def unsure(self) -> dict[int, np.ndarray]:
        """By component, (spheres,), how far friction of C at its limit is from the stored one, summed at each
        sphere."""
        own, network = np.flatnonzero(self.full), self.network
        found = {k: np.zeros(len(network.free)) for k in network.needed}
        for slot, k in enumerate(network.needed):
            missing = self.friction(slot).plus(-network.moment[k].high[own]).most
            missing[~network.feels[k][own]] = 0.0
            for end in network.graph.contact[:, own]:
                found[k] += np.bincount(end, missing, len(found[k]))
        return found


def _pulls(motion: Motion, contacts: Slipping, limit: Limit) -> Pulls:
    """The pulls of S (`contacts`) and C (`limit`) in a motion."""
    network, full = motion.network, np.flatnonzero(limit.full)
    own = np.append(contacts.own, full)
    lower, upper = network.graph.contact[:, own]
    pull = np.array([np.sign(limit.friction(slot).high) * network.sign[k][network.graph.contact[1, full]]
                     for slot, k in enumerate(network.needed)])  # fmt: skip
    turns = np.array([np.sign(part.high) for part in contacts.difference])
    (coefficient,) = network.factors
    domain, part, body = (
        np.array([_numbered(joined_by(slot), k) for slot, k in enumerate(network.needed)])
        for joined_by in (lambda _: motion, lambda _: limit.others(motion, None), lambda s: limit.others(motion, s))
    )
    return Pulls(
        own, lower, upper, np.array([network.feels[k][own] for k in network.needed]),
        np.concatenate([turns, pull], axis=1), coefficient[own], np.arange(len(own)) < len(contacts.own),
        domain, part, body,
    )  # fmt: skip


def _numbered(motion: Motion, k: int) -> np.ndarray:
    """(spheres,), number of the domain of each sphere in component k: 0 and 1 for what turns with the bottom and the
    top, larger numbers for all others."""
    label = motion.domain[k]
    low, high = slices(motion.network.graph).leader(k)
    return np.where(label == label[low], 0, np.where(label == label[high], 1, label + 2))


def _held(pulls: Pulls, label: np.ndarray, between: Between) -> np.ndarray | None:
    """(2, spheres) mask of the domains or bodies `label` that are held: one of each cluster, and those between two
    sets. None if all members of a cluster lie between sets."""
    held = np.zeros(label.shape, dtype=bool)
    for slot in range(2):
        cluster, inner = pulls.clusters(label, slot), np.isin(pulls.domain[slot], between.labels[slot])
        for number in range(1, int(cluster.max()) + 1):
            some = label[slot][(cluster == number) & ~inner]
            if not len(some):
                return None
            held[slot] |= label[slot] == some[0]
        for own in between.labels[slot][between.slot == slot]:
            held[slot] |= label[slot] == label[slot][pulls.domain[slot] == own][0]
    return held


def _still_labels(motion: Motion, label: np.ndarray, held: np.ndarray) -> dict[int, np.ndarray]:
    """The labels (2, spheres) by component, with 0, the bottom, for what is held."""
    return {k: np.where(h, 0, own) for k, own, h in zip(motion.network.needed, label, held, strict=True)}


def _balanced(
    motion: Motion,
    pulls: Pulls,
    between: Between,
    held: np.ndarray,
    limit: Limit,
) -> tuple[Slipping, np.ndarray] | None:
    """Contacts of S near the minimum u*, and the share (n,) by which each slip differs there at most, by steps 1 to 3
    of the module docstring; None if u* is not proven to be a minimum."""
    rests, unsure = limit.others(motion, None), limit.unsure()
    near = nearest_minimum(Slipping.of(motion, _still_labels(motion, pulls.domain, held)))
    if near is None:
        return None
    found, turn = near
    # The pulls that were added keep their signs, cancel, and T bears the rest inside all discs.
    known = pulls.felt & ~pulls.turns & pulls.slips
    signs = np.array([np.sign(part.high) for part in found.difference])
    same = (signs == pulls.sign[:, : len(turn)]) | ~known[:, : len(turn)]
    known_well = same.all() and _cancel(pulls) and between.lie_between(found, turn)
    return near if known_well and bearable(rests, found, turn, unsure) else None


def _cancel(pulls: Pulls) -> bool:
    """True if the pulls that are known exactly cancel: on each cluster of domains, and on each part, except one at most
    of each free domain, on which others act."""
    for slot in range(2):
        sums = pulls.sums(pulls.clusters(pulls.domain, slot), slot)
        if not all(cancels for number, cancels in sums.items() if number > 0):
            return False
        part, domain = pulls.part[slot], pulls.domain[slot]
        others = pulls.slips & pulls.turns[slot] & pulls.apart(pulls.domain, slot)
        ends = np.concatenate([pulls.lower[others], pulls.upper[others]])
        pulled = np.unique(np.array([part[ends], domain[ends]]), axis=1)
        pulled = pulled[:, pulled[0] > 1]
        if (pulled[1] < 2).any() or len(np.unique(pulled[1])) < pulled.shape[1]:
            return False
        sums = pulls.sums(part, slot)
        if not all(cancels for number, cancels in sums.items() if number > 1 and number not in pulled[0]):
            return False
    return True


def _states_along_lines(
    pulls: Pulls, between: Between, contacts: Slipping, turn: np.ndarray, moves: bool, count: int
) -> tuple[np.ndarray, bool | None]:
    """States (E,), and whether there is only one minimum, by step 4 of the module docstring. contacts, turn : S near
    u*, and the share (n,) by which each slip differs there. moves : whether some body is held, so that minima may
    differ. count : E."""
    rest = len(pulls.slips) - len(turn)
    least = np.append(contacts.size.least * (1 - turn) / PATH_ROUNDING, np.zeros(rest))
    most = np.append(contacts.size.most * (1 + turn) * PATH_ROUNDING, np.zeros(rest))
    state = np.where(pulls.slips, SLIPPING, SLIPLESS)
    state[between.unclear] = UNDECIDED
    for line in _lines(pulls):
        rests, always, some = line.limits(least[line.own], most[line.own])
        known = np.where(rests & some, TIED, np.where(always, SLIPPING, np.where(rests, SLIPLESS, UNDECIDED)))
        unclear = line.with_others(between.unclear[line.own])
        state[line.own] = np.where(unclear & (known != TIED), UNDECIDED, known)
    found = np.full(count, SLIPLESS)
    found[pulls.own] = state
    tied, unproven = (found == TIED).any(), (found == UNDECIDED).any()
    return found, False if tied else True if not moves or not unproven else None


def _lines(pulls: Pulls) -> list[Line]:
    """The contacts whose slips change along either of the two components."""
    found, size = [], pulls.domain.shape[1] + 2
    for slot in range(2):
        cluster = pulls.clusters(pulls.body, slot)
        ends = cluster[pulls.lower], cluster[pulls.upper]
        own = np.flatnonzero(pulls.felt[slot] & ~pulls.turns[slot] & (ends[0] != ends[1]))
        sign = pulls.sign[slot, own]
        low, high = (pulls.domain[slot, end[own]] for end in (pulls.lower, pulls.upper))
        twin = np.where(sign > 0, low * size + high, high * size + low)
        twin = np.where(pulls.slips[own], twin, size * size + own)
        found.append(Line(own, ends[0][own], ends[1][own], sign, twin))
    return found
