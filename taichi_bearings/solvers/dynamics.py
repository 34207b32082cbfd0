"""What all dynamics have in common: simulated time, energy balance, detection of rest, and the arrays of a checkpoint.

Shapes: R samples (replicas), N spheres, E contacts, C carried spin components. *Staggered* spins are those that are
carried: on a lattice with signs by which neighbours differ, measured from the bottom plane; in a packing u = R omega,
radius times spin. In the shape (C, R, E) of forces of a packing C is the number of tangents of a contact.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.proof.certificate import relative_gap
from taichi_bearings.scene import Bearing, Energy, Progress
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.contacts import Stepped
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.table import CundallStrack, Motion

REST_SLIP = 1e-6  # largest slip that is called rest, in units of the slip of a contact with the whole imposed jump
REST_CHECKS = 3  # consecutive checks for rest that must agree
WATCH_NAMES = tuple(f"rest.{name}" for name in ("iteration", "time", "quiet_checks", "last_slipping", "last_objective"))
ENERGY_NAMES = ("work", "injected", "energy_at_start")


def replica_sum(values: np.ndarray) -> np.ndarray:
    """Return the sum (R,) of values (T, R, ...) over all axes but that of the R samples."""
    found: np.ndarray = values.sum(axis=(0, *range(2, values.ndim)))
    return found


def slipping_contacts(
    scene: Bearing, force: np.ndarray, slip: np.ndarray, tolerance: float
) -> tuple[np.ndarray, float]:
    """Return how many contacts of each sample slip, (R samples,), and the slip speed that can be resolved, length/time.

    A contact slips if it bears all the friction that it can. The slip speed that can be resolved is the largest one of
    a contact that does not slip, but at most REST_SLIP times the slip of the whole imposed jump. So fast contacts count
    as slipping from the first step on.

    scene : R samples of a lattice or packing with E contacts each, with their friction limits.
    force : (C components, R, E contacts), contact forces.
    slip : (R, E), slip speeds, length/time.
    tolerance : relative distance from the friction limit that counts as none.
    """
    limit, coarsest = scene.law.holding_force(scene.material), REST_SLIP * scene.slip_radius * scene.jump
    if limit is None:
        return np.zeros(scene.replicas, dtype=np.int64), 0.0
    slips = vector_length(force) >= (1 - tolerance) * limit
    return (slips & (limit > 0)).sum(axis=1), min(float(slip[~slips].max(initial=0.0)), coarsest)


@dataclass
class RestWatch:
    """Counts the checks in a row at which a dynamics has not changed.

    least, share : the next check is `least` + iteration // `share` iterations after the last one.
    later : a check counts if the simulated time has grown by this fraction since the last check that counted.
    last_objective : (R samples,), the objective at the last check that counted.
    last_slipping : number of slipping contacts then, of all samples.
    quiet_checks : how many checks in a row found no change.
    iteration : iteration of the last check.
    time : simulated time of the last check that counted.
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
        """Iteration of the next check: `least` iterations after the last one, and a fraction 1 / `share` of all
        iterations up to it more. States that are recorded in between do not shift it.
        """
        return self.iteration + self.least + self.iteration // self.share

    @property
    def at_rest(self) -> bool:
        """True if enough checks in a row found that nothing changed."""
        return self.quiet_checks >= REST_CHECKS

    def look(self, found: Progress, time: float, radius: float, tolerance: float, believed: bool) -> None:
        """If a check is due, find out whether the dynamics has changed since the last one, and count in `quiet_checks`.

        No change means three things: the objective has changed by at most `tolerance`, as many contacts slip, and the
        largest torque left on a sphere is at most 1000 * tolerance times radius times largest contact force.

        found : the progress now.
        time : simulated time now.
        radius : radius of the largest sphere, length.
        tolerance : largest relative change of the objective.
        believed : True if a state without change may be rest; False while springs may still be loading, which changes
            as little.
        """
        if found.iteration < self.next_check:
            return
        self.iteration = found.iteration
        if time < self.time * (1 + self.later):
            return
        assert found.slipping is not None
        # objective, torques and number of slipping contacts are the same as at the last check
        typical_torque = radius * float(vector_length(found.force).max(initial=0.0))
        slipping = int(found.slipping.sum())
        still = bool((np.abs(found.objective - self.last_objective) <= tolerance * np.abs(found.objective)).all())
        balanced = bool((found.largest_balance_residual <= 1e3 * tolerance * typical_torque).all())
        quiet = believed and still and balanced and slipping == self.last_slipping
        self.quiet_checks = self.quiet_checks + 1 if quiet else 0
        self.time, self.last_objective, self.last_slipping = time, found.objective, slipping


class Dynamics(Method):
    """A method whose iterations are steps in time. Its run can be interrupted and resumed with the same bits.

    state_names : names of the attributes that the further steps depend on, beside time and iteration; WATCH_NAMES are
        among them if it has a `RestWatch`, ENERGY_NAMES if it keeps an energy balance.
    rest_gap : relative gap to the proven lower bound up to which a state without change may be called rest.
    time : simulated time.
    aim : the next simulated time at which a state is recorded; infinity for none.
    end : the simulated time at which the run ends; infinity if there is none.
    halted : True if no further step can be made.
    density : density of the spheres of a packing, mass / length^D in D dimensions, one number or (N,); None to use the
        mass in the options. It is set before the method begins.
    inertia : moments of inertia of the free spheres, one number or (N,): mass * length^2 on a lattice; in a packing
        over the squared radius, mass.

    Only with an energy balance:

    energy_at_start : (R samples,), kinetic energy at time 0.
    work : (R,), energy that the contacts have taken from the spins so far.
    injected : (R,), energy that the driven spheres have given so far.
    imposed : (C components, R, E contacts), what the spins of the driven spheres alone add to the spin differences of
        the contacts, 1/time.
    """

    options: Motion
    contacts: Stepped
    resumes = True
    state_names: ClassVar[tuple[str, ...]] = ()
    rest_gap: ClassVar = 1e-4
    aim = end = np.inf
    density: ArrayLike | None = None

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare to solve a scene, at time 0.

        spin : (R samples, *N spheres, 3), in 2D (R, *N), laboratory spins to start from, 1/time.
        """
        super().begin(scene, spin)
        self.inertia = self.contacts.inertias(self.options, self.density)
        self.iteration, self.time, self.halted = 0, 0.0, False

    def aim_at(self, time: float) -> None:
        """Set the next simulated time at which a state is recorded; infinity for none.

        A method with fixed steps reads its progress after the first step that reaches this time; a method that chooses
        the lengths of its steps ends a step exactly at this time.
        """
        self.aim = time

    def end_at(self, time: float, resumable: bool) -> None:
        """Set the simulated time at which the run ends.

        resumable : True if `state` will be asked for after the last step.
        """
        self.end = time

    def state(self) -> dict[str, np.ndarray]:
        """Return by name all that the further steps depend on, for a checkpoint."""
        values = ((name, attrgetter(name)(self)) for name in ("iteration", "time", *self.state_names))
        own = {name: np.array(value, np.int64 if isinstance(value, tuple) else None) for name, value in values}
        return own | self.contacts.state()

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the arrays by name that `state` returned in an earlier call; called after `begin`."""
        for name in ("iteration", "time", *self.state_names):
            *path, last = name.split(".")
            owner: Any = reduce(getattr, path, self)
            setattr(owner, last, _with_type_of(getattr(owner, last), state[name]))
        self.contacts.restore(state)

    def findings(self, last: Progress) -> dict[str, np.ndarray]:
        """Return further results at the end by name, (R samples,) each; here none.

        last : the progress at the end, which is not needed here.
        """
        return {}

    def may_be_at_rest(self, found: Progress) -> bool:
        """Return True if a state that does not change may be called rest: if its gap to the lower bound is at most
        `rest_gap`.

        found : the progress now, with objective and lower bound.
        """
        return bool((relative_gap(self.scene, found.objective, found.lower_bound) <= self.rest_gap).all())

    def start_energy_balance(self, staggered: np.ndarray) -> None:
        """Begin the energy balance, at the start of a run, when no spring is stretched.

        staggered : (C components, R samples, *N spheres), spins at the start with signs that alternate between
            neighbours, 1/time; in a packing radius * spin.
        """
        self.injected, self.work = np.zeros((2, self.scene.replicas))
        self.energy_at_start = self.kinetic_energy(staggered)
        self.imposed = self.differences(self.absolute(staggered) * self.scene.is_driven)

    def add_energies(self, before: np.ndarray, after: np.ndarray, force: np.ndarray, duration: float) -> None:
        """Add the energies of one step to the balance: the work of the contacts and the work of the driven spheres.

        before, after : (C components, R samples, *N spheres), spins at the two ends of the step, with signs that
            alternate between neighbours, 1/time; in a packing radius * spin.
        force : (C, R, E contacts), mean contact forces of the step.
        duration : length of the step, time.
        """
        length, mean = duration * self.scene.slip_radius, (before + after) / 2
        self.work = self.work + length * replica_sum(force * self.differences(mean))
        self.injected = self.injected + length * replica_sum(force * self.imposed)

    def kinetic_energy(self, staggered: np.ndarray) -> np.ndarray:
        """Return the kinetic energy (R samples,) of the free spheres.

        staggered : (C components, R, *N spheres), spins with signs that alternate between neighbours, 1/time; in a
            packing radius * spin.
        """
        return replica_sum(self.inertia / 2 * ~self.scene.is_driven * self.absolute(staggered) ** 2)

    def balance(self, staggered: np.ndarray, spring: np.ndarray) -> Energy:
        """Return the energy balance now: kinetic, spring, injected and dissipated energy.

        staggered : (C components, R samples, *N spheres), spins with signs that alternate between neighbours, 1/time;
            in a packing radius * spin.
        spring : (R,), energy stored in the springs.
        """
        return Energy(self.kinetic_energy(staggered), spring, self.injected, self.work - spring, self.energy_at_start)


def _with_type_of(now: object, stored: np.ndarray) -> Any:
    """Return a value of a checkpoint with the type of the value that it replaces: whole numbers, a number, or an array.

    now : the value that is replaced.
    stored : the array in the checkpoint, with no axis for a number.
    """
    if isinstance(now, tuple):
        return tuple(int(number) for number in stored)
    return type(now)(stored) if isinstance(now, int | float) else np.array(stored)


class SpringDynamics(Dynamics):
    """A dynamics whose contacts have springs: its progress, and when it is at rest.

    same_force : relative distance from the friction limit below which a contact counts as slipping.
    checks : three numbers (least, share, later). It is checked whether the motion rests least + iteration // share
        iterations after the last check. A check counts only if the simulated time has grown by the fraction `later`
        since the last one that counted.
    rest : the `RestWatch` that tells when nothing changes any more.
    """

    options: CundallStrack
    same_force: ClassVar[float]
    checks: ClassVar[tuple[int, int, float]]

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare to solve a scene, and to watch for rest.

        spin : (R samples, *N spheres, 3), in 2D (R, *N), laboratory spins to start from, 1/time.
        """
        super().begin(scene, spin)
        self.rest = RestWatch(*self.checks, np.full(scene.replicas, np.inf))

    @abstractmethod
    def motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the present state as three arrays: the spins, with signs that alternate between neighbours, (C
        components, R samples, *N spheres), 1/time, in a packing radius * spin; the contact forces (C, R, E contacts);
        and the elongations of the springs (C, R, E), length."""

    def damping_force(self, staggered: np.ndarray) -> np.ndarray:
        """Return the forces (C components, R samples, E contacts) of contacts whose springs are not stretched: the
        force of the damper, cut off at the friction limit, plus the viscous force.

        staggered : (C, R, *N spheres), spins with signs that alternate between neighbours, 1/time; in a packing radius
            * spin.
        """
        scene, difference = self.scene, self.differences(staggered)
        force = self.options.damping * scene.slip_radius * difference
        size, limit = vector_length(force), scene.strength * scene.acting_coefficient
        slips = size > limit * self.options.static_ratio
        force = force * np.divide(limit, size, out=np.ones_like(size), where=slips)
        return self.with_viscosity(force if scene.law.has_friction else np.zeros_like(force), difference)

    def energy_balance(self, staggered: np.ndarray, force: np.ndarray, spring: np.ndarray) -> Energy | None:
        """Return the energy balance now; a subclass may return None if none is kept.

        staggered : (C components, R samples, *N spheres), spins with signs that alternate between neighbours, 1/time;
            in a packing radius * spin.
        force : (C, R, E contacts), contact forces.
        spring : (R,), energy stored in the springs.
        """
        return self.balance(staggered, spring)

    def findings(self, last: Progress) -> dict[str, np.ndarray]:
        """Return by name one further result at the end: `elastic_share`, (R samples,), the elongation of the longest
        spring divided by the distance by which the driven planes have slid past each other. Return an empty dictionary
        if the planes have not slid.

        last : the progress at the end, which is not needed here.
        """
        slid = self.scene.slip_radius * self.scene.jump * self.time if self.scene.law.has_friction else 0.0
        return {"elastic_share": vector_length(self.motion()[2]).max(axis=1) / slid} if slid > 0 else {}

    def progress(self) -> Progress:
        """Return the progress now: spins, forces, bounds on the objective, energies, numbers of slipping contacts, and
        whether the dynamics is at rest.
        """
        scene, stiffness = self.scene, self.options.stiffness
        staggered, force, stretch = self.motion()
        springs = force  # the lower bound follows from the forces without those of the dampers
        if scene.law.has_friction:
            springs = self.with_viscosity(stiffness * stretch, self.differences(staggered))
        slipping, creep = slipping_contacts(scene, force, scene.slips(staggered, self.spin_axes), self.same_force)
        found = self.judged(
            staggered,
            force,
            springs,
            iteration=self.iteration,
            resolution=creep,
            time=self.time,
            energy=self.energy_balance(staggered, force, stiffness / 2 * replica_sum(stretch**2)),
            slipping=slipping,
            halted=self.halted,
        )
        radius = float(np.max(scene.network.radius))
        self.rest.look(found, self.time, radius, self.options.rest_tolerance, self.may_be_at_rest(found))
        return replace(found, at_rest=self.rest.at_rest)
