"""Cundall–Strack dynamics, the paper's second method: how the state of least dissipation is reached in time.

I dw/dt = sum of r x F (paper Eq. 10) with the spring-and-damper friction of Eqs. 7-9, integrated by Gear's method. The
power of the spins is an upper bound of the least power, and the spring forces, once balanced, give a lower one: a
dynamical run proves its own gap.
"""

from collections.abc import Mapping

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.fields import Fields, FieldSpec, team_size
from taichi_bearings.kernels.cundall_strack import cundall_strack_steps
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import Team
from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.proof.certificate import largest_unbalanced_torque, lower_bound, relative_gap
from taichi_bearings.scene import Energy, Progress, Scene
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.dynamics import (
    RestWatch,
    Saturation,
    absolute,
    default_inertia,
    elastic_share,
    kinetic_energy,
    moving_spin_axes,
    replica_sum,
)
from taichi_bearings.solvers.gear import (
    CORRECTORS,
    largest_laplacian_eigenvalue,
    largest_stable_step,
    largest_weighted_eigenvalue,
)
from taichi_bearings.solvers.step_error import Modes, StepError, laplacian_spectrum
from taichi_bearings.solvers.table import CundallStrack

DEFAULT_STEP = 0.8  # of the stability bound
BELIEVED = 1e-4  # proven gap from which a stationary state is believed to be one
SAME_FORCE = 1e-12  # relative: a contact this close to all the friction it can bear slips


class CundallStrackMethod:
    """See the module docstring. An iteration is one time step."""

    def __init__(self, options: CundallStrack) -> None:
        self.options = options
        self.aim = np.inf

    def plan(self, scene: Scene, spin: np.ndarray) -> FieldSpec:
        self.scene, self.spin_axes = scene, moving_spin_axes(scene, spin)
        components, dimension = len(self.spin_axes), scene.lattice.dimension
        forces = Stencil(self.spin_axes, dimension, 1).force_components
        spec = [(f"gear_{n}", components) for n in range(self.options.gear_order + 1)]
        spec += [("predicted", components), ("is_free", 1), ("force", forces), ("coefficient", dimension)]
        if scene.law.holds:
            spec += [("integral", components), ("elongation", forces)]
        if scene.viscosity:
            spec.append(("viscosity", dimension))
        if self.options.energy:
            spec += [("work", 1), ("impulse", components)]
        self.spec = tuple(spec)
        return self.spec

    def begin(self, scene: Scene, spin: np.ndarray, fields: Fields | None) -> None:
        assert fields is not None
        self.fields, layout, options = fields, fields.layout, self.options
        self.inertia = options.inertia or default_inertia(scene, options.mass)
        self.stability_bound = stability_bound(scene, self.spin_axes, options)
        self.time_step = choose_time_step(self.stability_bound, options.time_step)
        modes = sticking_modes(scene, self.spin_axes, options, float(np.abs(spin).max()), self.stability_bound)
        self.step_error = StepError(modes, options.gear_order, self.time_step)
        self.stencil = Stencil(self.spin_axes, scene.lattice.dimension, layout.block)
        self._load_gear(scene.staggered_spin(spin, self.spin_axes))
        is_free = np.broadcast_to(~scene.lattice.is_driven, (1, scene.replicas, *scene.lattice.shape))
        fields.load("is_free", is_free.astype(np.float64))
        fields.load("coefficient", layout.at_lower_sphere(scene.acting_coefficient))
        if scene.viscosity_beside_friction is not None:  # over the radius, as the force of the device law
            beside = layout.at_lower_sphere(scene.viscosity_beside_friction)
            fields.load("viscosity", scene.lattice.radius * beside)
        self.team = Team(team_size(layout, self.stencil.components + self.stencil.force_components))
        self.steps = cundall_strack_steps(self.spec, self.stencil, CORRECTORS[options.gear_order])
        self.steps.compile(fields, self.team)
        self.iteration = self.rest_check = 0
        self.rest = RestWatch(np.full(scene.replicas, np.inf))

    def _load_gear(self, staggered: np.ndarray) -> None:
        """Spins and their derivatives at the start, from the equation of motion. Without those of the sticking springs
        the first step would spoil the order of all that follow."""
        scene, options = self.scene, self.options
        derivatives, forces = [staggered], list[np.ndarray]()
        for n in range(1, options.gear_order + 1):
            forces.append(self._force_derivative(derivatives) / n)
            rate = scene.lattice.radius / self.inertia * torques(forces[-1], scene.lattice, self.spin_axes)
            rate[..., scene.lattice.is_driven] = 0.0
            derivatives.append(self.time_step * rate)
        for n, values in enumerate(derivatives):
            self.fields.load(f"gear_{n}", values)
        self.fields.load("predicted", np.sum(derivatives, axis=0))
        if scene.law.holds:
            self.fields.load("integral", np.sum([values / (n + 1) for n, values in enumerate(derivatives)], axis=0))
        if options.energy:
            self.fields.load("force", self.stencil.forces_at_lower_sphere(forces[0], self.fields.layout))
            self.energy_at_start = kinetic_energy(self.scene, staggered, self.spin_axes, self.inertia)
            self.power_at_start = self._contact_power(forces[0], staggered)
            self.pull_at_start = torques(forces[0], scene.lattice, self.spin_axes)

    def _force_derivative(self, derivatives: list[np.ndarray]) -> np.ndarray:
        """Derivative of the contact forces (C, R, E) at the start, scaled like the last of these of the spins, of the
        same order.

        A sticking contact feels its damper and the spring that the slip stretches from then on; one that slips keeps
        its force, apart from a turn of the slip in contacts with two components, which is left out.
        """
        scene, options, order = self.scene, self.options, len(derivatives) - 1
        if order == 0 or not scene.law.holds:
            return self._damping_force(derivatives[-1])
        stretch = options.stiffness * self.time_step / order
        felt = options.damping * derivatives[-1] + stretch * derivatives[-2]
        holds = options.static_ratio * scene.normal_force * scene.acting_coefficient
        sticks = options.damping * scene.slips(derivatives[0], self.spin_axes) <= holds
        felt = contact_differences(felt, scene.lattice, self.spin_axes)
        return self._with_viscosity(np.where(sticks, scene.lattice.radius * felt, 0.0), derivatives[-1])

    def _damping_force(self, staggered: np.ndarray) -> np.ndarray:
        """Forces (C, R, E) of unstretched contacts: their damper as far as friction holds it, and their viscosity."""
        scene, options = self.scene, self.options
        force = options.damping * scene.lattice.radius * contact_differences(staggered, scene.lattice, self.spin_axes)
        size, limit = vector_length(force), scene.normal_force * scene.acting_coefficient
        slips = size > limit * options.static_ratio
        force = force * np.divide(limit, size, out=np.ones_like(size), where=slips)
        return self._with_viscosity(force if scene.law.holds else np.zeros_like(force), staggered)

    def _with_viscosity(self, force: np.ndarray, staggered: np.ndarray) -> np.ndarray:
        """The forces and what the viscosity of the contacts, if they have any, adds at these spins."""
        scene = self.scene
        if scene.viscosities is None:
            return force
        return force + scene.lattice.radius * scene.viscosities * contact_differences(
            staggered, scene.lattice, self.spin_axes
        )

    @property
    def time(self) -> float:
        """Simulated time."""
        return self.iteration * self.time_step

    def aim_at(self, time: float) -> None:
        self.aim = time

    def next_check(self, iteration: int) -> int:
        wanted = int(np.ceil(self.aim / self.time_step * (1 - 1e-12))) if np.isfinite(self.aim) else np.inf
        return int(min(self._next_rest_check(), max(wanted, iteration + 1)))

    def _next_rest_check(self) -> int:
        """Iterations 100 and 1/16 of the run apart, whatever other states are looked at in between."""
        return self.rest_check + 100 + self.rest_check // 16

    def state(self) -> dict[str, np.ndarray]:
        fields = {name: self.fields.read(name) for name in self._changing_fields()}
        counters = [self.iteration, self.rest_check, self.rest.quiet_checks, self.rest.last_slipping]
        return fields | {
            "counters": np.array(counters, dtype=np.int64),
            "last_power": self.rest.last_objective,
            "time_step": np.array(self.time_step),
        }

    def _changing_fields(self) -> list[str]:
        return [name for name, _ in self.spec if name not in ("is_free", "coefficient", "viscosity")]

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        if float(state["time_step"]) != self.time_step:
            raise InputError(
                f"time_step is {self.time_step!r}, but the run to be resumed has {float(state['time_step'])!r}; "
                "it was made by another version or library"
            )
        for name in self._changing_fields():
            self.fields.load(name, state[name])
        self.iteration, self.rest_check, quiet_checks, last_slipping = map(int, state["counters"])
        self.rest = RestWatch(np.array(state["last_power"]), last_slipping, quiet_checks)

    def advance(self, steps: int) -> None:
        scene, options = self.scene, self.options
        radius = scene.lattice.radius
        numbers = (
            radius * self.time_step,
            options.stiffness,
            radius * (options.damping if scene.law.holds else 1.0),
            scene.normal_force,
            scene.normal_force * options.static_ratio,
            *options.after_slip(self.time_step),
            self.time_step * radius / self.inertia,
        )
        self.steps.run(self.fields, self.team, steps, numbers)
        self.iteration += steps

    def progress(self) -> Progress:
        scene = self.scene
        staggered = scene.impose_driving(self.fields.read("gear_0"), self.spin_axes)
        force = self._contact_forces("force") if self.iteration else self._damping_force(staggered)
        springs, longest = force, np.zeros(scene.replicas)
        if scene.law.holds:
            stretch = self._contact_forces("elongation")
            longest = vector_length(stretch).max(axis=1)
            springs = self._with_viscosity(self.options.stiffness * stretch, staggered)
        objective = scene.objective(staggered, self.spin_axes)
        bound = lower_bound(scene, springs, self.spin_axes)
        left_over = largest_unbalanced_torque(scene, force, self.spin_axes)
        saturation = Saturation.of(scene, force, scene.slips(staggered, self.spin_axes), SAME_FORCE)
        if self.iteration >= self._next_rest_check():
            self.rest_check = self.iteration
            believed, slipping = self._is_believed(objective, bound), int(saturation.slipping.sum())
            self.rest.look(scene, objective, slipping, force, left_over, self.options.rest_tolerance, believed)
        return Progress(
            iteration=self.iteration,
            staggered=staggered,
            spin_axes=self.spin_axes,
            force=force,
            objective=objective,
            lower_bound=bound,
            resolution=saturation.creep,
            largest_balance_residual=left_over,
            proof=springs,
            time=self.time,
            energy=self._energy(staggered, force) if self.options.energy else None,
            slipping=saturation.slipping,
            at_rest=self.rest.at_rest,
            findings={
                "step_error": np.full(scene.replicas, self.step_error.within(self.iteration)),
                "accurate_time_step": np.full(scene.replicas, self.step_error.accurate_step(self.iteration)),
                **elastic_share(scene, longest, self.time),
            },
        )

    def _contact_power(self, force: np.ndarray, staggered: np.ndarray) -> np.ndarray:
        """(R,) what the contacts take from the spins, over the radius."""
        return replica_sum(force * contact_differences(staggered, self.scene.lattice, self.spin_axes))

    def _energy(self, staggered: np.ndarray, force: np.ndarray) -> Energy:
        """The energy balance at the end of the last step.

        The powers of contacts and drive are integrated by the trapezoidal rule. The residual therefore is the error of
        the integration, of Gear's and of this rule.
        """
        scene, spring = self.scene, np.zeros(self.scene.replicas)
        if scene.law.holds:
            spring = self.options.stiffness / 2 * replica_sum(self._contact_forces("elongation") ** 2)
        reach = scene.lattice.radius * self.time_step
        ends = (self._contact_power(force, staggered) - self.power_at_start) / 2
        work = reach * (replica_sum(self.fields.read("work")) + ends)
        pull = self.fields.read("impulse") + (self.pull_at_start - torques(force, scene.lattice, self.spin_axes)) / 2
        return Energy(
            kinetic=kinetic_energy(self.scene, staggered, self.spin_axes, self.inertia),
            spring=spring,
            injected=-reach * replica_sum(pull * absolute(scene, staggered, self.spin_axes) * scene.lattice.is_driven),
            dissipated=work - spring,
            at_start=self.energy_at_start,
        )

    def _contact_forces(self, name: str) -> np.ndarray:
        return self.stencil.forces_of_contacts(self.fields.read(name), self.fields.layout)

    def _is_believed(self, objective: np.ndarray, bound: np.ndarray) -> bool:
        """Rest is believed only if the certificate agrees; with mu_s > mu_k, where it need not, only after the driven
        planes could have stretched the springs to slipping."""
        if self.options.static_ratio > 1:
            return self.time >= self._loading_time()
        return bool((relative_gap(self.scene, objective, bound) <= BELIEVED).all())

    def _loading_time(self) -> float:
        """Time in which the driven planes stretch a spring ten times as far as the strongest contact can hold."""
        scene = self.scene
        strongest = float(scene.acting_coefficient.max()) * self.options.static_ratio
        speed = scene.lattice.radius * scene.jump
        return 10 * scene.normal_force * strongest / (self.options.stiffness * speed) if speed > 0 else 0.0


def stability_bound(scene: Scene, spin_axes: tuple[int, ...], options: CundallStrack) -> float:
    """Largest stable time step while all contacts stick, from the stiffest mode of this lattice; slipping is softer."""
    inertia = options.inertia or default_inertia(scene, options.mass)
    over = scene.lattice.radius**2 / inertia
    decay = over * largest_weighted_eigenvalue(scene, spin_axes) if scene.law.flows else 0.0
    if not scene.law.holds:
        return largest_stable_step(options.gear_order, decay, 0.0)
    stiffest = over * largest_laplacian_eigenvalue(scene.lattice, spin_axes)
    return largest_stable_step(options.gear_order, options.damping * stiffest + decay, options.stiffness * stiffest)


def sticking_modes(
    scene: Scene, spin_axes: tuple[int, ...], options: CundallStrack, largest_spin: float, stable: float
) -> Modes:
    """The modes that tell the error of a time step.

    largest_spin : at the start, 1/time; the driven ones count too. stable : largest stable time step.
    """
    radius = scene.lattice.radius
    over = radius**2 / (options.inertia or default_inertia(scene, options.mass))
    spectrum = over * laplacian_spectrum(scene.lattice, spin_axes)
    if not scene.law.holds:  # all as much stiffer than with even contacts as the stiffest one, known by its bound
        stiffest = largest_stable_step(options.gear_order, 1.0, 0.0) / stable
        decay = stiffest * spectrum / (over * largest_laplacian_eigenvalue(scene.lattice, spin_axes))
        return Modes(decay, np.zeros_like(spectrum), 1.0, 0.0, np.inf)
    strongest = float(scene.acting_coefficient.max())
    holds = scene.normal_force * strongest * options.static_ratio
    fastest = max(largest_spin, scene.fastest, np.finfo(float).tiny)
    damping = options.damping
    if scene.viscosities is not None:
        damping += max(float(values.mean()) for values in scene.lattice.by_axis(scene.viscosities))
    return Modes(damping * spectrum, options.stiffness * spectrum, damping, options.stiffness, holds / radius / fastest)


def choose_time_step(bound: float, wanted: float | None) -> float:
    if wanted is None:
        return DEFAULT_STEP * bound
    if wanted > bound:
        raise InputError(f"time_step is {wanted:g}; this scene is stable only up to {bound:.6g}")
    return wanted
