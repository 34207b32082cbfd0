"""Dynamics and descent of any packing: the methods of scenes, over contacts in lists."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.fields import Fields, team_size
from taichi_bearings.fields.lists import Lists, ListSpec
from taichi_bearings.kernels.contact_list import CundallStrackLists, DescentLists
from taichi_bearings.kernels.team import Team, made_once
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.packing.answer import judged
from taichi_bearings.packing.found import Found
from taichi_bearings.packing.starts import start_of
from taichi_bearings.proof.contact_state import classify, decided, what_is_proven
from taichi_bearings.scene import Bearing, Progress, Solution, Status
from taichi_bearings.scene.packing import Packing
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, UNDECIDED
from taichi_bearings.solvers.cundall_strack import CundallStrackMethod, largest_step
from taichi_bearings.solvers.drive import Checkpoints, Monitor, solve
from taichi_bearings.solvers.gradient_descent import GradientDescentMethod
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.packing_bounds import PackingBounds
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import MethodOptions

LOOK_AGAIN = 1.2  # times the iterations after which bounds that cost a factorisation were looked for
OF_BOUND = ("bounds.proven", "bounds.witness", "bounds.looked")  # on which the further course of a dynamics depends


class OnLists(Method):
    """What a method asks of contacts in lists. Fields hold of each T f and what is along its tangents.

    bounds : what is proven of the packing. density : of its spheres, as of `Packing.inertias`.
    """

    bounds: PackingBounds
    density: Any = None

    @property
    def packing(self) -> Packing:
        """The scene: all contacts that act, and no others."""
        return cast(Packing, self.scene)

    def carried(self, scene: Bearing, spin: np.ndarray) -> tuple[int, ...]:
        return scene.minimum_spin_axes

    def inertias(self, scene: Bearing) -> Any:
        return self.packing.inertias(self.options.mass, self.options.inertia, self.density)

    @property
    def across(self) -> np.ndarray:
        """T, (d, E, C)."""
        return self.packing.network.tangents

    def specified(self, spheres: dict[str, int], contacts: list[str]) -> ListSpec:
        tangents, _, components = self.across.shape
        counts: dict[str, int] = {"force": components, "coefficient": 1, "viscosity": 1, "work": 1}
        counts["across"] = 6 if components == 3 else 0
        names = (*contacts, *self.of_law, "across")
        return tuple(spheres.items()), tuple((name, counts.get(name, int(tangents))) for name in names)

    def on_device(self, spec: Any) -> Fields:
        network = self.packing.network
        return Fields(Lists.of(network.spheres, network.contact.T), spec)

    def use(self, spec: Any, viscosity: np.ndarray | None) -> None:
        fields = self.on_device(spec)
        self.spec, self.fields = spec, fields
        if self.packing.network.components == 3:
            fields.load("across", self.across.transpose(0, 2, 1).reshape(6, 1, -1))
        fields.load("coefficient", self.scene.acting_coefficient[None])
        if viscosity is not None:
            fields.load("viscosity", viscosity[None])

    def sweeps_of(self, kind: type, corrector: tuple[float, ...]) -> tuple[Team, Any]:
        """Workers and kernels of a kind. corrector : of Gear's method."""
        team = Team(team_size(self.fields.layout, sum(count for _, count in self.spec[0])))
        return team, made_once(kind, self.spec, self.scene.law.name, corrector)

    def read_forces(self, name: str) -> np.ndarray:
        found = self.fields.read(name)
        return np.einsum("kre,tek->tre", found, self.across) if name == "force" else found

    def proven_by(self, force: np.ndarray) -> np.ndarray:
        return np.array([self.bounds.again(force)])

    def judged(
        self, staggered: np.ndarray, force: np.ndarray, proof: np.ndarray | None = None, **more: Any
    ) -> Progress:
        scene, bounds, axes = self.scene, self.bounds, self.spin_axes
        objective = scene.objective(staggered, axes)
        whole = not bounds.looked < more["iteration"] < LOOK_AGAIN * bounds.looked
        bounds.looked = more["iteration"] if whole else bounds.looked
        bound, proof = bounds.of(force if proof is None else proof, staggered, whole)
        bound = min(bound, float(objective[0]))
        bounds.take(bound, staggered)
        left = np.abs(self.pulls(force))[..., ~scene.is_driven].max(initial=0.0)
        return Progress(
            staggered=staggered, spin_axes=axes, force=force, objective=objective, proof=proof,
            lower_bound=np.array([bound]), largest_balance_residual=np.array([left]), **more,
        )  # fmt: skip

    def answered(self, course: Any) -> Solution:
        """The best state and the best forces; `force`, the states of a dynamics, and those of parts that nothing drives
        are those of now."""
        scene, bounds, row, stop, last = self.scene, self.bounds, self.options, course.stop, course.best.progress
        system, acting = bounds.system, bounds.acting
        value, forces = bounds.of(last.force if last.proof is None else last.proof, last.staggered, whole=True)
        proof = forces if value > course.best.bound[0] else course.best.proof
        found = Found(
            np.zeros(system.unknowns), proof[:, 0, bounds.of_system], row.name, everywhere=last.staggered[:, 0].T
        )
        result = judged(system, bounds.packing, found, stop.tolerance, row.is_dynamics)
        force, told, slip = result.force.copy(), result.state.copy(), result.slip[0]
        force[:, acting] = vector_length(last.force)
        loose = np.setdiff1d(acting, system.numbers)
        told[0, loose] = np.where(slip[loose] > last.resolution, SLIPPING, SLIPLESS)
        if scene.law.holds:
            now = result.slip[:, acting], last.force, float(np.max(last.resolution))
            told[:, acting] = classify(scene, *now)
        if not scene.law.holds:  # sum eta |slip - that of the minimum|^2 is no more than what is open of the power
            left = max(result.objective[0] - result.lower_bound[0], 0.0)
            apart = np.sqrt(left / scene.acting_coefficient[0])
            told[0, acting[slip[acting] <= apart]] = UNDECIDED
        cut_short = np.isfinite(stop.duration) and course.status in (Status.STEP_LIMIT, Status.TIME_LIMIT)
        status = result.status if result.status is Status.CERTIFIED and not cut_short else course.ended_as(result)
        moves, known = row.is_dynamics and not scene.law.flows, what_is_proven(result.state, result.proven)
        state, proven = decided(told, known, moves, has_ended=moves and result.status is Status.CERTIFIED)
        iterations = course.last.iteration
        return replace(result, status=status, iterations=iterations, force=force, state=state, proven=proven)


class CundallStrackOfPacking(OnLists, CundallStrackMethod):
    """An iteration is one time step. `is_free` holds 1 / inertia."""

    kept = (*CundallStrackMethod.kept, *OF_BOUND)
    unit_inertia = 1.0

    def _largest_step(self) -> float:
        """As of lattices, with a proven bound on the stiffest mode in the place of their known one."""
        scene, network, decay = self.packing, self.packing.network, 0.0
        if scene.viscosities is not None:
            decay = network.largest_eigenvalue(scene.viscosities[0], self.inertia)
        stiffest = network.largest_eigenvalue(np.ones(network.contacts), self.inertia)
        return largest_step(self.options, scene.law.holds, decay, stiffest)

    def _kernels(self, corrector: tuple[float, ...]) -> Any:
        return self.sweeps_of(CundallStrackLists, corrector)

    def _load_force(self, force: np.ndarray) -> None:
        self.fields.load("force", np.einsum("tre,tek->kre", force, self.across))

    def is_believed(self, found: Any) -> bool:
        """By the best bound so far; where none is proven as with static_ratio > 1."""
        if not self.bounds.proven > 0:
            return not self.packing.contacts or self.time >= self._loading_time()
        return super().is_believed(replace(found, lower_bound=np.array([self.bounds.proven])))


class GradientDescentOfPacking(OnLists, GradientDescentMethod):
    """An iteration is one sweep over all contacts."""

    resumes = False  # its bounds keep forces of their own
    points, forces = ("point",), ("force",)

    def _kernels(self) -> Any:
        return self.sweeps_of(DescentLists, ())

    def weights(self, bounds: np.ndarray) -> np.ndarray:
        """At each sphere sum b_e P_e with P = T^T T is no larger than the diagonal matrix of its rows' sizes."""
        network = self.packing.network
        rows = np.abs(np.einsum("tek,tel->ekl", self.across, self.across)).sum(axis=2) * bounds[0][:, None]
        total = np.zeros((network.spheres, network.components))
        for end in network.contact:
            np.add.at(total, end, rows)
        return total.T[:, None]

    def _steer(self, staggered: np.ndarray, objective: np.ndarray, bound: np.ndarray) -> None:
        super()._steer(staggered, objective, np.maximum(bound, self.bounds.proven))


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
    """A dynamics or descent of a packing. start : as of `start_of`. density : as of `Packing.inertias`. Others : as of
    drive.solve."""
    if density is not None and not method.is_dynamics:
        raise InputError(f"density is given, but {method.name} has no use for it; dynamics have")
    assert isinstance(packing, Packing)
    built: OnLists = method.build_for_packing()
    with one_thread():
        spins = start_of(packing, start)
        built.bounds, built.density = PackingBounds(packing), density
        scene = packing.as_stepped(spins, built.bounds.is_at_rest())
        given = scene.laboratory_spin(spins, scene.minimum_spin_axes)
        return solve(scene, built, given, stop, monitors, None, recording, checkpoints)
