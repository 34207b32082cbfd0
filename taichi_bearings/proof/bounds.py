"""Rigorous bounds on the least dissipation of any network, from its spins and its friction: theorem 1.

For any friction F, of which s F with s <= 1 stays inside the discs of contacts without viscosity, and torques r on free
spheres that it leaves over,

    least potential >= s (work of the driven spheres + sum r . u*) - sum max(s |F| - mu F_n, 0)^2 / (2 eta)

at any spins u* at which the potential is least. Where components do not mix (discs; normals along the axes) clipping
every component to the largest size imposed lengthens no slip, and on lattices to what is between the planes, layer by
layer: so some u* lies within, and the least that r can do there counts. On other networks springs take r away
(springs.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.proof.enclosure import UP, Enclosure, in_cache, row_sum
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.springs import Springs, natural, rolling

FASTEST_COMPARED = 1e6  # times the fastest imposed surface, up to which spins are compared
PAID = 1e-10  # of the potential, that a proof for all spins may cost
LEAST_POWER = 1e-3  # of the natural power, for which the springs are made at least
DOUBLE_ERROR = 1e-12  # more than doubles are off
PROVEN, WITHIN = "proven", f"proven of all spins up to {FASTEST_COMPARED:.0e} times the fastest imposed"


@dataclass(frozen=True)
class Bounds:
    """upper, lower : (R,), of the least potential, in units of power; of the spins, and of the friction. proof :
    PROVEN, or what `lower` is restricted to. excess : (R,), of the spins over what the friction proves. friction : F in
    balance, where components mix. worst : (R,), 1 / s. size : (m,), s |F|. largest_torque, price : (R,), of the
    friction as it is stored; what its torques may cost at spins within the box."""

    network: JudgedNetwork
    upper: np.ndarray
    lower: np.ndarray
    excess: np.ndarray
    size: Enclosure
    worst: np.ndarray
    proof: str
    largest_torque: np.ndarray
    price: np.ndarray
    springs: Springs | None
    friction: list[Enclosure]

    @classmethod
    def of(cls, network: JudgedNetwork) -> Bounds:
        potential, layered = network.dissipated(0.5), network.graph.layered
        upper = potential.upper()
        if layered:
            upper = np.where(network.motion.torn, np.inf, upper)
        if network.mixes and upper > 0:
            network = replace(network, rolling=rolling(network))
        count, friction, springs, proof = network.count, network.own_friction, None, PROVEN
        torques = network.own_torques
        left = np.array([_largest(network, torque) for torque in torques])
        paid = price = _price(network, torques)
        if network.mixes and upper > 0:
            springs = Springs.of(network, max(float(upper[0]), LEAST_POWER * float(natural(network)[0])))
            fastest, reach = FASTEST_COMPARED * float(network.box.max(initial=0.0)), np.inf
            if springs is not None:
                friction, torques = springs.balanced()
                reach = springs.reach
            rest = float(np.sum([part.most[network.reached].sum() for part in torques])) * UP
            proof = PROVEN if reach <= fastest or reach * rest <= PAID * upper[0] else WITHIN
            paid = Enclosure.exact(np.array([rest * (reach if proof == PROVEN else fastest)]))
        work = -paid
        for torque, imposed in zip(torques, network.imposed, strict=True):
            held = np.flatnonzero(imposed.high)
            if len(held):
                work = work + row_sum((torque.at(held) * imposed.at(held)).reshaped((count, -1)))
        size = network.graph.lengths(friction)
        hard, soft = (
            np.flatnonzero(network.counts & some) for some in (network.slope.high == 0, network.slope.high > 0)
        )
        worst = _worst(network, size, hard)
        if (worst > 1).any():
            size = size / Enclosure.exact(network.on_contacts(worst))
        beyond = size.at(soft)
        if network.law.holds:  # no less than what is beyond the friction
            beyond = Enclosure.exact(np.maximum((beyond - network.holding.at(soft)).upper(), 0.0))
        cost = network.by_sample((beyond * beyond / network.slope.at(soft)).signed(0.5), soft)
        least = work / Enclosure.exact(worst) - cost
        lower = least.lower()
        apart = (potential - least).upper() if not layered else (upper - lower) * UP
        return cls(network, upper, lower, np.maximum(apart, 0.0), size, worst, proof, left.max(axis=0), price.upper(),
                   springs, friction if network.mixes else [])  # fmt: skip


def _largest(network: JudgedNetwork, torque: Enclosure) -> np.ndarray:
    """(R,), of the torques on free spheres that are reached."""
    if not torque.high.any():
        return np.zeros(network.count)
    return np.where(network.reached, torque.most, 0.0).reshape(network.count, -1).max(axis=1, initial=0.0)


def _price(network: JudgedNetwork, torques: list[Enclosure]) -> Enclosure:
    """(R,), what torques on free spheres may take from the work at spins within what is imposed."""
    total, taken_of = Enclosure.exact(np.zeros(network.count)), _taken_between if network.graph.layered else _taken
    for torque, reach, size in zip(torques, network.reach, network.box, strict=True):
        if size and (torque.high.any() or torque.error.any()):
            taken = taken_of(torque, reach, network.reached)
            total = total + row_sum(taken[np.flatnonzero(network.free)].reshaped((network.count, -1)))
    return total


@in_cache
def _taken(torque: Enclosure, reach: Enclosure, some: np.ndarray) -> Enclosure:
    """Of some spheres, what a torque may take at spins between reach and its negative; 0 of others."""
    return Enclosure.exact(np.where(some, torque.most, 0.0)) * abs(reach)


@in_cache
def _taken_between(torque: Enclosure, reach: Enclosure, some: np.ndarray) -> Enclosure:
    """At spins between 0 and reach: none if they have the sign of the torque for sure."""
    gives = np.sign(reach.high) * torque.high >= torque.error + np.abs(torque.low)
    return _taken(torque, reach, some & ~gives)


def _worst(network: JudgedNetwork, size: Enclosure, hard: np.ndarray) -> np.ndarray:
    """(R,), largest size / holding of some contacts, 1 at least, rounded up: of those that are about as large."""
    found, about = np.ones(network.count), np.zeros(len(network.acts))
    about[hard] = size.high[hard] / network.holding.high[hard]
    most = about.reshape(network.count, -1).max(axis=1, initial=1.0)
    large = hard[about[hard] >= network.on_contacts(most * (1 - DOUBLE_ERROR))[hard]]
    np.maximum.at(found, network.sample_of(large), (size.at(large) / network.holding.at(large)).most)
    return found
