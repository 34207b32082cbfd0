"""The lightest interface of two rigid domains of a packing: a minimum cut, and the spins of its two sides.

Where the network has no odd loops and two driven bodies, each in a bearing state s u = A + c x of its own, a contact on
the interface slips with their jump across its normal.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.numerics.minimum_cut import TIED_WEIGHTS, largest_flow, within_reach
from taichi_bearings.packing.packing import Packing
from taichi_bearings.packing.system import acting, odd_parts

SAME_STATE = 1e-9  # of the largest R omega, by which spins may miss a bearing state
ACROSS = 1e-12  # of the jump, what rounding leaves of it across a normal along it
CUT_BITS = 50  # of the weight of all contacts, in whole units


def nodes_of(driven: np.ndarray) -> np.ndarray:
    """(N,) nodes, a driven body being one: 0 the first, then the free spheres, then the others. driven : (N,)."""
    free = driven < 0
    rank, number = np.unique(driven[~free], return_inverse=True)
    node = np.empty(len(driven), dtype=np.int64)
    node[free] = (len(rank) > 0) + np.arange(free.sum())
    node[~free] = np.where(number == 0, 0, free.sum() + number)
    return node


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
    """A minimum cut. power : energy/time. contacts : (E,). above : (N,), True on the side of the second body.

    unique : every other one is heavier by more than 1e-12. spins : u (N, C) of the two rigid domains.
    """

    power: float
    contacts: np.ndarray
    above: np.ndarray
    unique: bool
    spins: np.ndarray

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
        node, taken = nodes_of(packing.driven), np.zeros(packing.contacts, dtype=bool)
        ends = node[packing.contact].T
        taken[acting(packing)] = True
        taken &= (ends[0] != ends[1]) & (weight > 0)
        ends, weight = ends[:, taken], weight[taken]
        total = float(weight.sum())
        if not total > 0:
            return None
        unit = total * 2.0**-CUT_BITS
        capacity = np.floor(weight / unit).astype(np.int64)
        size = int(node.max()) + 1
        edges = np.append(ends, [[0], [size - 1]], axis=1)  # one without capacity, so that both ends are there
        capacity = np.append(capacity, 0)
        flow = largest_flow(edges, capacity, int(capacity.sum()) + 1)
        left = np.stack([capacity - flow, capacity + flow])
        tie = int(TIED_WEIGHTS * capacity.sum()) + len(weight)  # each weight is rounded by less than a unit
        above = ~within_reach(edges, left, 0)
        reached, nearest = within_reach(edges, left, 0, tie), within_reach(edges, left[::-1], size - 1, tie)
        cut = np.flatnonzero(taken)[above[ends[0]] != above[ends[1]]]
        contacts = np.zeros(packing.contacts, dtype=bool)
        contacts[cut] = True
        loose = np.ones(size, dtype=bool)
        loose[ends.ravel()] = False
        unique = bool((reached | nearest | loose).all())
        power = packing.kind.power(tuple(of[cut] for of in packing.coefficients), across[cut])
        spins = sign[:, None] * np.where(above[node][:, None], high, low)
        return cls(float(power.sum()), contacts, above[node], unique, spins)
