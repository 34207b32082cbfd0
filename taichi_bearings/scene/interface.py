"""The lightest interface of two rigid domains, and how it is found in a packing, with the spins of its two sides.

Where the network has no odd loops and two driven bodies, each in a bearing state s u = A + c x of its own, a contact on
the interface slips with their jump across its normal. Where normals lie along the axes, components of spins that can be
the same everywhere are not needed, and the jump has none of them: of a cubic lattice that along its height.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.numerics.minimum_cut import graph_cut, number_bodies
from taichi_bearings.scene.bearing import Bearing

SAME_STATE = 1e-9  # of the largest R omega, by which spins may miss a bearing state
ACROSS = 1e-12  # of the jump, what rounding leaves of it across a normal along it
STATE_ROUNDING = 2.0**-48  # of R omega: a dozen roundings of 2^-53 each


def bearing_states(bearing: Bearing) -> tuple[np.ndarray, np.ndarray] | None:
    """Signs (N,) by which neighbours differ, and s u (2, N, C) of all spheres if they turned with the first or with the
    second of two driven bodies in bearing states; None where it has odd loops, or others, or where a state slips at a
    contact, as across a periodic side."""
    (odd, sign), bodies = bearing.network.sublattices, bearing.network.bodies
    if odd.any() or len(bodies) != 2:
        return None
    turned = sign[:, None] * bearing.driven_speed
    low, high = (_state(bearing.network.center, turned, bearing.network.body == body) for body in bodies)
    if low is None or high is None:
        return None
    for state in (low, high):
        contact = bearing.acting
        first, second = bearing.network.contact[:, contact]
        missed = bearing.network.across(state[second] - state[first], contact)
        if missed.max(initial=0.0) > SAME_STATE * np.abs(state).max(initial=0.0):
            return None
    return sign, np.stack([low, high])


def _state(center: np.ndarray, turned: np.ndarray, own: np.ndarray) -> np.ndarray | None:
    """A + c x, (N, C), of the bearing state that these spheres have, with c = 0 where that does; None if none."""
    value = turned[own][0]
    if (turned[own] == value).all():
        return np.broadcast_to(value, turned.shape)
    if turned.shape[1] == 1:
        return None
    rows = np.concatenate([np.tile(np.eye(3), (own.sum(), 1)), center[own].reshape(-1, 1)], axis=1)
    found = np.linalg.lstsq(rows, turned[own].ravel(), rcond=None)[0]
    missed = np.abs(rows @ found - turned[own].ravel()).max()
    return found[:3] + found[3] * center if missed <= SAME_STATE * np.abs(turned).max(initial=0.0) else None


@dataclass(frozen=True)
class Interface:
    """The lightest interface of two rigid domains of one sample: a minimum cut.

    If every sphere turned with the bottom or with the top, of a packing with the first or with the second body, all
    slip would be at the interface of the two domains, and the lightest one would dissipate least. In 2D with Coulomb
    friction that is the minimum itself; in 3D, and for the viscous law, states between the two dissipate less
    (equations.md, 5).

    power : energy/time, if the two domains are rigid. contacts : (E,) True for those that slip.
    above : N, True for the spheres that turn with the top or the second body.
    between : N, True for the spheres that another cut that is as light, or to rounding, may put on the other side; if
        there are none every other interface is proven to dissipate more.
    lower_bound : of a lattice: no two rigid domains dissipate less, or have less of what the stationary state minimises
        if that is not the power; proven.
    next_power : the same of the cheapest other interface that leaves either domain in one piece; NaN in 3D and of
        packings, where it is not known (see :func:`taichi_bearings.numerics.minimum_cut.next_cut`).
    spins : of a packing, u (N, C) of the two rigid domains.
    """

    power: float
    contacts: np.ndarray
    above: np.ndarray
    between: np.ndarray
    lower_bound: float = np.nan
    next_power: float = np.nan
    spins: Any = None

    @property
    def unique(self) -> bool:
        """Every other one is proven to be heavier."""
        return self.power > 0 and not self.between.any()

    @classmethod
    def of(cls, bearing: Bearing) -> "Interface | None":
        """Of the least power, or what else the stationary state minimises; None without two bearing states."""
        states = bearing_states(bearing)
        if states is None:
            return None
        sign, (low, high) = states
        known, needed = _needed_components(bearing)
        jump = ((high - low) * needed)[bearing.network.contact[0]]
        across = bearing.network.across(jump)
        across[across <= ACROSS * np.linalg.norm(jump, axis=1)] = 0.0
        material = tuple(values[0] for values in bearing.material)
        weight = bearing.law.objective(material, across)
        node, taken = number_bodies(bearing.network.body), np.zeros(bearing.network.contacts, dtype=bool)
        ends = node[bearing.network.contact]
        taken[bearing.acting] = True
        taken &= (ends[0] != ends[1]) & (weight > 0)
        ends, weight = ends[:, taken], weight[taken]
        if not weight.sum() > 0:
            return None
        size = int(node.max()) + 1
        edges = np.append(ends, [[0], [size - 1]], axis=1)  # one of no weight, so that both ends are there
        slack = _slack(bearing, np.flatnonzero(taken), across, states[1])
        found = graph_cut(edges, np.append(weight, 0.0), np.arange(size) > 0, STATE_ROUNDING, slack)
        above, between = found.above[node], found.between[node]
        cut = np.flatnonzero(taken)[found.above[ends[0]] != found.above[ends[1]]]
        contacts = np.zeros(bearing.network.contacts, dtype=bool)
        contacts[cut] = True
        power = bearing.law.power(tuple(of[cut] for of in material), across[cut])
        spins = np.where(needed, sign[:, None] * np.where(above[:, None], high, low), known)
        return cls(float(power.sum()), contacts, above, between, spins=spins)


def _needed_components(bearing: Bearing) -> tuple[np.ndarray, np.ndarray]:
    """Spins u (N, C) at which the components that are not needed slip nowhere; and (C,) True for those that are needed:
    all but those that can turn without any slip where normals lie along the axes."""
    known, wanted, _ = bearing.network.needed(bearing.driven_speed, bearing.acting, bearing.network.free)
    return known, np.asarray(wanted.any(axis=0))


def _slack(bearing: Bearing, contact: np.ndarray, across: np.ndarray, states: np.ndarray) -> float:
    """What the weights of contacts (n,) may differ in all from those of the bearing states that are meant: these
    (2, N, C) are known from spins to rounding, or to what these miss a state by. across : (E,) of the jump."""
    bodies, sign = bearing.network.bodies, bearing.network.sublattices[1]
    turned, largest = sign[:, None] * bearing.driven_speed, np.abs(states).max()
    missed = [
        np.abs(turned - state)[bearing.network.body == body].max() for state, body in zip(states, bodies, strict=True)
    ]
    off = 4 * (sum(missed) + STATE_ROUNDING * largest)
    of = tuple(values[0, contact] for values in bearing.material)
    near, far = (bearing.law.objective(of, np.maximum(across[contact] + by, 0.0)) for by in (-off, off))
    return float((far - near).sum())
