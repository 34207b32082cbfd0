"""Dynamics and descent of any packing: the methods of scenes, over contacts in lists."""

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.errors import DeviceError, InputError
from taichi_bearings.fields.lists import ListFields, ListSpec
from taichi_bearings.interrupts import Interrupt
from taichi_bearings.kernels.contact_list import CundallStrackLists, DescentLists, list_sweeps
from taichi_bearings.kernels.team import Team
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.packing.answer import SLIPLESS, SLIPPING, UNDECIDED, PackingSolution, judged
from taichi_bearings.packing.packing import Packing
from taichi_bearings.packing.system import Found
from taichi_bearings.scene import Snapshots, Status
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.cundall_strack import CundallStrackMethod, choose_time_step
from taichi_bearings.solvers.drive import Checkpoints, Course, Monitor
from taichi_bearings.solvers.dynamics import RestWatch
from taichi_bearings.solvers.gear import GEAR_COEFFICIENTS, largest_stable_step
from taichi_bearings.solvers.gradient_descent import GradientDescentMethod
from taichi_bearings.solvers.network import OF_BOUND, Network, OnNetwork
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import CundallStrack, MethodOptions
from taichi_bearings.stages import stage


class _OnLists(OnNetwork):
    """Forces in fields: T f of each contact, and what is along its tangents."""

    def _spec(self, spheres: dict[str, int], contacts: dict[str, int]) -> ListSpec:
        network: Network = self.scene
        contacts |= {"force": network.components, "coefficient": 1}
        contacts["across"] = 6 if network.components == 3 else 0
        if network.viscosity_beside_friction is not None:
            contacts["viscosity"] = 1
        return tuple(spheres.items()), tuple(contacts.items())

    def _load_contacts(self, fields: ListFields) -> None:
        network: Network = self.scene
        if network.components == 3:
            fields.load("across", network.across.transpose(0, 2, 1).reshape(6, 1, -1))
        fields.load("coefficient", network.acting_coefficient[None])
        if network.viscosity_beside_friction is not None:
            fields.load("viscosity", network.viscosity_beside_friction[None])


class CundallStrackOfPacking(_OnLists, CundallStrackMethod):
    """An iteration is one time step."""

    kept = (*CundallStrackMethod.kept, *OF_BOUND)

    def __init__(self, options: CundallStrack, density: Any = None) -> None:
        super().__init__(options)
        self.density = density

    def begin_on(self, network: Network, spins: np.ndarray) -> None:
        """spins : u (C, 1, N)."""
        options, c, d = self.options, network.components, len(network.across)
        self.scene, self.spin_axes = network, tuple(range(c))
        self.inertia: Any = network.inertias(options.mass, options.inertia, self.density)
        self.iteration, self.time, self.halted = 0, 0.0, False
        self.rest = RestWatch(*self.checks, np.full(1, np.inf))
        bound = self._stability_bound(network)
        self.stability_bound = bound if np.isfinite(bound) else 1.0  # where nothing acts any step is right
        self.time_step = choose_time_step(self.stability_bound, options.time_step)
        spheres = {f"gear_{n}": c for n in range(options.gear_order + 1)} | {"predicted": c, "is_free": 1}
        contacts = dict[str, int]()
        if network.law.holds:
            spheres, contacts = spheres | {"integral": c}, {"elongation": d}
        if options.energy:
            spheres, contacts = spheres | {"impulse": c}, contacts | {"work": 1}
        spec = self._spec(spheres, contacts)
        self.spec = (*spec[0], *spec[1])
        fields: Any = ListFields(network.lists, spec)
        self.fields = fields
        self._load_contacts(fields)
        self.fields.load("is_free", np.where(network.lattice.is_driven, 0.0, 1 / self.inertia)[None, None])
        self._load_gear(spins)
        self.team = Team(fields.team_size)
        steps: Any = list_sweeps(CundallStrackLists, spec, network.law.name, GEAR_COEFFICIENTS[options.gear_order])
        self.steps = steps
        steps.compile(self.fields, self.team)

    def _stability_bound(self, network: Network) -> float:
        """As of lattices, with a proven bound on the stiffest mode in the place of their known one."""
        options, decay = self.options, 0.0
        if network.viscosities is not None:
            decay = network.largest_eigenvalue(network.viscosities[0], self.inertia)
        if not network.law.holds:
            return largest_stable_step(options.gear_order, decay, 0.0)
        stiffest = network.largest_eigenvalue(np.ones(len(network.acting)), self.inertia)
        return largest_stable_step(options.gear_order, options.damping * stiffest + decay, options.stiffness * stiffest)

    def _response(self) -> float:
        return self.time_step

    def _load_force(self, force: np.ndarray) -> None:
        self.fields.load("force", np.einsum("tre,tek->kre", force, self.scene.across))

    def _contact_forces(self, name: str) -> np.ndarray:
        found = self.fields.read(name)
        return found if name == "elongation" else np.einsum("kre,tek->tre", found, self.scene.across)

    def findings(self) -> dict[str, np.ndarray]:
        return {}

    def is_believed(self, found: Any) -> bool:
        """By the best bound so far; where none is proven as with static_ratio > 1."""
        if not self.scene.proven > 0:
            return not len(self.scene.acting) or self.time >= self._loading_time()
        return super().is_believed(replace(found, lower_bound=np.array([self.scene.proven])))


class GradientDescentOfPacking(_OnLists, GradientDescentMethod):
    """An iteration is one sweep over all contacts; no box holds the spins, which on oblique networks would be wrong."""

    points = ("point",)

    def begin_on(self, network: Network, spins: np.ndarray) -> None:
        c, d = network.components, len(network.across)
        self.scene, self.spin_axes, self.box = network, tuple(range(c)), [0.0] * 6
        self.averages = network.law.holds and not self.momentum
        spheres, contacts = {"point": c, "inverse_weight": c}, dict[str, int]()
        if self.momentum:
            spheres["spin"] = c
        if self.averages:
            spheres, contacts = spheres | {"spin_sum": c}, {"force_sum": d}
        spec = self._spec(spheres, contacts)
        fields: Any = ListFields(network.lists, spec)
        self.fields = fields
        self._load_contacts(fields)
        self._load_spins(spins)
        self.viscosity = self._viscosity()
        self.team, self.sweeps = Team(fields.team_size), list_sweeps(DescentLists, spec, network.law.name, ())
        self._begin()

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

    def _averaged_force(self) -> np.ndarray:
        return self.fields.read("force_sum") / self.averaged


def follow_packing(
    packing: Packing,
    method: MethodOptions,
    start: str | np.ndarray,
    stop: StopRule,
    recording: Recording,
    density: Any = None,
    monitors: Sequence[Monitor] = (),
    checkpoints: Checkpoints | None = None,
) -> PackingSolution:
    """A dynamics or descent of a packing. start, density : see :class:`Network`. Others : as of drive.solve."""
    row = type(method)
    if density is not None and not row.is_dynamics:
        raise InputError(f"density is given, but {row.name} has no use for it; dynamics have")
    if row.cpu_only and runtime.current().is_gpu:
        raise DeviceError(f"{row.name} works in the memory of the CPU; use --arch cpu")
    begun, network = perf_counter(), Network(packing)
    built = method.build_for_packing(*([density] if row.is_dynamics else []))
    with Interrupt() as interrupt, one_thread():
        with stage("preparing"), interrupt.at_once():
            built.begin_on(network, network.start(start))
        if interrupt.heard:  # nothing is reached yet
            raise KeyboardInterrupt
        scene: Any = network
        course = Course(scene, built, stop, recording, checkpoints, interrupt)
        with stage("solving") as solving:
            status, last, seconds = course.follow([solving.tell, *monitors])
        found = _answer(network, course, row.name, stop.tolerance, begun)
    cut_short = np.isfinite(stop.duration) and status in (Status.STEP_LIMIT, Status.TIME_LIMIT)
    if found.status != Status.CERTIFIED.value or cut_short:
        found = replace(found, status=status.value)
    columns = {name: v[:, 0] if v.ndim == 2 else v for name, v in course.recorder.history().items()}
    kept = course.recorder.snapshots()
    snapshots = None if kept is None else Snapshots(kept.time, kept.spin[:, 0])
    found = replace(found, history=columns, snapshots=snapshots)
    return replace(found, time=last.time, seconds=seconds, iterations=last.iteration)


def _answer(network: Network, course: Course, name: str, tolerance: float, begun: float) -> PackingSolution:
    """The best state and the best forces; `force` and the states of parts that nothing drives are those of now."""
    system, best = network.proof[0], course.best
    last = best.progress
    value, forces = network.bound(last.force if last.proof is None else last.proof, last.staggered, whole=True)
    proof = forces if value > best.bound[0] else best.proof
    found = Found(np.zeros(system.unknowns), proof[:, 0, network.of_system], name, everywhere=last.staggered[:, 0].T)
    result = judged(system, found, tolerance, begun)
    force, state = result.force.copy(), result.state.copy()
    force[network.acting] = vector_length(last.force)[0]
    loose = np.setdiff1d(network.acting, system.contact)
    state[loose] = np.where(result.slip[loose] > last.resolution, SLIPPING, SLIPLESS)
    if not network.law.holds:  # sum eta |slip - that of the minimum|^2 is no more than what is open of the power
        apart = np.sqrt(max(result.potential - result.lower_bound, 0.0) / network.acting_coefficient[0])
        state[network.acting[result.slip[network.acting] <= apart]] = UNDECIDED
    return replace(result, force=force, state=state)
