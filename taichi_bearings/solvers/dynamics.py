"""What the dynamics have in common: clock and aim, energy balance, the watch for rest, and what a checkpoint holds."""

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

REST_SLIP = 1e-6  # of the imposed jump
REST_CHECKS = 3  # consecutive checks, each 1/16 of the time so far apart, that must agree
WATCH_NAMES = tuple(f"rest.{name}" for name in ("iteration", "time", "quiet_checks", "last_slipping", "last_objective"))
ENERGY_NAMES = ("work", "injected", "energy_at_start")


def replica_sum(values: np.ndarray) -> np.ndarray:
    """(R,) from (T, R, ...): the sum over everything but the replicas."""
    return values.sum(axis=(0, *range(2, values.ndim)))


def saturated(scene: Bearing, force: np.ndarray, slip: np.ndarray, tolerance: float) -> tuple[np.ndarray, float]:
    """How many contacts (R,) bear all the friction they can, to a relative tolerance, and so slip; and the largest slip
    speed of one that holds, length/time: by less a contact is not known to slip. That is at most REST_SLIP of the
    imposed jump, so that contacts which slip plainly are told from the first step on.

    force : (C, R, E). slip : (R, E).
    """
    limit, coarsest = scene.law.holding_force(scene.material), REST_SLIP * scene.slip_radius * scene.jump
    if limit is None:
        return np.zeros(scene.replicas, dtype=np.int64), 0.0
    slips = vector_length(force) >= (1 - tolerance) * limit
    return (slips & (limit > 0)).sum(axis=1), min(float(slip[~slips].max(initial=0.0)), coarsest)


@dataclass
class RestWatch:
    """Counts the checks in a row at which a dynamics has been stationary.

    least, share : checks are `least` iterations and this share of the run apart. later : share of the simulated time
    that must have passed since the last one. last_objective : (R,), then. last_slipping : slipping contacts then, of
    all replicas. iteration : of the last check. time : of the last one that counted.
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
        return self.quiet_checks >= REST_CHECKS

    def look(self, found: Progress, time: float, radius: float, tolerance: float, believed: bool) -> None:
        """A check, if it is due.

        tolerance : change of the objective, relative; a thousand times as much of the typical torque may be left.
        believed : springs that have not loaded yet look stationary too; True once that can be ruled out.
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

    kept : what its further course depends on, by name, beside the clock; WATCH_NAMES and ENERGY_NAMES if it has them.
    rest_gap : proven gap from which a stationary state is believed to be one.
    time : simulated time. aim : the next one at which a state is wanted. end : the one at which the run ends, infinity
    if it has none. halted : it cannot make another step. density : of the spheres of a packing, as of
    `Packing.inertias`; it is set before the method begins.
    """

    resumes = True
    kept: ClassVar[tuple[str, ...]] = ()
    rest_gap: ClassVar = 1e-4
    aim = end = np.inf
    density: Any = None

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        super().begin(scene, spin)
        self.inertia = self.contacts.inertias(self.options, self.density)
        self.iteration, self.time, self.halted = 0, 0.0, False

    def aim_at(self, time: float) -> None:
        """The next simulated time at which a state is wanted; infinity for none.

        `next_check` stops at the first step that reaches it; a method that chooses its steps ends one there exactly.
        """
        self.aim = time

    def end_at(self, time: float, resumable: bool) -> None:
        """The simulated time at which the run ends, to rounding. resumable : `state` is asked for afterwards."""
        self.end = time

    def state(self) -> dict[str, np.ndarray]:
        """Everything that the further course depends on."""
        values = ((name, attrgetter(name)(self)) for name in ("iteration", "time", *self.kept))
        own = {name: np.array(value, np.int64 if isinstance(value, tuple) else None) for name, value in values}
        return own | self.contacts.state()

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from such a state; called after `begin`."""
        for name in ("iteration", "time", *self.kept):
            *path, last = name.split(".")
            owner: Any = reduce(getattr, path, self)
            setattr(owner, last, _like(getattr(owner, last), state[name]))
        self.contacts.restore(state)

    def findings(self, last: Progress) -> dict[str, np.ndarray]:
        """What else is found, by name, (R,) each. last : the state at the end."""
        return {}

    def is_believed(self, found: Progress) -> bool:
        """Rest is believed only if the certificate agrees."""
        return bool((relative_gap(self.scene, found.objective, found.lower_bound) <= self.rest_gap).all())

    def advance(self, steps: int) -> None:
        with one_thread():  # fronts are shared among threads here, not inside the library
            for _ in range(steps):
                self._step()
                if self.halted:
                    return
                self.iteration += 1

    def _step(self) -> None:
        """One step, of which `halted` says if it could not be made."""
        raise NotImplementedError

    def open_books(self, staggered: np.ndarray) -> None:
        """Keep the energy balance from these spins (C, R, *N) on, without a stretched spring."""
        self.injected, self.work = np.zeros((2, self.scene.replicas))
        self.energy_at_start = self.kinetic_energy(staggered)
        self.imposed = self.differences(self.absolute(staggered) * self.scene.is_driven)

    def book(self, before: np.ndarray, after: np.ndarray, force: np.ndarray, duration: float) -> None:
        """Work of the mean forces (C, R, E) of a step on its mean slip, and of the driven spheres against them."""
        reach, mean = duration * self.scene.slip_radius, (before + after) / 2
        self.work = self.work + reach * replica_sum(force * self.differences(mean))
        self.injected = self.injected + reach * replica_sum(force * self.imposed)

    def kinetic_energy(self, staggered: np.ndarray) -> np.ndarray:
        """(R,) of the free spheres with staggered spins (C, R, *N), energy."""
        return replica_sum(self.inertia / 2 * ~self.scene.is_driven * self.absolute(staggered) ** 2)

    def balance(self, staggered: np.ndarray, spring: np.ndarray) -> Energy:
        """The books, with the energy (R,) in the springs."""
        return Energy(self.kinetic_energy(staggered), spring, self.injected, self.work - spring, self.energy_at_start)


def _like(now: Any, stored: np.ndarray) -> Any:
    """What a checkpoint has stored in the place of `now`."""
    if isinstance(now, tuple):
        return tuple(int(number) for number in stored)
    return type(now)(stored) if isinstance(now, int | float) else np.array(stored)


class SpringDynamics(Dynamics):
    """A dynamics whose contacts have springs: how it is looked at, and when it is at rest.

    same_force : relative distance from all the friction it can bear at which a contact slips. checks : see RestWatch.
    """

    same_force: ClassVar[float]
    checks: ClassVar[tuple[int, int, float]]

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        super().begin(scene, spin)
        self.rest = RestWatch(*self.checks, np.full(scene.replicas, np.inf))

    def motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Staggered spins (C, R, *N), forces and elongations (C, R, E) of now."""
        raise NotImplementedError

    def damping_force(self, staggered: np.ndarray) -> np.ndarray:
        """Forces (C, R, E) of unstretched contacts: their damper as far as friction holds it, and their viscosity."""
        scene, difference = self.scene, self.differences(staggered)
        force = self.options.damping * scene.slip_radius * difference
        size, limit = vector_length(force), scene.strength * scene.acting_coefficient
        slips = size > limit * self.options.static_ratio
        force = force * np.divide(limit, size, out=np.ones_like(size), where=slips)
        return self.with_viscosity(force if scene.law.holds else np.zeros_like(force), difference)

    def books(self, staggered: np.ndarray, force: np.ndarray, spring: np.ndarray) -> Energy | None:
        """The energy balance of now, if it is kept."""
        return self.balance(staggered, spring)

    def findings(self, last: Progress) -> dict[str, np.ndarray]:
        """Of the distance that the driven planes have slid past each other, what the longest spring takes up."""
        slid = self.scene.slip_radius * self.scene.jump * self.time if self.scene.law.holds else 0.0
        return {"elastic_share": vector_length(self.motion()[2]).max(axis=1) / slid} if slid > 0 else {}

    def progress(self) -> Progress:
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
