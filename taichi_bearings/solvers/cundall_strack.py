"""Cundall–Strack dynamics, the paper's second method: how the state of least dissipation is reached in time.

I dw/dt = sum of r x F (paper Eq. 10) with the spring-and-damper friction of Eqs. 7-9, integrated by Gear's method. The
power of the spins is an upper bound of the least power, and the spring forces, once balanced, give a lower one: a
dynamical run proves its own gap.

Letters: h time step, I moment of inertia, K and A stiffness and damping of a spring, lambda eigenvalue of the Laplacian
of the contacts. Shapes: R samples, N spheres, E contacts, C carried spin components. The n-th *scaled derivative* of a
quantity is its n-th time derivative times h^n / n!, as Gear's method keeps it. *Staggered* spins are those that are
carried: on a lattice with signs by which neighbours differ, measured from the bottom plane; in a packing u = R omega.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.fields.lists import AnySpec
from taichi_bearings.scene import Bearing, Energy, Progress, Scene
from taichi_bearings.solvers.contacts import CONSTANT, Launch
from taichi_bearings.solvers.dynamics import WATCH_NAMES, SpringDynamics, replica_sum
from taichi_bearings.solvers.gear import GEAR_COEFFICIENTS, largest_stable_step
from taichi_bearings.solvers.method import Swept
from taichi_bearings.solvers.on_strides import fastest_modes, inertia_of
from taichi_bearings.solvers.table import CundallStrack

DEFAULT_STEP = 0.8  # of the stability bound
SAME_STEP = 1e-12  # relative distance of two times that counts as none


class CundallStrackMethod(Swept, SpringDynamics):
    """The dynamics of Cundall and Strack: springs and dampers at the contacts, and Gear's method for the spins.

    An iteration is one time step. All steps are equally long, but for the last one, which may be shorter so that the
    run ends at its duration.

    time_step : length of a step, time.
    stability_bound : largest stable step, time.
    common_inertia : moment of inertia by which the kernel divides torques where the field `is_free` is 1, mass *
        length^2 on a lattice, mass in a packing.
    start_spin : largest spin at the start, 1/time.
    team, sweeps : the threads that run the kernel, and the kernel, a call of which makes one time step.
    before_last : the state, by name, before a shorter last step; None if none was made.
    balance_before : (R samples,) work of the contacts, (R,) energy that driven spheres gave, (R,) power of the contacts
        and (C components, R, *N spheres) forces on spheres, all before a shorter last step; None if none was made.
    last_span : length of that shorter last step, time.
    power_at_start, pull_at_start : with an energy balance, at time 0: (R samples,) power of the contacts over the
        radius, and (C components, R, *N spheres) sum of the contact forces on each sphere.
    resumable : True if the state before a shorter last step is stored, so that the run can be continued.
    """

    state_names = WATCH_NAMES
    same_force, checks = 1e-12, (100, 16, 0.0)
    resumable = False
    before_last: dict[str, np.ndarray] | None = None
    balance_before: tuple[np.ndarray, ...] | None = None  # work, injected, power and pull of contacts before that step

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare the dynamics: choose the time step, load spins, their time derivatives and inertias into the fields
        (arrays on the device), and compile the kernel.

        scene : what to solve.
        spin : (R samples, *N spheres, 3), in 2D (R, *N), laboratory spins to start from, 1/time.

        Raises InputError for an option `time_step` that is not stable.
        """
        super().begin(scene, spin)
        scene = self.scene
        options, beside, replicas = self.options, scene.viscosity_beside_friction, scene.replicas
        # the kernels multiply viscosities by spin differences, hence the radius
        self.contacts.allocate(self.needed(), None if beside is None else scene.slip_radius * beside)
        # the largest stable step, from the fastest modes of the network
        slopes = scene.steepest(self._largest_slip(scene.staggered_spin(spin, self.spin_axes)))
        bound = largest_step(options, scene.law.has_friction, *self.contacts.fastest_modes(self.inertia, slopes))
        self.common_inertia = self.contacts.common_inertia(self.inertia)
        self.stability_bound = bound if np.isfinite(bound) else 1.0  # without contacts any step is stable
        if (options.time_step or 0.0) > self.stability_bound:
            given, most = options.time_step, self.stability_bound
            raise InputError(
                f"time_step is {given:g}; the computed motion of this scene is stable only for time steps up to "
                f"{most:.6g}"
            )
        self.time_step = options.time_step or DEFAULT_STEP * self.stability_bound
        self.start_spin = float(np.abs(spin).max())
        self._load_gear(scene.staggered_spin(spin, self.spin_axes))
        # by what the kernel multiplies torques: 0 for driven spheres, else the common inertia over that of the sphere
        is_free = np.where(scene.is_driven, 0.0, self.common_inertia / self.inertia)
        self.fields.load("is_free", np.broadcast_to(is_free, (1, replicas, *scene.network.shape)))
        self.team, self.sweeps = self.contacts.spring_kernel(GEAR_COEFFICIENTS[options.gear_order])
        self.sweeps.compile(self.fields, self.team)

    def _largest_slip(self, staggered: np.ndarray) -> float:
        """Return a slip speed, length/time, that no contact of a lattice without friction exceeds. Each spin component
        is drawn towards those of the neighbours, so it stays between the smallest and the largest one at the start.

        staggered : (C components, R samples, *N spheres), spins at the start with signs that alternate between
            neighbours, 1/time.
        """
        spins = self.scene.impose_driving(staggered, self.spin_axes).reshape(len(staggered), -1)
        return self.scene.slip_radius * float(np.linalg.norm(np.ptp(spins, axis=1)))

    def needed(self) -> AnySpec:
        """Return the names and sizes of the fields that the time steps need.

        * On spheres, with a number for each spin component: `gear_0`, `gear_1`, ..., the spin and its scaled
          derivatives; `predicted`, the spin at the end of the next step; `integral`, its mean over that step, with
          friction; `impulse`, the sum of the contact forces over all steps, with an energy balance. `is_free` has one
          number.
        * On contacts: `force`; `elongation` of the spring, with friction; `work`, with an energy balance.
        """
        energy, has_friction, order = self.options.energy, self.scene.law.has_friction, self.options.gear_order
        predicted = ["predicted"] * self.contacts.stores_predicted  # a name times False is an empty list
        moved = [
            *(f"gear_{n}" for n in range(order + 1)),
            *predicted,
            *["integral"] * has_friction,
            *["impulse"] * energy,
        ]
        spheres = dict.fromkeys(moved, len(self.spin_axes)) | {"is_free": 1}
        return self.contacts.field_spec(spheres, ["force", *["elongation"] * has_friction, *["work"] * energy])

    def _load_gear(self, staggered: np.ndarray) -> None:
        """Load the spins at the start and their scaled derivatives, which follow from the equation of motion.

        The n-th scaled derivative is the n-th time derivative times (time step)^n / n!. The derivatives include those
        of the spring forces of sticking contacts; without them the error of the first step would lower the order of the
        whole run.

        staggered : (C components, R samples, *N spheres), spins at the start with signs that alternate between
            neighbours, 1/time; in a packing radius * spin.
        """
        scene, options = self.scene, self.options
        # each derivative of the spins follows from that of the forces, which follows from the one before
        derivatives, forces = [staggered], list[np.ndarray]()
        for n in range(1, options.gear_order + 1):
            forces.append(self._force_derivative(derivatives) / n)
            rate = scene.slip_radius / self.inertia * self.pulls(forces[-1])
            rate[..., scene.is_driven] = 0.0
            derivatives.append(self.time_step * rate)
        # the end of the first step and its mean are predicted by the Taylor series
        for n, values in enumerate(derivatives):
            self.fields.load(f"gear_{n}", values)
        self._load_predicted(derivatives)
        if scene.law.has_friction:
            self.fields.load("integral", _mean_over_step(derivatives))
        if options.energy:
            self.contacts.load_force(forces[0])
            self.start_energy_balance(staggered)
            self.power_at_start = self._contact_power(forces[0], staggered)
            self.pull_at_start = self.pulls(forces[0])

    def _load_predicted(self, derivatives: list[np.ndarray]) -> None:
        """Load the spins at the end of the next step, as the Taylor series predicts them, into the field `predicted`.
        Lattices too large for the caches have no such field; then nothing is done.

        derivatives : scaled derivatives of the spins (n-th time derivative times (time step)^n / n!), the 0th first,
            each (C components, R samples, *N spheres).
        """
        if "predicted" in self.fields.names:
            self.fields.load("predicted", np.sum(derivatives, axis=0))

    def _force_derivative(self, derivatives: list[np.ndarray]) -> np.ndarray:
        """Return a scaled derivative (C components, R samples, E contacts) of the contact forces at the start: the n-th
        time derivative times (time step)^n / n!.

        The force of a sticking contact changes by its damper, and by its spring, which the slip stretches from the
        start on. The force of a slipping contact is taken as constant; with two components its direction could change,
        which is left out.

        derivatives : scaled derivatives of the spins, the 0th first, each (C, R, *N spheres); the result has the order
            n of the last one.
        """
        scene, options, order = self.scene, self.options, len(derivatives) - 1
        if not scene.law.is_sum:
            return self._derivative_of_own_law(derivatives)
        if order == 0 or not scene.law.has_friction:
            return self.damping_force(derivatives[-1])
        stretch = options.stiffness * self.time_step / order
        rate = options.damping * derivatives[-1] + stretch * derivatives[-2]
        static_limit = options.static_ratio * scene.strength * scene.acting_coefficient
        sticks = options.damping * scene.slips(derivatives[0], self.spin_axes) <= static_limit
        rate = self.differences(rate)
        force = np.where(sticks, scene.slip_radius * rate, 0.0)
        return self.with_viscosity(force, self.differences(derivatives[-1]))

    def _derivative_of_own_law(self, derivatives: list[np.ndarray]) -> np.ndarray:
        """Return a scaled derivative (C components, R samples, E contacts) of the contact forces at the start, for a
        law of one's own: the n-th time derivative times (time step)^n / n!, with n the number of the last
        derivative that is given.

        It is a coefficient of the polynomial in time that has the forces of the law at five times one step apart; the
        spins at these times follow from their Taylor series.

        derivatives : scaled derivatives of the spins, the 0th first, each (C, R, *N spheres).
        """
        steps = np.arange(-2.0, 3.0)
        series = np.polynomial.polynomial.polyvander(steps, len(derivatives) - 1)
        forces = [self.damping_force(np.tensordot(powers, derivatives, 1)) for powers in series]
        weights = np.linalg.inv(np.polynomial.polynomial.polyvander(steps, len(steps) - 1))[len(derivatives) - 1]
        return np.asarray(np.tensordot(weights, forces, 1))

    def end_at(self, time: float, resumable: bool) -> None:
        """Set the simulated time at which the run ends.

        resumable : True to store the state before a shorter last step, so that the run can be continued with the same
            bits.
        """
        super().end_at(time, resumable)
        self.resumable = resumable

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next: at the next check for rest, or after the first step
        that reaches the simulated time `aim`, whichever comes first.

        iteration : the one at which it is read now.
        """
        return int(min(self.rest.next_check, max(self._steps_to(self.aim), iteration + 1)))

    def _steps_to(self, time: float) -> float:
        """Return the number of steps after which a simulated time is reached; infinity if the time is infinite."""
        return float(np.ceil(time / self.time_step * (1 - SAME_STEP))) if np.isfinite(time) else np.inf

    def state(self) -> dict[str, np.ndarray]:
        """Return the state for a checkpoint, by name. If the run ended with a shorter step, it is the state before that
        step; so a run that is continued for longer has the same bits as one that never ended.
        """
        return self._state() if self.before_last is None else self.before_last

    def _state(self) -> dict[str, np.ndarray]:
        """Return the state now, by name: the fields that steps change, the time step, and what all dynamics keep."""
        fields = {name: self.fields.read(name) for name in self._changing}
        return super().state() | fields | {"time_step": np.array(self.time_step)}

    @property
    def _changing(self) -> list[str]:
        """Names of the fields that a step changes."""
        return [name for name in self.fields.names if name not in CONSTANT]

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from a checkpoint: the arrays by name that `state` returned in an earlier call. Raise InputError if
        it has another time step.
        """
        if float(state["time_step"]) != self.time_step:
            raise InputError(
                f"time_step is {self.time_step!r}, but the run to be resumed has {float(state['time_step'])!r}; "
                "continue it with the version of program and libraries that began it"
            )
        super().restore(state)
        for name in self._changing:
            self.fields.load(name, state[name])

    def numbers(self, span: float) -> tuple[float, ...]:
        """Return the constants that the kernel takes for a step, in its order.

        span : length of the step, time.
        """
        scene, options = self.scene, self.options
        radius = scene.slip_radius
        return (
            radius * span,  # turns a spin difference into the distance slipped in the step
            options.stiffness,  # of a spring
            # radius times damping of a contact; the radius alone for laws without friction
            radius * (options.damping if scene.law.has_friction else 1.0),
            scene.strength,  # by which a coefficient is multiplied to give the limit of kinetic friction
            scene.strength * options.static_ratio,  # the same for static friction
            *options.after_slip(span),  # two numbers that give the elongation of a slipping spring from its force
            span * radius / self.common_inertia,  # turns a sum of forces into the change of a spin in the step
        )

    def launches(self, steps: int) -> Iterator[Launch]:
        """Yield the launches (calls of the kernel with the same constants) that make `steps` steps, and count the time.

        The step that reaches the end of the run is shortened so that it ends there.
        """
        ends = self.iteration + steps == self._steps_to(self.end)
        shorter = ends and (self.iteration + steps) * self.time_step > self.end * (1 + SAME_STEP)
        # the steps of full length, then the shorter one
        if whole := steps - int(shorter):
            yield Launch(whole, self.numbers(self.time_step))
            self.iteration += whole
            self.time = self.iteration * self.time_step
        if shorter:
            span = self.end - self.time
            self._prepare_last_step(span)
            yield Launch(1, self.numbers(span))
            self.iteration += 1
            self.last_span = span
        if ends:
            self.time = self.end

    def _prepare_last_step(self, span: float) -> None:
        """Rescale the fields for one last step of another length. If the run can be resumed, store the state before
        that step first.

        The scaled n-th derivatives `gear_n` of the spins are proportional to the n-th power of the step. The field
        `integral` is a sum: the predicted mean spin of the next step, and a correction c for the error of the last
        prediction. The angle c * step must stay the same, so c is divided by the ratio of the steps.

        span : length of the step, time.
        """
        if self.resumable:
            self.before_last = self._state()
        if self.options.energy:
            staggered, force, _ = self.motion()
            self.balance_before = (
                *self._work(staggered, force),
                self._contact_power(force, staggered),
                self.pulls(force),
            )
        # the scaled derivatives, the predicted end, and the mean with its correction
        share = span / self.time_step
        old = [self.fields.read(f"gear_{n}") for n in range(self.options.gear_order + 1)]
        new = [share**n * values for n, values in enumerate(old)]
        for n, values in enumerate(new):
            self.fields.load(f"gear_{n}", values)
        self._load_predicted(new)
        if self.scene.law.has_friction:
            corrected = self.fields.read("integral") - _mean_over_step(old)
            self.fields.load("integral", _mean_over_step(new) + corrected / share)

    def spins(self) -> np.ndarray:
        """Return the spins now, with signs that alternate between neighbours, (C components, R samples, *N spheres),
        1/time; in a packing radius * spin.
        """
        return self.scene.impose_driving(self.fields.read("gear_0"), self.spin_axes)

    def motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the present state as three arrays: the spins, with signs that alternate between neighbours, (C
        components, R samples, *N spheres), 1/time, in a packing radius * spin; the contact forces (C, R, E contacts);
        and the elongations of the springs (C, R, E), length."""
        staggered = self.spins()
        force = self.contacts.read_forces("force") if self.iteration else self.damping_force(staggered)
        stretch = self.contacts.read_forces("elongation") if self.scene.law.has_friction else np.zeros_like(force)
        return staggered, force, stretch

    def findings(self, last: Progress) -> dict[str, np.ndarray]:
        """Return further results at the end, (R samples,) each: `elastic_share`, and on lattices `step_error`, the
        error of the spins by the time step relative to the largest spin, and `accurate_time_step`, a step that is
        accurate enough.

        The error is estimated from the modes of sticking contacts, which are known for lattices only.

        last : the progress at the end.
        """
        modes = self.contacts.sticking_modes(self.options, self.start_spin, self.stability_bound)
        if modes is None:
            return super().findings(last)
        of, replicas = (self.options.gear_order, self.time_step, self.iteration), self.scene.replicas
        found = {"step_error": modes.error(*of), "accurate_time_step": modes.accurate_step(*of)}
        return super().findings(last) | {name: np.full(replicas, value) for name, value in found.items()}

    def _contact_power(self, force: np.ndarray, staggered: np.ndarray) -> np.ndarray:
        """Return the power (R samples,) that the contacts take from the spins, divided by the radius.

        force : (C components, R, E contacts), contact forces.
        staggered : (C, R, *N spheres), spins with signs that alternate between neighbours, 1/time; in a packing radius
            * spin.
        """
        return replica_sum(force * self.differences(staggered))

    def energy_balance(self, staggered: np.ndarray, force: np.ndarray, spring: np.ndarray) -> Energy | None:
        """Return the energy balance at the end of the last step, or None if none is asked for.

        The powers of contacts and drive are integrated over time by the trapezoidal rule. So what is missing in the
        balance is the error of Gear's method and of this rule.

        staggered : (C components, R samples, *N spheres), spins with signs that alternate between neighbours, 1/time;
            in a packing radius * spin.
        force : (C, R, E contacts), contact forces.
        spring : (R,), energy in the springs.
        """
        if not self.options.energy:
            return None
        self.work, self.injected = self._work(staggered, force)
        return self.balance(staggered, spring)

    def _work(self, staggered: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return two energies since the start, (R samples,) each: the energy that the contacts took from the spins, and
        the energy that the driven spheres gave. Where the last step was shorter than the others, its energies are added
        separately.

        staggered, force : spins (C components, R, *N spheres) and contact forces (C, R, E contacts) at the end of the
            last step.
        """
        driven, power = self.absolute(staggered) * self.scene.is_driven, self._contact_power(force, staggered)
        if self.balance_before is not None:  # the trapezoidal rule over the last step alone
            work, injected, power_before, pull_before = self.balance_before
            length = self.scene.slip_radius * self.last_span / 2
            pull = replica_sum((pull_before + self.pulls(force)) * driven)
            return work + length * (power_before + power), injected - length * pull
        # the kernels sum over the steps; half of the first and last values makes the trapezoidal rule of that
        length = self.scene.slip_radius * self.time_step
        pull = self.fields.read("impulse") + (self.pull_at_start - self.pulls(force)) / 2
        work = replica_sum(self.fields.read("work")) + (power - self.power_at_start) / 2
        return length * work, -length * replica_sum(pull * driven)

    def may_be_at_rest(self, found: Progress) -> bool:
        """Return True if a state that does not change may be called rest, as its gap to the best lower bound so far is
        small.

        There is no usable bound where none can be proven, as of some packings, and with static friction above kinetic
        friction, as the motion may end above the least power. Then rest is believed once the driving has had the time
        to stretch the springs until they slip; in a packing without contacts, which has no springs, at once.

        found : the progress now.
        """
        if self.contacts.has_no_bound and not self.scene.network.contacts:
            return True
        if self.contacts.has_no_bound or self.options.static_ratio > 1:
            return self.time >= self._loading_time()
        return super().may_be_at_rest(replace(found, lower_bound=self.contacts.best_bound(found.lower_bound)))

    def _loading_time(self) -> float:
        """Return the time in which the driving stretches a spring to ten times the elongation at which the strongest
        contact slips, so that all springs are loaded after it; 0 if nothing is driven."""
        scene = self.scene
        strongest = float(scene.acting_coefficient.max()) * self.options.static_ratio
        speed = scene.slip_radius * scene.jump
        return 10 * scene.strength * strongest / (self.options.stiffness * speed) if speed > 0 else 0.0


def _mean_over_step(derivatives: list[np.ndarray]) -> np.ndarray:
    """Return the mean of a quantity over the next step of Gear's method.

    derivatives : scaled derivatives (n-th time derivative times (time step)^n / n!), the 0th first.
    """
    return np.asarray(np.sum([values / (n + 1) for n, values in enumerate(derivatives)], axis=0))


def stability_bound(scene: Scene, spin_axes: tuple[int, ...], options: CundallStrack) -> float:
    """Return the largest stable time step while all contacts stick, from the stiffest mode of a lattice.

    Slipping contacts are softer and do not reduce it. Contacts with a law of one's own are taken to slip at most as
    fast as the driven planes would on each other.

    scene : the lattice.
    spin_axes : numbers of the axes of the spin components that are computed.
    options : stiffness, damping, mass and order of Gear's method.
    """
    slopes = scene.steepest(scene.slip_radius * float(np.linalg.norm(np.ptp(scene.box(spin_axes), axis=0))))
    inertia = inertia_of(scene, options)
    return largest_step(options, scene.law.has_friction, *fastest_modes(scene, spin_axes, inertia, slopes))


def largest_step(options: CundallStrack, has_friction: bool, decay: float, stiffest: float) -> float:
    """Return the largest stable time step of the stiffest mode of the network.

    options : stiffness, damping and order of Gear's method.
    has_friction : True if the law has friction, and so springs and dampers.
    decay : decay rate of the fastest mode by viscosity, 1/time.
    stiffest : R^2 lambda / I, 1/mass: radius R, largest eigenvalue lambda of the Laplacian of the contacts, moment of
        inertia I.
    """
    damping, stiffness = (options.damping, options.stiffness) if has_friction else (0.0, 0.0)
    return largest_stable_step(options.gear_order, damping * stiffest + decay, stiffness * stiffest)
