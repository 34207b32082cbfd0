"""The structure of one sample, of a lattice or a packing, part by part; a part is computed when it is first asked for.

A lattice is here a packing whose spins are measured from its bottom, so all is said once of a network of contacts; it
only knows better what its contacts along axes force to turn alike, and which interface is the lightest.

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
from typing import Any, ClassVar, TypeVar

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, laplacian
from scipy.sparse.linalg import spsolve

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.analysis.domains import RigidDomains, rigid_domains
from taichi_bearings.analysis.network import MOST_BODIES, SliplessNetwork
from taichi_bearings.analysis.topology import self_stress_of
from taichi_bearings.numerics.minimum_cut import WEIGHT_ROUNDING
from taichi_bearings.proof.contact_state import ContactState, by_threshold
from taichi_bearings.quantities import STRUCTURE, Quantity, plain
from taichi_bearings.read_only import cached_read_only
from taichi_bearings.scene import Bearing, Scene, Solution
from taichi_bearings.scene.initial_spins import cut_of, cut_unit, cut_weights
from taichi_bearings.scene.interface import SAME_STATE, Interface, bearing_states
from taichi_bearings.scene.network import Network
from taichi_bearings.scene.scene import of_lattice, vector_length
from taichi_bearings.stages import stage

OF_EVERY_SAMPLE = ("power", "lower_bound", "slipping", "slipless", "tied", "undecided")
OF_MINIMA = ("minimum_is_unique",)
MAY_BE_ABSENT = ("planes_crossed", "winds_x", "winds_y", "spanning_winds_x", "spanning_winds_y", "mean_saturation")
"""Numbers that are left out where they make no sense."""
Kind = TypeVar("Kind", bound="Structure")


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

    told: ClassVar[tuple[str, ...]] = OF_EVERY_SAMPLE

    @cached_property
    def state(self) -> np.ndarray:
        """Those between driven spheres stay, whatever the threshold."""
        if self.threshold is None:
            return self.found
        return by_threshold(self.slip, self.found, self.threshold)

    def by_threshold(self: Kind, threshold: float) -> Kind:
        """The same sample by a threshold."""
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
        return self.state == ContactState.SLIPLESS

    @property
    def bearing(self) -> Bearing:
        """What was solved."""
        return self.answer.scene

    @property
    def whole(self) -> Network:
        """All spheres and contacts."""
        return self.bearing.network

    @property
    def fastest(self) -> float:
        """The largest imposed R omega, of a lattice R times the largest jump; length/time."""
        return float(np.linalg.norm(self.bearing.driven_speed, axis=1).max(initial=0.0))

    def shown_spin(self, spin: np.ndarray) -> np.ndarray:
        """Spins of this sample, in the shape they have, less what no contact feels; the same of a packing."""
        return spin

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
        return spin.reshape(self.whole.spheres, -1) * self.whole.radius[:, None]

    @cached_property
    def network(self) -> SliplessNetwork:
        return SliplessNetwork(self.whole, self.slipless)

    @cached_property
    def bottlenecks(self) -> Any:
        """Between driven bodies; None with fewer than two of them, or more than MOST_BODIES."""
        return Bottlenecks(self.network) if 2 <= len(self.network.held) <= MOST_BODIES else None

    @cached_property
    def interface(self) -> Interface | None:
        """The lightest interface of two rigid domains; None where there are no two bearing states."""
        with stage("finding the minimum cut"):
            return Interface.of(self.bearing)

    @cached_read_only
    def signs(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) True in parts with odd loops, and the signs by which neighbours differ in others."""
        return self.whole.sublattices

    @cached_read_only
    def states(self) -> np.ndarray | None:
        """s u (2, N, C) of all spheres if they turned with the first or with the second of two driven bodies,
        length/time; None where these are in no bearing states."""
        found = bearing_states(self.bearing)
        return None if found is None else found[1]

    @cached_read_only
    def turned(self) -> np.ndarray:
        """s R omega (N, C), length/time, with signs s by which neighbours differ; in parts with odd loops, where each
        sphere has neighbours of its own sign, that of its first component is taken away."""
        odd, sign = self.signs
        u = sign[:, None] * self.speeds(self.spin)
        first = np.argmax(np.abs(u) > SAME_STATE * np.abs(u).max(initial=0.0), axis=1)
        return np.where(odd[:, None] & (u[np.arange(len(u)), first] < 0)[:, None], -u, u)

    @cached_property
    def rigid_domains(self) -> RigidDomains:
        """Spheres of one connected piece of slipless contacts that turn as fast, but for their signs. Components that
        all have alike are left out; those of one piece with a body that turn as it does are locked to it."""
        u, piece = self.turned, self.network.component
        largest, states = np.abs(u).max(initial=0.0), self.states
        near = max(SAME_STATE * largest, 2 * self.slip[self.slipless].max(initial=0.0))
        low, high = np.zeros((2, *u.shape)) if states is None else states
        apart = 4 * largest  # with bodies that turn unevenly all is one domain that turns as they do
        values = np.where(np.abs(u - low) <= near, -apart, np.where(np.abs(u - high) <= near, apart, u))
        axes = self._slipping_components(near)
        labels = np.stack([_alike(piece, (u if states is None else values)[:, k], near) for k in axes])
        held = np.flatnonzero(~self.whole.free)
        bodies, body = np.unique(self.whole.body[held], return_inverse=True)
        tied = np.zeros((len(axes), len(u)), dtype=np.int64)
        for lock, label in zip(tied, labels, strict=True):
            np.bitwise_or.at(lock, label[held], 1 << np.minimum(body, MOST_BODIES))
        tied = np.take_along_axis(tied, labels, axis=1)
        jump = (high - low)[:, axes].T
        jump[np.abs(jump) <= SAME_STATE * largest] = 0.0  # rounding of states that agree
        names = ("bottom", "top") if len(bodies) == 2 else tuple(f"body {number}" for number in bodies[:MOST_BODIES])
        above = (u - low)[:, axes].T
        return RigidDomains.of(axes, labels, tied, above, None if states is None else jump, piece.shape, names)

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
        """(N,) 0 on the first body, 1 on the last one, and between the mean of that of the neighbours; 0 where these
        two do not reach."""
        node = self.network.body
        ends, size = node[self.whole.contact[:, self.bearing.acting]], int(node.max()) + 1
        ones = np.ones(ends.shape[1])
        graph = csr_array((np.tile(ones, 2), np.append(ends, ends[::-1], axis=1)), shape=(size, size))
        label = connected_components(graph, directed=False)[1]
        inside = np.flatnonzero(np.isin(label, label[[0, -1]])[1:-1]) + 1
        matrix, height = (laplacian(graph))[inside], np.zeros(size)
        height[-1] = 1.0
        if len(inside):
            height[inside] = spsolve(matrix[:, inside].tocsc(), -matrix[:, [-1]].toarray()[:, 0])
        return height[node]

    @cached_property
    def torque_flow(self) -> TorqueFlow:
        """What drives the bodies, and how it goes through the network: layers are those of `height`."""
        whole, imposed, (odd, sign) = self.whole, self.bearing.driven_speed, self.signs
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
        return TorqueFlow(total[-1] if len(bodies) == 2 else total, power, share)

    @property
    def mean_saturation(self) -> float | None:
        """Mean share of their friction limit that slipless contacts bear: not-a-number where there are none, None
        without a limit of friction."""
        if not self.bearing.law.is_rate_independent:
            return None
        limit, size = self.bearing.material[0][0], vector_length(np.atleast_2d(self.friction.T))
        loaded = self.slipless & (limit > 0)
        return float((size[loaded] / limit[loaded]).mean()) if loaded.any() else np.nan

    @cached_property
    def self_stress(self) -> int | None:
        """States of self-stress: how far the forces of slipless contacts are left open; None if rounding hides it."""
        chosen, every = np.flatnonzero(self.slipless), range(self.whole.components)
        axes = self.rigid_domains.spin_axes if self.whole.along_axes(chosen) else every
        return self_stress_of(self.whole, chosen, axes)

    @cached_property
    def numbers(self) -> dict[str, Any]:
        """As `bearings analyse --json` has them, for JSON. Those that are not finite, or of which there are none,
        are None."""
        states = {which.name.lower(): self.contacts_in(which) for which in ContactState}
        told = {name: states[name] if name in states else getattr(self, name) for name in self.told}
        found = {row.name: row.of(self) for row in self._rows()}
        return told | {n: plain(v) for n, v in found.items() if v is not None or n not in MAY_BE_ABSENT}

    def _rows(self) -> Iterator[Quantity]:
        for section, rows in STRUCTURE.items():
            if section != "bottlenecks" or self.bottlenecks is not None:
                yield from rows


class LatticeStructure(Structure):
    """That of one sample of a lattice; R = 1."""

    told = (*OF_EVERY_SAMPLE, *OF_MINIMA)

    @property
    def scene(self) -> Scene:
        return of_lattice(self.answer.scene)

    @property
    def fastest(self) -> float:
        return self.scene.lattice.radius * self.scene.jump

    def shown_spin(self, spin: np.ndarray) -> np.ndarray:
        """Spins (..., *N, 3) as pictures show them: about the height, every layer has the mean of the driven planes.

        No contact feels by how much a whole layer turns about the height (up to the sign of the sublattice), so a
        dynamics keeps whatever mean each layer began with. Where both planes have the same mean, free layers get it
        too; else, and in 2D, the spins stay as they are.
        """
        if self.scene.lattice.dimension == 2:
            return spin
        sign = self.scene.lattice.parity
        staggered = sign * spin[..., 2]
        mean = staggered.mean(axis=(-3, -2), keepdims=True)
        bottom, top = mean[..., :1], mean[..., -1:]
        if not np.allclose(bottom, top, rtol=0, atol=1e-12 * self.scene.fastest):
            return spin
        shown = spin.copy()
        shown[..., 1:-1, 2] -= (sign * (mean - bottom))[..., 1:-1]
        return shown

    def slips_of(self, spin: np.ndarray) -> np.ndarray:
        axes = self.scene.lattice.all_spin_axes
        return self.scene.slips(self.scene.staggered_spin(spin[None], axes), axes)[0]

    @property
    def states_proven(self) -> bool:
        """True if `state` is proven to be that of every minimum."""
        return self.threshold is None and bool(self.answer.states_proven[0])

    @property
    def minimum_is_unique(self) -> bool | None:
        """None if it is not known."""
        return self.answer.minimum_is_unique[0] if self.threshold is None else None

    @cached_property
    def interface(self) -> Interface:
        with stage("finding the minimum cut"):
            return find_interface(self.scene)

    @cached_read_only
    def states(self) -> np.ndarray:
        sign, imposed = self.signs[1], self.scene.driven_speed
        top = (sign[:, None] * imposed).reshape(*self.scene.lattice.shape, -1)[..., -1:, :]
        high = np.broadcast_to(top, (*self.scene.lattice.shape, imposed.shape[1])).reshape(imposed.shape)
        return np.stack([np.zeros_like(high), high])

    @cached_property
    def rigid_domains(self) -> RigidDomains:
        axes = self.scene.minimum_spin_axes
        with stage("finding rigid domains"):
            return rigid_domains(self.network, self.scene.staggered_spin(self.spin[None], axes)[:, 0], axes)

    @cached_read_only
    def height(self) -> np.ndarray:
        *_, layer = np.indices(self.scene.lattice.shape)
        return np.asarray(layer.ravel() / layer.max())

    @cached_property
    def torque_flow(self) -> TorqueFlow:
        """That of the components that the driving needs."""
        flow = super().torque_flow
        return flow if len(flow.total) == 1 else replace(flow, total=flow.total[list(self.scene.minimum_spin_axes)])

    @cached_property
    def self_stress(self) -> int:
        with stage("counting states of self-stress"):
            return int(self_stress(self.network, self.scene.minimum_spin_axes).sum())


def structure_of(answer: Solution, number: int = 0, threshold: float | None = None) -> Any:
    """One sample of an answer, ready to be looked at: a :class:`LatticeStructure`, of a packing a :class:`Structure`.

    number : of the sample. threshold : as of these.
    """
    one = answer.sample(number)
    kind: type[Structure] = Structure if one.scene.network.lattice is None else LatticeStructure
    power, lower_bound = float(one.power[0]), float(one.lower_bound[0])
    of_contacts = (one.slip[0], one.state[0], one.friction[0], one.power_per_contact[0])
    return kind(one, one.spin[0], *of_contacts, power, lower_bound, threshold)


def find_interface(scene: Scene, replica: int = 0) -> Interface:
    """The cheapest interface of one sample: of the least power, or what else the stationary state minimises."""
    scene = scene.sample(replica)
    weight, cut, unit = cut_weights(scene), cut_of(scene), cut_unit(scene)
    low, high = cut.above[0].ravel()[scene.lattice.ends]
    contacts = (low != high) & (weight[0] > 0) & (scene.jump > 0)  # without a jump nothing slips
    power = unit * float(cut.weight[0])
    if scene.law.minimises != "power":
        power = float(scene.law.power(scene.material, _interface_slips(scene)[None])[0, contacts].sum())
    return Interface(
        power,
        contacts,
        cut.above[0],
        cut.between[0],
        unit * float(cut.lower_bound[0]) * (1 - WEIGHT_ROUNDING),
        unit * float(cut.next_weight[0]),
    )


def _interface_slips(scene: Scene) -> np.ndarray:
    """(E,) slips of contacts on an interface of two rigid domains, length/time; of the jump itself, as spins in the
    laboratory lose the digits of a jump that is small beside them."""
    axes = scene.minimum_spin_axes
    jump = scene.top_spin(axes).reshape(len(axes), -1)[:, scene.lattice.column]
    return scene.lattice.radius * vector_length(np.where(scene.lattice.tangential_mask(axes), jump, 0.0))


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


def _alike(piece: np.ndarray, values: np.ndarray, near: float) -> np.ndarray:
    """Label (N,) of the spheres of each piece whose values follow each other by no more than `near`."""
    order = np.lexsort([values, piece])
    new = (np.diff(piece[order], prepend=-1) != 0) | (np.diff(values[order], prepend=np.inf) > near)
    label = np.empty(len(piece), dtype=np.int64)
    label[order] = np.cumsum(new) - 1
    return label
