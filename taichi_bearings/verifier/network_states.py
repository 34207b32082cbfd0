"""Which contacts of a network slip at every minimum, and how fast at most: proven from its spins and its friction.

At any minimum all contacts together have sum phi(y) + phi*(F) - F . y <= E, the excess of the potential of the given
spins over what the friction proves. So

* a slip of no minimum exceeds what `bounds.slip_bound` says; with damping eta none is further than (2 E / eta)^1/2
  from the given one;
* where one component slips alone (discs; one of three along the axes) minima are mixtures of lightest cuts, one for
  each step t of the imposed values, and no cut crosses a contact with more room than E / t. The network is that of the
  differences of signed spins; on its double cover, each sphere with either sign, where loops are odd;
* where normals lie along the axes and loops are even, contacts with signed spins are those of a lattice: the nearest
  minimum of what slips (curvature.py), and friction of the others inside all discs in balance (states.py, 1 to 3);
* on others a slip y* that is b across its friction has mu F_n b^2 / (2 |y*|) <= mu F_n |y*| - F . y*, and one with the
  room m has m |y*|: a quadratic form of y* that is at most E, and of the given slips as well. Its floor, by an
  elimination, says how far minima are. Motions that change no slip play no part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.verifier.bounds import slip_bound
from taichi_bearings.verifier.curvature import Slipping, nearest_minimum
from taichi_bearings.verifier.elimination import EPS
from taichi_bearings.verifier.enclosure import UP, Enclosure, joined
from taichi_bearings.verifier.motion import length
from taichi_bearings.verifier.network import Network
from taichi_bearings.verifier.network_bounds import PROVEN, Bounds, Springs, slip_rows
from taichi_bearings.verifier.samples import SLIPLESS, SLIPPING, UNPROVEN
from taichi_bearings.verifier.states import States, reached

MOST_LEVELS = 100  # steps of imposed values that are looked at, the largest
STILL = 1e-12  # of the fastest imposed component, below which slips may be none
AT_REST = 1e-9  # of the fastest imposed component, up to which a slip may well be none
CLEAR_ROOM = 1e-3  # of its friction, from which a contact may well rest
STIFFEST = 1e4  # stiffness of what rests, over that of what slips
PASSES = 2


@np.errstate(all="ignore")  # what is not finite proves nothing
def network_states(bounds: Bounds) -> States:
    network = bounds.network
    states = np.full(len(network.contact), UNPROVEN)
    bound = np.where(network.acts, _most(bounds), np.inf)
    rests = network.acts & ~network.counts | (network.acts & (bounds.upper == 0))
    open_ = network.counts & ~rests
    if bounds.proof != PROVEN:
        reason = "the bound is proven of some spins alone"
    else:
        bound[open_] = np.fmin(bound, _by_room(bounds))[open_]
        states, reason = _by_law(bounds, states, bound)
    states, bound = np.where(rests, SLIPLESS, states), np.where(rests, 0.0, bound)
    bound = np.where(np.isnan(bound), np.inf, bound) * UP
    bound[states == SLIPLESS] = 0.0
    unknown = open_ & (states == UNPROVEN)
    slow = int((bound[unknown] <= AT_REST * network.box.max(initial=0.0)).sum())
    reason += f"; {slow:,} of these slip by no more than {AT_REST:.0e} of the fastest imposed" if slow else ""
    return States(np.where(network.acts, states, UNPROVEN), None, reason if unknown.any() else "", bound)


def _most(bounds: Bounds) -> np.ndarray:
    """(E,), by all that there is to dissipate."""
    network = bounds.network
    return np.fmin(bounds.upper / network.holding.least, np.sqrt(2 * bounds.upper / network.slope.least)) * UP


def _by_room(bounds: Bounds) -> np.ndarray:
    """(E,), by the room that friction leaves."""
    room = (bounds.network.holding - bounds.size).lower()
    return slip_bound(room, bounds.network.slope.least, np.array(bounds.excess)) * UP


def _by_law(bounds: Bounds, states: np.ndarray, bound: np.ndarray) -> tuple[np.ndarray, str]:
    """States, and why some are not proven; bounds (E,) of slips are improved in place."""
    network = bounds.network
    if network.flows:
        far = np.sqrt(2 * bounds.excess / network.slope.least) * UP
        return _apart(network, states, bound, far), "slips are small, or nothing is known of what bears no viscosity"
    if not network.mixes:
        needed = [k for k in range(len(network.spin)) if _is_needed(network, k)]
        if not needed:
            bound[network.counts] = 0.0
            return np.where(network.counts, SLIPLESS, states), ""
        if len(needed) == 1:
            return _by_cuts(bounds, needed[0], bound), "cuts (nearly) tie"
        return _by_curvature(bounds, needed, states, bound)
    return _apart(network, states, bound, _by_cones(bounds)), "minima are not known closely enough"


def _apart(network: Network, states: np.ndarray, bound: np.ndarray, far: np.ndarray) -> np.ndarray:
    """far : (E,), that slips of minima differ by at most from the given ones."""
    bound[:] = np.fmin(bound, network.slip.most + far)
    return np.where(network.counts & (network.slip.least > far), SLIPPING, states)


def _feel(network: Network, k: int) -> np.ndarray:
    """(E,) mask of the contacts that count, and slip with component k."""
    return network.counts & (network.normal[:, k] == 0 if len(network.spin) == 3 else True)


def _signs(network: Network, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts that contacts join in component k: label (N,), mask of those with odd loops, and signs s by which
    neighbours differ in the others."""
    count, (first, second) = len(network.free), network.contact[_feel(network, k)].T
    ends = np.append(first, second), np.append(second, first) + count
    cover = sparse.csr_array((np.ones(len(ends[0])), ends), shape=(2 * count,) * 2)
    copy = connected_components(cover, directed=False)[1].reshape(2, -1)
    return copy.min(axis=0), copy[0] == copy[1], np.where(copy[0] > copy[1], -1.0, 1.0)


def _is_needed(network: Network, k: int) -> bool:
    """False if component k can be such that nothing slips along it: then that is so at every minimum."""
    label, odd, sign = _signs(network, k)
    own, held = network.spin[k].signed(sign), ~network.free
    values = np.stack([label, own.high, own.low])[:, held]
    several = len(np.unique(values, axis=1).T) > len(np.unique(label[held]))
    return bool(several or (odd[held] & (own.high[held] != 0)).any())


def _by_cuts(bounds: Bounds, k: int, bound: np.ndarray) -> np.ndarray:
    """One component: what is on one side of the lightest cuts of all steps, or on two of those of one."""
    network, count = bounds.network, len(bounds.network.free)
    contacts = np.flatnonzero(_feel(network, k))
    first, second = network.contact[contacts].T
    pull = network.moments(network.own_friction)[k].at(contacts) / Enclosure.exact(np.full(len(contacts), bounds.worst))
    strength = network.holding.at(contacts)
    if len(network.spin) == 3:
        strength = strength.times(np.abs(network.normal[contacts]).max(axis=1))
    up, down = (strength - pull).lower(), (strength + pull).lower()
    held = np.unique(network.contact[contacts][~network.free[network.contact[contacts]]])
    own = network.spin[k].at(held)
    node, value = np.append(held, held + count), joined([own, -own])
    order = np.lexsort((value.low, value.high))
    node, value = node[order], value[order]
    step = value[1:] - value[:-1]
    steps = np.flatnonzero((value.high[1:] != value.high[:-1]) | (value.low[1:] != value.low[:-1]))
    small = np.setdiff1d(steps, steps[np.argsort(-step.high[steps], kind="stable")[:MOST_LEVELS]])
    slips, open_ = np.zeros(len(contacts), dtype=bool), np.full(len(contacts), step.most[small].sum())
    low, high = np.append(second + count, first + count), np.append(first, second)  # u_i + u_j is high less low
    for number in np.setdiff1d(steps, small):
        # with more room than all have together: if the one is above the cut, so is the other
        room = 2 * bounds.excess / step.lower()[number] * UP if step.lower()[number] > 0 else np.inf
        rises, falls = np.tile(up > room, 2), np.tile(down > room, 2)
        tail, head = np.append(high[rises], low[falls]), np.append(low[rises], high[falls])
        follows = sparse.csr_array((np.ones(len(tail), dtype=np.int8), (tail, head)), shape=(2 * count,) * 2)
        together = connected_components(follows, directed=True, connection="strong")[1]
        above, below = reached(follows, node[number + 1 :]), reached(follows.T.tocsr(), node[: number + 1])
        a, b = low[: len(contacts)], high[: len(contacts)]
        alike = (together[a] == together[b]) | (above[a] & above[b]) | (below[a] & below[b])
        slips |= (above[a] & below[b]) | (below[a] & above[b])
        open_ += np.where(alike, 0.0, step.most[number])
    states, whole = np.full(len(network.contact), UNPROVEN), np.zeros(len(network.contact))
    states[contacts], whole[contacts] = np.where(slips, SLIPPING, np.where(open_ == 0, SLIPLESS, UNPROVEN)), open_ * UP
    states[network.counts & ~_feel(network, k)] = SLIPLESS
    bound[network.counts] = np.fmin(bound, whole)[network.counts]
    return states


@dataclass(frozen=True)
class Domains:
    """Of one component: domain (N,) that contacts without slip join, sign (N,), value : signed spins (N,), the same in
    each domain; number (N,) of its unknown, -1 where none."""

    domain: np.ndarray
    sign: np.ndarray
    value: Enclosure
    number: np.ndarray


def _by_curvature(bounds: Bounds, needed: list[int], states: np.ndarray, bound: np.ndarray) -> tuple[np.ndarray, str]:
    """Normals along the axes, several components."""
    network = bounds.network
    rests = network.counts & (network.slip.value <= STILL * network.box.max())
    signs = {k: _signs(network, k) for k in needed}
    ends = network.contact[network.counts].ravel()
    if any(odd[ends].any() for _, odd, _ in signs.values()):
        return states, "loops are odd"
    first, second = network.contact.T
    domain = {k: _joined(network, k, rests) for k in needed}
    rests = network.counts & np.all([(d[first] == d[second]) | ~_feel(network, k) for k, d in domain.items()], axis=0)
    moving, unknowns, of = np.flatnonzero(network.counts & ~rests), 0, {}
    for k in needed:
        found = _domains(network, k, domain[k], signs[k][2], moving, unknowns)
        if found is None:
            return states, "contacts without slip join driven spheres that turn otherwise"
        of[k], unknowns = found, max(unknowns, int(found.number.max(initial=-1)) + 1)
    slipping = _slipping(network, of, moving, unknowns)
    if not (slipping.size.least > 0).all():
        return states, "slips are lost in the rounding of the spins"
    near = nearest_minimum(slipping)
    if near is not None and not _bearable(network, of, moving, rests, *near):
        near = nearest_minimum(near[0].improved())
        if near is not None and not _bearable(network, of, moving, rests, *near):
            return states, "slipless contacts are not known to bear what the others leave to them"
    if near is None:
        return states, "the power is not known to rise in all directions"
    size = near[0].size.most * (1 + near[1]) * np.abs(network.normal[moving]).max(axis=1)
    bound[rests], bound[moving] = 0.0, np.fmin(bound[moving], size * UP)
    states = np.where(rests, SLIPLESS, states)
    states[moving] = SLIPPING
    return states, ""


def _joined(network: Network, k: int, rests: np.ndarray) -> np.ndarray:
    first, second = network.contact[rests & _feel(network, k)].T
    graph = sparse.csr_array((np.ones(len(first)), (first, second)), shape=(len(network.free),) * 2)
    return connected_components(graph, directed=False)[1]


def _domains(
    network: Network, k: int, domain: np.ndarray, sign: np.ndarray, moving: np.ndarray, unknowns: int
) -> Domains | None:
    """None where driven spheres of a domain do not turn as one."""
    signed, held = network.spin[k].signed(sign), np.flatnonzero(~network.free)
    model = np.unique(domain, return_index=True)[1]
    model[domain[held]] = held
    value = signed.at(model[domain])
    if any((part[held] != own[held]).any() for part, own in zip(signed.parts[:2], value.parts[:2], strict=True)):
        return None
    ends = domain[network.contact[moving[_feel(network, k)[moving]]]]
    there = np.zeros(len(model), dtype=bool)
    there[ends[ends[:, 0] != ends[:, 1]].ravel()] = True
    there[domain[held]] = False
    number = np.where(there, unknowns + np.cumsum(there) - 1, -1)
    return Domains(domain, sign, value, number[domain])


def _felt(network: Network, contacts: np.ndarray) -> np.ndarray:
    """(2, n), the two components that each of these contacts feels."""
    axis = np.argmax(np.abs(network.normal[contacts]), axis=1)
    return np.stack([(axis + 1) % 3, (axis + 2) % 3])


def _slipping(network: Network, of: dict[int, Domains], moving: np.ndarray, unknowns: int) -> Slipping:
    """Contacts that slip, as those of a lattice; their two components are each one's own."""
    first, second = network.contact[moving].T
    felt = _felt(network, moving)
    lower, upper = np.full((2, len(moving)), -1), np.full((2, len(moving)), -1)
    difference = [Enclosure.exact(np.zeros(len(moving))) for _ in range(2)]
    for slot in range(2):
        for k, own in of.items():
            some = np.flatnonzero(felt[slot] == k)
            a, b = first[some], second[some]
            lower[slot, some], upper[slot, some] = own.number[a], own.number[b]
            apart = np.flatnonzero(own.domain[a] != own.domain[b])
            difference[slot].put(some[apart], own.value.at(b[apart]) - own.value.at(a[apart]))
    both = np.isin(felt, list(of)).all(axis=0)
    strength = network.holding.at(moving).times(np.abs(network.normal[moving]).max(axis=1))
    place = (network.place[first] + network.place[second]).T / 2
    return Slipping(unknowns, lower, upper, np.flatnonzero(both), (difference[0], difference[1]), strength,
                    np.stack([first, second]), place)  # fmt: skip


def _bearable(
    network: Network, of: dict[int, Domains], moving: np.ndarray, rests: np.ndarray, near: Slipping, turn: np.ndarray
) -> bool:
    """True if friction of the contacts that rest can be put in balance inside all discs: balance.py."""
    moments, torques = (made(network.own_friction) for made in (network.moments, network.torques))
    felt, ends, left = _felt(network, moving), network.contact.T, {}
    unsure = np.zeros((2, len(moving)))
    for slot in range(2):
        said = Enclosure.exact(np.zeros(len(moving)))
        for k, own in of.items():
            some = np.flatnonzero(felt[slot] == k)
            said.put(some, moments[k].at(moving[some]).signed(own.sign[ends[1, moving[some]]]))
        unsure[slot] = (near.pulls[slot] - said).most
        unsure[slot, near.curved] += 2 * turn[near.curved] * near.strength.at(near.curved).most
    for k, own in of.items():
        residual = np.where(network.free, torques[k].most, 0.0)
        for slot in range(2):
            some = felt[slot] == k
            for end in ends[:, moving[some]]:
                np.add.at(residual, end, unsure[slot, some])
        residual[~network.free] = 0.0
        left[k] = np.bincount(own.domain, residual)[own.domain] * UP
    still = np.flatnonzero(rests)
    borne = length([m.at(still) for m in moments])
    room = network.holding.at(still).times(np.abs(network.normal[still]).max(axis=1)) - borne
    more = np.sqrt(sum(np.where(_feel(network, k)[still], left[k][ends[0, still]], 0.0) ** 2 for k in of))
    return bool(((room.high > 0) & (room.least > more * UP)).all())


def _by_cones(bounds: Bounds) -> np.ndarray:
    """(E,), how far slips of minima are from the given ones at most, of a Coulomb network whose components mix."""
    network, springs = bounds.network, bounds.springs
    if springs is None:
        return np.full(len(network.contact), np.inf)
    holding, slip = np.where(network.counts, network.holding.value, 0.0), network.slip.most
    room = np.maximum((network.holding - bounds.size).lower(), 0.0)
    moment = np.stack([part.value for part in network.moments(bounds.friction)], axis=1)
    across = moment / np.linalg.norm(moment, axis=1)[:, None]
    slides = network.counts & (room <= CLEAR_ROOM * holding) & np.isfinite(across).all(axis=1)
    count, own = len(holding), np.flatnonzero(slides)
    at = np.tile(own, 3), np.concatenate([k * count + own for k in range(3)])
    kept = np.flatnonzero(np.tile(network.counts & ~slides, 3))
    pick = sparse.csr_array((np.append(across[own].T.ravel(), np.ones(len(kept))),
                             (np.append(at[0], kept), np.append(at[1], kept))), shape=(3 * count,) * 2)  # fmt: skip
    rows = sparse.csr_array(pick @ slip_rows(network, springs.number))
    far, most = np.full(count, np.inf), bounds.upper / holding * UP
    for _ in range(PASSES):
        fastest = np.maximum(np.fmin(most, slip + far), slip)
        weight = np.where(network.counts, holding / (2 * fastest), 0.0)
        stiff = np.minimum(room**2 / bounds.excess, STIFFEST * weight)
        weight = np.where(slides, weight, np.where(network.counts, stiff, 0.0))
        form = Springs.made(network, rows, weight, springs.number)
        if form is None or form.floor is None:
            break
        rounded = 16 * EPS * np.sqrt((weight * fastest**2)[slides].sum())
        radius = 2 * (np.sqrt(bounds.excess) + rounded) / np.sqrt(form.floor) * UP**2
        scale = np.zeros(springs.number.shape)
        scale[springs.number >= 0] = form.scale
        largest = scale.max(axis=1)[network.contact].max(axis=1)
        far = np.fmin(far, np.sqrt(2) * largest * radius * np.linalg.norm(network.normal, axis=1) * UP**2)
    return far
