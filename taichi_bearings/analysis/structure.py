"""The structure of one sample, part by part; a part is computed when it is first asked for."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.analysis.domains import RigidDomains, rigid_domains
from taichi_bearings.analysis.network import SliplessNetwork, network_of
from taichi_bearings.analysis.torque_flow import TorqueFlow, saturation, self_stress, torque_flow
from taichi_bearings.lattice.grid import staggered_forces
from taichi_bearings.numerics.minimum_cut import minimum_cut
from taichi_bearings.proof.contact_state import ContactState, by_threshold, critical
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.scene.initial_spins import cut_unit, cut_weights, minimum_cut_spin


@dataclass(frozen=True)
class Interface:
    """The cheapest interface of two rigid domains of one sample: a minimum cut.

    If every sphere turned with the bottom or with the top, all slip would be at the interface of the two domains, and
    the lightest one would dissipate least. In 2D with Coulomb friction that is the minimum itself; in 3D, and for the
    viscous law, states between the two dissipate less (equations.md, 5).

    above : N, True for the spheres that turn with the top. contacts : (E,) True for those that slip.
    between : N, True for the spheres that another cut, as light (in 3D: to 1e-12), may put on the other side; if there
        are none every other interface is proven to dissipate more.
    power : energy/time, if the two domains are rigid. lower_bound : no two rigid domains dissipate less, or have less
        of what the stationary state minimises if that is not the power; proven.
    next_power : the same of the cheapest other interface that leaves either domain in one piece; NaN in 3D, where it is
        known only if grids are apart (see :func:`taichi_bearings.numerics.minimum_cut.next_cut`).
    """

    above: np.ndarray
    between: np.ndarray
    contacts: np.ndarray
    power: float
    lower_bound: float
    next_power: float


def find_interface(scene: Scene, replica: int = 0) -> Interface:
    """The cheapest interface of one sample: of the least power, or what else the stationary state minimises."""
    weight = cut_weights(scene)[[replica]]
    cut, unit = minimum_cut(scene.lattice.by_axis(weight)), cut_unit(scene)
    low, high = cut.above[0].ravel()[scene.lattice.ends]
    power = unit * float(cut.weight[0])
    if scene.law.minimises != "power":
        spin, axes = minimum_cut_spin(scene.sample(replica)), scene.lattice.all_spin_axes
        power = float(scene.sample(replica).power(scene.staggered_spin(spin, axes), axes)[0])
    return Interface(
        above=cut.above[0],
        between=cut.between[0],
        contacts=(low != high) & (weight[0] > 0) & (scene.jump > 0),  # without a jump nothing slips
        power=power,
        lower_bound=unit * float(cut.lower_bound[0]),
        next_power=unit * float(cut.next_weight[0]),
    )


@dataclass(frozen=True)
class Structure:
    """A solved sample and what its contacts form.

    scene : one sample (R = 1). spin : laboratory frame, (*N) or (*N, 3), 1/time.
    slip, state : (E,). power, lower_bound : energy/time.
    friction : laboratory frame, (E, 3), in 2D (E,).
    critical, tied : how many of the undecided contacts are known to be that.
    states_proven : True if `state` is proven to be that of every minimum. minimum_is_unique : None if it is not known.
    """

    scene: Scene
    spin: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    power: float
    lower_bound: float
    friction: np.ndarray
    critical: int = 0
    tied: int = 0
    states_proven: bool = False
    minimum_is_unique: bool | None = None

    @cached_property
    def force(self) -> np.ndarray:
        """Staggered contact forces, (C, E), of the components that the driving needs."""
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
    def rigid_domains(self) -> RigidDomains:
        axes = self.scene.minimum_spin_axes
        return rigid_domains(self.network, self.scene.staggered_spin(self.spin[None], axes)[:, 0], axes)

    def by_threshold(self, threshold: float) -> "Structure":
        """The sample with states as :func:`by_threshold` of contact states says."""
        state = by_threshold(self.slip, self.state, threshold)
        return replace(self, state=state, critical=0, tied=0, states_proven=False, minimum_is_unique=None)

    @cached_property
    def bottlenecks(self) -> Bottlenecks:
        return Bottlenecks(self.network)

    @cached_property
    def torque_flow(self) -> TorqueFlow:
        """How the driving torque goes through the sample."""
        top = self.scene.top_spin(self.scene.minimum_spin_axes)
        return torque_flow(self.scene.lattice, self.force, self.state, top)

    @property
    def mean_saturation(self) -> float | None:
        """Mean share of their friction limit that slipless contacts bear: not-a-number where there are none, None
        without a limit of friction."""
        if not self.scene.law.is_rate_independent:
            return None
        shares = saturation(self.force, self.scene.strength * self.scene.coefficient[0], self.state)
        return float(shares.mean()) if len(shares) else np.nan

    @cached_property
    def self_stress(self) -> int:
        """States of self-stress: how far the forces of slipless contacts are left open."""
        return int(self_stress(self.network, self.scene.minimum_spin_axes).sum())


def structure_of(solution: Solution, number: int = 0, threshold: float | None = None) -> Structure:
    """One sample of a solution, ready to be looked at.

    threshold : slip speed up to which contacts count as slipless, whatever the solution says. Default: its own states.
    """
    sample = solution.sample(number)
    found = Structure(
        scene=sample.scene,
        spin=sample.spin[0],
        slip=sample.slip[0],
        state=sample.state[0],
        power=float(sample.power[0]),
        lower_bound=float(sample.lower_bound[0]),
        friction=sample.friction[0],
        critical=int(critical(sample)[0]),
        tied=int(sample.findings.get("tied_contacts", [0])[0]),
        states_proven=bool(sample.states_proven[0]),
        minimum_is_unique=sample.minimum_is_unique[0],
    )
    return found if threshold is None else found.by_threshold(threshold)
