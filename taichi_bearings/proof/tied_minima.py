"""Which contacts slip at every minimum, at none, or at some, where there are many minima: theorem 9.

Two components. Let S be the contacts that slip as stored, C those that do not and yet bear all their friction, along
one component, and T the others that do not slip. A *domain* is what T and C join in a component, a *part* what T joins
alone, and a *body* what T joins and those of C that bear nothing along the component.

1. A contact of S with slip along both components turns as soon as one domain moves. What such contacts join in a
   component, and no driven plane, is a *cluster*. Moved as a whole it turns no slip, and its other contacts pull it by
   their whole friction either way. If these pulls, added exactly, cancel, the balance of all its domains but one is
   that of the last one too: so one may be held where it is. Likewise a domain *between* two sets of contacts that pull
   it either way, each from one other domain, with the same friction in all: held in one component, and in balance in
   the other one, it is pulled along one line.
2. With these domains held there is one minimum nearby (curvature.py), u*. It is a minimum as long as T and C hold.
3. Friction that agrees with u* can be put in balance: on C exactly at its limit, if the pulls on each part, added
   exactly, cancel, but for one part at most of a free domain, on which others act (its balance is that of the domain);
   on T inside all discs (curvature.py). So u* is a minimum of the whole power, and T rests at every minimum.
4. All minima share that friction. So they differ from u* by motions of bodies that keep T at rest, turn no slip of S
   and let C slip along its friction alone. Clusters of bodies that move as a whole do so, and what lies between two
   sets, along the line, which leaves these slips open. By the curvature with one body of each held (rises) there are no
   others. So minima are all motions y of clusters for which no contact of S and C slips backwards: t + y_b - y_a >= 0,
   with t its slip at u*, which is 0 on C. How far a slip can go is the length of a shortest path. A contact of S rests
   at some minimum if t is no longer than any other path, and at none if one is shorter; one of C rests at all if a path
   of length 0 leads back.
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
# share of the friction across a component that may be none, where a limit is missed by that much
MISSED_DIRECTION = 2e-3
PATH_ROUNDING = 1 + 1e-12  # factor that makes up for the rounding of sums along a path


@dataclass(frozen=True)
class Pulls:
    """The n contacts of S, then those of C, of one sample.

    own : (n,), their numbers among all contacts. lower, upper : (n,) numbers of their spheres. felt : (2, n), which of
    the needed components they feel. sign : (2, n), of the difference of signed spins, or on C of the friction that
    would go with it. coefficient : (n,).
    slips : (n,) mask of S. domain, part, body : (2, spheres), 0 and 1 for what turns with the planes.
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
        """(n,) mask of those with ends in different domains, parts or bodies."""
        return label[slot, self.lower] != label[slot, self.upper]

    def touches(self, label: np.ndarray, value: int, slot: int) -> np.ndarray:
        """(n,) mask of contacts of C at a domain with this label (spheres,), and of S between it and another one."""
        ends = label[self.lower] == value, label[self.upper] == value
        return np.where(self.slips, ends[0] != ends[1], ends[0] | ends[1])

    @cached_property
    def turns(self) -> np.ndarray:
        """(2, n) masks: does a motion of one end in this component turn the slip? So it does if there is slip in the
        other one."""
        both = self.felt.all(axis=0)
        return np.array([both & self.apart(self.domain, 1), both & self.apart(self.domain, 0)])

    def clusters(self, label: np.ndarray, slot: int) -> np.ndarray:
        """(spheres,), number of the cluster of domains or bodies of each sphere; 0 for what is joined to a plane."""
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
        """(spheres,), equal numbers for equal domains in both components."""
        return np.unique(self.domain, axis=1, return_inverse=True)[1].reshape(-1)

    def sums(self, owner: np.ndarray, slot: int) -> dict[int, bool]:
        """Do the pulls along a component that are known exactly cancel, owner by owner (spheres,) -> number?"""
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
    """The contacts (n,) that a way along which minima differ changes: their ends on it, (n,) numbers of what moves, 0
    for what does not; sign : by which the motion of the upper end lengthens the slip; twin : equal numbers for equal
    slips; own : (n,) numbers of the contacts."""

    own: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    sign: np.ndarray
    twin: np.ndarray

    def with_others(self, some: np.ndarray) -> np.ndarray:
        """(n,) mask of some contacts, and of all that share what moves with them, directly or through others."""
        size = int(max(self.lower.max(initial=0), self.upper.max(initial=0))) + 1
        inner = (self.lower > 0) & (self.upper > 0)
        joins = self.lower[inner], self.upper[inner]
        graph = sparse.coo_array((np.ones(len(joins[0]), dtype=np.int8), joins), shape=(size, size))
        piece = connected_components(graph, directed=False)[1][np.maximum(self.lower, self.upper)]
        return np.isin(piece, piece[some])

    def limits(self, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Masks (n,): rests at some minimum, slips at every one, slips at some. least, most : (n,), bounds of the slip
        at one minimum, both 0 where there is none."""
        # the slip t of a contact leaves y[head] - y[tail] <= t
        tail, head = np.where(self.sign > 0, (self.upper, self.lower), (self.lower, self.upper))
        twins = np.unique(self.twin, return_inverse=True)[1]
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
    """(size, size) directed graph of the shortest edges, with those of length 0."""
    size = max(size, int(max(tail.max(initial=0), head.max(initial=0))) + 1)
    order = np.lexsort((length, head, tail))
    first = np.append(True, (np.diff(tail[order]) != 0) | (np.diff(head[order]) != 0))[: len(order)]
    kept = order[first]
    begin = np.searchsorted(tail[kept], np.arange(size + 1))
    return sparse.csr_array((length[kept], head[kept].astype(np.int32), begin.astype(np.int32)), shape=(size, size))


@dataclass(frozen=True)
class Between:
    """The m domains that just two equal sets of contacts pull.

    labels : (2, m), of both components. slot : (m,), that in which each is held. sets : numbers of the contacts of
    both sets of each. unclear : (n,), all these, and contacts along which such a domain slides.
    """

    labels: np.ndarray
    slot: np.ndarray
    sets: list[np.ndarray]
    unclear: np.ndarray

    @classmethod
    def of(cls, pulls: Pulls, contacts: Slipping) -> Between:
        """contacts : those of S."""
        pair, known = pulls.pairs, [pulls.sums(pulls.domain[slot], slot) for slot in range(2)]
        spans = pulls.slips & pulls.turns.all(axis=0)
        spans &= pulls.apart(pulls.domain, 0) & pulls.apart(pulls.domain, 1)
        at = {slot: _touching(pulls.domain[slot], pulls, pulls.slips & pulls.turns[slot]) for slot in range(2)}
        labels, slots, sets, unclear = [], [], [], np.zeros(len(spans), dtype=bool)
        for sphere in np.unique(pair, return_index=True)[1]:
            own = [int(pulls.domain[slot, sphere]) for slot in range(2)]
            some = at[0].get(own[0], set())
            if min(own) < 2 or not some or some != at[1].get(own[1], set()):
                continue
            chosen = np.array(sorted(some))
            up = pair[pulls.upper[chosen]] == pair[sphere]
            mine = up | (pair[pulls.lower[chosen]] == pair[sphere])
            other = pair[np.where(up, pulls.lower[chosen], pulls.upper[chosen])]
            sides = np.unique(other)
            if not (spans[chosen].all() and mine.all() and len(sides) == 2):
                continue
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
        """True if near the minimum the contacts of the sets surely slip along the component in which they are held."""
        for own, slot in zip(self.sets, self.slot, strict=True):
            if not (contacts.difference[slot].at(own).least > turn[own] * contacts.size.at(own).most * UP).all():
                return False
        return True


def _touching(label: np.ndarray, pulls: Pulls, some: np.ndarray) -> dict[int, set[int]]:
    """Numbers of some contacts, (n,) mask, between different labels (spheres,), by the labels at their ends."""
    found: dict[int, set[int]] = {}
    own = np.flatnonzero(some & (label[pulls.lower] != label[pulls.upper]))
    for end in (pulls.lower, pulls.upper):
        for one, number in zip(label[end[own]].tolist(), own.tolist(), strict=True):
            found.setdefault(one, set()).add(number)
    return found


def tied_states(motion: Motion, contacts: Slipping) -> tuple[np.ndarray, bool | None] | None:
    """Of one sample of a lattice with two components: states (E,) of its contacts, and whether there is only one
    minimum. None if nothing is proven. contacts : those that slip."""
    limit = Limit.of(motion)
    if limit is None or motion.torn.any() or not (contacts.size.least > 0).all():
        return None
    pulls = _pulls(motion, contacts, limit)
    between = Between.of(pulls, contacts)
    held, held_bodies = (_held(pulls, label, between) for label in (pulls.domain, pulls.body))
    if held is None or held_bodies is None or not (held.any() or not pulls.slips.all()):
        return None
    near = _balanced(motion, pulls, between, held, limit)
    if near is None:
        return None
    found, turn = near
    if not pulls.slips.all():
        of_bodies = Slipping.of(motion, _still_labels(motion, pulls.body, held_bodies))
        if not rises(replace(of_bodies, difference=found.difference), turn):
            return None
    return _named(pulls, between, found, turn, bool(held_bodies.any()), len(motion.rests))


@dataclass(frozen=True)
class Limit:
    """Contacts C of one sample. full : (E,) mask. along : (E,), along which of the needed components they bear all
    their friction; they bear none along the other one."""

    network: JudgedNetwork
    full: np.ndarray
    along: np.ndarray

    @classmethod
    def of(cls, motion: Motion) -> Limit | None:
        """None if contacts bear all their friction along both components."""
        network, strength = motion.network, motion.network.holding.value
        parts = np.abs([network.moment[k].high for k in network.needed])
        full = motion.rests & (np.hypot(*parts) >= (1 - MISSED_LIMIT) * strength) & network.counts
        if (parts.min(axis=0)[full] > MISSED_DIRECTION * strength[full]).any():
            return None
        return cls(network, full, np.argmax(parts, axis=0))

    def friction(self, slot: int) -> Enclosure:
        """Exactly what they have to bear, (n,), with its sign in the moment."""
        own = np.flatnonzero(self.full)
        said = np.sign(self.network.moment[self.network.needed[slot]].high[own])
        return self.network.holding.at(own).signed(said * (self.along[own] == slot))

    def others(self, motion: Motion, slot: int | None) -> Motion:
        """Where only T rests; and those of C that bear nothing along a component, if it is given."""
        return Motion(self.network, motion.rests & ~(self.full if slot is None else self.full & (self.along == slot)))

    def unsure(self) -> dict[int, np.ndarray]:
        """By component, (n,): how far that is from what the file says, summed at each sphere."""
        own, network = np.flatnonzero(self.full), self.network
        found = {k: np.zeros(len(network.free)) for k in network.needed}
        for slot, k in enumerate(network.needed):
            missing = self.friction(slot).plus(-network.moment[k].high[own]).most
            missing[~network.feels[k][own]] = 0.0
            for end in network.graph.contact[:, own]:
                found[k] += np.bincount(end, missing, len(found[k]))
        return found


def _pulls(motion: Motion, contacts: Slipping, limit: Limit) -> Pulls:
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
    """(spheres,), numbers of domains: 0 and 1 for what turns with the bottom and the top, and larger ones."""
    label = motion.domain[k]
    low, high = slices(motion.network.graph).leader(k)
    return np.where(label == label[low], 0, np.where(label == label[high], 1, label + 2))


def _held(pulls: Pulls, label: np.ndarray, between: Between) -> np.ndarray | None:
    """(2, spheres) mask of the domains or parts that are held: one of each cluster, and those between two sets. None if
    a cluster has none but these."""
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
    """The labels (n,), component by component, 0 for what is held."""
    return {k: np.where(h, 0, own) for k, own, h in zip(motion.network.needed, label, held, strict=True)}


def _balanced(
    motion: Motion,
    pulls: Pulls,
    between: Between,
    held: np.ndarray,
    limit: Limit,
) -> tuple[Slipping, np.ndarray] | None:
    """Steps 1 to 3 of the module docstring: contacts of S near the minimum u*, and the share (n,) by which each slip
    differs there at most; None if it is not known to be one."""
    rests, unsure = limit.others(motion, None), limit.unsure()
    near = nearest_minimum(Slipping.of(motion, _still_labels(motion, pulls.domain, held)))
    if near is None:
        return None
    found, turn = near
    known = pulls.felt & ~pulls.turns & pulls.slips
    signs = np.array([np.sign(part.high) for part in found.difference])
    same = (signs == pulls.sign[:, : len(turn)]) | ~known[:, : len(turn)]
    known_well = same.all() and _cancel(pulls) and between.lie_between(found, turn)
    return near if known_well and bearable(rests, found, turn, unsure) else None


def _cancel(pulls: Pulls) -> bool:
    """True if the pulls that are known exactly cancel: on each cluster of domains, and on each part but one at most of
    each free domain, on which others act."""
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


def _named(
    pulls: Pulls, between: Between, contacts: Slipping, turn: np.ndarray, moves: bool, count: int
) -> tuple[np.ndarray, bool | None]:
    """Step 4."""
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
    """Along either component."""
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
