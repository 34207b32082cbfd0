"""What the contacts of a solved packing form: the slipless network, what it joins, and the lightest interface.

Nodes are free spheres and driven bodies, edges contacts. Each driven body is one node, so contacts within it are none.
The lightest interface of two rigid domains is a minimum cut: where the network has no odd loops and two driven bodies,
each in a bearing state s u = A + c x of its own, a contact on it slips with their jump across its normal.
"""

from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.analysis.network import ContactNetwork
from taichi_bearings.numerics.minimum_cut import TIED_WEIGHTS, largest_flow, within_reach
from taichi_bearings.packing import Packing, PackingSolution
from taichi_bearings.packing.system import odd_parts
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import STRUCTURE, plain
from taichi_bearings.words import html_table

MOST_BODIES = 50  # between which paths are looked for
SAME_STATE = 1e-9  # of the largest R omega, by which spins may miss a bearing state, or each other in a domain
CUT_BITS = 50  # of the weight of all contacts, in whole units
OF_NETWORK = ("components", "spans", "reached_fraction", "spanning_fraction", "disjoint_paths")


@dataclass(frozen=True)
class PackingNetwork(ContactNetwork):
    """That of a packing."""

    @classmethod
    def of(cls, packing: Packing, slipless: np.ndarray) -> "PackingNetwork":
        held = packing.driven >= 0
        spheres = {"sites": packing.spheres, "shape": held.shape, "is_driven": held, "driven": packing.driven}
        return cls(SimpleNamespace(ends=packing.contact.T, **spheres), slipless)

    @cached_property
    def body(self) -> np.ndarray:
        free, driven = ~self.lattice.is_driven, self.lattice.driven
        rank, number = np.unique(driven[~free], return_inverse=True)
        node = np.empty(len(driven), dtype=np.int64)
        node[free] = (len(rank) > 0) + np.arange(free.sum())
        node[~free] = np.where(number == 0, 0, free.sum() + number)
        return node

    @property
    def names(self) -> dict[str, np.ndarray]:
        return {"contact": np.flatnonzero(self.slipless), "spheres": self.ends.T}


@dataclass(frozen=True)
class PackingStructure:
    """slipless : (E,) contacts that count as slipless."""

    result: PackingSolution
    slipless: np.ndarray

    @classmethod
    def of(cls, result: PackingSolution, threshold: float | None = None) -> "PackingStructure":
        """threshold : slip, length/time, up to which contacts count as slipless; the states of the result if None."""
        acts = result.state != ContactState.DRIVEN
        return cls(result, acts & (result.state == 0 if threshold is None else result.slip <= threshold))

    @cached_property
    def network(self) -> "PackingNetwork":
        return PackingNetwork.of(self.result.packing, self.slipless)

    @cached_property
    def bottlenecks(self) -> Bottlenecks:
        """Between two driven bodies."""
        return Bottlenecks(self.network)

    @property
    def bodies(self) -> int:
        return len(self.network.held)

    @cached_property
    def shortest_path(self) -> int | None:
        """Contacts of the shortest slipless path between two driven bodies; None without one."""
        if not self.network.spans or self.bodies > MOST_BODIES:
            return None
        far = dijkstra(self.network.graph(), unweighted=True, indices=self.network.held)[:, self.network.held]
        return int(far[~np.eye(self.bodies, dtype=bool)].min())

    @cached_property
    def domain(self) -> np.ndarray:
        """(N,) label of the rigid domain of each sphere: slipless contacts join spheres that turn against each other as
        fast, u_i = -u_j, and a driven body those that turn as its first one does, or against it."""
        packing = self.result.packing
        u = self.result.spin.reshape(packing.spheres, -1) * np.asarray(packing.radius)[:, None]
        near = SAME_STATE * np.abs(u).max(initial=0.0)
        first, second = packing.contact[self.slipless | (self.result.state == ContactState.DRIVEN)].T
        held = np.flatnonzero(packing.driven >= 0)
        _, one, of = np.unique(self.network.body[held], return_index=True, return_inverse=True)
        leader = held[one[of]]
        ends = [np.append(first, held), np.append(second, leader)]
        apart = np.abs(u[ends[0]] + u[ends[1]]).max(axis=1, initial=0.0)
        alike = np.abs(u[held] - u[leader]).max(axis=1, initial=0.0)
        apart[len(first) :] = np.minimum(apart[len(first) :], alike)
        joined = apart <= near
        graph = sparse.csr_array((np.ones(joined.sum()), (ends[0][joined], ends[1][joined])), shape=(len(u), len(u)))
        return np.asarray(connected_components(graph, directed=False)[1])

    @cached_property
    def interface(self) -> "Interface | None":
        """The lightest interface; None where there is none of two bearing states."""
        return Interface.of(self.result, self.network.body) if self.bodies == 2 else None

    def __getattr__(self, name: str) -> Any:
        if name in (numbers := {} if name.startswith("_") else self.numbers):
            return numbers[name]
        raise AttributeError(f"the structure of a packing has no {name!r}; it has {', '.join(numbers)}")

    @cached_property
    def numbers(self) -> dict[str, Any]:
        """As `bearings analyse --json` has them, for JSON; each is an attribute too, such as `spans`."""
        packing, cut = self.result.packing, self.interface
        free, acts = packing.driven < 0, self.result.state != ContactState.DRIVEN
        return {
            "power": self.result.power,
            "power_minimum_cut": None if cut is None else cut.power,
            "power_over_cut": self.result.power / cut.power if cut is not None and cut.power > 0 else None,
            "cut_is_unique": None if cut is None else cut.unique,
            "cut_contacts": None if cut is None else int(cut.contacts.sum()),
            "slipless_fraction": float(self.slipless.sum() / acts.sum()) if acts.any() else None,
            **{name: getattr(self.network, name) for name in OF_NETWORK},
            "shortest_path": self.shortest_path,
            "domains": int(self.domain.max()) + 1,
            "largest_domain": int(np.bincount(self.domain[free]).max()) if free.any() else 0,
            **{row.name: plain(row.of(self)) for row in STRUCTURE["bottlenecks"] if self.bodies == 2},
        }

    def _repr_html_(self) -> str:
        """For notebooks."""
        return html_table(f"structure of {self.result.packing!r}", self.numbers.items())

    @property
    def columns(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Of spheres (N,) and of contacts (E,): `domain`, `component`; `on_cut`, `above_cut` where there is a cut."""
        spheres, contacts = {"domain": self.domain, "component": self.network.component}, dict[str, np.ndarray]()
        if self.interface is not None:
            spheres["above_cut"], contacts["on_cut"] = self.interface.above, self.interface.contacts
        return spheres, contacts


@dataclass(frozen=True)
class Interface:
    """A minimum cut. power : energy/time. contacts : (E,). above : (N,), True on the side of the second body.

    unique : every other one is heavier by more than 1e-12.
    """

    power: float
    contacts: np.ndarray
    above: np.ndarray
    unique: bool

    @classmethod
    def of(cls, result: PackingSolution, node: np.ndarray) -> "Interface | None":
        packing, (first, second) = result.packing, result.packing.contact.T
        odd, sign = odd_parts(packing.spheres, first, second)
        held = packing.kind.holding_force(packing.coefficients)
        if odd.any() or held is None or packing.kind.flows:
            return None
        state = [
            _bearing_state(packing.center, sign[:, None] * packing.imposed, node == body) for body in (0, node.max())
        ]
        if state[0] is None or state[1] is None:
            return None
        jump = _at(packing.center[first], state[1]) - _at(packing.center[first], state[0])
        across = np.cross(jump, np.asarray(packing.normal)) if packing.dimension == 3 else jump
        weight = held * np.linalg.norm(across, axis=1)
        ends = node[packing.contact].T
        taken = (ends[0] != ends[1]) & (weight > 0) & (result.state != ContactState.DRIVEN)
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
        cut = above[ends[0]] != above[ends[1]]
        contacts = np.zeros(packing.contacts, dtype=bool)
        contacts[np.flatnonzero(taken)[cut]] = True
        loose = np.ones(size, dtype=bool)
        loose[ends.ravel()] = False
        unique = bool((reached | nearest | loose).all())
        return cls(float(weight[cut].sum()), contacts, above[node], unique)


def _bearing_state(center: np.ndarray, turned: np.ndarray, own: np.ndarray) -> np.ndarray | None:
    """A and c, (C + 1, C) with c x in the last row, of the bearing state that these spheres have; None if none."""
    if turned.shape[1] == 1:
        value = turned[own][0]
        return np.array([value, [0.0]]) if (turned[own] == value).all() else None
    rows = np.concatenate([np.tile(np.eye(3), (own.sum(), 1)), center[own].reshape(-1, 1)], axis=1)
    found = np.linalg.lstsq(rows, turned[own].ravel(), rcond=None)[0]
    missed = np.abs(rows @ found - turned[own].ravel()).max()
    return np.append(found[:3], found[3]) if missed <= SAME_STATE * np.abs(turned).max(initial=0.0) else None


def _at(place: np.ndarray, state: np.ndarray) -> np.ndarray:
    """A + c x, (E, C)."""
    if state.shape == (2, 1):
        return np.broadcast_to(state[0], (len(place), 1))
    return state[:3] + state[3] * place
