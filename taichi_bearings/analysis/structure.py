"""The structure of one sample, of a lattice or a packing, part by part; a part is computed when it is first asked for.

All is said once of a network of contacts, whose spins a lattice measures from its bottom. Where a network has strides,
these tell three things that are found by searches else: how high a sphere lies, what contacts along axes force to turn
alike, and around how many loops torque can circulate.

**Torque.** With signs s by which neighbours differ, s times what a contact pulls with at u = R omega is a current of
each component, from one of its spheres to the other. No free sphere stores any of it; it enters at the one driven body
and leaves at the other. Of a lattice the same torque T_k goes through every gap between two layers, so the driven
planes spend the power sum_k T_k (Omega_top - Omega_bottom)_k. T_k is unique at the minimum if top and bottom differ in
component k, and so is what the slipless contacts carry of it as a whole. The force of a single slipless contact is not,
as long as there are loops of slipless contacts around which torque can circulate: states of self-stress, as in frames
(Pellegrino and Calladine, Int. J. Solids Struct. 22, 1986). Then such forces are one admissible choice: the method's.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, laplacian
from scipy.sparse.linalg import spsolve

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.analysis.domains import RigidDomains, rigid_domains, turning_domains
from taichi_bearings.analysis.slipless_network import MOST_BODIES, SliplessNetwork
from taichi_bearings.analysis.topology import self_stress_of
from taichi_bearings.proof.contact_state import ContactState, by_threshold
from taichi_bearings.quantities import STRUCTURE, Quantity, plain
from taichi_bearings.read_only import cached_read_only
from taichi_bearings.scene import Bearing, Solution
from taichi_bearings.scene.interface import SAME_STATE, Interface, bearing_states, find_interface
from taichi_bearings.scene.network import Network
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.stages import stage

OF_THE_RUN = ("power", "lower_bound", "slipping", "slipless", "tied", "undecided", "minimum_is_unique")
"""Numbers of the run itself that stand before those of the structure."""
MAY_BE_ABSENT = ("planes_crossed", "winds_x", "winds_y", "spanning_winds_x", "spanning_winds_y", "mean_saturation")
"""Numbers that are left out where they make no sense."""


@dataclass(frozen=True)
class TorqueFlow:
    """total : (C,) torque that drives the top plane, or the second of two bodies, and holds the other; with fewer or
    more bodies that of each, (bodies, C); force * length; signs of a sublattice are taken away.
    power : that each body spends, (bodies,), energy/time; for certifying forces of the Coulomb law a lower bound.
    slipless_share : of the power from the first of two bodies to the second what slipless contacts carry, None where
    these are in no bearing states of their own; 0 without power.
    """

    total: np.ndarray
    power: np.ndarray
    slipless_share: float | None


@dataclass(frozen=True)
class Structure:
    """A solved sample and what its contacts form.

    answer : that of one sample, R = 1. spin : laboratory frame, of a lattice (*N) or (*N, 3), of a
    packing (N,) or (N, 3), 1/time. slip, found : (E,), found the states of the answer. friction : on the second sphere
    of each contact, laboratory frame, (E, 3), in 2D (E,). power_per_contact : (E,). power, lower_bound : energy/time.
    threshold : slip speed, length/time, up to which contacts count as slipless, whatever is found; if None the states
    found.
    """

    answer: Solution
    spin: np.ndarray
    slip: np.ndarray
    found: np.ndarray
    friction: np.ndarray
    power_per_contact: np.ndarray
    power: float
    lower_bound: float
    threshold: float | None = None

    @cached_property
    def state(self) -> np.ndarray:
        """(E,) contact states, by the threshold if there is one; contacts between driven spheres stay what they are."""
        if self.threshold is None:
            return self.found
        return by_threshold(self.slip, self.found, self.threshold)

    def by_threshold(self, threshold: float) -> "Structure":
        """The structure of the same sample if contacts count as slipless up to this slip speed, length/time."""
        return replace(self, threshold=threshold)

    def contacts_in(self, which: ContactState) -> int:
        """Number of contacts in a state."""
        return int((self.state == which).sum())

    @property
    def movable(self) -> int:
        """Contacts that can slip: all but absent ones and those between driven spheres."""
        return len(self.state) - self.contacts_in(ContactState.DRIVEN)

    @cached_read_only
    def slipless(self) -> np.ndarray:
        """(E,) True for slipless contacts."""
        return np.asarray(self.state == ContactState.SLIPLESS)

    @property
    def states_proven(self) -> bool:
        """True if the state of every contact is proven to be that of every minimum."""
        return self.threshold is None and bool(self.answer.states_proven[0])

    @property
    def minimum_is_unique(self) -> bool | None:
        """True if no other slips have the least power, False if others have, None if neither is proven."""
        return self.answer.minimum_is_unique[0] if self.threshold is None else None

    @property
    def scene(self) -> Bearing:
        """What was solved."""
        return self.answer.scene

    @property
    def whole(self) -> Network:
        """All spheres and contacts."""
        return self.scene.network

    @property
    def fastest(self) -> float:
        """The largest imposed R omega, length/time, of a lattice measured from its bottom."""
        return float(np.linalg.norm(self.scene.driven_speed, axis=1).max(initial=0.0))

    def shown_spin(self, spin: np.ndarray) -> np.ndarray:
        """Spins (..., *N, 3) or (..., *N) as pictures show them, without what no contact feels.

        No contact of a lattice feels by how much a whole layer turns about the height (up to the sign of the
        sublattice), so a dynamics keeps whatever mean each layer began with. Where both planes have the same mean, free
        layers get it too; else, in 2D, and without layers, the spins stay as they are.
        """
        lattice = self.whole.lattice
        if lattice is None or lattice.dimension == 2:
            return spin
        sign = lattice.parity
        mean = (sign * spin[..., 2]).mean(axis=(-3, -2), keepdims=True)
        bottom, top = mean[..., :1], mean[..., -1:]
        if not np.allclose(bottom, top, rtol=0, atol=1e-12 * self.scene.fastest):
            return spin
        shown = np.array(spin)
        shown[..., 1:-1, 2] -= (sign * (mean - bottom))[..., 1:-1]
        return shown

    @property
    def snapshots(self) -> np.ndarray:
        """Spins (S, ...) of a dynamics that kept some."""
        assert self.answer.snapshots is not None
        return np.asarray(self.answer.snapshots.spin[:, 0])

    def slips_of(self, spin: np.ndarray) -> np.ndarray:
        """Slip speeds (E,) with other spins."""
        return self.whole.slips(self.speeds(spin))

    def speeds(self, spin: np.ndarray) -> np.ndarray:
        """R omega (N, C) of spins in the shape that they have; length/time."""
        return np.asarray(spin.reshape(self.whole.spheres, -1) * self.whole.radius[:, None])

    @cached_property
    def network(self) -> SliplessNetwork:
        return SliplessNetwork(self.whole, self.slipless)

    @cached_property
    def bottlenecks(self) -> Bottlenecks | None:
        """Contacts that paths between bodies cannot avoid; None with fewer than two, or more than MOST_BODIES."""
        return Bottlenecks(self.network) if 2 <= len(self.network.held) <= MOST_BODIES else None

    @cached_property
    def interface(self) -> Interface | None:
        """The lightest interface of two rigid domains; None where there are no two bearing states."""
        with stage("finding the minimum cut"):
            return find_interface(self.scene)

    @cached_read_only
    def signs(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) True in parts with odd loops, and the signs by which neighbours differ in others."""
        return self.whole.sublattices

    @cached_read_only
    def states(self) -> np.ndarray | None:
        """s u (2, N, C) of all spheres if they turned with the first or with the second of two driven bodies,
        length/time; None where these are in no bearing states."""
        found = bearing_states(self.scene)
        return None if found is None else found[1]

    @cached_read_only
    def turned(self) -> np.ndarray:
        """s R omega (N, C), length/time, with signs s by which neighbours differ; in parts with odd loops, where each
        sphere has neighbours of its own sign, that of its first component is taken away."""
        odd, sign = self.signs
        u = sign[:, None] * self.speeds(self.spin)
        first = np.argmax(np.abs(u) > SAME_STATE * np.abs(u).max(initial=0.0), axis=1)
        return np.asarray(np.where(odd[:, None] & (u[np.arange(len(u)), first] < 0)[:, None], -u, u))

    @cached_property
    def rigid_domains(self) -> RigidDomains:
        """Spheres that turn as one, but for the signs of their sublattice: what contacts along the axes of a lattice
        force to do so; without strides spheres of one connected piece of slipless contacts that turn as fast."""
        with stage("finding rigid domains"):
            if self.whole.lattice is not None:
                axes = self.scene.minimum_spin_axes
                return rigid_domains(self.network, self.scene.staggered_spin(self.spin[None], axes)[:, 0], axes)
            near = max(SAME_STATE * np.abs(self.turned).max(initial=0.0), 2 * self.slip[self.slipless].max(initial=0.0))
            return turning_domains(self.network, self.turned, self.states, near, self._slipping_components(near))

    @cached_read_only
    def domain(self) -> np.ndarray:
        """N, label of the rigid domain of each sphere, the largest first."""
        return self.rigid_domains.domain

    def _slipping_components(self, near: float) -> tuple[int, ...]:
        """Components in which some contact slips; all where none does."""
        acts = self.state != ContactState.DRIVEN
        both, normal = self.speeds(self.spin)[self.whole.contact[:, acts]].sum(axis=0), self.whole.normal[acts]
        if self.whole.dimension == 3:
            both = both - normal * (both * normal).sum(axis=1)[:, None]
        slips = np.abs(both).max(axis=0, initial=0.0) > near
        return tuple(np.flatnonzero(slips | ~slips.any()).tolist())

    @cached_read_only
    def height(self) -> np.ndarray:
        """(N,) 0 on the first body and 1 on the last one: the layer of a lattice; without layers the mean of that of
        the neighbours, and 0 where these two bodies do not reach."""
        if self.whole.lattice is not None:
            *_, layer = np.indices(self.whole.lattice.shape)
            return np.asarray(layer.ravel() / layer.max())
        node = self.network.body
        ends, size = node[self.whole.contact[:, self.scene.acting]], int(node.max()) + 1
        ones = np.ones(ends.shape[1])
        graph = csr_array((np.tile(ones, 2), np.append(ends, ends[::-1], axis=1)), shape=(size, size))
        label = connected_components(graph, directed=False)[1]
        inside = np.flatnonzero(np.isin(label, label[[0, -1]])[1:-1]) + 1
        matrix, height = (laplacian(graph))[inside], np.zeros(size)
        height[-1] = 1.0
        if len(inside):
            height[inside] = spsolve(matrix[:, inside].tocsc(), -matrix[:, [-1]].toarray()[:, 0])
        return np.asarray(height[node])

    @cached_property
    def torque_flow(self) -> TorqueFlow:
        """What drives the bodies, and how it goes through the network: layers are those of `height`."""
        whole, imposed, (odd, sign) = self.whole, self.scene.driven_speed, self.signs
        first, second = whole.contact
        friction, sign = self.friction, np.where(odd, 1, sign)
        pull = friction[:, None] if whole.dimension == 2 else np.cross(whole.normal, friction)
        pull = np.where((self.state != ContactState.DRIVEN)[:, None], pull, 0.0)
        drive, held = np.zeros(imposed.shape), np.flatnonzero(~whole.free)
        for end in (first, second):
            np.add.at(drive, end, pull)
        bodies, body = np.unique(whole.body[held], return_inverse=True)
        total, spent = np.zeros((len(bodies), pull.shape[1])), (drive * imposed).sum(axis=1)
        np.add.at(total, body, (sign * whole.radius)[held, None] * drive[held])
        power, share = np.bincount(body, spent[held], len(bodies)), None
        if self.states is not None:
            drop = sign[first] * (self.height[first] - self.height[second])
            carried = (pull * drop[:, None] * (self.states[1] - self.states[0])[first]).sum(axis=1)
            share = float(carried[self.slipless].sum() / carried.sum()) if carried.sum() else 0.0
        needed = list(self.scene.minimum_spin_axes) if whole.components > 1 else [0]
        return TorqueFlow(total[-1, needed] if len(bodies) == 2 else total, power, share)

    @property
    def mean_saturation(self) -> float | None:
        """Mean share of their friction limit that slipless contacts bear: not-a-number where there are none, None
        without a limit of friction."""
        if not self.scene.law.is_rate_independent:
            return None
        limit, size = self.scene.material[0][0], vector_length(np.atleast_2d(self.friction.T))
        loaded = self.slipless & (limit > 0)
        return float((size[loaded] / limit[loaded]).mean()) if loaded.any() else np.nan

    @cached_property
    def self_stress(self) -> int | None:
        """States of self-stress: how far the forces of slipless contacts are left open; None if rounding hides it."""
        with stage("counting states of self-stress"):
            chosen, axes = np.flatnonzero(self.slipless), self.rigid_domains.spin_axes
            if self.whole.lattice is not None:
                return int(self_stress(self.network, axes).sum())
            every = tuple(range(self.whole.components))
            return self_stress_of(self.whole, chosen, axes if self.whole.along_axes(chosen) else every)

    @cached_property
    def numbers(self) -> dict[str, Any]:
        """As `bearings analyse --json` has them, for JSON. Those that are not finite, or of which there are none,
        are None."""
        states = {which.name.lower(): self.contacts_in(which) for which in ContactState}
        told = {name: states[name] if name in states else getattr(self, name) for name in OF_THE_RUN}
        found = {row.name: row.of(self) for row in self._rows()}
        return told | {n: plain(v) for n, v in found.items() if v is not None or n not in MAY_BE_ABSENT}

    def _rows(self) -> Iterator[Quantity]:
        for section, rows in STRUCTURE.items():
            if section != "bottlenecks" or self.bottlenecks is not None:
                yield from rows


def structure_of(answer: Solution, number: int = 0, threshold: float | None = None) -> Structure:
    """The structure of one sample of an answer, ready to be looked at.

    number : of the sample. threshold : as of :class:`Structure`.
    """
    one = answer.sample(number)
    power, lower_bound = float(one.power[0]), float(one.lower_bound[0])
    of_contacts = (one.slip[0], one.state[0], one.friction[0], one.power_per_contact[0])
    return Structure(one, one.spin[0], *of_contacts, power, lower_bound, threshold)


def self_stress(network: SliplessNetwork, spin_axes: tuple[int, ...]) -> np.ndarray:
    """(C,) states of self-stress of a lattice: independent loops of slipless contacts around which a component can
    circulate.

    With the forces of slipping contacts and the total torque of each component given, balance is one equation for each
    body of a connected piece, one of them a consequence of the others, and one unknown for each slipless contact. So
    the sum is the number of free parameters of the forces while nothing is at its limit of friction.
    """
    states = []
    for component in spin_axes:
        carries = network.axis != component
        joined = np.unique(network.body[network.ends[:, carries]])
        domains = np.unique(network.pieces(carries)[joined])
        states.append(int(carries.sum()) - (len(joined) - len(domains)))
    return np.array(states)
