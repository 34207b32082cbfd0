"""Rigid-limit dynamics: I dOmega/dt = - dP/dOmega without springs, in implicit Euler steps of any length.

Where Cundall and Strack give every contact a spring, nonsmooth contact dynamics (Moreau 1988; Jean 1999) lets friction
act at once: a contact that slips bears all its friction, one that does not bears what is needed. Then the motion is the
steepest descent of the power in the metric of the inertia (equations.md, 6), and a step is the minimum of the power
plus I |change of the spins|^2 / (2 h), found to round-off (proximal.py). The power cannot rise, however long the step;
the forces of the step obey the law of friction, and near rest they prove how far the power is from its minimum.

The error of a step is estimated as in codes for stiff equations: by the difference from what the forces of the step
before would have done. Spin components that friction has stopped (such as the one about the height, after a random
start) never start again (equations.md, 3), so that later steps leave them out.

Letters: h length of a step, I moment of inertia, P power, R samples, N spheres, E contacts, C carried spin components.
The *relaxation time* is that in which a typical contact alone stops a sphere from the largest spin. *Staggered* spins
are those that are carried: on a lattice with signs by which neighbours differ and measured from the bottom plane; in a
packing u = R omega, radius times spin.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from taichi_bearings.conic.proximal import ProximalSteps, Step
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.scene import Bearing, Progress
from taichi_bearings.solvers.dynamics import ENERGY_NAMES, Dynamics, replica_sum
from taichi_bearings.solvers.table import RigidLimit

FIRST_ERROR_SHARE = 0.1  # length of the first step, in units of the error tolerance times the relaxation time
LEAST_STEP, MOST_STEP = 1e-6, 1e8  # bounds on a step, in relaxation times
MOST_GROWTH, MOST_SHRINKAGE = 3.0, 0.2  # largest and smallest ratio of a step to the one before
STEP_SAFETY = 0.8  # factor on the step that the error estimate asks for
ACCEPTED_ERROR = 2.0  # error over tolerance up to which a step counts
STOPPED_SPREAD = 1e-7  # of the unit of spin: a component that varies by less is stopped,
STOPPED_ENERGY = 1e-14  # if that changes the kinetic energy by no more than this fraction of that at the start
FIRST_RESOLVED_SLIP = 1e-12  # of the unit of spin: slips at the start
# steps in a row without a fall of the power: after 2 it is at rest if that is proven, after 20 it is given up
REST_STEPS, STUCK_STEPS = 2, 20


class RigidLimitMethod(Dynamics):
    """The rigid-limit dynamics: friction acts without springs, in implicit Euler steps. An iteration is one step of all
    R samples together.

    length, last_length : length of the next and of the last step, time.
    unit, largest : largest difference of spins within a component, and largest spin, both at the start, 1/time.
    creep : spin difference, 1/time, up to which a contact may have no slip.
    staggered, force : spins (C components, R, *N spheres) and contact forces (C, R, E contacts) of the last step.
    moving : axes of the spin components that friction has not stopped.
    slots : places of these components among all that are computed.
    rows : places of the force components that the solver of a step returns.
    slipping : (R,), number of contacts that slip in the last step.
    rest_time : (R,), time of the last step in which the power fell.
    still : number of steps in a row in which no power fell.
    newton_steps : number of Newton steps so far.
    """

    state_names = (
        "length", "last_length", "unit", "largest", "creep", "staggered", "force", "moving", "slipping", "rest_time",
        "newton_steps", "still", *ENERGY_NAMES,
    )  # fmt: skip

    rest_gap = 1e-9
    options: RigidLimit

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare the dynamics: set up the steps, choose the length of the first, and begin the energy balance. The
        forces at the start are those of friction that grows in proportion to the spin difference, up to `creep`.

        scene : what to solve.
        spin : (R samples, *N spheres, 3), in 2D (R, *N), laboratory spins to start from, 1/time.
        """
        super().begin(scene, spin)
        scene, self.contacts.look_again = self.scene, 1.0
        self.staggered = scene.staggered_spin(spin, self.spin_axes)
        # for each spin component the largest less the smallest spin, 1/time
        spread = [float(values.max() - values.min()) for values in self.staggered]
        self.unit = max(spread) or 1.0
        self.largest = float(np.abs(self.staggered).max()) or 1.0
        self.moving = self.spin_axes
        self._set_up_steps()
        self.creep = FIRST_RESOLVED_SLIP * self.unit
        self.force = self.forces_at(self.staggered, self.creep)
        self.newton_steps = self.still = 0
        self.length = self.options.time_step or FIRST_ERROR_SHARE * self.options.error_tolerance * self.relaxation_time
        self.last_length = self.length
        self.start_energy_balance(self.staggered)
        self.rest_time = np.zeros(scene.replicas)
        slips = scene.slips(self.staggered, self.spin_axes)
        self.slipping = (slips > scene.slip_radius * self.creep).sum(axis=1)

    def _set_up_steps(self) -> None:
        """Make the solver of steps for the spin components that still move (`moving`).

        Three attributes are set: slots, the index of each moving component in `spin_axes`; rows, for each force
        component that the solver returns its row in `force` (on lattices these are the same as `slots`); and steps, the
        solver, None if no sphere is free to move.
        """
        self.slots = [self.spin_axes.index(component) for component in self.moving]
        self.steps: ProximalSteps | None = None
        if self.moving:
            unknowns = self.contacts.unknowns(self.moving, self.unit, self.inertia)
            self.rows = self.slots if unknowns.rows == len(self.slots) else list(range(unknowns.rows))
            if unknowns.system.unknowns:
                self.steps = ProximalSteps(self.scene, unknowns, self.unit, float(np.mean(self.inertia)))

    @property
    def relaxation_time(self) -> float:
        """The time, on average, in which the force of one contact alone would stop a sphere with the largest spin."""
        scene, fastest = self.scene, self.scene.slip_radius * self.largest
        if not scene.network.has_free_end.any():
            return 1.0  # no contact acts on a free sphere, and any step is exact

        def mean(coefficient: np.ndarray) -> float:
            """Return the mean of a coefficient (samples R, contacts E) over the contacts with a free sphere."""
            return float(coefficient[:, scene.network.has_free_end].mean())

        force = scene.strength * mean(scene.coefficient) * (1.0 if scene.law.has_friction else fastest)
        if scene.viscosity_beside_friction is not None:
            force += mean(scene.viscosity_beside_friction) * fastest
        return float(np.mean(self.inertia)) * self.largest / (scene.slip_radius * force)

    def advance(self, steps: int) -> None:
        """Make `steps` steps, or fewer if one cannot be made."""
        with one_thread():  # fronts are shared among threads here, not inside the library
            for _ in range(steps):
                self._step()
                if self.halted:
                    return
                self.iteration += 1

    def _step(self) -> None:
        """Make one step, shortened until it is accurate enough or as short as steps may be.

        A step that would pass the next time at which a state is recorded (`aim`) ends there. A fixed step of the user
        is not shortened by its error.
        """
        least, most = LEAST_STEP * self.relaxation_time, MOST_STEP * self.relaxation_time
        chosen, length = self.options.time_step is not None, self.length
        while True:
            aimed = self.time < self.aim <= self.time + length * (1 + 1e-9)  # no tiny step is left over
            duration = self.aim - self.time if aimed else length
            step = self._trial_step(duration)
            error = self._error(step, duration) / self.options.error_tolerance
            # a rejected step is repeated at half its length at most
            if chosen or duration <= least or (step.solved and error <= ACCEPTED_ERROR):
                break
            factor = STEP_SAFETY / error if step.solved else MOST_SHRINKAGE
            length = max(least, duration * max(MOST_SHRINKAGE, min(factor, 0.5)))
        self.length = length
        self._accept_step(step, duration, self.aim if aimed else self.time + duration)
        # the error is proportional to the square of the step, which gives the length of the next one
        factor = min(MOST_GROWTH, STEP_SAFETY / np.sqrt(max(error, 1e-30)))
        if not chosen and (not aimed or factor < 1):
            self.length = min(max(duration * factor, least), most)

    def _trial_step(self, duration: float) -> Step:
        """Return the result of a step that is not yet accepted, for all spin components. Components that have stopped
        stay as they are, without forces.

        duration : length of the step, time.
        """
        scene, force = self.scene, np.zeros_like(self.force)
        if self.steps is None:
            return Step(self.staggered, force, np.zeros(scene.replicas, dtype=int), 0.0, 0, True)
        step = self.steps.step(self.staggered[self.slots], duration)
        staggered = self.staggered.copy()
        staggered[self.slots] = step.staggered
        force[self.rows] = step.force
        return Step(staggered, force, step.slipping, step.creep, step.newton_steps, step.solved)

    def _error(self, step: Step, duration: float) -> float:
        """Return the error of the spins in a step, root mean square in the worst sample, over the largest spin.

        A step of implicit Euler, of length h, has the error h^2 / 2 times the second derivative of the spins. It is
        estimated by a comparison with a step that is made with the mean forces of the previous step, of length h'.
        These forces belong to a time that is (h + h') / 2 earlier. So the two results differ by h (h + h') / 2 times
        the second derivative, and the error is h / (h + h') of this difference.

        step : result of the step.
        duration : length h of the step, time.
        """
        scene = self.scene
        impulse = duration * scene.slip_radius / self.inertia
        foreseen = self.staggered + impulse * self.pulls(self.force)
        missed = (step.staggered - foreseen)[..., ~scene.is_driven]
        mean_square = (missed**2).mean(axis=(0, 2)).max()
        return duration / (duration + self.last_length) * float(np.sqrt(mean_square)) / self.largest

    def _accept_step(self, step: Step, duration: float, time: float) -> None:
        """Accept a step: its spins and forces, the energies that it moved, and whether the power fell in it.

        step : result of the step.
        duration : length of the step, time.
        time : simulated time at its end.
        """
        scene = self.scene
        before, objective_before = self.staggered, scene.objective(self.staggered, self.spin_axes)
        self.staggered, self.force = step.staggered, step.force
        self.add_energies(before, self.staggered, self.force, duration)
        self._stop_components()
        self.time, self.last_length = time, duration
        self.slipping, self.creep = step.slipping, step.creep
        self.newton_steps += step.newton_steps
        fall = objective_before - scene.objective(self.staggered, self.spin_axes)
        falls = fall > self.options.rest_tolerance * objective_before
        self.rest_time = np.where(falls, time, self.rest_time)
        self.still = 0 if falls.any() else self.still + 1

    def _stop_components(self) -> None:
        """Set to rest the spin components that the driving does not move and that hardly vary any more. Later steps
        leave them out.

        A component is stopped if no spin changes thereby by more than STOPPED_SPREAD, and the kinetic energy by no more
        than STOPPED_ENERGY of that at the start.
        """
        moving, bottom = [], self.absolute(np.zeros_like(self.staggered))  # spins are measured from those of the bottom
        for component in self.moving:
            slot = self.spin_axes.index(component)
            spins = self.staggered[slot]
            rest = self.contacts.stopped_spins(component, spins)
            if rest is None:
                moving.append(component)
                continue
            # kinetic energy that stopping would take away
            energy = self.inertia / 2 * replica_sum(((spins - rest) * (spins + rest + 2 * bottom[slot]))[None])
            is_small = bool((np.abs(energy) <= STOPPED_ENERGY * self.energy_at_start).all())
            if is_small and np.abs(spins - rest).max() <= STOPPED_SPREAD * self.unit:
                spins[...] = rest
            else:
                moving.append(component)
        if tuple(moving) != self.moving:
            self.moving = tuple(moving)
            self._set_up_steps()

    def progress(self) -> Progress:
        """Return the progress now with its bounds and energies. It says whether the motion is at rest (`at_rest`), and
        whether it can come no closer to the minimum (`exhausted`).
        """
        scene = self.scene
        found = self.judged(
            self.staggered.copy(),
            self.force,
            iteration=self.iteration,
            resolution=scene.slip_radius * self.creep,
            time=self.time,
            energy=self.balance(self.staggered, np.zeros(scene.replicas)),
            slipping=self.slipping,
        )
        # without a fall of the power the motion is at rest if that is proven, else it is given up later
        believed = self.may_be_at_rest(found)
        at_rest, stuck = self.still >= REST_STEPS and believed, self.still >= STUCK_STEPS and not believed
        return replace(found, at_rest=at_rest, exhausted=stuck)

    def may_be_at_rest(self, found: Progress) -> bool:
        """Return True if a state that does not change may be called rest: if its gap to the best lower bound is small,
        or if no bound can be proven, as there are no springs that would have to load first.

        found : the progress now.
        """
        if self.contacts.has_no_bound:
            return True
        return super().may_be_at_rest(replace(found, lower_bound=self.contacts.best_bound(found.lower_bound)))

    def findings(self, last: Progress) -> dict[str, np.ndarray]:
        """Return by name two findings, (R samples,) each: the time since which the power has not fallen, NaN if the
        motion is not at rest; and the number of Newton steps.

        last : the progress at the end.
        """
        rest_time = np.where(self.may_be_at_rest(last), self.rest_time, np.nan)
        return {"rest_time": rest_time, "newton_steps": np.full(self.scene.replicas, self.newton_steps)}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the arrays by name that `state` returned in an earlier call."""
        super().restore(state)
        self._set_up_steps()
