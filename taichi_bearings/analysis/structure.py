"""The structure of one sample, of a lattice or a packing: networks, domains, bottlenecks, and the flow of torque.

Each part is computed when it is first asked for. Lattices and packings are treated alike, as networks of contacts. Only
the rigid domains, and the number of loops around which torque can circulate, are found in a simpler way on lattices.

**Torque.** Let s be signs by which neighbours differ. Then s times the force that a contact exerts on u = R omega is a
current of each component, from one of its spheres to the other. No free sphere stores any of it; it enters at one
driven body and leaves at the other. On a lattice the same torque T_k goes through every gap between two layers, so the
driven planes spend the power sum_k T_k (Omega_top - Omega_bottom)_k. T_k is unique at the minimum if top and bottom
differ in component k, and so is the part of it that all slipless contacts carry together. The force of a single
slipless contact is not unique if there are loops of slipless contacts around which torque can circulate: *states of
self-stress*, as in frames (Pellegrino and Calladine, Int. J. Solids Struct. 22, 1986). Then the forces are one
admissible choice, which depends on the method.

Shapes: N spheres (the shape of a lattice, else their number), E contacts, C components of a spin.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.analysis.domains import RigidDomains, domains_of_packing, rigid_domains
from taichi_bearings.analysis.slipless_network import MOST_BODIES, SliplessNetwork
from taichi_bearings.analysis.topology import self_stress_of
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.plain_files import Json
from taichi_bearings.proof.contact_state import ContactState, by_threshold
from taichi_bearings.quantities import STRUCTURE, Quantity, plain
from taichi_bearings.read_only import cached_read_only
from taichi_bearings.scene import Bearing, Solution
from taichi_bearings.scene.interface import SAME_STATE, Interface, bearing_states, find_interface
from taichi_bearings.scene.network import Network
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.stages import stage

OF_THE_RUN = ("power", "lower_bound", "slipping", "slipless", "tied", "undecided", "minimum_is_unique")
"""Results of the run itself, which come before those of the structure in `numbers`."""
LEFT_OVER = 1e-3  # torques left over on free spheres, together and relative to that on a body, that count as none
MAY_BE_ABSENT = ("planes_crossed", "winds_x", "winds_y", "spanning_winds_x", "spanning_winds_y", "mean_saturation")
"""Results that are left out of `numbers` where they have no value."""


@dataclass(frozen=True)
class TorqueFlow:
    """The torque that drives a sample, and the power that it brings into the network of contacts.

    total : torque, force * length, summed over spheres with opposite signs for neighbours. With two driven bodies: that
        on the second one, on lattices the top plane, by spin component that the driving needs. Else (bodies, components
        C), that on each body. None if forces leave torques on free spheres, as those of a dynamics may: then different
        torques pass through different layers.
    power : (bodies,), power that each body spends, energy/time. If the forces are those that prove the lower bound of
        the Coulomb law, the sum of these powers is a lower bound as well.
    slipless_share : share of the power that slipless contacts carry between two bodies; 0 without power. None where the
        two bodies are not in bearing states or `total` is None.
    """

    total: np.ndarray | None
    power: np.ndarray
    slipless_share: float | None


@dataclass(frozen=True)
class Structure:
    """A solved sample and what its contacts form: slipless network, rigid domains, minimum cut, bottlenecks and torque.

    Attributes
    ----------
    answer : Solution
        The answer to this sample alone.
    spin : array
        Laboratory spins, 1/time: for a lattice (nx, ny) or (nx, ny, nz, 3), for a packing of N spheres (N,) or (N, 3).
    slip : (E,) array
        Slip speeds of the E contacts, length/time.
    found : (E,) array of int
        Contact states of the answer.
    friction : (E, 3) array, in 2D (E,)
        Force on the second sphere of each contact, laboratory frame.
    power_per_contact : (E,) array
        Power of each contact, energy/time.
    power, lower_bound : float
        Power of the sample, and its proven bound, energy/time.
    threshold : float or None
        Slip speed, length/time, up to which contacts count as slipless, whatever the answer says; None to take the
        states of the answer.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> structure = tb.analyse(tb.solve(tb.Scene.random((4, 5), seed=3), threads=1)).structure
    >>> structure.contacts_in(1) + structure.contacts_in(0), structure.domain.shape
    (25, (4, 5))
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
        """(contacts E,), contact states: those of the answer, or by `threshold` if there is one. Contacts that can
        never slip stay DRIVEN.
        """
        if self.threshold is None:
            return self.found
        return by_threshold(self.slip, self.found, self.threshold)

    def by_threshold(self, threshold: float) -> "Structure":
        """Return the structure of this sample in which all contacts whose slip speed is at most `threshold`,
        length/time, count as slipless.
        """
        return replace(self, threshold=threshold)

    def contacts_in(self, which: ContactState) -> int:
        """Return the number of contacts in a state.

        which : the state.
        """
        return int((self.state == which).sum())

    @property
    def movable(self) -> int:
        """Number of contacts that can slip: all but absent ones and those between driven spheres."""
        return len(self.state) - self.contacts_in(ContactState.DRIVEN)

    @cached_read_only
    def slipless(self) -> np.ndarray:
        """(contacts E,) True for slipless contacts."""
        return np.asarray(self.state == ContactState.SLIPLESS)

    @property
    def states_proven(self) -> bool:
        """True if the state of every contact is proven, for all states of least power."""
        return self.threshold is None and bool(self.answer.states_proven[0])

    @property
    def minimum_is_unique(self) -> bool | None:
        """True if all states of least power are proven to have the same slips, False if they are proven not to; None if
        neither is.
        """
        return self.answer.minimum_is_unique[0] if self.threshold is None else None

    @property
    def scene(self) -> Bearing:
        """The lattice or packing that was solved."""
        return self.answer.scene

    @property
    def whole(self) -> Network:
        """The network of all spheres and contacts."""
        return self.scene.network

    @property
    def fastest(self) -> float:
        """The largest imposed radius * spin, length/time; for a lattice measured from its bottom plane."""
        return float(np.linalg.norm(self.scene.driven_speed, axis=1).max(initial=0.0))

    @property
    def snapshots(self) -> np.ndarray:
        """(S, spheres *N) or (S, *N, 3), laboratory spins at the S snapshots of a dynamics, 1/time. The run must have
        snapshots.
        """
        assert self.answer.snapshots is not None
        return np.asarray(self.answer.snapshots.spin[:, 0])

    def slips_of(self, spin: np.ndarray) -> np.ndarray:
        """Return the slip speeds (contacts E,), length/time, that all contacts would have at other spins.

        spin : laboratory spins, 1/time, of discs (nx, ny), of spheres (nx, ny, nz, 3); in a packing of N of them (N,)
            or (N, 3).
        """
        return self.whole.slips(self.speeds(spin))

    def speeds(self, spin: np.ndarray) -> np.ndarray:
        """Return radius * spin of all spheres, (spheres N, components C), length/time.

        spin : laboratory spins, 1/time, of discs (nx, ny) or (N,), of spheres (nx, ny, nz, 3) or (N, 3).
        """
        return np.asarray(spin.reshape(self.whole.spheres, -1) * self.whole.radius[:, None])

    @cached_property
    def network(self) -> SliplessNetwork:
        """The network of the slipless contacts."""
        return SliplessNetwork(self.whole, self.slipless)

    @cached_property
    def bottlenecks(self) -> Bottlenecks | None:
        """Contacts that carry most paths between driven bodies; None with fewer than two, or more than MOST_BODIES."""
        return Bottlenecks(self.network) if 2 <= len(self.network.driven_nodes) <= MOST_BODIES else None

    @cached_property
    def interface(self) -> Interface | None:
        """The minimum cut: the lightest interface between two rigid domains, each rotating with one driven body.
        None unless there are two driven bodies in bearing states (spins at which no contact slips).
        """
        with stage("finding the minimum cut"):
            return find_interface(self.scene)

    @cached_read_only
    def signs(self) -> tuple[np.ndarray, np.ndarray]:
        """Two arrays (spheres N,): a mask of the spheres in connected parts with odd loops (closed chains of an odd
        number of contacts), and signs, +1 or -1, by which neighbours differ in the other parts.
        """
        return self.whole.sublattices

    @cached_read_only
    def states(self) -> np.ndarray | None:
        """(2, spheres N, components C), sign * radius * spin of all spheres, length/time, if they rotated with the
        first, or with the second, of two driven bodies.

        Signs differ between neighbours. None where these bodies are not in bearing states.
        """
        found = bearing_states(self.scene)
        return None if found is None else found[1]

    @cached_read_only
    def signed_speeds(self) -> np.ndarray:
        """(spheres N, components C), sign * radius * spin of all spheres, length/time, with signs by which neighbours
        differ.

        Parts with odd loops (closed chains of an odd number of contacts) have no such signs; there the first component
        of each sphere that is not 0 is made positive.
        """
        odd, sign = self.signs
        u = sign[:, None] * self.speeds(self.spin)
        first = np.argmax(np.abs(u) > SAME_STATE * np.abs(u).max(initial=0.0), axis=1)
        return np.asarray(np.where(odd[:, None] & (u[np.arange(len(u)), first] < 0)[:, None], -u, u))

    @cached_property
    def rigid_domains(self) -> RigidDomains:
        """The rigid domains: sets of spheres that have the same spin, up to signs by which neighbours differ.

        On a lattice they are the spheres whose spins slipless contacts force to be equal. In a packing they are the
        spheres of one connected piece of slipless contacts that have the same sign * radius * spin.
        """
        with stage("finding rigid domains"):
            if self.whole.lattice is not None:
                axes = self.scene.minimum_spin_axes
                return rigid_domains(self.network, self.scene.staggered_spin(self.spin[None], axes)[:, 0], axes)
            # speeds of one domain may differ by rounding, or by twice the slip of a slipless contact
            rounding = SAME_STATE * np.abs(self.signed_speeds).max(initial=0.0)
            tolerance = max(rounding, 2 * self.slip[self.slipless].max(initial=0.0))
            axes = self._slipping_components(tolerance)
            return domains_of_packing(self.network, self.signed_speeds, self.states, tolerance, axes)

    @cached_read_only
    def domain(self) -> np.ndarray:
        """Label of the rigid domain of each sphere, in the shape of the lattice or (spheres,); 0 is the largest one."""
        return self.rigid_domains.domain

    def _slipping_components(self, tolerance: float) -> tuple[int, ...]:
        """Return the numbers of the spin components in which some contact slips; all if none does.

        tolerance : slip speed, length/time, up to which a contact does not slip.
        """
        can_slip = self.state != ContactState.DRIVEN
        # slip velocity u x n, as large as u without its part along n: u sums radius * spin of both, n is the normal
        u, normal = self.speeds(self.spin)[self.whole.contact[:, can_slip]].sum(axis=0), self.whole.normal[can_slip]
        if self.whole.dimension == 3:
            u = u - normal * (u * normal).sum(axis=1)[:, None]
        slips = np.abs(u).max(axis=0, initial=0.0) > tolerance
        return tuple(np.flatnonzero(slips | ~slips.any()).tolist())

    @cached_property
    def torque_flow(self) -> TorqueFlow:
        """Torques on the driven bodies, the power that each spends, and the share of it that slipless contacts carry.

        The share is None unless two bodies are driven, both in bearing states. What a contact carries is a product of
        three: its force; the difference of the imposed speeds of the two bodies; and the difference of the heights of
        its spheres (`driving.heights`, 0 at one body, 1 at the other). The sum over all contacts is the power.
        """
        whole, imposed, (odd, sign) = self.whole, self.scene.driven_speed, self.signs
        first, second = whole.contact
        friction, sign = self.friction, np.where(odd, 1, sign)
        # force against the friction of a contact, conjugate to u = R omega; it is the same for both spheres
        force = friction[:, None] if whole.dimension == 2 else np.cross(whole.normal, friction)
        force = np.where((self.state != ContactState.DRIVEN)[:, None], force, 0.0)
        # sum over the contacts of each sphere
        on_sphere, driven = np.zeros(imposed.shape), np.flatnonzero(~whole.free)
        for end in (first, second):
            np.add.at(on_sphere, end, force)
        # torque on each body, summed with signs by which neighbours differ, and power that it spends
        bodies, body = np.unique(whole.body[driven], return_inverse=True)
        total, spent = np.zeros((len(bodies), force.shape[1])), (on_sphere * imposed).sum(axis=1)
        np.add.at(total, body, (sign * whole.radius)[driven, None] * on_sphere[driven])
        power, share = np.bincount(body, spent[driven], len(bodies)), None
        left_over = (np.abs(on_sphere) * whole.radius[:, None])[whole.free].sum(axis=0).max(initial=0.0)
        if left_over > LEFT_OVER * np.abs(total).max(initial=0.0):
            return TorqueFlow(None, power, None)
        if self.states is not None:
            # share of each contact: force, times difference of the heights, times difference of the imposed speeds
            height = self.scene.driving.heights
            drop = sign[first] * (height[first] - height[second])
            carried = (force * drop[:, None] * (self.states[1] - self.states[0])[first]).sum(axis=1)
            share = float(carried[self.slipless].sum() / carried.sum()) if carried.sum() else 0.0
        needed = list(self.scene.minimum_spin_axes) if whole.components > 1 else [0]
        return TorqueFlow(total[-1, needed] if len(bodies) == 2 else total, power, share)

    @property
    def mean_saturation(self) -> float | None:
        """Mean ratio of friction to friction limit of the slipless contacts.

        It is not-a-number if there are none, and None for laws other than Coulomb friction.
        """
        if not self.scene.law.is_rate_independent:
            return None
        limit, size = self.scene.material[0][0], vector_length(np.atleast_2d(self.friction.T))
        loaded = self.slipless & (limit > 0)
        return float((size[loaded] / limit[loaded]).mean()) if loaded.any() else np.nan

    @cached_property
    def self_stress(self) -> int | None:
        """Number of states of self-stress: independent sets of forces on slipless contacts that balance by themselves.
        If there are any, contact forces are not unique. None if rounding leaves the number open.
        """
        with stage("counting contact forces that balance without a load"):
            chosen, axes = np.flatnonzero(self.slipless), self.rigid_domains.spin_axes
            if self.whole.lattice is not None:
                jump = self.scene.staggered_spin(self.spin[None], axes)[:, 0, ..., -1]
                return int(self_stress(self.network, axes, jump).sum())
            every = tuple(range(self.whole.components))
            return self_stress_of(self.whole, chosen, axes if self.whole.along_axes(chosen) else every)

    @cached_property
    def numbers(self) -> Json:
        """All results by name, as `bearings analyse --json` writes them; None for numbers that are not finite. Those in
        MAY_BE_ABSENT are left out where they have no value."""
        states = {which.name.lower(): self.contacts_in(which) for which in ContactState}
        of_run = {name: states[name] if name in states else getattr(self, name) for name in OF_THE_RUN}
        found = {row.name: row.of(self) for row in self._rows()}
        return of_run | {n: plain(v) for n, v in found.items() if v is not None or n not in MAY_BE_ABSENT}

    def _rows(self) -> Iterator[Quantity]:
        """Yield the rows of the table STRUCTURE, without those of bottlenecks if this sample has no bottlenecks."""
        for section, rows in STRUCTURE.items():
            if section != "bottlenecks" or self.bottlenecks is not None:
                yield from rows


def structure_of(answer: Solution, number: int = 0, threshold: float | None = None) -> Structure:
    """Return what the contacts of one sample of an answer form: network, domains, cut, bottlenecks.

    answer : the solution of one or several samples.
    number : number of the sample, from 0.
    threshold : slip speed, length/time, up to which contacts count as slipless; None to take the states of the answer.
    """
    one = answer.sample(number)
    power, lower_bound = float(one.power[0]), float(one.lower_bound[0])
    of_contacts = (one.slip[0], one.state[0], one.friction[0], one.power_per_contact[0])
    return Structure(one, one.spin[0], *of_contacts, power, lower_bound, threshold)


def self_stress(network: SliplessNetwork, spin_axes: tuple[int, ...], jump: np.ndarray | None = None) -> np.ndarray:
    """Return the number (C,) of states of self-stress of a lattice in each of C spin components: independent forces on
    slipless contacts that balance by themselves.

    network : the slipless contacts.
    spin_axes : numbers of the C components.
    jump : (C, nx, ny), in 2D (C, nx), imposed spin of the top less that of the bottom, 1/time; None if it is nowhere 0.

    Such a state is a loop of slipless contacts around which torque can circulate; contacts along the axis of a
    component carry none of its torque. In each connected piece one force is unknown for each slipless contact, and all
    nodes but one give an equation of balance. Therefore the number is contacts - (nodes - pieces). Spheres of the top
    without a jump count as the bottom: torque that passes between the two does no work.
    """
    states = []
    for slot, component in enumerate(spin_axes):
        body = network.body.reshape(network.shape).copy()
        if jump is not None:
            body[..., -1][jump[slot] == 0] = body.flat[0]
        ends = body.ravel()[network.ends[:, network.axis != component]]
        nodes = np.unique(ends)
        states.append(ends.shape[1] - (len(nodes) - len(np.unique(pieces(network.bodies, *ends)[nodes]))))
    return np.array(states)
