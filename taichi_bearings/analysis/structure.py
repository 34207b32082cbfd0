"""The structure of one sample, part by part; a part is computed when it is first asked for."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.analysis.bottlenecks import Bottlenecks, find_bottlenecks
from taichi_bearings.analysis.domains import RigidDomains, rigid_domains
from taichi_bearings.analysis.interface import Interface, find_interface
from taichi_bearings.analysis.network import SliplessNetwork, network_of
from taichi_bearings.analysis.thresholds import View, view, views_by_threshold
from taichi_bearings.analysis.torque_flow import (
    ForceDistribution,
    FrictionLoad,
    SelfStress,
    TorqueFlow,
    force_distribution,
    friction_load,
    self_stress,
    torque_flow,
)
from taichi_bearings.lattice.grid import staggered_forces
from taichi_bearings.proof.contact_state import ContactState, critical
from taichi_bearings.scene import Scene, Solution


@dataclass(frozen=True)
class Structure:
    """A solved sample and what its contacts form.

    scene : one sample (R = 1). spin : laboratory frame, (*N) or (*N, 3), 1/time.
    slip, state : (E,). power, lower_bound : energy/time.
    friction : laboratory frame, (E, 3), in 2D (E,); None if it is not known.
    critical, tied : how many of the undecided contacts are known to be that.
    states_proven : True if `state` is proven to be that of every minimum. minimum_is_unique : None if it is not known.
    """

    scene: Scene
    spin: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    power: float
    lower_bound: float
    friction: np.ndarray | None = None
    critical: int = 0
    tied: int = 0
    states_proven: bool = False
    minimum_is_unique: bool | None = None

    @cached_property
    def staggered(self) -> np.ndarray:
        """Staggered spins (C, *N) of the components that the driving needs, 1/time."""
        return self.scene.staggered_spin(self.spin[None], self.scene.minimum_spin_axes)[:, 0]

    @cached_property
    def force(self) -> np.ndarray | None:
        """Staggered contact forces, (C, E), of these components."""
        if self.friction is None:
            return None
        return staggered_forces(self.friction[None], self.scene.lattice, self.scene.minimum_spin_axes)[:, 0]

    def contacts_in(self, which: ContactState) -> int:
        """Number of contacts in a state."""
        return int((self.state == which).sum())

    @cached_property
    def interface(self) -> Interface:
        """The cheapest interface of two rigid domains."""
        return find_interface(self.scene)

    @cached_property
    def network(self) -> SliplessNetwork:
        return network_of(self.scene.lattice, self.state)

    @cached_property
    def domains(self) -> RigidDomains:
        return rigid_domains(self.network, self.staggered, self.scene.minimum_spin_axes)

    @cached_property
    def view(self) -> View:
        """Network and domains in a few numbers, by the contact states."""
        return view(self.network, self.domains)

    @cached_property
    def views_by_threshold(self) -> list[View]:
        """The same by slip thresholds."""
        scene = self.scene
        return views_by_threshold(
            scene.lattice, self.slip, scene.lattice.radius * scene.jump, self.staggered, scene.minimum_spin_axes
        )

    @cached_property
    def bottlenecks(self) -> Bottlenecks:
        return find_bottlenecks(self.network)

    @cached_property
    def torque_flow(self) -> TorqueFlow | None:
        """How the driving torque goes through the sample; None without forces."""
        if self.force is None:
            return None
        scene = self.scene
        top = scene.top_spin(scene.minimum_spin_axes)
        return torque_flow(scene.lattice, scene.minimum_spin_axes, self.force, self.state, top)

    @cached_property
    def friction_load(self) -> FrictionLoad | None:
        """How close to slipping the contacts are; None without forces or without a limit of friction."""
        if self.force is None or not self.scene.law.is_rate_independent:
            return None
        return friction_load(
            self.scene.lattice, self.force, self.scene.strength * self.scene.coefficient[0], self.state
        )

    @cached_property
    def force_distribution(self) -> ForceDistribution | None:
        return None if self.force is None else force_distribution(self.force, self.state)

    @cached_property
    def self_stress(self) -> SelfStress:
        """How far the forces of slipless contacts are left open."""
        return self_stress(self.network, self.scene.minimum_spin_axes)


def structure_of(solution: Solution, number: int = 0, threshold: float | None = None) -> Structure:
    """One sample of a solution, ready to be looked at.

    threshold : slip speed up to which contacts count as slipless, whatever the solution says. Default: its own states.
    """
    sample = solution.sample(number)
    slip, state = sample.slip[0], sample.state[0]
    return Structure(
        scene=sample.scene,
        spin=sample.spin[0],
        slip=slip,
        state=state if threshold is None else states_by_threshold(slip, state, threshold),
        power=float(sample.power[0]),
        lower_bound=float(sample.lower_bound[0]),
        friction=sample.friction[0],
        critical=int(critical(sample)[0]) if threshold is None else 0,
        tied=int(sample.findings.get("tied_contacts", [0])[0]) if threshold is None else 0,
        states_proven=bool(sample.states_proven[0]) and threshold is None,
        minimum_is_unique=sample.minimum_is_unique[0] if threshold is None else None,
    )


def states_by_threshold(slip: np.ndarray, state: np.ndarray, threshold: float) -> np.ndarray:
    """Contacts (E,) that slip faster than the threshold slip, all others are slipless; those between driven spheres
    stay."""
    told = np.where(slip > threshold, ContactState.SLIPPING, ContactState.SLIPLESS)
    return np.where(state == ContactState.DRIVEN, state, told).astype(np.uint8)
