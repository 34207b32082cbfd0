"""The lightest interface of two rigid domains, and how it is found in a packing, with the spins of its two sides.

Where the network has no odd loops and two driven bodies, each in a bearing state s u = A + c x of its own, a contact on
the interface slips with their jump across its normal.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.numerics.minimum_cut import graph_cut, number_bodies
from taichi_bearings.packing.packing import Packing
from taichi_bearings.packing.system import acting, odd_parts

SAME_STATE = 1e-9  # of the largest R omega, by which spins may miss a bearing state
ACROSS = 1e-12  # of the jump, what rounding leaves of it across a normal along it


def bearing_states(packing: Packing) -> tuple[np.ndarray, np.ndarray] | None:
    """Signs (N,) by which neighbours differ, and s u (2, N, C) of all spheres if they turned with the first or with the
    second of two driven bodies in bearing states; None where it has odd loops, or others."""
    odd, sign = odd_parts(packing.spheres, *packing.contact.T)
    bodies = np.unique(packing.driven[packing.driven >= 0])
    if odd.any() or len(bodies) != 2:
        return None
    turned = sign[:, None] * packing.imposed
    low, high = (_state(packing.center, turned, packing.driven == body) for body in bodies)
    return None if low is None or high is None else (sign, np.stack([low, high]))


def _state(center: np.ndarray, turned: np.ndarray, own: np.ndarray) -> np.ndarray | None:
    """A + c x, (N, C), of the bearing state that these spheres have; None if none."""
    if turned.shape[1] == 1:
        value = turned[own][0]
        return np.broadcast_to(value, turned.shape) if (turned[own] == value).all() else None
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
    between : N, True for the spheres that another cut, as light (but in the plane: to 1e-12), may put on the other
        side; if there are none every other interface is proven to dissipate more.
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
    def of(cls, packing: Packing) -> "Interface | None":
        """Of the least power, or what else the stationary state minimises; None without two bearing states."""
        states = bearing_states(packing)
        if states is None:
            return None
        sign, (low, high) = states
        jump = (high - low)[packing.contact[:, 0]]
        across = np.linalg.norm(np.cross(jump, np.asarray(packing.normal)) if packing.dimension == 3 else jump, axis=1)
        across[across <= ACROSS * np.linalg.norm(jump, axis=1)] = 0.0
        weight = packing.kind.objective(packing.coefficients, across)
        node, taken = number_bodies(packing.driven), np.zeros(packing.contacts, dtype=bool)
        ends = node[packing.contact].T
        taken[acting(packing)] = True
        taken &= (ends[0] != ends[1]) & (weight > 0)
        ends, weight = ends[:, taken], weight[taken]
        if not weight.sum() > 0:
            return None
        size = int(node.max()) + 1
        edges = np.append(ends, [[0], [size - 1]], axis=1)  # one of no weight, so that both ends are there
        found = graph_cut(edges, np.append(weight, 0.0), np.arange(size) > 0)
        above, between = found.above[node], found.between[node] & np.isin(node, ends)
        cut = np.flatnonzero(taken)[found.above[ends[0]] != found.above[ends[1]]]
        contacts = np.zeros(packing.contacts, dtype=bool)
        contacts[cut] = True
        power = packing.kind.power(tuple(of[cut] for of in packing.coefficients), across[cut])
        spins = sign[:, None] * np.where(above[:, None], high, low)
        return cls(float(power.sum()), contacts, above, between, spins=spins)
