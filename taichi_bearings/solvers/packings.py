"""Dynamics and descent of any packing: the methods of scenes, over contacts in lists."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.fields import Fields, team_size
from taichi_bearings.fields.lists import ListSpec
from taichi_bearings.kernels.contact_list import CundallStrackLists, DescentLists
from taichi_bearings.kernels.team import Team, made_once
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.packing.answer import SLIPLESS, SLIPPING, UNDECIDED, judged
from taichi_bearings.packing.packing import Packing
from taichi_bearings.packing.system import Found
from taichi_bearings.proof.contact_state import classify, decided, what_is_proven
from taichi_bearings.scene import Bearing, Progress, Solution, Status
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.cundall_strack import CundallStrackMethod, largest_step
from taichi_bearings.solvers.drive import Checkpoints, Monitor, solve
from taichi_bearings.solvers.gradient_descent import GradientDescentMethod
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.network import Network
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import MethodOptions

LOOK_AGAIN = 1.2  # times the iterations after which bounds that cost a factorisation were looked for
OF_BOUND = ("scene.proven", "scene.witness", "scene.looked")  # what the further course of a dynamics depends on beside


class OnNetwork(Method):
    """What a method asks of contacts in lists. Fields hold of each T f and what is along its tangents."""

    scene: Any

    def carried(self, network: Any, spin: np.ndarray) -> tuple[int, ...]:
        return network.minimum_spin_axes

    def inertias(self, network: Any) -> np.ndarray:
        return network.inertias(self.options.mass, self.options.inertia)

    def specified(self, spheres: dict[str, int], contacts: list[str]) -> ListSpec:
        across, components = self.scene.across, self.scene.components
        counts = {"force": components, "coefficient": 1, "viscosity": 1, "work": 1}
        counts["across"] = 6 if components == 3 else 0
        names = (*contacts, *self.of_law, "across")
        return tuple(spheres.items()), tuple((name, counts.get(name, len(across))) for name in names)

    def on_device(self, spec: Any) -> Fields:
        return Fields(self.scene.lists, spec)

    def use(self, spec: Any, viscosity: np.ndarray | None) -> None:
        fields, across = self.on_device(spec), self.scene.across
        self.spec, self.fields = spec, fields
        if self.scene.components == 3:
            fields.load("across", across.transpose(0, 2, 1).reshape(6, 1, -1))
        fields.load("coefficient", self.scene.acting_coefficient[None])
        if viscosity is not None:
            fields.load("viscosity", viscosity[None])

    def sweeps_of(self, kind: type, corrector: tuple[float, ...]) -> tuple[Team, Any]:
        """Workers and kernels of a kind. corrector : of Gear's method."""
        team = Team(team_size(self.fields.layout, sum(count for _, count in self.spec[0])))
        return team, made_once(kind, self.spec, self.scene.law.name, corrector)

    def read_forces(self, name: str) -> np.ndarray:
        found = self.fields.read(name)
        return np.einsum("kre,tek->tre", found, self.scene.across) if name == "force" else found

    def differences(self, staggered: np.ndarray) -> np.ndarray:
        return self.scene.differences(staggered)

    def pulls(self, force: np.ndarray) -> np.ndarray:
        return self.scene.pulls(force)

    def absolute(self, staggered: np.ndarray) -> np.ndarray:
        return staggered

    def proven_by(self, force: np.ndarray) -> np.ndarray:
        return np.array([self.scene.proven_again(force)])

    def judged(
        self, staggered: np.ndarray, force: np.ndarray, proof: np.ndarray | None = None, **more: Any
    ) -> Progress:
        scene: Network = self.scene
        objective = scene.law.objective(scene.material, scene.slips(staggered)).sum(axis=1)
        whole = not scene.looked < more["iteration"] < LOOK_AGAIN * scene.looked
        scene.looked = more["iteration"] if whole else scene.looked
        bound, proof = scene.bound(force if proof is None else proof, staggered, whole)
        bound = min(bound, float(objective[0]))
        if bound >= scene.proven:
            scene.proven, scene.witness = bound, staggered
        left = np.abs(scene.pulls(force))[..., ~scene.lattice.is_driven].max(initial=0.0)
        return Progress(
            staggered=staggered, spin_axes=self.spin_axes, force=force, objective=objective, proof=proof,
            lower_bound=np.array([bound]), largest_balance_residual=np.array([left]), **more,
        )  # fmt: skip

    def answered(self, course: Any) -> Solution:
        """The best state and the best forces; `force`, the states of a dynamics, and those of parts that nothing drives
        are those of now."""
        network, row, stop, last = self.scene, self.options, course.stop, course.best.progress
        system = network.proof[0]
        value, forces = network.bound(last.force if last.proof is None else last.proof, last.staggered, whole=True)
        proof = forces if value > course.best.bound[0] else course.best.proof
        found = Found(
            np.zeros(system.unknowns), proof[:, 0, network.of_system], row.name, everywhere=last.staggered[:, 0].T
        )
        result = judged(system, found, stop.tolerance, row.is_dynamics)
        force, told, slip = result.force.copy(), result.state.copy(), result.slip[0]
        force[:, network.acting] = vector_length(last.force)
        loose = np.setdiff1d(network.acting, system.contact)
        told[0, loose] = np.where(slip[loose] > last.resolution, SLIPPING, SLIPLESS)
        if network.law.holds:
            now = result.slip[:, network.acting], last.force, float(np.max(last.resolution))
            told[:, network.acting] = classify(network, *now)
        if not network.law.holds:  # sum eta |slip - that of the minimum|^2 is no more than what is open of the power
            left = max(result.objective[0] - result.lower_bound[0], 0.0)
            apart = np.sqrt(left / network.acting_coefficient[0])
            told[0, network.acting[slip[network.acting] <= apart]] = UNDECIDED
        cut_short = np.isfinite(stop.duration) and course.status in (Status.STEP_LIMIT, Status.TIME_LIMIT)
        status = result.status if result.status is Status.CERTIFIED and not cut_short else course.ended_as(result)
        moves, known = row.is_dynamics and not network.law.flows, what_is_proven(result.state, result.proven)
        state, proven = decided(told, known, moves, has_ended=moves and result.status is Status.CERTIFIED)
        iterations = course.last.iteration
        return replace(result, status=status, iterations=iterations, force=force, state=state, proven=proven)


class CundallStrackOfPacking(OnNetwork, CundallStrackMethod):
    """An iteration is one time step. `is_free` holds 1 / inertia."""

    kept = (*CundallStrackMethod.kept, *OF_BOUND)
    unit_inertia = 1.0

    def _largest_step(self) -> float:
        """As of lattices, with a proven bound on the stiffest mode in the place of their known one."""
        network, options, decay = self.scene, self.options, 0.0
        if network.viscosities is not None:
            decay = network.largest_eigenvalue(network.viscosities[0], self.inertia)
        stiffest = network.largest_eigenvalue(np.ones(len(network.acting)), self.inertia)
        return largest_step(options, network.law.holds, decay, stiffest)

    def _kernels(self, corrector: tuple[float, ...]) -> Any:
        return self.sweeps_of(CundallStrackLists, corrector)

    def _load_force(self, force: np.ndarray) -> None:
        self.fields.load("force", np.einsum("tre,tek->kre", force, self.scene.across))

    def is_believed(self, found: Any) -> bool:
        """By the best bound so far; where none is proven as with static_ratio > 1."""
        if not self.scene.proven > 0:
            return not len(self.scene.acting) or self.time >= self._loading_time()
        return super().is_believed(replace(found, lower_bound=np.array([self.scene.proven])))


class GradientDescentOfPacking(OnNetwork, GradientDescentMethod):
    """An iteration is one sweep over all contacts."""

    resumes = False  # its network keeps forces and bounds of its own
    points, forces = ("point",), ("force",)

    def _kernels(self) -> Any:
        return self.sweeps_of(DescentLists, ())

    def weights(self, bounds: np.ndarray) -> np.ndarray:
        """At each sphere sum b_e P_e with P = T^T T is no larger than the diagonal matrix of its rows' sizes."""
        network: Network = self.scene
        rows = np.abs(np.einsum("tek,tel->ekl", network.across, network.across)).sum(axis=2) * bounds[0][:, None]
        total = np.zeros((network.packing.spheres, network.components))
        for end in network.packing.contact[network.acting].T:
            np.add.at(total, end, rows)
        return total.T[:, None]

    def _steer(self, staggered: np.ndarray, objective: np.ndarray, bound: np.ndarray) -> None:
        super()._steer(staggered, objective, np.maximum(bound, self.scene.proven))


def follow_packing(
    packing: Bearing,
    method: MethodOptions,
    start: str | np.ndarray,
    stop: StopRule,
    recording: Recording,
    density: Any = None,
    monitors: Sequence[Monitor] = (),
    checkpoints: Checkpoints | None = None,
) -> Solution:
    """A dynamics or descent of a packing. start, density : see :class:`Network`. Others : as of drive.solve."""
    if density is not None and not method.is_dynamics:
        raise InputError(f"density is given, but {method.name} has no use for it; dynamics have")
    assert isinstance(packing, Packing)
    network, built = Network(packing, density), method.build_for_packing()
    with one_thread():
        return solve(network, built, network.start(start), stop, monitors, None, recording, checkpoints)
