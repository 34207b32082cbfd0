"""Rigorous bounds on the least dissipation of any network, from its spins and its friction.

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
from functools import cached_property

import numpy as np

from taichi_bearings.verifier.enclosure import UP, Enclosure, length, row_sum
from taichi_bearings.verifier.network import Network
from taichi_bearings.verifier.springs import Springs, natural, rolling

FASTEST_COMPARED = 1e6  # times the fastest imposed surface, up to which spins are compared
PAID = 1e-10  # of the potential, that a proof for all spins may cost
LEAST_POWER = 1e-3  # of the natural power, for which the springs are made at least
DOUBLE_ERROR = 1e-12  # more than doubles are off
PROVEN, WITHIN = "proven", f"proven of all spins up to {FASTEST_COMPARED:.0e} times the fastest imposed"


@dataclass(frozen=True)
class Bounds:
    """upper, lower : (R,), of the least potential, in units of power; of the spins, and of the friction. proof :
    PROVEN, or what `lower` is restricted to. friction : F in balance, where components mix. worst : (R,),
    1 / s. size : (m,), s |F|. largest_torque, price : (R,), of the friction as it is stored; what its torques may cost
    at spins within the box."""

    network: Network
    upper: np.ndarray
    lower: np.ndarray
    size: Enclosure
    worst: np.ndarray
    proof: str
    largest_torque: np.ndarray
    price: np.ndarray
    springs: Springs | None
    friction: list[Enclosure]

    @classmethod
    def of(cls, network: Network) -> Bounds:
        upper, own = network.dissipated(0.5).upper(), network.samples
        if own is not None:
            upper = np.where(network.motion.torn, np.inf, upper)
        if network.mixes and upper > 0:
            network = replace(network, rolling=rolling(network))
        count, friction, springs, proof = network.count, network.own_friction, None, PROVEN
        torques, free = network.own_torques, network.reached
        left = np.array([np.where(free, t.most, 0.0).reshape(count, -1).max(axis=1, initial=0.0) for t in torques])
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
        size = length(friction)
        hard, soft = (
            np.flatnonzero(network.counts & some) for some in (network.slope.high == 0, network.slope.high > 0)
        )
        worst = _worst(network, size, hard)
        if (worst > 1).any():
            size = size / Enclosure.exact(np.repeat(worst, len(size.high) // count))
        beyond = size.at(soft)
        if network.holds:  # no less than what is beyond the friction
            beyond = Enclosure.exact(np.maximum((beyond - network.holding.at(soft)).upper(), 0.0))
        cost = network.by_sample((beyond * beyond / network.slope.at(soft)).signed(0.5), soft)
        lower = (work / Enclosure.exact(worst) - cost).lower()
        return cls(network, upper, lower, size, worst, proof, left.max(axis=0), price.upper(), springs,
                   friction if network.mixes else [])  # fmt: skip

    @cached_property
    def excess(self) -> np.ndarray:
        """(R,), of the spins over what the friction proves, rounded up; in units of power."""
        return np.maximum((self.upper - self.lower) * UP, 0.0)


def _price(network: Network, torques: list[Enclosure]) -> Enclosure:
    """(R,), what torques on free spheres may take from the work at spins within what is imposed."""
    total = Enclosure.exact(np.zeros(network.count))
    for torque, reach, size in zip(torques, network.reach, network.box, strict=True):
        if not size:
            continue
        taken = np.where(network.reached, torque.most, 0.0)
        if network.samples is not None:  # none for a spin between 0 and what has the same sign for sure
            taken[np.sign(reach.high) * torque.high >= torque.error + np.abs(torque.low)] = 0.0
        own = np.flatnonzero(network.free)
        total = total + row_sum((Enclosure.exact(taken[own]) * abs(reach.at(own))).reshaped((network.count, -1)))
    return total


def _worst(network: Network, size: Enclosure, hard: np.ndarray) -> np.ndarray:
    """(R,), largest size / holding of some contacts, 1 at least, rounded up: of those that are about as large."""
    found, sample = np.ones(network.count), network.sample_of(hard)
    about = size.high[hard] / network.holding.high[hard]
    most = found.copy()
    np.maximum.at(most, sample, about)
    large = hard[about >= most[sample] * (1 - DOUBLE_ERROR)]
    np.maximum.at(found, network.sample_of(large), (size.at(large) / network.holding.at(large)).most)
    return found


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def slip_bound(room: np.ndarray, slope: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """No contact slips faster at any minimum; nearly rounded up, or no number. room : m = mu F_n - |F|, rounded down.

    Let E, the excess, be the potential of any spins less what the friction F proves. At a minimum no contact has
    phi(v) + phi*(F) - |F| v below 0, and all together have no more than E. With room in its disc a contact of Coulomb's
    has m v <= E, one with viscosity eta as well eta v^2 / 2 + m v <= E, and where F exceeds the disc
    eta (v + m / eta)^2 / 2 <= E.
    """
    inside = np.maximum(room, 0.0)
    root = np.sqrt(inside**2 + 2 * slope * excess)
    beyond = np.where(room < 0, -room / slope, 0.0)  # infinite without viscosity
    return np.where((excess > 0) | (slope == 0), 2 * excess / (inside + root), 0.0) + beyond
