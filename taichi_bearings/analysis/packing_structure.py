"""What the contacts of a solved packing form: the slipless network, what it joins, and the lightest interface.

Nodes are free spheres and driven bodies, edges contacts. Each driven body is one node, so contacts within it are none.
"""

from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra, laplacian
from scipy.sparse.linalg import spsolve

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.analysis.domains import Lock, RigidDomains, refined
from taichi_bearings.analysis.network import ContactNetwork
from taichi_bearings.packing import Packing
from taichi_bearings.packing.interface import SAME_STATE, Interface, bearing_states, nodes_of
from taichi_bearings.packing.structure import self_stress_of
from taichi_bearings.packing.system import acting, along_axes, odd_parts
from taichi_bearings.proof.contact_state import ContactState, by_threshold
from taichi_bearings.quantities import STRUCTURE, plain
from taichi_bearings.scene import Solution
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.words import html_table

MOST_BODIES = 50  # between which paths are looked for
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
        return nodes_of(self.lattice.driven)

    @property
    def names(self) -> dict[str, np.ndarray]:
        return {"contact": np.flatnonzero(self.slipless), "spheres": self.ends.T}


@dataclass(frozen=True)
class PackingFlow:
    """total : torque, signs of a sublattice taken away, that drives the second of two bodies, by component (C,); with
    fewer or more that of each, (bodies, C); force * length. power : that each body spends, (bodies,), energy/time.
    slipless_share : of the power from the first of two bodies to the second what slipless contacts carry, None where
    these are in no bearing states of their own; 0 without power.
    """

    total: np.ndarray
    power: np.ndarray
    slipless_share: float | None


@dataclass(frozen=True)
class PackingStructure:
    """A solved packing and what its contacts form.

    spin : (N, 3), of discs (N,), laboratory frame, 1/time. slip, state, slipless : (E,); those that count as slipless.
    friction : on the second sphere, (E, 3), of discs (E,). power : energy/time.
    """

    packing: Packing
    spin: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    friction: np.ndarray
    power: float
    slipless: np.ndarray

    @classmethod
    def of(cls, solution: Solution, threshold: float | None = None) -> "PackingStructure":
        """Of one sample. threshold : slip, length/time, up to which contacts count as slipless; the states of the
        solution if None."""
        slip, state = solution.slip[0], solution.state[0]
        state = state if threshold is None else by_threshold(slip, state, threshold)
        slipless, power = state == ContactState.SLIPLESS, float(solution.power[0])
        return cls(solution.scene[0], solution.spin[0], slip, state, solution.friction[0], power, slipless)

    @cached_property
    def network(self) -> "PackingNetwork":
        return PackingNetwork.of(self.packing, self.slipless)

    @cached_property
    def bottlenecks(self) -> Bottlenecks:
        """Between driven bodies."""
        return Bottlenecks(self.network)

    @property
    def bodies(self) -> int:
        return len(self.network.held)

    @property
    def has_pairs(self) -> bool:
        """Whether paths between bodies are looked for."""
        return 2 <= self.bodies <= MOST_BODIES

    @cached_property
    def shortest_path(self) -> int | None:
        """Contacts of the shortest slipless path between two driven bodies; None without one."""
        if not self.network.spans or self.bodies > MOST_BODIES:
            return None
        far = dijkstra(self.network.graph(), unweighted=True, indices=self.network.held)[:, self.network.held]
        return int(far[~np.eye(self.bodies, dtype=bool)].min())

    @cached_property
    def turned(self) -> np.ndarray:
        """s R omega (N, C), length/time, with signs s by which neighbours differ; in parts with odd loops, where each
        sphere has neighbours of its own sign, that of its first component is taken away."""
        packing = self.packing
        odd, sign = odd_parts(packing.spheres, *packing.contact.T)
        u = sign[:, None] * self.spin.reshape(packing.spheres, -1) * np.asarray(packing.radius)[:, None]
        first = np.argmax(np.abs(u) > SAME_STATE * np.abs(u).max(initial=0.0), axis=1)
        return np.where(odd[:, None] & (u[np.arange(len(u)), first] < 0)[:, None], -u, u)

    @cached_property
    def rigid_domains(self) -> RigidDomains:
        """Spheres of one connected piece of slipless contacts that turn as fast, but for their signs. Components that
        all have alike are left out; those of one piece with a body that turn as it does are locked to it."""
        packing, u, piece = self.packing, self.turned, self.network.component
        near = max(SAME_STATE * np.abs(u).max(initial=0.0), 2 * self.slip[self.slipless].max(initial=0.0))
        axes = self._slipping_components(near)
        states = bearing_states(packing)
        low, high = np.zeros((2, *u.shape)) if states is None else states[1]
        apart = 4 * np.abs(u).max(initial=0.0)  # with bodies that turn unevenly all is one domain that turns as they do
        values = np.where(np.abs(u - low) <= near, -apart, np.where(np.abs(u - high) <= near, apart, u))
        labels = np.stack([_alike(piece, (u if states is None else values)[:, k], near) for k in axes])
        held, domain = np.flatnonzero(packing.driven >= 0), refined(labels)
        bodies, body = np.unique(packing.driven[held], return_inverse=True)
        lock, first = np.zeros((len(axes), len(u)), dtype=np.int64), np.unique(domain, return_index=True)[1]
        for tied, label in zip(lock, labels, strict=True):
            np.bitwise_or.at(tied, label[held], 1 << np.minimum(body, MOST_BODIES))
        spheres, above = np.bincount(domain), u[:, axes] - low[:, axes]
        mean = np.stack([np.bincount(domain, values) / spheres for values in above.T], axis=1)
        tied = np.take_along_axis(lock, labels, axis=1)[:, first].T
        jump = (high - low)[:, axes]
        jump[np.abs(jump) <= SAME_STATE * np.abs(u).max(initial=0.0)] = 0.0  # rounding of states that agree
        own = np.abs(above - np.where(tied[domain] == Lock.TOP, jump, mean[domain]) * (tied[domain] != Lock.BOTTOM))
        names = ("bottom", "top") if len(bodies) == 2 else tuple(f"body {number}" for number in bodies[:MOST_BODIES])
        shape = (-1, *u.shape[:1])
        return RigidDomains(
            None, axes, labels.reshape(shape), domain, spheres, mean, float(own.max()), tied, jump[first], names
        )

    @property
    def domain(self) -> np.ndarray:
        """(N,) label of the rigid domain of each sphere, the largest first."""
        return self.rigid_domains.domain

    def _slipping_components(self, near: float) -> tuple[int, ...]:
        """Components in which some contact slips; all where none does."""
        packing, acts = self.packing, self.state != ContactState.DRIVEN
        u = self.spin.reshape(packing.spheres, -1) * np.asarray(packing.radius)[:, None]
        both, normal = u[packing.contact[acts]].sum(axis=1), np.asarray(packing.normal)[acts]
        if packing.dimension == 3:
            both = both - normal * (both * normal).sum(axis=1)[:, None]
        slips = np.abs(both).max(axis=0, initial=0.0) > near
        return tuple(np.flatnonzero(slips | ~slips.any()).tolist())

    @cached_property
    def torque_flow(self) -> PackingFlow:
        """What drives the bodies, and how it goes through the network."""
        packing, acts = self.packing, self.state != ContactState.DRIVEN
        friction, normal = self.friction, np.asarray(packing.normal)
        pull = friction[:, None] if packing.dimension == 2 else np.cross(normal, friction)
        odd, sign = odd_parts(packing.spheres, *packing.contact.T)
        sign = np.where(odd, 1, sign)
        return flow_through(packing, self.network.body, sign, np.where(acts[:, None], pull, 0.0), self.slipless)

    @cached_property
    def interface(self) -> Interface | None:
        """The lightest interface; None where there is none of two bearing states."""
        return Interface.of(self.packing)

    def __getattr__(self, name: str) -> Any:
        if name in (numbers := {} if name.startswith("_") else self.numbers):
            return numbers[name]
        raise AttributeError(f"the structure of a packing has no {name!r}; it has {', '.join(numbers)}")

    @property
    def mean_saturation(self) -> float | None:
        """As of lattices."""
        packing, size = self.packing, vector_length(np.atleast_2d(self.friction.T))
        if not packing.kind.is_rate_independent:
            return None
        loaded = self.slipless & (packing.coefficients[0] > 0)
        return float((size[loaded] / packing.coefficients[0][loaded]).mean()) if loaded.any() else np.nan

    @cached_property
    def self_stress(self) -> int | None:
        """States of self-stress: how far the forces of slipless contacts are left open; None if rounding hides it."""
        packing, chosen = self.packing, np.flatnonzero(self.slipless)
        every = range(packing.imposed.shape[1])
        return self_stress_of(packing, chosen, self.rigid_domains.spin_axes if along_axes(packing, chosen) else every)

    @cached_property
    def numbers(self) -> dict[str, Any]:
        """As `bearings analyse --json` has them, for JSON; each is an attribute too, such as `spans`."""
        packing, cut = self.packing, self.interface
        free, acts = packing.driven < 0, self.state != ContactState.DRIVEN
        sections = ["rigid domains", "forces"] if self.bodies <= MOST_BODIES else ["forces"]
        sections += ["bottlenecks"] if self.has_pairs else []
        rows = [row for section in sections for row in STRUCTURE[section]]
        return {
            "power": self.power,
            "power_minimum_cut": None if cut is None else cut.power,
            "power_over_cut": self.power / cut.power if cut is not None and cut.power > 0 else None,
            "cut_is_unique": None if cut is None else cut.unique,
            "cut_contacts": None if cut is None else int(cut.contacts.sum()),
            "slipless_fraction": float(self.slipless.sum() / acts.sum()) if acts.any() else None,
            **{name: getattr(self.network, name) for name in OF_NETWORK},
            "shortest_path": self.shortest_path,
            "domains": self.rigid_domains.number,
            "largest_domain": int(np.bincount(self.domain[free]).max()) if free.any() else 0,
            **{row.name: plain(row.of(self)) for row in rows},
        }

    def _repr_html_(self) -> str:
        """For notebooks."""
        return html_table(f"structure of {self.packing!r}", self.numbers.items())

    @property
    def columns(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Of spheres (N,) and of contacts (E,): `domain`, `component`; `on_cut`, `above_cut` where there is a cut."""
        spheres, contacts = {"domain": self.domain, "component": self.network.component}, dict[str, np.ndarray]()
        if self.interface is not None:
            spheres["above_cut"], contacts["on_cut"] = self.interface.above, self.interface.contacts
        return spheres, contacts


def _alike(piece: np.ndarray, values: np.ndarray, near: float) -> np.ndarray:
    """Label (N,) of the spheres of each piece whose values follow each other by no more than `near`."""
    order = np.lexsort([values, piece])
    new = (np.diff(piece[order], prepend=-1) != 0) | (np.diff(values[order], prepend=np.inf) > near)
    label = np.empty(len(piece), dtype=np.int64)
    label[order] = np.cumsum(new) - 1
    return label


def flow_through(
    packing: Packing, node: np.ndarray, sign: np.ndarray, pull: np.ndarray, slipless: np.ndarray
) -> PackingFlow:
    """node : (N,) of each sphere, a body being one. sign : (N,) of the sublattice. pull : (E, C) of each contact on
    R omega of both its ends; force, 0 between driven spheres. slipless : (E,).

    s pull is a current of each component, from one end of a contact to the other, as T_k of lattices, and layers are
    those of a height that is 0 on the first body, 1 on the second and in between the mean of that of the neighbours.
    """
    held, (first, second) = np.flatnonzero(packing.driven >= 0), packing.contact.T
    drive = np.zeros(packing.imposed.shape)
    for end in (first, second):
        np.add.at(drive, end, pull)
    bodies, body = np.unique(packing.driven[held], return_inverse=True)
    total, spent = np.zeros((len(bodies), pull.shape[1])), (drive * packing.imposed).sum(axis=1)
    np.add.at(total, body, (sign * packing.radius)[held, None] * drive[held])
    power, states, share = np.bincount(body, spent[held], len(bodies)), bearing_states(packing), None
    if states is not None:
        height = _height(node, node[packing.contact[acting(packing)]].T)
        fall = (sign[first] * (height[first] - height[second]))[:, None] * (states[1][1] - states[1][0])[first]
        carried = (pull * fall).sum(axis=1)
        share = float(carried[slipless].sum() / carried.sum()) if carried.sum() else 0.0
    return PackingFlow(total[-1] if len(bodies) == 2 else total, power, share)


def _height(node: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(N,) 0 at node 0, 1 at the last node, elsewhere the mean of the neighbours; 0 where these two do not reach."""
    size = int(node.max()) + 1
    ones = np.ones(ends.shape[1])
    graph = csr_array((np.tile(ones, 2), np.append(ends, ends[::-1], axis=1)), shape=(size, size))
    label = connected_components(graph, directed=False)[1]
    inside = np.flatnonzero(np.isin(label, label[[0, -1]])[1:-1]) + 1
    matrix, height = (laplacian(graph))[inside], np.zeros(size)
    height[-1] = 1.0
    if len(inside):
        height[inside] = spsolve(matrix[:, inside].tocsc(), -matrix[:, [-1]].toarray()[:, 0])
    return height[node]
