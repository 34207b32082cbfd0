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
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.friction_stage import Friction, FrictionStage, StageEnd
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.errors import InputError
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import dissect
from taichi_bearings.scene import Scene
from taichi_bearings.solvers.dynamics import ENERGY_NAMES, WATCH_NAMES, SpringDynamics

GAMMA = 1 - np.sqrt(0.5)  # length of a stage in steps
ERROR_SAFETY, SHRINK, GROW = 0.9, 0.2, 4.0  # of the step that the error allows, and limits to its change
# change of a step whose error is too large, at most: in an event it may hardly fall with the step
REJECTED_CHANGE = 0.5
FAILED_CHANGE, MOST_RETREATS = 0.25, 40  # change of a step whose Newton iteration fails, and how often in a row
# a free step stretches no spring by more than so many times what friction holds: rounding of the forces
MOST_STRETCH = 1e6


@dataclass(frozen=True)
class _Tried:
    """A step of one replica. spins : (unknowns,). elongation, force : (d, n), at its end.

    mean_force : during the step. error : of the spins, root mean square.
    """

    spins: np.ndarray
    elongation: np.ndarray
    force: np.ndarray
    mean_force: np.ndarray
    error: float


class ImplicitCundallStrackMethod(SpringDynamics):
    """See the module docstring. An iteration is one time step, the same for all replicas.

    staggered : (C, R, *N). elongation, force : (C, R, E), at the end of the last step.
    """

    kept = ("time_step", "spin_scale", "staggered", "elongation", "force", *ENERGY_NAMES, *WATCH_NAMES)
    same_force, checks = 1e-9, (1, 32, 1 / 16)

    def begin(self, scene: Scene, spin: np.ndarray) -> None:
        super().begin(scene, spin)
        axes = self.spin_axes
        self.system: Any = lattice_system(scene.lattice, axes, scene.top_spin(axes))
        self._begin(scene.staggered_spin(spin, axes))

    def driven(self, staggered: np.ndarray) -> np.ndarray:
        """The spins (C, R, *N) with those that are imposed."""
        return self.scene.impose_driving(staggered, self.spin_axes)

    def _begin(self, staggered: np.ndarray, spin_scale: float = 0.0) -> None:
        """From these spins (C, R, *N), with springs that nothing stretches. spin_scale : what counts as large, 1/time,
        if not the largest of them."""
        options = self.options
        self.spin_scale = spin_scale or float(np.abs(staggered).max()) or 1.0
        self.staggered = self.driven(staggered)
        self._set_stage()
        self.force = self.damping_force(self.staggered)
        self.elongation = np.zeros_like(self.force)
        self.open_books(self.staggered)
        longest = self._longest_step()
        if options.time_step is not None and options.time_step > longest:
            raise InputError(f"time_step is {options.time_step:g}; rounding allows at most {longest:.3g} in this scene")
        self.time_step = options.time_step or self._first_step()
        with one_thread():  # once for all, so that the kernels are compiled before the clock starts
            self.stage.matrix.factorise(isotropic(self.system.offset), 1.0)

    def free_spins(self, staggered: np.ndarray) -> np.ndarray:
        """(R, unknowns)."""
        return free_spins(staggered)

    def place_free_spins(self, staggered: np.ndarray, replica: int, spins: np.ndarray) -> None:
        place_free_spins(staggered, replica, spins)

    def _matrix(self) -> Any:
        return NewtonMatrix(self.system, dissect(self.scene.lattice, self.spin_axes))

    def _conserved(self) -> np.ndarray:
        """(layers, spheres) unknowns of the component about the height of a cubic lattice, whose mean no contact
        changes."""
        lattice, axes = self.scene.lattice, self.spin_axes
        if lattice.dimension == 2 or lattice.height_axis not in axes:
            return np.zeros((0, 0), dtype=np.int64)
        spheres = np.arange(np.prod(lattice.free_shape)).reshape(-1, lattice.free_shape[-1]).T
        return spheres * len(axes) + axes.index(lattice.height_axis)

    @property
    def unit_inertia(self) -> float:
        """Of the unknowns."""
        return self.inertia

    def _set_stage(self) -> None:
        scene, matrix = self.scene, self._matrix()
        self.strength = scene.strength * scene.positive_coefficient[:, self.system.contact]
        flow = scene.viscosity_beside_friction
        self.viscosity = None if flow is None else flow[:, self.system.contact]
        strongest = float(self.strength.max(initial=0.0))
        if not scene.law.holds:
            strongest *= scene.lattice.radius * self.spin_scale
        self.stage = FrictionStage(
            self.system, matrix, scene.lattice.radius, self._conserved(), self.spin_scale, strongest
        )

    def _friction(self, replica: int, span: float) -> Friction:
        """Law of the contacts in a stage of length `span`, time."""
        strength, inertia = self.strength[replica], self.unit_inertia / span
        if not self.scene.law.holds:
            return Friction(np.full_like(strength, np.inf), strength, inertia)
        resistance = self.options.stiffness * span + self.options.damping
        viscosity = None if self.viscosity is None else self.viscosity[replica]
        return Friction(strength, np.full_like(strength, resistance), inertia, viscosity)

    def _first_step(self) -> float:
        """Spins change by the tolerated error, and it is not long against the time scale of the stiffest contact."""
        scene, radius = self.scene, self.scene.lattice.radius
        if scene.law.holds:
            longest = np.sqrt(self.unit_inertia / self.options.stiffness) / radius
        else:
            longest = self.unit_inertia / (radius**2 * float(scene.coefficient.max()))
        forces = (self.system.gather_vectors(self.force, replica) for replica in range(scene.replicas))
        fastest = max(_mean_size(radius / self.unit_inertia * self.system.torques(force)) for force in forces)
        change = self.options.error_tolerance * self.stage.spin_scale
        return min(longest, change / fastest) if fastest > 0 else longest

    def _longest_step(self) -> float:
        if not self.scene.law.holds:
            return np.inf
        reach = self.options.stiffness * self.scene.lattice.radius * self.stage.spin_scale
        return MOST_STRETCH * self.stage.force_scale / reach

    def next_check(self, iteration: int) -> int:
        return iteration + 1 if np.isfinite(self.aim) else self.rest.next_check

    def _step(self) -> None:
        """One accepted step: as long as planned, unless the aim, the error or Newton's method asks for less."""
        left, planned, most = self.aim - self.time, self.time_step, GROW
        fixed = self.options.time_step is not None
        for _ in range(MOST_RETREATS):
            arrives = 0 < left <= planned * (1 + 1e-12)
            span = left if arrives else planned
            tried = [self._tried(*sample, span) for sample in enumerate(self.free_spins(self.staggered))]
            found = [new for new in tried if new is not None]
            if len(found) < len(tried):
                planned, most = FAILED_CHANGE * span, 1.0
                continue
            error = max(new.error for new in found) / (self.options.error_tolerance * self.stage.spin_scale)
            factor = float(np.clip(ERROR_SAFETY / np.sqrt(max(error, 1e-300)), SHRINK, most))
            if fixed or not error > 1:
                break
            planned, most = min(factor, REJECTED_CHANGE) * span, 1.0
        else:
            self.halted = True
            return
        self._take(found, span)
        self.time = self.aim if arrives else self.time + span
        if not fixed:
            self.time_step = min(max(factor * span, planned if arrives else 0.0), self._longest_step())

    def _take(self, found: list[_Tried], span: float) -> None:
        before, self.staggered = self.staggered, self.staggered.copy()
        self.elongation, self.force, mean = np.zeros((3, *self.force.shape))
        for replica, new in enumerate(found):
            self.place_free_spins(self.staggered, replica, new.spins)
            self.system.scatter_vectors(new.elongation, self.elongation, replica)
            self.system.scatter_vectors(new.force, self.force, replica)
            self.system.scatter_vectors(new.mean_force, mean, replica)
        self.book(before, self.staggered, mean, span)

    def _tried(self, replica: int, spins: np.ndarray, span: float) -> _Tried | None:
        """A step from these spins; None if a stage cannot be solved."""
        before = self.system.gather_vectors(self.elongation, replica)
        stage, share = GAMMA * span, (1 - GAMMA) / GAMMA
        friction = self._friction(replica, stage)
        first = self._stage(friction, spins, before, spins)
        if first is None:
            return None
        end, elongation = first
        base = spins + share * (end.spins - spins)
        stretched = before + share * (elongation - before)
        second = self._stage(friction, base, self._bearable(friction, stretched), end.spins)
        if second is None:
            return None
        last, elongation = second
        force = (1 - GAMMA) * end.force + GAMMA * last.force
        error = _mean_size((last.spins - base) - (end.spins - spins))
        return _Tried(last.spins, elongation, last.force, force, error)

    def _stage(
        self, friction: Friction, base: np.ndarray, elongation: np.ndarray, guess: np.ndarray
    ) -> tuple[StageEnd, np.ndarray] | None:
        """End of a stage, and the elongations there: of a spring that slips, what its force alone stretches it to."""
        if not self.scene.law.holds:
            end = self.stage.solve(friction, base, np.zeros_like(elongation), guess)
            return None if end is None else (end, elongation)
        stiffness, damping = self.options.stiffness, self.options.damping * self.scene.lattice.radius
        end = self.stage.solve(friction, base, stiffness * elongation, guess)
        if end is None:
            return None
        stuck = (end.held - damping * self.system.differences(end.spins)) / stiffness
        of_force, of_past = self.options.after_slip(self.unit_inertia / friction.inertia)
        return end, np.where(end.slips, of_force * end.held + of_past * elongation, stuck)

    def _bearable(self, friction: Friction, elongation: np.ndarray) -> np.ndarray:
        """Springs pull no harder than friction holds: one that has begun to slip is not stretched any further."""
        if not self.scene.law.holds:
            return elongation
        stiffness = self.options.stiffness
        return friction.limited(stiffness * elongation) / stiffness

    def motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.staggered, self.force, self.elongation

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        super().restore(state)
        self._set_stage()


def _mean_size(values: np.ndarray) -> float:
    """Root mean square; 0 of nothing."""
    return float(np.sqrt((values * values).mean())) if values.size else 0.0
