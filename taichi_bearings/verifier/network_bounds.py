"""Rigorous bounds on the least dissipation of any network, from its spins and its friction.

For any friction F, of which s F with s <= 1 stays inside the discs of contacts without viscosity, and torques r on free
spheres that it leaves over,

    least potential >= s (work of the driven spheres + sum r . u*) - sum max(s |F| - mu F_n, 0)^2 / (2 eta)

at any spins u* at which the potential is least. Where components do not mix (discs; normals along the axes) clipping
every component to the largest size imposed lengthens no slip, so some u* lies within, and r costs |r| times that.

On other networks no box of imposed spins holds. There springs q take the torques away, F - q (K z) with K^T q K z = r,
until some 1e-30 of them are left: these are paid for at the largest spins that some u* can have. With Phi the potential
of any spins, each contact has q |y*|^2 <= phi(y*) / Phi for q = w w_min / Phi^2 with w = mu F_n, or eta / (2 Phi). So
the norm of q^1/2 y* is at most 1, and

    |D^-1 u*| <= (1 + |q^1/2 b|) / sigma,    sigma^2 <= least eigenvalue of D K^T q K D,

a floor that an elimination proves. Spheres whose contacts all have one direction can turn about it without any slip:
the largest component of that is held at 0. Spheres whose contacts bear nothing, and whose spins make any slips of these
contacts whatever (their rows of K are independent, by a floor of K K^T), let them roll at every minimum and are left
out, with all that is loose among them. If other motions slip by no more than rounding no floor is found, and the bound
is one on spins up to `FASTEST_COMPARED` times the fastest imposed one alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.verifier.curvature import proven_floor
from taichi_bearings.verifier.elimination import EPS, Elimination
from taichi_bearings.verifier.enclosure import UP, Enclosure, row_sum
from taichi_bearings.verifier.motion import length
from taichi_bearings.verifier.network import Network

FASTEST_COMPARED = 1e6  # times the fastest imposed surface, up to which spins are compared
ROUNDS, SHIFT = 2, -1e-13  # of the springs, and what keeps slipless motions from being divided by 0
NO_POWER = 1e-10  # of the natural power, below which a relative gap says nothing
PAID = 1e-10  # of the potential, that a proof for all spins may cost
UNSTRESSED = 1e-6  # of its friction, or of the largest force, below which a contact may bear nothing
LEAST_POWER = 1e-3  # of the natural power, for which the springs are made at least
PROVEN, WITHIN = "proven", f"proven of all spins up to {FASTEST_COMPARED:.0e} times the fastest imposed"


@dataclass(frozen=True)
class Bounds:
    """upper, lower : of the least potential, in units of power; of the spins, and of the friction. proof :
    PROVEN, or what `lower` is restricted to. friction : F, balanced where components mix. worst : 1 / s. size : s |F|.
    largest_torque, price : of the friction as it is stored; what its torques may cost at spins within the box."""

    network: Network
    upper: float
    lower: float
    size: Enclosure
    worst: float
    proof: str
    largest_torque: float
    price: float
    springs: Springs | None
    friction: list[Enclosure]

    @classmethod
    def of(cls, network: Network) -> Bounds:
        upper = float(network.dissipated(0.5).upper()[0])
        if network.mixes and upper > 0:
            network = replace(network, rolling=_rolling(network))
        stored = network.own_friction
        torques, free = network.torques(stored), network.reached
        left = np.array([part.most[free] for part in torques])
        price = float((left.sum(axis=1) * network.box).sum() * UP)
        proof, paid, friction, springs = PROVEN, price, stored, None
        if network.mixes and upper > 0:
            springs = Springs.of(network, max(upper, LEAST_POWER * natural(network)))
            fastest, reach = FASTEST_COMPARED * float(network.box.max(initial=0.0)), np.inf
            if springs is not None:
                friction, torques = springs.balanced(stored)
                reach = springs.reach
            rest = float(np.sum([part.most[network.reached].sum() for part in torques])) * UP
            proof = PROVEN if reach <= fastest or reach * rest <= PAID * upper else WITHIN
            paid = rest * (reach if proof == PROVEN else fastest)
        held = ~network.free
        works = [row_sum((t[held] * u[held]).reshaped((1, -1))) for t, u in zip(torques, network.spin, strict=True)]
        work = sum(works[1:], works[0]).plus(np.array([-paid]))
        size, worst = length(friction), 1.0
        hard = np.flatnonzero(network.counts & (network.slope.high == 0))
        worst = float((size.at(hard) / network.holding.at(hard)).most.max(initial=1.0))
        if worst > 1:
            size = size / Enclosure.exact(np.full(len(size.high), worst))
        soft = np.flatnonzero(network.counts & (network.slope.high > 0))
        beyond = Enclosure.exact(np.maximum((size.at(soft) - network.holding.at(soft)).upper(), 0.0))
        cost = row_sum((beyond * beyond / network.slope.at(soft)).signed(0.5).reshaped((1, -1)))
        lower = float((work / Enclosure.exact(np.array([worst])) - cost).lower()[0])
        return cls(network, upper, lower, size, worst, proof, float(left.max(initial=0.0)), price, springs, friction)

    @property
    def excess(self) -> float:
        """Of the spins over what the friction proves, rounded up; in units of power."""
        return max((self.upper - self.lower) * UP, 0.0)

    def _reported(self, value: float, towards: float) -> float:
        """In units of energy/time; exactly, or rounded that way where it is tiny."""
        found = value * self.network.power_unit * self.network.share
        return float(np.nextafter(found, towards)) if 0 < abs(found) < np.finfo(float).tiny * 2**60 else found

    @property
    def lower_bound(self) -> float:
        """Not above the least objective."""
        return max(self._reported(min(self.lower, self.upper), -np.inf), 0.0)

    @property
    def upper_bound(self) -> float:
        return self._reported(self.upper, np.inf)

    @cached_property
    def power(self) -> float:
        """What the spins dissipate, to the nearest double."""
        return float(self.network.dissipated(1.0).value[0] * self.network.power_unit)

    @cached_property
    def objective(self) -> float:
        """What is least at rest: the power, or with friction and viscosity the potential; to the nearest double."""
        return float(self.network.dissipated(0.5).value[0] * self.network.power_unit * self.network.share)

    @property
    def natural(self) -> float:
        """The natural objective."""
        return self._reported(natural(self.network), np.inf)

    @property
    def gap(self) -> float:
        """(upper - lower) / upper, or over the natural objective where next to nothing is dissipated."""
        unit = self.upper_bound if self.upper_bound > NO_POWER * self.natural else self.natural
        return (self.upper_bound - self.lower_bound) / unit if unit > 0 else 0.0


def natural(network: Network) -> float:
    """Potential of all contacts that act if they slipped as fast as the fastest imposed component."""
    fastest = float(network.box.max(initial=0.0))
    holding, slope = (values.value[network.acts].sum() for values in (network.holding, network.slope))
    return float(holding * fastest + slope * fastest**2 / 2)


@dataclass(frozen=True)
class Springs:
    """rows : q^1/2 K D, (3 E, n). weight : q, (E,). scale : D, (n,). number : (N, 3) of each unknown, or -1.

    elimination : of D K^T q K D.
    """

    network: Network
    rows: sparse.csr_array
    weight: np.ndarray
    scale: np.ndarray
    number: np.ndarray
    elimination: Elimination

    @classmethod
    def of(cls, network: Network, potential: float) -> Springs | None:
        """None where some unknown slips nowhere."""
        holding, slope = (np.where(network.counts, v.value, 0.0) for v in (network.holding, network.slope))
        least = holding[holding > 0].min(initial=np.inf)
        with np.errstate(all="ignore"):
            weight = np.maximum(
                holding * (least / potential) / potential if least < np.inf else 0.0, slope / potential / 2
            )
        number = np.full((len(network.free), 3), -1)
        there = network.reached[:, None] & ~_turning_freely(network)
        number[there] = np.arange(there.sum())
        return cls.made(network, slip_rows(network, number), weight, number)

    @classmethod
    def made(cls, network: Network, rows: sparse.csr_array, weight: np.ndarray, number: np.ndarray) -> Springs | None:
        rows = sparse.csr_array(sparse.diags_array(np.sqrt(np.tile(weight, 3))) @ rows)
        rows.eliminate_zeros()
        squares = np.bincount(rows.indices, rows.data**2, rows.shape[1])
        if not ((squares > 0) & (squares < np.inf)).all():
            return None
        scale = 1 / np.sqrt(squares)
        rows = sparse.csr_array(rows @ sparse.diags_array(scale))
        place = network.place[np.nonzero(number >= 0)[0]].T
        return cls(network, rows, weight, scale, number, Elimination.of((rows.T @ rows).tocsc(), place))

    def balanced(self, friction: list[Enclosure]) -> tuple[list[Enclosure], list[Enclosure]]:
        """The friction less what springs take from it, and torques that are left."""
        network, factor = self.network, self.elimination.factorised(SHIFT)
        torques, there = network.torques(friction), self.number >= 0
        if factor is None:
            return friction, torques
        taken, fine = np.zeros_like(network.friction), friction
        for _ in range(ROUNDS):
            left = np.stack([part.value for part in torques], axis=1)[there]
            root = np.sqrt(np.tile(self.weight, 3))
            taken += (root * (self.rows @ factor.solve(left * self.scale))).reshape(3, -1).T
            fine = [Enclosure.exact(f.high, -x) for f, x in zip(friction, taken.T, strict=True)]
            torques = network.torques(fine)
        return fine, torques

    @cached_property
    def floor(self) -> float | None:
        """Of the eigenvalues of D K^T q K D, proven."""
        doubt = sparse.csr_array(
            (16 * EPS * np.abs(self.rows.data), self.rows.indices, self.rows.indptr), shape=self.rows.shape
        )
        with np.errstate(all="ignore"):
            return proven_floor(self.rows, doubt, self.elimination)

    @property
    def reach(self) -> float:
        """No component of a free spin of some minimum is larger."""
        if self.floor is None:
            return np.inf
        known = [replace_free(part, self.network.free) for part in self.network.spin]
        start = np.sqrt(sum((self.weight * part.most**2).sum() for part in self.network.slips(known)))
        return float(self.scale.max(initial=0.0) * (1 + start) / np.sqrt(self.floor) * UP**2)


def _rolling(network: Network) -> np.ndarray:
    """(N,) mask of free spheres that let all their contacts roll, whatever the others do."""
    size = np.sqrt((network.friction**2).sum(axis=1))
    small = UNSTRESSED * np.where(network.holding.high > 0, network.holding.high, size.max(initial=0.0))
    ends = network.contact[network.counts & (size > small)]
    some = network.reached.copy()
    some[ends.ravel()] = False
    first, second = network.contact[network.counts].T
    inner = some[first] & some[second]
    graph = sparse.csr_array((np.ones(inner.sum()), (first[inner], second[inner])), shape=(len(some),) * 2)
    label = connected_components(graph, directed=False)[1]
    if _independent(network, some):
        return some
    for part in np.unique(label[some]):
        own = some & (label == part)
        if not _independent(network, own):
            some &= ~own
    return some


def _independent(network: Network, some: np.ndarray) -> bool:
    """True if the spins of some spheres (N,) can make any slips whatever of all their contacts that count."""
    number = np.full((len(some), 3), -1)
    number[some] = np.arange(3 * some.sum()).reshape(-1, 3)
    touched = np.flatnonzero(network.counts & some[network.contact].any(axis=1))
    # of the three components of a slip across n two are enough
    kept = np.ones((3, len(network.contact)), dtype=bool)
    kept[np.argmax(np.abs(network.normal), axis=1), np.arange(len(network.contact))] = False
    own = np.concatenate([k * len(network.contact) + touched[kept[k, touched]] for k in range(3)])
    columns = sparse.csr_array(slip_rows(network, number)[own].T)
    if columns.shape[1] > columns.shape[0]:
        return False
    if not columns.shape[1]:
        return True
    columns.eliminate_zeros()
    place = network.place[network.contact[own % len(network.contact), 0]].T
    doubt = sparse.csr_array((EPS * np.abs(columns.data), columns.indices, columns.indptr), shape=columns.shape)
    with np.errstate(all="ignore"):
        return proven_floor(columns, doubt, Elimination.of((columns.T @ columns).tocsc(), place)) is not None


def replace_free(part: Enclosure, free: np.ndarray) -> Enclosure:
    """With 0 for free spheres."""
    return Enclosure(*(np.where(free, 0.0, values) for values in part.parts))


def slip_rows(network: Network, number: np.ndarray) -> sparse.csr_array:
    """K (3 E, n), exactly: component by component of (u_i + u_j) x n."""
    count, turned = len(network.contact), [(1, 2), (2, 0), (0, 1)]
    rows, columns, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    for end in network.contact.T:
        for k, (a, b) in enumerate(turned):
            for own, value in ((number[end, a], network.normal[:, b]), (number[end, b], -network.normal[:, a])):
                there = (own >= 0) & network.counts
                rows.append(k * count + np.flatnonzero(there))
                columns.append(own[there])
                values.append(value[there])
    at = np.concatenate(rows), np.concatenate(columns)
    return sparse.csr_array((np.concatenate(values), at), shape=(3 * count, int(number.max(initial=-1)) + 1))


def _turning_freely(network: Network) -> np.ndarray:
    """(N, 3) mask of the largest component of the one direction that all contacts of a sphere have, bit by bit."""
    normal = network.normal[network.counts]
    large = np.argmax(np.abs(normal), axis=1)
    turned = normal * np.sign(normal[np.arange(len(normal)), large])[:, None]
    low, high = np.full((len(network.free), 3), np.inf), np.full((len(network.free), 3), -np.inf)
    for end in network.contact[network.counts].T:
        np.minimum.at(low, end, turned)
        np.maximum.at(high, end, turned)
    found = np.zeros(low.shape, dtype=bool)
    alike = np.flatnonzero((low == high).all(axis=1))
    found[alike, np.argmax(np.abs(low[alike]), axis=1)] = True
    return found
