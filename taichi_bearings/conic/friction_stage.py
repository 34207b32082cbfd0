"""Finds spins and contact forces in balance, where every contact has a spring whose force friction limits.

With inertia this is one implicit step in time of a dynamics, without it one step of the method of multipliers. Either
is called a *stage*. Let D Omega be the differences of spins across contacts and R the radius. A contact has the trial
force F* = start + resistance * R D Omega, shortened to its limit where |F*| exceeds that, and beside it the viscous
force viscosity * R D Omega, if there is a viscosity. Their sum is the force F. The spins Omega obey

    inertia (Omega - base) + R D^T F(Omega) = 0,

which holds at the minimum of a strictly convex function with a continuous gradient: inertia |Omega - base|^2 / 2 +
sum_e huber(F*_e) / resistance_e + the viscous potential. Newton's method finds this minimum: a contact that sticks
resists with its resistance; one that slips resists only across its force, with resistance * limit / |F*|. A line search
makes sure that no step goes up. Contacts begin or end to slip finitely often; after that convergence is quadratic.

Letters: n contacts with up to d slip components.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.newton_matrix import MOST_NEWTON_STEPS, REFINEMENTS, NewtonMatrix, resisted
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.scene.scene import vector_length

# torque left, relative to friction and inertia, at which Newton's method ends, and at which linear corrections end
STAGE_TORQUE, CORRECTED_TORQUE = 1e-10, 1e-15
# most corrections by conjugate gradients, which follow REFINEMENTS other ones; they end if a force over its limit
# exceeds STILL_LINEAR: a linear correction may turn the force of a slipping contact, but must hardly lengthen it
MOST_GRADIENTS, STILL_LINEAR = 8, 1 + 1e-3
LARGEST_EIGENVALUE = 8  # a Laplacian of lattice contacts is at most so large: twice the four contacts of a component
GRADIENT_RATIO = 200.0  # ratio of contact stiffness and inertia up to which conjugate gradients solve
GRADIENT_RESIDUAL = 1e-5  # relative residual at which conjugate gradients end
SEARCH_SLOPE = 0.1  # share of its slope at which a line search ends
LEAST_FORCE = 1e-280  # far below any force, and no limit over it overflows
EPS = np.finfo(np.float64).eps


@dataclass(frozen=True)
class StageEnd:
    """Spins and forces at the end of a stage: a step in time of a dynamics, or a step of the method of multipliers. The
    n contacts, with up to d slip components, have springs whose force friction limits.

    spins : (unknowns,), 1/time.
    force : (d, n), the whole force of each contact.
    held : (d, n), that force without its viscous part.
    slips : (n,) mask of the contacts that slip.
    """

    spins: np.ndarray
    force: np.ndarray
    held: np.ndarray
    slips: np.ndarray


@dataclass(frozen=True)
class Friction:
    """Laws of the n contacts of one sample in a stage (a step in time, or a step of the method of multipliers): each
    bears the force of a spring, limited by friction, and a viscous force.

    limit : (n,), largest force of friction; infinite for linear contacts.
    resistance : (n,), stiffness of the springs, force * time / length.
    inertia : moment of inertia over the duration of the stage; 0 for none.
    viscosity : (n,), force * time / length, of contacts that have one beside friction; None for none.
    """

    limit: np.ndarray
    resistance: np.ndarray
    inertia: float
    viscosity: np.ndarray | None = None

    @property
    def stiffest(self) -> float:
        """Largest derivative of a contact force with respect to the slip speed, force * time / length."""
        viscosity = 0.0 if self.viscosity is None else self.viscosity.max(initial=0.0)
        return float(self.resistance.max(initial=0.0) + viscosity)

    def limited(self, trial: np.ndarray) -> np.ndarray:
        """Return the forces (d, n) that friction allows: trial forces, shortened to the limit where they exceed it.

        trial : (d, n), forces that the springs would have without a limit, on n contacts with up to d slip components.
        """
        found: np.ndarray = trial * np.minimum(1.0, self.limit / np.maximum(vector_length(trial), LEAST_FORCE))
        return found

    def slips(self, trial: np.ndarray) -> np.ndarray:
        """Return a mask (n,) of the contacts that slip, as the force of their springs would exceed the limit.

        trial : (d, n), forces that the springs would have without a limit, on n contacts with up to d slip components.
        """
        return vector_length(trial) > self.limit

    def stiffness(self, trial: np.ndarray) -> np.ndarray:
        """Return the derivative (d, d, n) of each contact force with respect to the slip speed, force * time / length.

        trial : (d, n), forces that the springs would have without a limit, on n contacts with up to d slip components.
        """
        size = np.maximum(vector_length(trial), LEAST_FORCE)
        slips, along = size > self.limit, trial / size
        across = self.resistance * np.where(slips, self.limit / size, 1.0)
        found = np.where(slips, -across, 0.0) * along[:, None] * along[None, :]
        found[np.diag_indices(len(trial))] += across if self.viscosity is None else across + self.viscosity
        result: np.ndarray = found
        return result


class FrictionStage:
    """Solver for *stages*: an implicit step in time of a dynamics, or a step of the method of multipliers. It finds the
    spins at which the forces of springs limited by friction, viscous forces and the inertia of the spheres balance.

    system : the contacts.
    matrix : factorises their Newton matrix.
    radius : radius R of the spheres, length.
    spin_scale, force_scale : typical sizes of spins and forces, by which rounding is judged.
    factorisations : number of factorisations so far.
    """

    def __init__(
        self,
        system: ContactSystem,
        matrix: NewtonMatrix,
        radius: float,
        spin_scale: float,
        force_scale: float,
    ) -> None:
        """Prepare to solve stages over one system of contacts; nothing is factorised yet.

        system : the contacts.
        matrix : Newton matrix of the system.
        radius : radius of the spheres, length.
        spin_scale : typical size of spins, 1/time, by which rounding is judged.
        force_scale : typical size of forces, by which rounding is judged.
        """
        self.system, self.matrix, self.radius = system, matrix, radius
        self.spin_scale, self.force_scale = spin_scale, force_scale
        self.factorisations = 0
        self._factorised: tuple[float, np.ndarray] | None = None  # inertia and stiffnesses of the factorised matrix

    def solve(self, friction: Friction, base: np.ndarray, start: np.ndarray, guess: np.ndarray) -> StageEnd | None:
        """Return spins and forces at the end of a stage (a step in time, or of the method of multipliers), where forces
        and inertia balance; None if Newton's method gets nowhere.

        friction : laws of the n contacts, which have up to d slip components.
        base : (unknowns,), spins before the stage, from which inertia acts, 1/time.
        start : (d, n), force of each spring without slip.
        guess : (unknowns,), spins to begin with, 1/time.
        """
        inertia, resistance = friction.inertia, friction.resistance
        spins = guess
        trial = self._trial(start, resistance, spins)
        scale = inertia * self.spin_scale + self.radius * self.force_scale
        # torques that the rounding of spins makes
        noise = 8 * EPS * friction.stiffest * self.radius**2 * self.spin_scale
        prepared = False
        for _ in range(MOST_NEWTON_STEPS):
            # Torques that are left; the stage ends when they are small.
            force = friction.limited(trial) + self._viscous(friction, spins)
            torque = self._torque(force, inertia, spins - base)
            if prepared and np.abs(torque).max(initial=0.0) <= STAGE_TORQUE * scale + noise:
                return self._corrected(friction, base, spins, trial, force, scale)
            prepared = self._prepare(friction, trial)
            if not prepared:
                return None
            # A Newton step, as long as the line search allows.
            step = self._solved(-torque)
            change = resistance * self.radius * self.system.change(step)
            length = self._step_length(friction, trial, change, spins, base, step, float(torque @ step))
            spins = spins + length * step
            trial = self._trial(start, resistance, spins)
        return None

    def _trial(self, start: np.ndarray, resistance: np.ndarray, spins: np.ndarray) -> np.ndarray:
        """Return the trial forces (d, n) of the springs, before friction limits them: `start` plus stiffness times slip
        speed.

        start : (d, n), force of each spring without slip.
        resistance : (n,), stiffness of each spring, force * time / length.
        spins : (unknowns,), 1/time.
        """
        found: np.ndarray = start + resistance * self.radius * self.system.differences(spins)
        return found

    def _viscous(self, friction: Friction, spins: np.ndarray) -> np.ndarray | float:
        """Return the viscous parts (d, n) of the contact forces; 0 for a law without viscosity.

        friction : laws of the n contacts, of which the viscosity is used.
        spins : (unknowns,), 1/time.
        """
        if friction.viscosity is None:
            return 0.0
        found: np.ndarray = friction.viscosity * self.radius * self.system.differences(spins)
        return found

    def _torque(self, force: np.ndarray, inertia: float, gained: np.ndarray) -> np.ndarray:
        """Return the torques (unknowns,) that have to be 0 at the end of a stage: those of the contact forces plus
        inertia * gained.

        force : (d, n), forces on n contacts with up to d slip components.
        inertia : moment of inertia over the duration of the stage.
        gained : (unknowns,), spins less those before the stage, 1/time.
        """
        return inertia * gained + self.radius * self.system.torques(force)

    def _prepare(self, friction: Friction, trial: np.ndarray) -> bool:
        """Prepare to solve with the derivative of the torques with respect to the spins; return False if rounding makes
        that matrix singular.

        In short stages inertia dominates, and a few steps of conjugate gradients solve; nothing is factorised then.
        Otherwise the matrix is factorised, unless it is the last one again.

        friction : laws of the n contacts.
        trial : (d, n), forces of the springs before friction limits them.
        """
        self._inertia, self._stiffness = friction.inertia, np.zeros(0)  # gives the memory of the last one back
        self._stiffness = friction.stiffness(trial)
        self._stiffness *= self.radius**2 * self.system.felt
        coupling = LARGEST_EIGENVALUE * self.radius**2 * friction.stiffest
        self._by_gradients = bool(coupling <= GRADIENT_RATIO * friction.inertia and friction.slips(trial).any())
        if self._by_gradients:
            return True
        kept, self._factorised = self._factorised, None
        if kept is not None and kept[0] == friction.inertia and (kept[1] == self._stiffness).all():
            self._factorised = kept
            return True
        try:
            self.matrix.factorise(self._stiffness, friction.inertia)
        except NotPositiveDefinite:
            return False
        self.factorisations += 1
        self._factorised = friction.inertia, self._stiffness
        return True

    def _solved(self, right: np.ndarray) -> np.ndarray:
        """Return the solution (unknowns,) for a right-hand side (unknowns,) with the matrix that was prepared last; by
        conjugate gradients to a relative residual of GRADIENT_RESIDUAL."""
        if not self._by_gradients:
            return self.matrix.solve(right)
        solution, left, enough = np.zeros_like(right), right, GRADIENT_RESIDUAL**2 * float(right @ right)
        direction, size = left, float(left @ left)
        while size > enough:
            _, image = self._response(direction)
            length = size / float(direction @ image)
            solution, left = solution + length * direction, left - length * image
            size, before = float(left @ left), size
            direction = left + size / before * direction
        return solution

    def _response(self, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the response to a change of the spins, with the stiffness that was prepared last: the changes of the
        forces times the radius, (d, n), and those of the torques, (unknowns,), inertia included.

        step : (unknowns,), change of the spins, 1/time.
        """
        change = resisted(self._stiffness, self.system.change(step))
        return change, self._inertia * step + self.system.torques(change)

    def _step_length(
        self,
        friction: Friction,
        trial: np.ndarray,
        change: np.ndarray,
        spins: np.ndarray,
        base: np.ndarray,
        step: np.ndarray,
        first: float,
    ) -> float:
        """Return the length of a Newton step, 0 to 1, at which the function that the stage minimises has almost no
        slope along the step; 1 if it still falls at the end of the whole step.

        friction : laws of the n contacts.
        trial : (d, n), forces of the springs before friction limits them.
        change : (d, n), change of these by the whole step.
        spins : (unknowns,), spins now, 1/time.
        base : (unknowns,), spins from which inertia acts, 1/time.
        step : (unknowns,), the whole Newton step of the spins, 1/time.
        first : slope along the step at length 0, below 0.
        """
        gained = spins - base

        def slope(length: float) -> float:
            """Return the derivative of the function that the stage minimises, along the step at the length `length` (0
            to 1)."""
            force = friction.limited(trial + length * change) + self._viscous(friction, spins + length * step)
            work = float((force * change / friction.resistance).sum())
            return friction.inertia * float((gained + length * step) @ step) + work

        low, high, at_low, at_high = 0.0, 1.0, first, slope(1.0)
        if at_high <= SEARCH_SLOPE * abs(first):
            return 1.0
        length = 1.0
        for _ in range(MOST_NEWTON_STEPS):  # regula falsi; the end that stays is halved (Illinois)
            share = at_low / (at_low - at_high)
            length = low + min(max(share, 0.05), 0.95) * (high - low)
            now = slope(length)
            if abs(now) <= SEARCH_SLOPE * abs(first):
                break
            if now > 0:
                high, at_high, at_low = length, now, at_low / 2
            else:
                low, at_low, at_high = length, now, at_high / 2
        return length

    def _corrected(
        self,
        friction: Friction,
        base: np.ndarray,
        spins: np.ndarray,
        trial: np.ndarray,
        force: np.ndarray,
        scale: float,
    ) -> StageEnd:
        """Return the spins and forces at the end of the stage. Newton's method leaves small torques, as the forces of
        stiff contacts depend on more digits of the spins than doubles have. Here linear corrections are added to spins
        and forces, without computing forces from spins, until torques are gone.

        friction : laws of the n contacts.
        base : (unknowns,), spins from which inertia acts, 1/time.
        spins : (unknowns,), spins now, 1/time.
        trial : (d, n), forces of the springs before friction limits them.
        force : (d, n), the contact forces after that, with their viscous part.
        scale : torque by which the rest is judged.
        """
        for _ in range(REFINEMENTS):
            torque = self._torque(force, friction.inertia, spins - base)
            if np.abs(torque).max(initial=0.0) <= CORRECTED_TORQUE * scale:
                break
            step = self._solved(-torque)
            force = force + resisted(self._stiffness, self.system.change(step)) / self.radius
            spins = spins + step
        else:
            force, spins = self._corrected_by_gradients(friction, base, spins, force, scale)
        return StageEnd(spins, force, force - self._viscous(friction, spins), friction.slips(trial))

    def _corrected_by_gradients(
        self, friction: Friction, base: np.ndarray, spins: np.ndarray, force: np.ndarray, scale: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return forces (d, n) and spins (unknowns,) after more linear corrections, by conjugate gradients with the
        factorised matrix as preconditioner. They are needed where the diagonal of that matrix was raised, as a solve
        then corrects soft motions only in part.

        The corrections with the least torque are returned, or none if none reduces it. They end when a force clearly
        exceeds its limit (STILL_LINEAR): where friction differs by decades, the softest motions are mere rounding, and
        spins and forces would grow without end.

        friction : laws of the n contacts.
        base : (unknowns,), spins from which inertia acts, 1/time.
        spins : (unknowns,), spins now, 1/time.
        force : (d, n), the contact forces.
        scale : torque by which the rest is judged.
        """
        rubs, direction, before, least, best = friction.limit > 0, np.zeros_like(spins), np.inf, np.inf, (force, spins)
        for number in range(MOST_GRADIENTS + 1):
            held = vector_length(force - self._viscous(friction, spins))
            if number and (held > STILL_LINEAR * friction.limit)[rubs].any():
                break
            torque = self._torque(force, friction.inertia, spins - base)
            if (left := float(np.abs(torque).max(initial=0.0))) < least:
                least, best = left, (force, spins)
            if left <= CORRECTED_TORQUE * scale or number == MOST_GRADIENTS:
                break
            step = self._solved(-torque)
            now = -float(torque @ step)
            direction = step + now / before * direction
            change, image = self._response(direction)
            resisted_by_all = float(direction @ image)
            if not (now > 0 and resisted_by_all > 0):  # both are above 0 but for rounding
                break
            length = now / resisted_by_all
            force, spins, before = force + length * change / self.radius, spins + length * direction, now
        return best
