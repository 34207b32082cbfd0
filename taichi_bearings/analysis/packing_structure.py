"""What the contacts of a solved packing form: the slipless network, what it joins, and the lightest interface.

Nodes are free spheres and driven bodies, edges contacts. Each driven body is one node, so contacts within it are none.
The lightest interface of two rigid domains is a minimum cut: where the network has no odd loops and two driven bodies,
each in a bearing state s u = A + c x of its own, a contact on it slips with their jump across its normal.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra, maximum_flow

from taichi_bearings.numerics.minimum_cut import TIED_WEIGHTS, largest_flow, within_reach
from taichi_bearings.packing import PackingSolution
from taichi_bearings.packing.system import odd_parts
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.words import html_table

MOST_BODIES = 50  # between which paths are looked for
SAME_STATE = 1e-9  # of the largest R omega, by which spins may miss a bearing state, or each other in a domain
CUT_BITS = 50  # of the weight of all contacts, in whole units


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
    def node(self) -> np.ndarray:
        """(N,) of each sphere: driven bodies first, then the free spheres."""
        driven = self.result.packing.driven
        bodies, number = np.unique(driven[driven >= 0], return_inverse=True)
        node = np.empty(len(driven), dtype=np.int64)
        node[driven >= 0] = number
        node[driven < 0] = len(bodies) + np.arange((driven < 0).sum())
        return node

    @property
    def bodies(self) -> int:
        return len(np.unique(self.result.packing.driven)) - int((self.result.packing.driven < 0).any())

    @cached_property
    def graph(self) -> sparse.csr_array:
        """Of the slipless contacts: (nodes, nodes) of int32 ones, symmetric."""
        first, second = self.node[self.result.packing.contact[self.slipless]].T
        size = int(self.node.max()) + 1
        ends = np.concatenate([first, second]), np.concatenate([second, first])
        graph = sparse.csr_array((np.ones(len(ends[0]), dtype=np.int32), ends), shape=(size, size))
        graph.data[:] = 1  # of several contacts between two nodes one
        return graph

    @cached_property
    def piece(self) -> np.ndarray:
        """(N,) label of the connected piece of each sphere."""
        label = connected_components(self.graph, directed=False)[1]
        return np.asarray(label[self.node])

    @cached_property
    def touched(self) -> np.ndarray:
        """(N,) True for spheres with a slipless contact."""
        count = np.bincount(self.result.packing.contact[self.slipless].ravel(), minlength=self.result.packing.spheres)
        return count > 0

    @cached_property
    def spanning(self) -> np.ndarray:
        """(N,) True for spheres in pieces that hold two driven bodies or more."""
        held = self.result.packing.driven >= 0
        pairs = np.unique(np.stack([self.piece[held], self.node[held]]), axis=1)
        bodies = np.bincount(pairs[0], minlength=int(self.piece.max()) + 1)
        return np.asarray((bodies > 1)[self.piece])

    @cached_property
    def shortest_path(self) -> int | None:
        """Contacts of the shortest slipless path between two driven bodies; None without one."""
        if not self.spanning.any() or self.bodies > MOST_BODIES:
            return None
        far = dijkstra(self.graph, unweighted=True, indices=np.arange(self.bodies))[:, : self.bodies]
        return int(far[~np.eye(self.bodies, dtype=bool)].min())

    @cached_property
    def disjoint_paths(self) -> int | None:
        """Slipless paths between two driven bodies that share no contact; None with more or fewer bodies."""
        return None if self.bodies != 2 else int(maximum_flow(self.graph, 0, 1).flow_value)

    @cached_property
    def domain(self) -> np.ndarray:
        """(N,) label of the rigid domain of each sphere: slipless contacts join spheres that turn against each other as
        fast, u_i = -u_j, and a driven body those that turn as its first one does, or against it."""
        packing = self.result.packing
        u = self.result.spin.reshape(packing.spheres, -1) * np.asarray(packing.radius)[:, None]
        near = SAME_STATE * np.abs(u).max(initial=0.0)
        first, second = packing.contact[self.slipless | (self.result.state == ContactState.DRIVEN)].T
        held = np.flatnonzero(packing.driven >= 0)
        leader = held[np.unique(self.node[held], return_index=True)[1]][self.node[held]]
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
        return Interface.of(self.result, self.node) if self.bodies == 2 else None

    def __getattr__(self, name: str) -> Any:
        if name in (numbers := {} if name.startswith("_") else self.numbers):
            return numbers[name]
        raise AttributeError(f"the structure of a packing has no {name!r}; it has {', '.join(numbers)}")

    @cached_property
    def numbers(self) -> dict[str, Any]:
        """As `bearings analyse --json` has them, for JSON; each is an attribute too, such as `spans`."""
        packing, cut = self.result.packing, self.interface
        free, acts = packing.driven < 0, self.result.state != ContactState.DRIVEN
        share = lambda chosen: float(chosen[free].mean()) if free.any() else None  # noqa: E731
        return {
            "power": self.result.power,
            "power_minimum_cut": None if cut is None else cut.power,
            "power_over_cut": self.result.power / cut.power if cut is not None and cut.power > 0 else None,
            "cut_is_unique": None if cut is None else cut.unique,
            "cut_contacts": None if cut is None else int(cut.contacts.sum()),
            "slipless_fraction": float(self.slipless.sum() / acts.sum()) if acts.any() else None,
            "components": len(np.unique(self.piece[self.touched])),
            "spans": bool(self.spanning.any()),
            "reached_fraction": share(self.touched),
            "spanning_fraction": share(self.spanning),
            "shortest_path": self.shortest_path,
            "disjoint_paths": self.disjoint_paths,
            "domains": int(self.domain.max()) + 1,
            "largest_domain": int(np.bincount(self.domain[free]).max()) if free.any() else 0,
        }

    def _repr_html_(self) -> str:
        """For notebooks."""
        return html_table(f"structure of {self.result.packing!r}", self.numbers.items())

    @property
    def columns(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Of spheres (N,) and of contacts (E,): `domain`, `component`; `on_cut`, `above_cut` where there is a cut."""
        spheres, contacts = {"domain": self.domain, "component": self.piece}, dict[str, np.ndarray]()
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
        state = [_bearing_state(packing.center, sign[:, None] * packing.imposed, node == body) for body in (0, 1)]
        if state[0] is None or state[1] is None:
            return None
        jump = _at(packing.center[first], state[1]) - _at(packing.center[first], state[0])
        across = np.cross(jump, np.asarray(packing.normal)) if packing.dimension == 3 else jump
        weight = held * np.linalg.norm(across, axis=1)
        ends = node[packing.contact].T
        taken = (ends[0] != ends[1]) & (weight > 0) & (result.state != ContactState.DRIVEN)
        order = np.append([0], np.append(np.arange(2, node.max() + 1), 1))  # the second body last
        place = np.argsort(order)
        ends, weight = place[ends[:, taken]], weight[taken]
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
        return cls(float(weight[cut].sum()), contacts, above[place[node]], unique)


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
