"""Operator splitting for Coulomb friction: balance all torques as if by equal springs, let friction limit each force.

Write P(Omega) = R sum over contacts of mu F_n |D Omega| and give each contact a slip z of its own. The alternating
direction method of multipliers, which is Douglas-Rachford splitting, ties z to D Omega by springs of stiffness rho:

    f, z    per contact: the trial force v = f + rho z is split into f, v limited to the friction disc, and the rest
    Omega   minimises sum over contacts of |v - 2 f - rho D Omega|^2, a Poisson problem with constant coefficients,
            solved for the change that takes away what the springs leave on each sphere
    v       <- f + (1 - alpha) rho z + alpha rho D Omega, with alpha = 1.9 (over-relaxation)

Both halves are exact, so v converges from any start for any rho > 0 and 0 < alpha < 2 (Eckstein and Bertsekas 1992).
The spring force rho D Omega - (v - 2 f) right after the Poisson step leaves no torque on any free sphere: capped or
scaled into the friction discs it proves the lower bound. docs/how-methods-work.md has the rules and the measured rates.

Contacts along the height carry the drive and slip most, so their springs are four times softer. The stiffness is
steered by the proven gap, which splits into (P - W) + (W - bound) with W the work that the driven planes would do
against the balanced forces. The first part is large when the springs are too soft (the spins are late), the second when
they are too hard (the forces are late). At each check rho is changed, replica by replica, towards a second part that is
five times the first.
"""

import numpy as np

from taichi_bearings.fields import Fields, FieldSpec
from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels.splitting import ABSENT_FRICTION, contact_step
from taichi_bearings.lattice.incidence import contact_differences
from taichi_bearings.memory import refuse_beyond
from taichi_bearings.proof.certificate import (
    Forces,
    balance,
    capped,
    largest_unbalanced_torque,
    saturation,
    work_and_bound,
)
from taichi_bearings.scene import Progress, Scene
from taichi_bearings.scene.initial_spins import linear_spin
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.torque_balance import TorqueBalance

RELAXATION = 1.9  # alpha
HEIGHT_WEIGHT = 0.25  # stiffness of springs along the height over that of the others
USUAL_STIFFNESS = 15.0  # of the force that a column of spheres transmits / imposed jump
FORCES_BEHIND = 5.0  # (W - bound) / (P - W) that the stiffness is steered to
LARGEST_CHANGE, LEAST_CHANGE = 2.0, 1.2  # factor on the stiffness at one check; smaller changes are not made
STEERED_ITERATIONS = 20_000  # iterations after which the stiffness stays, so that the proof of convergence applies
FIRST_CHECK, CHECKS_A_RUN = 50, 6  # checks 50 iterations or 1/6 of the run apart, for 5 to 20 % of the time
# a sphere: 136 for fields in double precision, 220 for a check, the rest for the answer and its proof
BYTES_A_SPHERE = 1000.0
RESOLVED_SLIP = 0.01  # of the imposed jump: contacts that slip more are told from resting ones at any stage


class OperatorSplittingMethod(Method):
    """See the module docstring. An iteration is one pass over all contacts and one Poisson solve a spin component.

    The fields: `friction` mu F_n, `trial` v, `spring` rho D Omega - (v - 2 f), `potential` rho Omega, `pull` the
    springs of each sphere before the Poisson step.
    """

    def plan(self, scene: Scene, spin: np.ndarray) -> FieldSpec:
        super().plan(scene, spin)
        dimension, components = scene.lattice.dimension, len(self.spin_axes)
        spheres = scene.lattice.sites * scene.replicas
        refuse_beyond(BYTES_A_SPHERE * spheres, f"{self.options.name} of {spheres:,} spheres")
        forces = self.stencil_of(1).force_components
        self.spec = (
            ("friction", dimension),
            ("trial", forces),
            ("spring", forces),
            ("potential", components),
            ("pull", components),
        )
        return self.spec

    def begin(self, scene: Scene, spin: np.ndarray, fields: Fields | None) -> None:
        assert fields is not None
        lattice, self.fields, self.layout = scene.lattice, fields, fields.layout
        self.stencil = self.stencil_of(self.layout.block)
        self.weights = (1.0,) * lattice.height_axis + (HEIGHT_WEIGHT,)
        self.weight = np.array(self.weights)[lattice.axis]
        self.balance = TorqueBalance(self.spec, self.stencil, self.weights, fields)
        self.contacts = contact_step(self.spec, self.stencil)
        self.contacts.compile(fields)
        self._load(scene.clip_to_box(scene.staggered_spin(spin, self.spin_axes), self.spin_axes))

    def _load(self, staggered: np.ndarray) -> None:
        """Start from these spins, with the forces that springs of the first stiffness would bear."""
        scene = self.scene
        friction = np.full((scene.lattice.dimension, scene.replicas, *scene.lattice.shape), ABSENT_FRICTION)
        for axis, coefficient in enumerate(scene.lattice.by_axis(scene.acting_coefficient)):
            self.layout.from_lower_sphere(friction[axis], axis)[...] = scene.strength * coefficient
        self.fields.load("friction", friction)
        linear = scene.staggered_spin(linear_spin(scene), self.spin_axes)
        self.stiffness = self._usual_stiffness(scene.power(linear, self.spin_axes))
        self.change: np.ndarray | None = None
        self.iteration = 0
        stiffness = self._by_replica(self.stiffness)
        self.fields.load("potential", stiffness * staggered)
        differences = contact_differences(staggered, scene.lattice, self.spin_axes)
        trial = self.weight * self.stiffness[:, None] * differences
        self.fields.load("trial", self.stencil.forces_at_lower_sphere(trial, self.layout))

    def _by_replica(self, values: np.ndarray) -> np.ndarray:
        return values.reshape(-1, *(1,) * self.scene.lattice.dimension)

    def next_check(self, iteration: int) -> int:
        return iteration + max(FIRST_CHECK, iteration // CHECKS_A_RUN)

    def advance(self, steps: int) -> None:
        if self.change is not None:  # rho z and rho Omega as the last check asked for; spins and friction f stay
            self.stiffness = self.stiffness * self.change
            self.contacts.rescale(self.fields, self.change)
            self.change = None
        with self.balance.begin():
            for _ in range(steps):
                look_up()
                self._step_contacts(RELAXATION)
                self.balance.solve()
                self.iteration += 1

    def _step_contacts(self, relaxation: float) -> None:
        self.contacts.run(self.fields, (self.weights[0], self.weights[-1]), relaxation)

    def progress(self) -> Progress:
        """`force` is the limited friction f; the torque it leaves is reported and vanishes with the gap."""
        scene, axes = self.scene, self.spin_axes
        if self.balance.is_rough and self.iteration:  # once more, for what its rounding has left
            self._step_contacts(0.0)
            self.balance.solve()
        potential = self.fields.seen("potential")
        staggered = scene.impose_driving(potential / self._by_replica(self.stiffness), axes)
        trial = self.stencil.forces_of_contacts(self.fields.seen("trial"), self.layout)
        friction = capped(trial, saturation(scene, trial))
        slips = scene.slips(staggered, axes)
        power = scene.law.power(scene.contact, slips).sum(axis=1)
        balanced = self._spring_force(potential, trial, friction)
        work, bound = work_and_bound(scene, balanced, axes)
        self._steer(power, work, bound)
        # the fastest creep of a contact that rests, z = 0 exactly, as long as the two halves do not quite agree
        creep = float((slips * ((trial == friction).all(axis=0) & (scene.acting_coefficient > 0))).max())
        return Progress(
            iteration=self.iteration,
            staggered=staggered,
            spin_axes=axes,
            force=friction,
            objective=power,
            lower_bound=bound,
            resolution=min(creep, RESOLVED_SLIP * scene.lattice.radius * scene.jump),
            largest_balance_residual=largest_unbalanced_torque(scene, friction, axes),
            proof=balanced,
        )

    def _spring_force(self, potential: np.ndarray, trial: Forces, friction: Forces) -> Forces:
        """rho D Omega - (v - 2 f), (C, R, E).

        After a Poisson step they leave no torque but round-off on free spheres; some exceed their friction discs.
        """
        differences = contact_differences(potential, self.scene.lattice, self.spin_axes)
        force = self.weight * differences - (trial - 2 * friction)
        exact = self.fields.dtype == np.float64
        return force if exact else balance(self.scene, force, self.spin_axes)

    def _usual_stiffness(self, power: np.ndarray) -> np.ndarray:
        """USUAL_STIFFNESS in its units, (R,): a column transmits the force power / (R * jump * columns)."""
        scene = self.scene
        jump, columns = scene.jump or 1.0, scene.lattice.sites // scene.lattice.shape[-1]
        return (
            USUAL_STIFFNESS * np.maximum(power, np.finfo(np.float32).tiny) / (scene.lattice.radius * columns * jump**2)
        )

    def _steer(self, power: np.ndarray, balanced_power: np.ndarray, bound: np.ndarray) -> None:
        """Choose the next stiffness from the two parts of the gap, within a reach that only grows with the iterations.

        Without that limit a scene whose parts shrink in proportion would drive the stiffness away without end.
        """
        if not 0 < self.iteration < STEERED_ITERATIONS:
            return
        least = np.maximum(1e-3 * (power - bound), np.finfo(np.float64).tiny)
        spins_late = np.maximum(power - balanced_power, least)
        forces_late = np.maximum(balanced_power - bound, least)
        factor = np.sqrt(FORCES_BEHIND * spins_late / forces_late).clip(1 / LARGEST_CHANGE, LARGEST_CHANGE)
        reach = np.sqrt(max(self.iteration / FIRST_CHECK, 1.0))
        usual = self._usual_stiffness(power)
        wanted = (self.stiffness * factor).clip(usual / reach, usual * reach)
        factor = wanted / self.stiffness
        self.change = np.where(np.abs(np.log(factor)) > np.log(LEAST_CHANGE), factor, 1.0)
