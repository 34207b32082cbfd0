"""Gradient descent on the dissipated power, the paper's first method, with step lengths that provably converge.

The metric is diagonal: each spin is divided by the sum of its contacts' coefficients, which bounds the curvature of the
power by 2 whatever the disorder. The rules (docs/methods.md has the proofs and rates):

* viscous: step 1/2, the inverse of that bound, so the power falls in every step; with momentum the error falls like
  exp(-2 k / sqrt(condition number)) instead of exp(-k / condition number).
* Coulomb without momentum: the subgradient counts slipping contacts only. Epochs of 64, 128, 256 ... steps of constant
  length, shortened by sqrt(2) each time; spins and forces are averaged over the second half of an epoch. The
  average has a proven gap that falls like 1 / sqrt(k).
* Coulomb with momentum: contacts with |D| < width resist in proportion to D, which makes the power smooth; the width is
  halved whenever at least half the proven gap is due to it. The proven gap falls like 1 / k.
* Both together: as with Coulomb friction, with width times viscosity added to the friction in the metric.

Letters: k number of steps, D spin difference of a contact, R samples, N spheres, E contacts, C carried spin components.
The *box* is the interval between the driven spins, in which some minimum lies; spins stay in it where one is known. A
*sweep* is one step of all spins, a *look* is when the loop of drive.py reads the progress. *Staggered* spins are those
that are carried: on a lattice with signs by which neighbours differ and measured from the bottom plane; in a packing
u = R omega, radius times spin.
"""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.scene import Bearing, Progress
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.contacts import CONSTANT, Launch
from taichi_bearings.solvers.method import Swept
from taichi_bearings.solvers.table import GradientDescent

FIRST_EPOCH = 64  # sweeps of the first epoch without momentum; each further one has twice as many
FIRST_SPIN_STEP = 0.01  # of the imposed jump: length of the first steps without momentum
FIRST_WIDTH = 0.1  # of the imposed jump: regularisation at the start with momentum
LARGE_SLIP = 0.01  # of the imposed jump: faster contacts count as slipping from the first step on
# in widths: regularised contacts that should stick creep by about one width, few by ten, none by 100
RESOLVED_WIDTHS = 100
CHECKS_AN_EPOCH = 8  # without momentum; the first half of them before the averaging begins


class GradientDescentMethod(Swept):
    """Gradient descent on the dissipated power. An iteration is one sweep, in which all spins move; sweeps are made in
    pairs.

    The gradient is divided by a weight for each spin component of each sphere: the sum over its contacts of a bound on
    the curvature of their power, up to a factor that the step length has.

    momentum : True to accelerate the descent, by Nesterov's momentum.
    averages : True with friction and without momentum: spins and forces are then averaged over sweeps.
    viscosity : (R samples, E contacts), viscosity of each contact beside friction, times the radius and in the unit of
        the friction coefficients; None without.
    box : interval in which spins stay, lower ends of three components and then upper ends, 1/time.
    team, sweeps : the threads that run the kernel, and the kernel.

    With momentum:

    width : spin difference, 1/time, below which friction is smoothed: it then grows in proportion to the slip.
    least_width : width below which rounding rules, 1/time.
    age : sweeps since the momentum was last set to zero.
    last_smooth : (R,), the objective with smoothed friction when the progress was last read.

    Without momentum, a run is divided into epochs of constant step length, over whose second halves spins and forces
    are averaged:

    step_length : largest change of a spin in a sweep, 1/time.
    epoch_start, epoch_length : iteration at which the epoch began, and how many iterations it has.
    averaged : sweeps that are in the averages of this epoch.
    """

    resumes = True
    state_numbers = ("iteration", "age", "width", "step_length", "epoch_start", "epoch_length", "averaged")

    def __init__(self, options: GradientDescent) -> None:
        """Take the options of the method, among them `momentum`."""
        super().__init__(options)
        self.momentum = options.momentum

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare the descent: load the spins at the start and the weights by which gradients are divided, and compile
        the kernels.

        scene : what to solve.
        spin : (R samples, *N spheres, 3), in 2D (R, *N), spins to start from, 1/time; they are clipped to the interval
            between the driven spins where a minimum is known to lie in it.
        """
        super().begin(scene, spin)
        # the scene as the contacts have it: in a packing without those contacts that take no part
        scene, contacts = self.scene, self.contacts
        # multiplied by a spin difference this viscosity is a force in the unit `strength` of the friction coefficients
        beside = scene.viscosity_beside_friction
        self.viscosity = None if beside is None else scene.slip_radius / scene.strength * beside
        self.averages = scene.law.has_friction and not self.momentum
        # fields of the spheres, with a number for each spin component, and fields of the contacts
        names = [*contacts.points, "inverse_weight"] + self.momentum * ["spin"] + self.averages * ["spin_sum"]
        spheres = dict.fromkeys(names, len(self.spin_axes))
        of_contacts = [*contacts.forces, *(["force_sum"] if self.averages else [])]
        contacts.allocate(contacts.field_spec(spheres, of_contacts), self.viscosity)
        self._load_spins(scene.clip_to_box(scene.staggered_spin(spin, self.spin_axes), self.spin_axes))
        box = np.zeros((2, 3))  # lower and upper ends
        box[:, : len(self.spin_axes)] = scene.box(self.spin_axes)
        self.box = box.ravel().tolist()
        self.team, self.sweeps = contacts.descent_kernel()
        self.sweeps.compile(self.fields, self.team)
        jump = scene.jump or 1.0
        precision = np.float64 if runtime.current().precision == "f64" else np.float32
        self.least_width = 1e2 * float(np.finfo(precision).eps) * jump  # a hundred roundings of a spin
        # spin difference below which friction is smoothed; without momentum it is not
        self.width = FIRST_WIDTH * jump if self.momentum else self.least_width
        self.step_length = FIRST_SPIN_STEP * jump
        self.iteration = self.age = 0  # sweeps so far, and since the momentum was last set to zero
        self.last_smooth = np.full(scene.replicas, np.inf)
        self._load_weights()
        self._begin_epoch(FIRST_EPOCH)

    def _load_weights(self) -> None:
        """Load the field `inverse_weight`: one over the weight of each spin component of each sphere, 0 for driven
        ones.

        A step of the descent is step length * gradient / weight. The weight is the sum over the contacts of the sphere
        of a bound on the second derivative of the objective.

        Friction is smoothed over some difference of spins, so that this derivative is at most its coefficient over that
        difference. As the step length has the difference as a factor, the weight has the bare coefficient. The
        derivative of a viscous force does not depend on the difference, and is multiplied by it instead.
        """
        scene = self.scene
        # spin difference over which friction is smoothed; a law of a user has a bound of its own
        smoothed = self.width if self.momentum else 2 * self.step_length
        bounds = scene.acting_coefficient
        if not scene.law.is_sum:
            slopes = scene.steepest(self._largest_slip())
            assert slopes is not None, "a law of one's own that is solved here has no friction"
            bounds = scene.slip_radius * slopes
        if self.viscosity is not None:
            bounds = bounds + smoothed * self.viscosity
        weight = self.contacts.weights(bounds)
        weight[..., scene.is_driven] = 0.0
        self.fields.load("inverse_weight", np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0))

    def _largest_slip(self) -> float:
        """Return a slip speed, length/time, that no contact exceeds. Spins stay between the smallest and the largest
        imposed one (their box); momentum carries each beyond by less than the width of the box.
        """
        low, high = self.scene.box(self.spin_axes)
        return 3 * self.scene.slip_radius * float(np.linalg.norm(np.subtract(high, low)))

    def _load_spins(self, staggered: np.ndarray) -> None:
        """Write spins into all fields that hold spins.

        staggered : (C components, R samples, *N spheres), spins with signs that alternate between neighbours, 1/time;
            in a packing radius * spin.
        """
        for name in self.contacts.points + (("spin",) if self.momentum else ()):
            self.fields.load(name, staggered)

    def _begin_epoch(self, length: int) -> None:
        """Begin an epoch, a number of sweeps of constant step length, and clear the sums of spins and forces that are
        averaged over it.

        length : number of its iterations.
        """
        self.epoch_start, self.epoch_length, self.averaged = self.iteration, length, 0
        if self.averages:
            self.fields.clear("spin_sum")
            self.fields.clear("force_sum")

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next: if spins are averaged, an eighth of an epoch later
        (an epoch is a number of sweeps with one step length); otherwise later by about an eighth of the run so far.

        iteration : the one at which it is read now.
        """
        if self.averages:
            return iteration + self.epoch_length // CHECKS_AN_EPOCH
        return iteration + 2 * (16 + iteration // 16)

    def launches(self, steps: int) -> Iterator[Launch]:
        """Yield one launch (repeated calls of the kernel) that makes `steps` sweeps, or one more if the number is odd,
        since each call makes two.
        """
        pairs = -(-steps // 2)
        averaging = self.averages and self.iteration >= self.epoch_start + self.epoch_length // 2
        step, sharpness = self._step_and_sharpness()
        numbers = (step, sharpness, *self.box, float(averaging))
        yield Launch(pairs, numbers, self.age // 2)
        self.iteration += 2 * pairs
        if self.momentum:
            self.age += 2 * pairs
        if averaging:
            self.averaged += 2 * pairs

    @property
    def _changing(self) -> list[str]:
        """Names of the fields that the descent changes."""
        return [name for name in self.fields.names if name not in CONSTANT]

    def state(self) -> dict[str, np.ndarray]:
        """Return the fields and numbers that the further sweeps depend on, by name."""
        numbers = {name: np.array(getattr(self, name)) for name in self.state_numbers}
        fields = {name: self.fields.read(name) for name in self._changing}
        return fields | numbers | {"last_smooth": self.last_smooth} | self.contacts.state()

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the fields and numbers by name that `state` returned in an earlier call."""
        for name in self._changing:
            self.fields.load(name, state[name])
        for name in self.state_numbers:
            setattr(self, name, type(getattr(self, name))(state[name]))
        self.last_smooth = np.array(state["last_smooth"])
        self.contacts.restore(state)

    def _step_and_sharpness(self) -> tuple[float, float]:
        """Return two constants of the kernel: the step length, 1/time, and a constant of the function that computes the
        force of a contact.

        With friction that constant is one over the spin difference up to which friction grows, time; for a law without
        friction it is the radius.
        """
        if not self.scene.law.has_friction:
            return 0.5, self.scene.slip_radius
        return (self.width / 2 if self.momentum else self.step_length), 1.0 / self.width

    def progress(self) -> Progress:
        """Return the progress now, with the bounds on the objective, and choose width or step length of the next
        sweeps.

        Without momentum the progress is that of the average of the epoch. An epoch that has ended is followed by one of
        twice the length, with steps shorter by a factor sqrt(2). With momentum the width over which friction is
        smoothed is halved once it causes half the gap.
        """
        scene = self.scene
        if self.averaged:
            staggered = scene.impose_driving(self.fields.read("spin_sum") / self.averaged, self.spin_axes)
            force = self.contacts.read_forces("force_sum") * (scene.strength / self.averaged)
        else:
            staggered = scene.impose_driving(self.fields.read("spin" if self.momentum else "point"), self.spin_axes)
            force = self.forces_at(staggered, self.width)
        creep = RESOLVED_WIDTHS * (self.width if self.momentum else self.step_length) if scene.law.has_friction else 0.0
        resolution = scene.slip_radius * min(creep, LARGE_SLIP * scene.jump)  # slower slips may be rest
        found = self.judged(staggered, force, iteration=self.iteration, resolution=resolution)
        # what the next sweeps need: width and momentum, or the next epoch from its average
        if self.momentum:
            self._adapt(staggered, found.objective, self.contacts.best_bound(found.lower_bound))
        elif self.averages and self.iteration >= self.epoch_start + self.epoch_length:
            self._load_spins(staggered)
            self.step_length /= math.sqrt(2)
            if self.viscosity is not None:
                self._load_weights()
            self._begin_epoch(2 * self.epoch_length)
        return found

    def _adapt(self, staggered: np.ndarray, objective: np.ndarray, bound: np.ndarray) -> None:
        """Set the momentum to zero if the smoothed objective has risen. Halve the width of the smoothing if the
        smoothing causes half the gap or more.

        staggered : (C components, R samples, *N spheres), spins now, with signs that alternate between neighbours.
        objective, bound : (R,), what is minimised, and its best lower bound.
        """
        shorten, smooth, scene = False, objective, self.scene
        # the regularised objective is less than the true one, by at most radius * width / 2 times friction a contact
        if scene.law.has_friction:
            size = np.minimum(vector_length(self.differences(staggered)), self.width)
            error = scene.slip_radius * (size - size**2 / (2 * self.width))
            smooth = objective - (scene.strength * scene.acting_coefficient * error).sum(axis=1)
            shorten = self.width > self.least_width and bool((objective - smooth >= 0.5 * (objective - bound)).all())
        if shorten:
            self.width = max(self.width / 2, self.least_width)
            smooth = np.full_like(objective, np.inf)
            if self.viscosity is not None:
                self._load_weights()
        if shorten or (smooth > self.last_smooth).any():
            self.age = 0
        self.last_smooth = smooth
