"""What all dynamics have in common: simulated time, energy balance, detection of rest, and the arrays of a checkpoint.

Shapes: R samples (replicas), N spheres, E contacts, C carried spin components. *Staggered* spins are those that are
carried: on a lattice with signs by which neighbours differ, measured from the bottom plane; in a packing u = R omega,
radius times spin. In the shape (C, R, E) of forces of a packing C is the number of tangents of a contact.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.proof.certificate import relative_gap
from taichi_bearings.scene import Bearing, Energy, Progress
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.method import Method

REST_SLIP = 1e-6  # largest slip that is called rest, in units of the slip of a contact with the whole imposed jump
REST_CHECKS = 3  # consecutive checks for rest that must agree
WATCH_NAMES = tuple(f"rest.{name}" for name in ("iteration", "time", "quiet_checks", "last_slipping", "last_objective"))
ENERGY_NAMES = ("work", "injected", "energy_at_start")


def replica_sum(values: np.ndarray) -> np.ndarray:
    """Return the sum (R,) of values (T, R, ...) over all axes but that of the samples."""
    return values.sum(axis=(0, *range(2, values.ndim)))


def saturated(scene: Bearing, force: np.ndarray, slip: np.ndarray, tolerance: float) -> tuple[np.ndarray, float]:
    """Return how many contacts (R,) slip, as they bear all the friction that they can; and the slip speed resolved.

    force : (C, R, E). slip : (R, E), length/time. tolerance : relative distance from the friction limit that counts as
    none. The slip speed that can be resolved is the largest slip of a contact that holds, length/time, as a slower
    contact is not known to slip. It is cut off at REST_SLIP, so that fast contacts count as slipping from the first
    step on.
    """
    limit, coarsest = scene.law.holding_force(scene.material), REST_SLIP * scene.slip_radius * scene.jump
    if limit is None:
        return np.zeros(scene.replicas, dtype=np.int64), 0.0
    slips = vector_length(force) >= (1 - tolerance) * limit
    return (slips & (limit > 0)).sum(axis=1), min(float(slip[~slips].max(initial=0.0)), coarsest)


@dataclass
class RestWatch:
    """Counts the checks in a row at which a dynamics has been stationary.

    least, share : two checks are `least` + iteration // `share` iterations apart. later : a check counts if the
    simulated time has grown by this fraction since the last one that counted. last_objective : (R,), the objective at
    that one. last_slipping : number of slipping contacts then, of all samples. quiet_checks : how many checks in a row
    found no change. iteration : of the last check. time : simulated time of the last check that counted.
    """

    least: int
    share: int
    later: float
    last_objective: np.ndarray
    last_slipping: int = -1
    quiet_checks: int = 0
    iteration: int = 0
    time: float = 0.0

    @property
    def next_check(self) -> int:
        """Iteration of the next check, whatever other states are looked at in between."""
        return self.iteration + self.least + self.iteration // self.share

    @property
    def at_rest(self) -> bool:
        """Whether enough checks in a row have found no change."""
        return self.quiet_checks >= REST_CHECKS

    def look(self, found: Progress, time: float, radius: float, tolerance: float, believed: bool) -> None:
        """Check whether the dynamics has changed since the last check, if one is due.

        found : the state now. time : simulated time. radius : of spheres. tolerance : largest relative change of the
        objective; the largest torque left may be 1000 x tolerance x the typical torque. believed : False while springs
        may still have to load, which looks stationary too.
        """
        if found.iteration < self.next_check:
            return
        self.iteration = found.iteration
        if time < self.time * (1 + self.later):
            return
        assert found.slipping is not None
        typical_torque = radius * float(vector_length(found.force).max(initial=0.0))
        slipping = int(found.slipping.sum())
        still = bool((np.abs(found.objective - self.last_objective) <= tolerance * np.abs(found.objective)).all())
        balanced = bool((found.largest_balance_residual <= 1e3 * tolerance * typical_torque).all())
        quiet = believed and still and balanced and slipping == self.last_slipping
        self.quiet_checks = self.quiet_checks + 1 if quiet else 0
        self.time, self.last_objective, self.last_slipping = time, found.objective, slipping


class Dynamics(Method):
    """A method whose iterations are steps in time, which can be interrupted and resumed with the same bits.

    kept : names of the attributes that the further steps depend on, beside time and iteration; WATCH_NAMES if it has a
    `RestWatch`, ENERGY_NAMES if it keeps an energy balance. rest_gap : proven gap up to which a state without change is
    believed to be at rest.
    time : simulated time. aim : the next time at which a state is recorded. end : the time at which the run ends;
    infinity if there is none. halted : no further step can be made. density : that of the spheres of a packing, as for
    `Packing.inertias`; it is set before the method begins. inertia : moments of inertia, as from `Contacts.inertias`.
    """

    resumes = True
    kept: ClassVar[tuple[str, ...]] = ()
    rest_gap: ClassVar = 1e-4
    aim = end = np.inf
    density: Any = None

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare to solve a scene, at time 0. spin : laboratory spins to start from, 1/time."""
        super().begin(scene, spin)
        self.inertia = self.contacts.inertias(self.options, self.density)
        self.iteration, self.time, self.halted = 0, 0.0, False

    def aim_at(self, time: float) -> None:
        """Set the next simulated time at which a state is recorded; infinity for none.

        `next_check` stops at the first step that reaches it; a method that chooses its steps ends one there exactly.
        """
        self.aim = time

    def end_at(self, time: float, resumable: bool) -> None:
        """Set the simulated time at which the run ends. resumable : `state` will be asked for after the last step."""
        self.end = time

    def state(self) -> dict[str, np.ndarray]:
        """Return all that the further steps depend on, by name."""
        values = ((name, attrgetter(name)(self)) for name in ("iteration", "time", *self.kept))
        own = {name: np.array(value, np.int64 if isinstance(value, tuple) else None) for name, value in values}
        return own | self.contacts.state()

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from what `state` returned in an earlier call; called after `begin`."""
        for name in ("iteration", "time", *self.kept):
            *path, last = name.split(".")
            owner: Any = reduce(getattr, path, self)
            setattr(owner, last, _like(getattr(owner, last), state[name]))
        self.contacts.restore(state)

    def findings(self, last: Progress) -> dict[str, np.ndarray]:
        """Return further results at the end, by name, (R,) each. last : the state at the end."""
        return {}

    def is_believed(self, found: Progress) -> bool:
        """Return whether a state without change may be called rest: whether its proven gap is small enough."""
        return bool((relative_gap(self.scene, found.objective, found.lower_bound) <= self.rest_gap).all())

    def advance(self, steps: int) -> None:
        """Make `steps` steps, or fewer if one cannot be made."""
        with one_thread():  # fronts are shared among threads here, not inside the library
            for _ in range(steps):
                self._step()
                if self.halted:
                    return
                self.iteration += 1

    def _step(self) -> None:
        """Make one step in time; `halted` is set if it could not be made."""
        raise NotImplementedError

    def open_books(self, staggered: np.ndarray) -> None:
        """Begin the energy balance. staggered : spins (C, R, *N) at the start, when no spring is stretched."""
        self.injected, self.work = np.zeros((2, self.scene.replicas))
        self.energy_at_start = self.kinetic_energy(staggered)
        self.imposed = self.differences(self.absolute(staggered) * self.scene.is_driven)

    def book(self, before: np.ndarray, after: np.ndarray, force: np.ndarray, duration: float) -> None:
        """Add the energies of one step to the balance: the work of the contacts, and that of the driven spheres.

        before, after : spins (C, R, *N) at the two ends of the step. force : mean contact forces (C, R, E) of the step.
        duration : length of the step, time.
        """
        length, mean = duration * self.scene.slip_radius, (before + after) / 2
        self.work = self.work + length * replica_sum(force * self.differences(mean))
        self.injected = self.injected + length * replica_sum(force * self.imposed)

    def kinetic_energy(self, staggered: np.ndarray) -> np.ndarray:
        """Return the kinetic energy (R,) of the free spheres, from staggered spins (C, R, *N)."""
        return replica_sum(self.inertia / 2 * ~self.scene.is_driven * self.absolute(staggered) ** 2)

    def balance(self, staggered: np.ndarray, spring: np.ndarray) -> Energy:
        """Return the energy balance now. staggered : spins (C, R, *N). spring : energy (R,) stored in the springs."""
        return Energy(self.kinetic_energy(staggered), spring, self.injected, self.work - spring, self.energy_at_start)


def _like(now: Any, stored: np.ndarray) -> Any:
    """Return a value of a checkpoint with the type of the value `now` that it replaces."""
    if isinstance(now, tuple):
        return tuple(int(number) for number in stored)
    return type(now)(stored) if isinstance(now, int | float) else np.array(stored)


class SpringDynamics(Dynamics):
    """A dynamics whose contacts have springs: its progress, and when it is at rest.

    same_force : relative distance from the friction limit below which a contact counts as slipping. checks : `least`,
    `share` and `later` of `RestWatch`. rest : that watch.
    """

    same_force: ClassVar[float]
    checks: ClassVar[tuple[int, int, float]]

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare to solve a scene, and watch for rest. spin : laboratory spins to start from, 1/time."""
        super().begin(scene, spin)
        self.rest = RestWatch(*self.checks, np.full(scene.replicas, np.inf))

    def motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the staggered spins (C, R, *N), the contact forces and the elongations (C, R, E) now."""
        raise NotImplementedError

    def damping_force(self, staggered: np.ndarray) -> np.ndarray:
        """Return the forces (C, R, E) of contacts whose springs are not stretched, at spins (C, R, *N).

        These are the force of the damper, cut off at the friction limit, and that of the viscosity.
        """
        scene, difference = self.scene, self.differences(staggered)
        force = self.options.damping * scene.slip_radius * difference
        size, limit = vector_length(force), scene.strength * scene.acting_coefficient
        slips = size > limit * self.options.static_ratio
        force = force * np.divide(limit, size, out=np.ones_like(size), where=slips)
        return self.with_viscosity(force if scene.law.holds else np.zeros_like(force), difference)

    def books(self, staggered: np.ndarray, force: np.ndarray, spring: np.ndarray) -> Energy | None:
        """Return the energy balance now, or None if none is kept; arguments as of `balance`, force (C, R, E)."""
        return self.balance(staggered, spring)

    def findings(self, last: Progress) -> dict[str, np.ndarray]:
        """Return the elongation of the longest spring over the distance that the driven planes have slid so far."""
        slid = self.scene.slip_radius * self.scene.jump * self.time if self.scene.law.holds else 0.0
        return {"elastic_share": vector_length(self.motion()[2]).max(axis=1) / slid} if slid > 0 else {}

    def progress(self) -> Progress:
        """Return the state now with its bounds, energies and slipping contacts, and whether it is at rest."""
        scene, stiffness = self.scene, self.options.stiffness
        staggered, force, stretch = self.motion()
        springs = force
        if scene.law.holds:
            springs = self.with_viscosity(stiffness * stretch, self.differences(staggered))
        slipping, creep = saturated(scene, force, scene.slips(staggered, self.spin_axes), self.same_force)
        found = self.judged(
            staggered,
            force,
            springs,
            iteration=self.iteration,
            resolution=creep,
            time=self.time,
            energy=self.books(staggered, force, stiffness / 2 * replica_sum(stretch**2)),
            slipping=slipping,
            halted=self.halted,
        )
        self.rest.look(found, self.time, scene.slip_radius, self.options.rest_tolerance, self.is_believed(found))
        return replace(found, at_rest=self.rest.at_rest)
