"""Cundall–Strack dynamics with implicit steps: no stability limit, however stiff the contacts and long the steps.

The law of solvers/cundall_strack.py, integrated by the L-stable diagonally implicit Runge-Kutta method of order 2 with
two stages (Alexander, SIAM J. Numer. Anal. 14, 1977). In a stage of length g the force of a contact is F = K delta +
(K g + A) v, limited by friction, with the slip v at the end of the stage: a convex problem (friction_stage.py). Between
the stages the springs carry their elastic rate (delta at the end - delta at the base) / g, as in plasticity (Simo and
Hughes 1998), so that a contact that slips loads nothing. The difference to the first-order answer with the force of the
first stage alone is the error that chooses the step. Near rest nothing is left of it, steps grow by their largest
factor, and K g acts as the penalty of the method of multipliers: the proven gap falls to rounding in a few steps.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem, free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.friction_stage import Friction, FrictionStage, StageEnd
from taichi_bearings.conic.grouped import Arrays, Grouped, each, isotropic, where
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.errors import InputError
from taichi_bearings.fields import Fields, FieldSpec
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import dissect
from taichi_bearings.proof.certificate import largest_unbalanced_torque, lower_bound, relative_gap
from taichi_bearings.scene import Energy, Progress, Scene
from taichi_bearings.solvers.cundall_strack import BELIEVED
from taichi_bearings.solvers.dynamics import (
    RestWatch,
    Saturation,
    absolute,
    default_inertia,
    elastic_share,
    moving_spin_axes,
)
from taichi_bearings.solvers.table import ImplicitCundallStrack

GAMMA = 1 - np.sqrt(0.5)  # length of a stage in steps
SAFETY, SHRINK, GROW = 0.9, 0.2, 4.0  # of the step that the error allows, and limits to its change
REJECTED = 0.5  # change of a step whose error is too large, at most: in an event it may hardly fall with the step
RETREAT, MOST_RETREATS = 0.25, 40  # change of a step whose Newton iteration fails, and how often in a row
SPAN = 1e6  # a free step stretches no spring by more than so many times what friction holds: rounding of the forces
SAME_FORCE = 1e-9  # relative: a contact this close to all the friction it can bear slips
LATER = 1 / 16  # share of the run between two checks that count for rest


@dataclass
class _Sample:
    """One replica. spins : (unknowns,). elongation, force : (d, n) a group, at the end of the last step.

    work, injected : energy so far: of the contact forces on the slips, and of the driven spheres.
    """

    spins: np.ndarray
    elongation: Arrays
    force: Arrays
    work: float = 0.0
    injected: float = 0.0


class ImplicitCundallStrackMethod:
    """See the module docstring. An iteration is one time step, the same for all replicas."""

    def __init__(self, options: ImplicitCundallStrack) -> None:
        self.options = options
        self.aim = np.inf

    def plan(self, scene: Scene, spin: np.ndarray) -> FieldSpec:
        self.scene, self.spin_axes = scene, moving_spin_axes(scene, spin)
        return ()

    def begin(self, scene: Scene, spin: np.ndarray, fields: Fields | None) -> None:
        options = self.options
        self.inertia = options.inertia or default_inertia(scene, options.mass)
        self.system = lattice_system(scene.lattice, self.spin_axes, scene.top_spin(self.spin_axes))
        self.imposed = _imposed(scene, self.system, self.spin_axes)
        at_rest = np.zeros((len(self.spin_axes), 1, *scene.lattice.shape))
        self.bottom_spins = free_spins(absolute(scene, at_rest, self.spin_axes))[0]
        staggered = scene.staggered_spin(spin, self.spin_axes)
        self._set_stage(float(np.abs(staggered).max()) or 1.0)
        free = free_spins(staggered)
        self.samples = [self._sample_at(replica, spins.copy()) for replica, spins in enumerate(free)]
        self.energy_at_start = np.array([self._kinetic_energy(sample) for sample in self.samples])
        self.time, self.iteration, self.halted = 0.0, 0, False
        longest = self._longest_step()
        if options.time_step is not None and options.time_step > longest:
            raise InputError(f"time_step is {options.time_step:g}; rounding allows at most {longest:.3g} in this scene")
        self.time_step = options.time_step or self._first_step()
        self.rest_check, self.rest_check_time = 0, 0.0
        self.rest = RestWatch(np.full(scene.replicas, np.inf))
        with one_thread():  # once for all, so that the kernels are compiled before the clock starts
            self.stage.matrix.factorise(isotropic(self.system.offset), 1.0)

    def _set_stage(self, spin_scale: float) -> None:
        scene = self.scene
        matrix = NewtonMatrix(self.system, dissect(scene.lattice.free_shape, self.spin_axes))
        replicas = range(scene.replicas)
        self.strength = [
            scene.strength * self.system.gather(scene.positive_coefficient, replica) for replica in replicas
        ]
        flow = scene.viscosity_beside_friction
        self.viscosity = [None if flow is None else self.system.gather(flow, r) for r in replicas]
        strongest = max(strength.max() for strength in self.strength)
        if not scene.law.holds:
            strongest *= scene.lattice.radius * spin_scale
        conserved = _conserved_modes(scene, self.spin_axes)
        self.stage = FrictionStage(self.system, matrix, scene.lattice.radius, conserved, spin_scale, strongest)

    def _friction(self, replica: int, span: float) -> Friction:
        """Law of the contacts in a stage of length `span`, time; 0 for the forces of the present slips."""
        strength, inertia = self.strength[replica], self.inertia / span if span > 0 else np.inf
        if not self.scene.law.holds:
            return Friction(each(np.full_like, strength, np.inf), strength, inertia)
        resistance = self.options.stiffness * span + self.options.damping
        resisting = each(np.full_like, strength, resistance)
        return Friction(strength, resisting, inertia, self.viscosity[replica])

    def _sample_at(self, replica: int, spins: np.ndarray) -> _Sample:
        """At the start: no spring is stretched."""
        friction, radius = self._friction(replica, 0.0), self.scene.lattice.radius
        slip = radius * self.system.differences(spins)
        force = friction.limited(friction.resistance * slip)
        if friction.viscosity is not None:
            force = force + friction.viscosity * slip
        return _Sample(spins, each(np.zeros_like, force), force)

    def _first_step(self) -> float:
        """Spins change by the tolerated error, and it is not long against the time scale of the stiffest contact."""
        scene, radius = self.scene, self.scene.lattice.radius
        if scene.law.holds:
            longest = np.sqrt(self.inertia / self.options.stiffness) / radius
        else:
            longest = self.inertia / (radius**2 * float(scene.coefficient.max()))
        fastest = max(_mean_size(radius / self.inertia * self.system.torques(s.force)) for s in self.samples)
        change = self.options.error_tolerance * self.stage.spin_scale
        return min(longest, change / fastest) if fastest > 0 else longest

    def _longest_step(self) -> float:
        if not self.scene.law.holds:
            return np.inf
        reach = self.options.stiffness * self.scene.lattice.radius * self.stage.spin_scale
        return SPAN * self.stage.force_scale / reach

    def aim_at(self, time: float) -> None:
        self.aim = time

    def next_check(self, iteration: int) -> int:
        return iteration + 1 if np.isfinite(self.aim) else self._next_rest_check()

    def _next_rest_check(self) -> int:
        return self.rest_check + 1 + self.rest_check // 32

    def advance(self, steps: int) -> None:
        with one_thread():  # fronts are shared among threads here, not inside the library
            for _ in range(steps):
                self._step()
                if self.halted:
                    return
                self.iteration += 1

    def _step(self) -> None:
        """One accepted step: as long as planned, unless the aim, the error or Newton's method asks for less."""
        left, planned, most = self.aim - self.time, self.time_step, GROW
        fixed = self.options.time_step is not None
        for _ in range(MOST_RETREATS):
            arrives = 0 < left <= planned * (1 + 1e-12)
            span = left if arrives else planned
            tried = [self._tried(replica, sample, span) for replica, sample in enumerate(self.samples)]
            found = [new for new in tried if new is not None]
            if len(found) < len(tried):
                planned, most = RETREAT * span, 1.0
                continue
            error = max(new[1] for new in found) / (self.options.error_tolerance * self.stage.spin_scale)
            factor = float(np.clip(SAFETY / np.sqrt(max(error, 1e-300)), SHRINK, most))
            if fixed or not error > 1:
                break
            planned, most = min(factor, REJECTED) * span, 1.0
        else:
            self.halted = True
            return
        self.samples = [new for new, _ in found]
        self.time = self.aim if arrives else self.time + span
        if not fixed:
            self.time_step = min(max(factor * span, planned if arrives else 0.0), self._longest_step())

    def _tried(self, replica: int, sample: _Sample, span: float) -> tuple[_Sample, float] | None:
        """The sample after a step and the error (root mean square of the spins); None if a stage cannot be solved."""
        self.stage.begin_step()
        stage, share = GAMMA * span, (1 - GAMMA) / GAMMA
        friction = self._friction(replica, stage)
        first = self._stage(friction, sample.spins, sample.elongation, sample.spins)
        if first is None:
            return None
        end, elongation = first
        base = sample.spins + share * (end.spins - sample.spins)
        stretched = sample.elongation + share * (elongation - sample.elongation)
        second = self._stage(friction, base, self._bearable(friction, stretched), end.spins)
        if second is None:
            return None
        last, elongation = second
        force = (1 - GAMMA) * end.force + GAMMA * last.force
        error = _mean_size((last.spins - base) - (end.spins - sample.spins))
        return self._booked(sample, _Sample(last.spins, elongation, last.force), force, span), error

    def _stage(
        self, friction: Friction, base: np.ndarray, elongation: Arrays, guess: np.ndarray
    ) -> tuple[StageEnd, Arrays] | None:
        """End of a stage, and the elongations there: of a spring that slips, what its force alone stretches it to."""
        if not self.scene.law.holds:
            end = self.stage.solve(friction, base, each(np.zeros_like, elongation), guess)
            return None if end is None else (end, elongation)
        stiffness, damping = self.options.stiffness, self.options.damping * self.scene.lattice.radius
        end = self.stage.solve(friction, base, stiffness * elongation, guess)
        if end is None:
            return None
        stuck = (end.held - damping * self.system.differences(end.spins)) / stiffness
        of_force, of_past = self.options.after_slip(self.inertia / friction.inertia)
        return end, where(end.slips, of_force * end.held + of_past * elongation, stuck)

    def _bearable(self, friction: Friction, elongation: Arrays) -> Arrays:
        """Springs pull no harder than friction holds: one that has begun to slip is not stretched any further."""
        if not self.scene.law.holds:
            return elongation
        stiffness = self.options.stiffness
        return friction.limited(stiffness * elongation) / stiffness

    def _booked(self, old: _Sample, new: _Sample, force: Arrays, span: float) -> _Sample:
        """The new sample with the work that the mean force of the step has done on the mean slip."""
        reach, mean = self.scene.lattice.radius * span, (old.spins + new.spins) / 2
        work, injected = (force * self.system.differences(mean)).sum(), (force * self.imposed).sum()
        return replace(new, work=old.work + reach * work, injected=old.injected + reach * injected)

    def _kinetic_energy(self, sample: _Sample) -> float:
        absolute = sample.spins + self.bottom_spins
        return self.inertia / 2 * float(absolute @ absolute)

    def _spring_energy(self, sample: _Sample) -> float:
        return self.options.stiffness / 2 * (sample.elongation * sample.elongation).sum()

    def _energy(self) -> Energy:
        spring = np.array([self._spring_energy(sample) for sample in self.samples])
        return Energy(
            kinetic=np.array([self._kinetic_energy(sample) for sample in self.samples]),
            spring=spring,
            injected=np.array([sample.injected for sample in self.samples]),
            dissipated=np.array([sample.work for sample in self.samples]) - spring,
            at_start=self.energy_at_start,
        )

    def progress(self) -> Progress:
        scene, stiffness = self.scene, self.options.stiffness
        staggered = np.zeros((len(self.spin_axes), scene.replicas, *scene.lattice.shape))
        force, springs = np.zeros((2, len(self.spin_axes), scene.replicas, scene.lattice.all_contacts))
        for replica, sample in enumerate(self.samples):
            place_free_spins(staggered, replica, sample.spins)
            self.system.scatter_vectors(sample.force, force, replica)
            pulls, viscosity = stiffness * sample.elongation, self.viscosity[replica]
            if viscosity is not None:
                pulls = pulls + viscosity * scene.lattice.radius * self.system.differences(sample.spins)
            self.system.scatter_vectors(pulls, springs, replica)
        scene.impose_driving(staggered, self.spin_axes)
        objective = scene.objective(staggered, self.spin_axes)
        proof = springs if scene.law.holds else force
        bound = lower_bound(scene, proof, self.spin_axes)
        left_over = largest_unbalanced_torque(scene, force, self.spin_axes)
        saturation = Saturation.of(scene, force, scene.slips(staggered, self.spin_axes), SAME_FORCE)
        if self.iteration >= self._next_rest_check():
            self.rest_check = self.iteration
            if self.time >= self.rest_check_time * (1 + LATER):
                self.rest_check_time = self.time
                believed = bool((relative_gap(scene, objective, bound) <= BELIEVED).all())
                slipping = int(saturation.slipping.sum())
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
            proof=proof,
            time=self.time,
            energy=self._energy(),
            slipping=saturation.slipping,
            at_rest=self.rest.at_rest,
            halted=self.halted,
            findings=elastic_share(scene, np.array([s.elongation.length().max() for s in self.samples]), self.time),
        )

    def state(self) -> dict[str, np.ndarray]:
        state = {
            "spins": np.stack([sample.spins for sample in self.samples]),
            "books": np.array([[sample.work, sample.injected] for sample in self.samples]),
            "energy_at_start": self.energy_at_start,
            "clock": np.array([self.time, self.time_step, self.rest_check_time]),
            "counters": np.array([self.iteration, self.rest_check, self.rest.quiet_checks, self.rest.last_slipping]),
            "last_power": self.rest.last_objective,
            "spin_scale": np.array(self.stage.spin_scale),
        }
        for name in ("elongation", "force"):
            samples = zip(*(getattr(sample, name) for sample in self.samples), strict=True)
            state |= {f"{name}_{group}": np.stack(values) for group, values in enumerate(samples)}
        return state

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        self.samples = []
        for replica, spins in enumerate(state["spins"]):
            elongation, force = (
                Grouped(np.array(state[f"{name}_{group}"][replica]) for group in range(len(self.system.groups)))
                for name in ("elongation", "force")
            )
            self.samples.append(_Sample(np.array(spins), elongation, force, *map(float, state["books"][replica])))
        self.energy_at_start = np.array(state["energy_at_start"])
        self.time, self.time_step, self.rest_check_time = map(float, state["clock"])
        self.iteration, self.rest_check, quiet_checks, last_slipping = map(int, state["counters"])
        self.rest = RestWatch(np.array(state["last_power"]), last_slipping, quiet_checks)
        self._set_stage(float(state["spin_scale"]))


def _imposed(scene: Scene, system: ContactSystem, spin_axes: tuple[int, ...]) -> Arrays:
    """What the driven spheres, as they turn in the laboratory, add to the differences: (d, n) a group."""
    at_rest = np.zeros((len(spin_axes), 1, *scene.lattice.shape))
    spins = absolute(scene, scene.impose_driving(at_rest, spin_axes), spin_axes).reshape(len(spin_axes), -1)
    lower, upper = scene.lattice.ends
    return Grouped(
        spins[places.slot, upper[places.contact]] * (group.above < 0)
        - spins[places.slot, lower[places.contact]] * (group.below < 0)
        for group, places in zip(system.groups, system.places, strict=True)
    )


def _conserved_modes(scene: Scene, spin_axes: tuple[int, ...]) -> np.ndarray:
    """(layers, spheres) unknowns of the component about the height of a cubic lattice, whose mean contacts conserve."""
    lattice = scene.lattice
    if lattice.dimension == 2 or lattice.height_axis not in spin_axes:
        return np.zeros((0, 0), dtype=np.int64)
    spheres = np.arange(np.prod(lattice.free_shape)).reshape(-1, lattice.free_shape[-1]).T
    return spheres * len(spin_axes) + spin_axes.index(lattice.height_axis)


def _mean_size(values: np.ndarray) -> float:
    """Root mean square; 0 of nothing."""
    return float(np.sqrt((values * values).mean())) if values.size else 0.0
