"""Operator splitting for Coulomb friction: one step balances all torques, the next one applies the friction limits.

The power is P(Omega) = R sum over contacts of mu F_n |D Omega|, with spins Omega and their differences D Omega across
contacts. Each contact gets a slip z of its own. The alternating direction method of multipliers, which is
Douglas-Rachford splitting, ties z to D Omega by springs of stiffness rho:

    f, z    per contact: the trial force v = f + rho z is split into f, v limited to the friction disc, and the rest
    Omega   minimises sum over contacts of |v - 2 f - rho D Omega|^2, a Poisson problem with constant coefficients,
            solved for the change of Omega that cancels the torque which the springs leave on each sphere
    v       <- f + (1 - alpha) rho z + alpha rho D Omega, with alpha = 1.9 (over-relaxation)

Both halves are exact, so v converges from any start for any rho > 0 and 0 < alpha < 2 (Eckstein and Bertsekas 1992).
The spring force rho D Omega - (v - 2 f) right after the Poisson step leaves no torque on any free sphere: capped or
scaled into the friction discs it proves the lower bound. docs/methods.md has the rules and the measured rates.

Contacts along the height carry the drive and slip most, so their springs are four times softer. The stiffness is
steered by the proven gap, which splits into (P - W) + (W - bound) with W the work that the driven planes would do
against the balanced forces. The first part is large when the springs are too soft (the spins are late), the second when
they are too hard (the forces are late). At each look rho is changed, sample by sample, towards a second part that is
five times the first.

Shapes are (C, R, *N) for spins and (C, R, E) for forces: C carried spin components, N spheres, E contacts, and R in
shapes is the number of samples; in formulas it is the radius. A *look* is when the loop of drive.py reads the progress.
Spins are *staggered*: with signs by which neighbours differ, measured from the bottom plane.
"""

from collections.abc import Mapping

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import number_type, team_size
from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels.splitting import ABSENT_FRICTION, ContactStep
from taichi_bearings.kernels.team import Team, made_once
from taichi_bearings.memory import refuse_beyond
from taichi_bearings.proof.certificate import (
    Forces,
    balance,
    work_and_bound,
)
from taichi_bearings.proof.column_sums import parts_in_cache
from taichi_bearings.scene import Bearing, Progress, Scene
from taichi_bearings.scene.initial_spins import staggered_linear_spin
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.on_strides import OnStrides
from taichi_bearings.solvers.splitting_look import Look
from taichi_bearings.solvers.torque_balance import TorqueBalance

RELAXATION = 1.9  # alpha
HEIGHT_WEIGHT = 0.25  # stiffness of springs along the height over that of the others
USUAL_STIFFNESS = 15.0  # stiffness at the start, in units of the force that a column of spheres transmits over the jump
FORCES_BEHIND = 5.0  # ratio (W - bound) / (P - W) to which the stiffness is steered
LARGEST_CHANGE, LEAST_CHANGE = 2.0, 1.2  # factor on the stiffness at one check; smaller changes are not made
STEERED_ITERATIONS = 20_000  # iterations after which the stiffness stays, so that the proof of convergence applies
FIRST_CHECK, CHECKS_A_RUN = 50, 6  # looks are 50 iterations or 1/6 of the run apart; they take 5 to 20 % of the time
# bytes: 136 for the fields in double precision, 220 for a look, the rest for the answer and its proof
BYTES_A_SPHERE = 1000.0
GAP_FALLS_AS = 2.0  # the gap falls about as iteration^-2, measured from 24^3 to 48^3
# lattices with so many spheres, more than fit into the caches of a core, make so many iterations in single precision
# first: it halves the traffic of memory, and the gap falls as in double precision, to about 1e-4
LARGE_LATTICE, SINGLE_ITERATIONS = 60_000, 1_000
RESOLVED_SLIP = 0.01  # of the imposed jump: faster contacts count as slipping at any stage


class OperatorSplittingMethod(Method):
    """Operator splitting: the least power of friction by a pass over all contacts and a Poisson solve, repeated.

    The power is the sum over contacts of radius * mu F_n |D Omega|, with spins Omega and their differences D Omega
    across contacts. Each contact bears a trial force v; f is v cut off at the friction limit; springs of stiffness rho
    tie the slip (v - f) / rho of the contact to D Omega. An iteration is one pass over all contacts and one Poisson
    solve for each spin component.

    Fields, with C spin components or V force components at each site:

    friction : mu F_n of the contact above a site, by axis.
    trial : (V), v.
    spring : (V), rho D Omega - (v - 2 f), the forces of the springs.
    potential : (C), rho Omega. Where it is in single precision, `potential_rest` has what rounding leaves out of it.
    pull : (C), the sum of the spring forces on each sphere before the Poisson step.

    Attributes:

    stiffness : (R samples,), rho of each sample.
    weights : stiffness of the springs over rho, by lattice axis.
    changing : names of the fields on which further iterations depend.
    is_large : True on a CPU for a lattice whose fields are larger than the caches of a core.
    is_single : True while the fields are in single precision although the runtime is in double precision.
    layout, stencil : where the numbers of a site stand in the fields, and constants for which kernels are compiled.
    balance : the solver of the Poisson problem, which adds the change of the spins to `potential`.
    contact_step, team : the kernel of the pass over the contacts, and the threads that run it.
    """

    scene: Scene
    contacts: OnStrides
    resumes = True
    changing = ("trial", "potential")

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare the iteration: allocate the fields, build the Poisson solver, compile the kernels, and load the
        start.

        scene : the lattice that is solved.
        spin : (R samples, *N spheres, 3), in 2D (R, *N), laboratory spins to start from, 1/time; clipped to the
            interval of the driven ones.

        Raises an error if the memory does not suffice.
        """
        super().begin(scene, spin)
        scene = self.scene
        spheres = scene.lattice.sites * scene.replicas
        refuse_beyond(BYTES_A_SPHERE * spheres, f"{self.options.name} of {spheres:,} spheres")
        self.weights = (1.0,) * scene.lattice.height_axis + (HEIGHT_WEIGHT,)
        running = runtime.current()
        self.is_large = not running.is_gpu and scene.lattice.sites >= LARGE_LATTICE
        self._allocate(np.dtype(np.float32) if self.is_large else number_type())
        self._load(scene.clip_to_box(scene.staggered_spin(spin, self.spin_axes), self.spin_axes))

    def _allocate(self, kind: np.dtype) -> None:
        """Allocate the fields, all 0, and compile the kernels that work on them: the two halves of an iteration, the
        Poisson solve and the pass over the contacts.

        kind : type of the numbers of the fields.
        """
        scene, components = self.scene, len(self.spin_axes)
        self.is_single = kind != number_type()
        forces = self.contacts.stencil_of(1).force_components
        of_contacts = ("friction", scene.lattice.dimension), ("trial", forces), ("spring", forces)
        of_spheres = ["potential", "pull", *["potential_rest"] * self.is_single]
        spec = (*of_contacts, *((name, components) for name in of_spheres))
        self.fields = self.contacts.on_device(spec, kind)
        self.layout = self.fields.layout
        self.stencil = self.contacts.stencil_of(self.layout.block)
        self.balance = TorqueBalance(spec, self.stencil, self.weights, self.fields, self.is_large)
        self.contact_step = made_once(ContactStep, spec, self.stencil, kind.name)
        self.team = Team(team_size(self.layout, sum(components for _, components in spec)))
        self.contact_step.compile(self.fields, self.team)
        # the friction limit of each contact stands at its lower sphere
        friction = np.full((scene.lattice.dimension, scene.replicas, *scene.lattice.shape), ABSENT_FRICTION, kind)
        for axis, coefficient in enumerate(scene.lattice.by_axis(scene.acting_coefficient)):
            np.multiply(scene.strength, coefficient, out=self.layout.from_lower_sphere(friction[axis], axis))
        self.fields.load("friction", friction)

    def _load(self, staggered: np.ndarray) -> None:
        """Load the first iterate: the spins, and the forces that the springs bear at these spins. The first stiffness
        follows from the power of spins that change linearly with the height.

        staggered : (C components, R samples, *N spheres), spins with signs that alternate between neighbours, 1/time.
        """
        scene = self.scene
        linear = staggered_linear_spin(scene, self.spin_axes)
        self.stiffness = self._usual_stiffness(scene.power(linear, self.spin_axes))
        self.iteration = 0
        stiffness = self._along_lattice(self.stiffness)
        self._load_potential(stiffness * staggered)
        weight = np.array(self.weights)[scene.lattice.axis]
        self._load_trial_forces(weight * self.stiffness[:, None] * self.differences(staggered))

    def _load_trial_forces(self, trial: Forces) -> None:
        """Write trial forces, (C components, R samples, E contacts), into their field. A trial force is cut off at the
        friction limit to give the friction of the contact.
        """
        self.fields.load("trial", self.stencil.forces_at_lower_sphere(trial, self.layout))

    def _load_potential(self, potential: np.ndarray) -> None:
        """Write potentials, stiffness times spins, into their field; and what rounding leaves out of them into another
        one, where that is stored.

        potential : (C components, R samples, *N spheres), the potentials.
        """
        self.fields.load("potential", potential)
        if self.is_single:
            self.fields.load("potential_rest", potential - potential.astype(self.fields.dtype))

    def state(self) -> dict[str, np.ndarray]:
        """Return by name the fields and numbers that the further iterations depend on, for a checkpoint. The type of
        the fields says whether iterations are in single precision.
        """
        names = self.changing + ("potential_rest",) * self.is_single
        fields = {name: self.fields.read(name).astype(self.fields.dtype) for name in names}
        return fields | {"iteration": np.array(self.iteration), "stiffness": self.stiffness}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the fields and numbers by name that `state` returned in an earlier call."""
        if self.is_single and state["trial"].dtype != self.fields.dtype:
            self._allocate(number_type())
        for name in self.changing + ("potential_rest",) * self.is_single:
            self.fields.load(name, state[name])
        self.iteration, self.stiffness = int(state["iteration"]), np.array(state["stiffness"])

    def give_back(self) -> None:
        """Free the fields, before the proof of the answer needs ten times their memory."""
        del self.fields, self.balance

    def _along_lattice(self, values: np.ndarray) -> np.ndarray:
        """Return values (R samples,), one a sample, with an axis of length 1 for each axis of the lattice."""
        return values.reshape(-1, *(1,) * self.scene.lattice.dimension)

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next: FIRST_CHECK iterations or a sixth of the run later.

        iteration : the one at which it is read now.
        """
        return iteration + max(FIRST_CHECK, iteration // CHECKS_A_RUN)

    def advance(self, steps: int) -> None:
        """Make `steps` iterations, each a pass over the contacts and a Poisson solve."""
        with self.balance.begin():
            for _ in range(steps):
                look_up()
                if self.is_single and self.iteration >= SINGLE_ITERATIONS:
                    self._continue_in_double()
                self._step_contacts(RELAXATION)
                self.balance.solve()
                self.iteration += 1

    def _continue_in_double(self) -> None:
        """Replace the fields, which are in single precision, by fields with the precision of the runtime."""
        potential, trial = self._potential(), self.fields.read("trial")
        self._allocate(number_type())
        self._load_potential(potential)
        self.fields.load("trial", trial)

    def _step_contacts(self, relaxation: float) -> None:
        """Make the pass over the contacts: cut off trial forces at friction, update them, and sum the spring forces on
        each sphere.

        relaxation : alpha, the factor of the over-relaxation; with 0 the trial forces stay, and only the spring forces
            are computed anew.
        """
        self.contact_step.run(self.fields, self.team, 1, (self.weights[0], self.weights[-1], relaxation))

    def progress(self) -> Progress:
        """Return the progress now: the spins, the friction forces f, and the lower bound that the balanced spring
        forces prove.

        The trial force v is cut off at the friction limit to give f; f leaves a torque on the spheres, which is
        reported and vanishes with the gap. The stiffness rho is adapted here too, so the iterations depend on when this
        is called.
        """
        scene, axes = self.scene, self.spin_axes
        if self.balance.is_rough and self.iteration:  # balance once more, for the torques that its rounding has left
            with self.balance.begin():
                self._step_contacts(0.0)
                self.balance.solve()
        staggered = self._potential()
        staggered /= self._along_lattice(self.stiffness)
        scene.impose_driving(staggered, axes)
        trial = self._seen("trial")[0]
        look = Look(scene, self.stencil, self.layout, axes, staggered, trial, (self.stiffness, self.weights))
        found = look.look(self.balance.each)
        balanced, bound = found.balanced, found.bound
        if number_type() != np.float64:  # in single precision they are balanced once more
            balanced = balance(scene, balanced, axes)
            _, bound = work_and_bound(scene, balanced, axes)
        self._change_stiffness(self._stiffness_factors(found.power, found.work, bound))
        return Progress(
            iteration=self.iteration,
            staggered=staggered,
            spin_axes=axes,
            force=found.friction,
            objective=found.power,
            lower_bound=bound,
            resolution=min(found.creep, RESOLVED_SLIP * scene.lattice.radius * scene.jump),
            largest_balance_residual=found.left_over,
            proof=balanced,
            falls_as=GAP_FALLS_AS,
        )

    def _potential(self) -> np.ndarray:
        """Return the potentials (stiffness times spins), (C components, R samples, *N spheres), in double precision."""
        found = self.fields.read("potential")
        if self.is_single:
            found += self.fields.view("potential_rest")
        return found

    def _seen(self, *names: str) -> list[np.ndarray]:
        """Return fields by name: on a CPU the arrays themselves, which can be changed in place; on a GPU copies."""
        see = self.fields.read if runtime.current().is_gpu else self.fields.view
        return [see(name) for name in names]

    def _change_stiffness(self, change: np.ndarray) -> None:
        """Multiply the stiffness rho of each sample by a factor, in place. The spins Omega and the friction f, which is
        the trial force v cut off, stay the same. So two things get the factor: the potential rho Omega, and v - f.

        f keeps its bits, so that a contact that sticks goes on to stick.

        change : (R samples,), the factors; if all are 1 nothing is done.
        """
        if (change == 1).all():
            return
        self.stiffness = change * self.stiffness
        # the fields, in pieces that fit into the cache and that the threads share
        of_sites = self._along_lattice(change)
        trial, friction = self._seen("trial", "friction")
        self._load_potential(of_sites * self._potential())
        pieces = [
            ([trial[row][part] for row in rows], friction[axis][part], of_sites[part[0]])
            for axis, rows in enumerate(self.stencil.force_rows(0))
            for part in parts_in_cache(friction[axis].shape)
            if rows
        ]
        list(self.balance.each(lambda piece: _rescale(*piece), pieces))
        if runtime.current().is_gpu:
            self.fields.load("trial", trial)

    def _usual_stiffness(self, power: np.ndarray) -> np.ndarray:
        """Return the usual stiffness (R samples,): USUAL_STIFFNESS times the force of a column of spheres over the
        imposed spin difference.

        A column transmits the force power / (radius * spin difference * number of columns).

        power : (R,), energy/time.
        """
        scene = self.scene
        jump, columns = scene.jump or 1.0, scene.lattice.sites // scene.lattice.shape[-1]
        found: np.ndarray = (
            USUAL_STIFFNESS * np.maximum(power, np.finfo(np.float32).tiny) / (scene.lattice.radius * columns * jump**2)
        )
        return found

    def _stiffness_factors(self, power: np.ndarray, balanced_power: np.ndarray, bound: np.ndarray) -> np.ndarray:
        """Return factors (R samples,) by which the stiffness is to change so that the two parts of the gap get the
        ratio FORCES_BEHIND; 1 for no change.

        The part power - balanced_power is large if the springs are too soft, balanced_power - bound if they are too
        hard. The stiffness may differ from its usual value only by a ratio that grows slowly with the iterations;
        without that limit it could grow for ever, if both parts shrink in proportion. Small changes are not made.

        power : (R,), power of the spins.
        balanced_power : (R,), work of the driven spheres against the balanced forces.
        bound : (R,), lower bound on the least power.
        """
        if not 0 < self.iteration < STEERED_ITERATIONS:
            return np.ones(len(power))
        # neither part counts as less than a thousandth of the gap, so that their ratio stays finite
        least = np.maximum(1e-3 * (power - bound), np.finfo(np.float64).tiny)
        spins_late = np.maximum(power - balanced_power, least)
        forces_late = np.maximum(balanced_power - bound, least)
        factor = np.sqrt(FORCES_BEHIND * spins_late / forces_late).clip(1 / LARGEST_CHANGE, LARGEST_CHANGE)
        ratio = np.sqrt(max(self.iteration / FIRST_CHECK, 1.0))
        usual = self._usual_stiffness(power)
        wanted = (self.stiffness * factor).clip(usual / ratio, usual * ratio)
        factor = wanted / self.stiffness
        return np.where(np.abs(np.log(factor)) > np.log(LEAST_CHANGE), factor, 1.0)


def _rescale(force: list[np.ndarray], friction: np.ndarray, change: np.ndarray) -> None:
    """Multiply the part of trial forces beyond the friction limit by a factor, in place, for some contacts along one
    axis.

    force : a list of one or two components of trial forces, arrays (R samples, *N sites) each.
    friction : (R, *N), their friction limits, negative where there is no contact.
    change : (R, 1, ..., 1), the factor of each sample.
    """
    limit = np.maximum(friction, 0.0)
    if len(force) == 1:
        limited = [np.clip(force[0], -limit, limit)]
    else:
        size = np.sqrt(force[0] * force[0] + force[1] * force[1])
        share = np.divide(limit, size, out=np.ones_like(size), where=size > limit)
        limited = [of * share for of in force]
    for of, cut in zip(force, limited, strict=True):
        of -= cut
        of *= change
        of += cut
