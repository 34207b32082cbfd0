"""Newton steps along the central path of a contact system: predictor, corrector, recentring.

At a point of the path every contact has the same product, friction * bound - slip . force. Mehrotra's predictor and
corrector (1992) and Gondzio's further correctors (1996), in the Nesterov-Todd scaling, reduce that product by a factor
of about five in a step, with one factorisation and a few solves.

Contacts can have a viscosity eta as well. The cost is then the sum of mu b + eta |v|^2 / 2 over bounds b >= |v| of the
slips v, and a contact bears eta v beside its force of friction. So eta is added to the stiffness of the Newton matrix,
and eta v to the forces whose torques have to balance. The cost less the dual cost is, as without viscosity, the sum of
friction times slip speed less force of friction times slip.

Letters: n contacts with up to d slip components, S samples computed together (conic/__init__.py).
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.cones import isotropic, length, longest_step
from taichi_bearings.conic.contact_system import ContactSystem, stacked
from taichi_bearings.conic.iterate import Inertia, Iterate, are_even
from taichi_bearings.conic.newton_matrix import REFINEMENTS, NewtonMatrix
from taichi_bearings.kernels import central_path as kernels
from taichi_bearings.numerics.cholesky import NotPositiveDefinite

# Largest number of Gondzio's correctors in a step. Each costs a solve and lengthens the step, which saves part of a
# factorisation. MOST_CORRECTORS has pairs: operations of a factorisation for each number of the factor, and the number
# of correctors that is quickest up to there (measured at 6^3 to 16^3 spheres). The other two numbers are for frictions
# that are decades apart, so that steps are short, and for factorisations that take as long as ten solves or more.
MOST_CORRECTORS, CORRECTORS_IF_UNEVEN, CORRECTORS_IF_COSTLY = ((60.0, 1), (110.0, 2), (np.inf, 3)), 3, 4
# The next three and PRODUCT_SPREAD are usual values of such methods; they change the number of steps, not the result.
FULL_STEP = 0.9  # step length beyond which no further corrector is tried
LEAST_GAIN = 0.02  # gain in step length below which a corrector is dropped and none is tried after it
# Shares of a corrector that are tried where a factorisation takes long (`Path._furthest`)
SHARES = (0.75, 0.5, 0.25)
STEP_SHARE = 0.95  # share of the way to the boundary of the cones that a step goes
TINY = np.finfo(np.float64).tiny
# LEAST_WORK / slip^2 is a weak stiffness along the slip, where friction has none; it keeps matrices regular
LEAST_WORK = 1e-14
# most refinements of the last solve; torque over the mean friction that needs none, and such a torque for rough steps
STEP_REFINEMENTS, STEP_TORQUE, ROUGH_STEP_TORQUE = 4, 1e-11, 1e-10
PRODUCT_SPREAD = 10.0  # correctors bring products into [target / PRODUCT_SPREAD, target * PRODUCT_SPREAD]
Viscous = np.ndarray | None


def friction_stiffness(
    friction: np.ndarray, viscosity: np.ndarray | None, difference: np.ndarray, share: float = np.inf
) -> np.ndarray:
    """Return for each contact the second derivative (d, d, n) of its cost with respect to its slip, a vector of up to d
    components. The cost is friction * |slip| + viscosity * |slip|^2 / 2.

    Along the slip the cost of friction is a straight line. There a weak stiffness LEAST_WORK / slip^2 is put instead of
    0, so that matrices are regular.

    friction : (n,), largest friction force of each contact.
    viscosity : (n,), viscous force over slip speed; None for none.
    difference : (d, n), slips, none of them 0.
    share : the weak stiffness is at most `share` times the stiffness across the slip, friction / slip; infinity for no
        such bound.
    """
    size = length(difference)
    along = difference / size
    weak = np.minimum(LEAST_WORK / size**2, share * friction / size) if share < np.inf else LEAST_WORK / size**2
    stiffness = weak * along[:, None] * along[None, :]
    if len(along) == 2:
        across = np.stack([-along[1], along[0]])
        stiffness = stiffness + (friction / size) * across[:, None] * across[None, :]
    found: np.ndarray = stiffness if viscosity is None else stiffness + isotropic(difference, viscosity)
    return found


def newton_step(iterate: Iterate, matrix: NewtonMatrix, raised: int = 0) -> Iterate:
    """Return the next point along the central path: one Newton step of predictor, corrector and recentring.

    On the central path the product of slip bound and friction margin, friction * bound - slip . force, is the same for
    all contacts; the path ends at the minimum, where it is 0.

    iterate : a point of the path; not changed.
    matrix : Newton matrix of its system, which is factorised anew.
    raised : index in DIAGONAL_SHIFTS (newton_matrix.py) of the first addition to the diagonal to try, 0 for none; the
        one that was taken is then in `matrix.raised`.

    Raises NotPositiveDefinite if the Newton matrix is singular to working precision.
    """
    path = Path(matrix)
    path.put(0, iterate)
    if not path.step(raised)[0]:
        raise NotPositiveDefinite
    return path.iterate(0)


def flowing(
    system: ContactSystem,
    viscosity: np.ndarray,
    matrix: NewtonMatrix,
    spins: np.ndarray,
    inertia: Inertia | None = None,
) -> np.ndarray:
    """Return spins (unknowns,) at which the torques of viscous forces alone balance, refined as long as each solve at
    least halves them. A central path that begins at these spins has balanced torques from its first point on.

    system : the n contacts.
    viscosity : (n,), viscous force over slip speed.
    matrix : Newton matrix of the system, which is factorised anew.
    spins : (unknowns,), spins to begin with.
    inertia : the inertia of the spheres, whose torques balance as well; None for none.

    Raises NotPositiveDefinite if viscosities differ by too many decades.
    """
    matrix.factorise(isotropic(system.offset, viscosity), inertia.weight if inertia else 0.0)
    best, least = spins, np.inf
    for _ in range(STEP_REFINEMENTS + 1):
        left_over = system.torques(-viscosity * system.differences(spins))
        left_over = left_over if inertia is None else left_over - inertia.torques(spins)
        size, last = float(np.abs(left_over).max(initial=0.0)), least
        if size < last:
            best, least = spins, size
        if not size < last / 2:
            break
        spins = spins + matrix.solve(left_over)
    return best


def balance(
    iterate: Iterate, matrix: NewtonMatrix, share: float = STEP_SHARE, rounds: int = 1, solves: int = REFINEMENTS
) -> Iterate:
    """Return a point of the central path whose contact forces are changed such that torques balance, up to rounding.
    Forces stay below friction; if that does not allow balance within `rounds` rounds, torques are only reduced.

    Why this is needed: stiff contacts magnify the rounding of spins; with friction over six decades a Newton step
    leaves torques of 1e-8. The changes are forces of fictitious springs at the contacts, each with the stiffness
    (friction - |force|)^2.

    iterate : a point of the path; not changed.
    matrix : matrix of springs at its contacts (`Surroundings.springs`), which is factorised anew in each round.
    share : in a round all forces change by at most this share of the change at which a first one reaches its friction.
    rounds : largest number of rounds.
    solves : number of solves in a round; those after the first correct the rounding.

    Raises NotPositiveDefinite if the matrix of springs is singular.
    """
    friction, dual, none = iterate.friction, iterate.dual, np.zeros_like(iterate.friction)
    load = iterate.to_balance(iterate.spins)
    if iterate.viscosity is not None:
        load = load + iterate.system.torques(iterate.viscosity * iterate.difference)
    for _ in range(rounds):
        change = matrix.balanced(dual, np.maximum(friction - length(dual), TINY) ** 2, load, solves) - dual
        along = share * longest_step((friction, dual), (none, change))
        dual = dual + min(1.0, along) * change
        if along >= 1:
            break
    return replace(iterate, dual=dual)


@dataclass(frozen=True)
class _Step:
    """A Newton step of S samples that is computed, but not taken yet.

    slot : 0 or 1, which of the two places for steps in memory holds its changes of bounds, slips and forces.
    spins : (unknowns or more, S), changes of the spins.
    found : (6, S), numbers found over all contacts. The first two are the largest factors of the step that keep all
        primal points (bound, slip) and all dual points (friction, force) in their cones, bound >= |slip| and friction
        >= |force|. The others are sums that tell how the mean of friction * bound - slip . force changes with these
        factors.
    """

    slot: int
    spins: np.ndarray
    found: np.ndarray

    @property
    def lengths(self) -> np.ndarray:
        """(2, S), for each of S samples the largest factors of the step that keep all primal points in their cones,
        bound >= |slip|, and all dual points in theirs, friction >= |force|."""
        return self.found[: kernels.LEAST_FOUND]

    @property
    def shorter(self) -> np.ndarray:
        """(S,), for each of S samples the largest factor of the step that keeps all contacts in their cones: bound >=
        |slip| and friction >= |force|."""
        found: np.ndarray = self.lengths.min(axis=0)
        return found

    @property
    def reach(self) -> np.ndarray:
        """(S,), how good the step is for each of S samples, from 0 to 2: the sum of its two `lengths`, each counted as
        1 at most."""
        along, dual_along = self.within(1.0)
        found: np.ndarray = along + dual_along
        return found

    def within(self, share: float) -> np.ndarray:
        """Return the factors (2, S) by which S samples are to take the step, for primal and for dual points: the share
        `share` of the way to the boundary of the cones, and at most 1."""
        return np.minimum(1.0, share * self.lengths)

    def with_samples_of(self, kept: np.ndarray, other: "_Step") -> "_Step":
        """Return a copy of this step in which some samples have the changes of spins and the numbers found that another
        step has. The rows of memory with its changes of bounds, slips and forces are not copied.

        kept : (S,) mask of the samples that are taken from the other step.
        other : the other step.
        """
        return replace(
            self,
            spins=np.where(kept, other.spins, self.spins),
            found=np.where(kept, other.found, self.found),
        )


class Path:
    """Up to S samples of one system, each at a point of its central path, on which friction * bound - slip . force, the
    *product*, is the same for all contacts. Samples do not influence each other.

    All numbers stay, from step to step, in the memory that kernels work on: a row for each kind of number, with one
    number for each contact and sample.

    samples : S.
    used : (S,) mask of the places that hold a sample.
    """

    def __init__(self, matrix: NewtonMatrix, samples: int = 1, rough: bool = False) -> None:
        """Reserve places for samples of the system of contacts of a Newton matrix; all places are empty.

        samples : number of places, 1 or LANES, the number of lanes of a SIMD vector.
        rough : True to refine steps less (up to ROUGH_STEP_TORQUE), which saves one solve in eight. This applies to
            samples without inertia and viscosity whose frictions are not decades apart.
        """
        self.samples, self._matrix, self._rows = samples, matrix, matrix.rows(samples)
        self._rough, self._enough = rough, np.full(samples, STEP_TORQUE)  # (S,), torques that need no refinement
        # by place: the sample without its spins, slips and forces, which are in memory; None for a free place
        self._given: list[Iterate | None] = [None] * samples
        self._spins = self._spins_before = np.zeros_like(self._rows.spins)  # (unknowns or more, S), now and a step ago
        # True if spheres have inertia; True if primal and dual steps need the same length (inertia or viscosity)
        self._moving = self._together = False
        self._inertia = 0.0  # weight of the inertia, which is added to the diagonal of the Newton matrix
        # viscosities, (2 * contacts, S), one for each slip component; and as stiffness matrices, `stacked`
        self._viscosity: np.ndarray | None = None
        self._viscous: Viscous = None
        # (S,) each, after a step: the power, which is the sum of friction * slip; and that less the work of the forces
        self._power, self._excess = np.zeros((2, samples))
        self._most_correctors = np.zeros(samples, dtype=np.int64)  # (S,)
        # after a step, by sample: relative gap; and what `price_of_torques` returns, empty until it is called
        self._gaps, self._price = [np.inf] * samples, list[float]()

    @property
    def used(self) -> np.ndarray:
        """(S,) mask of the places that hold a sample."""
        return np.array([iterate is not None for iterate in self._given])

    def put(self, sample: int, iterate: Iterate | None) -> None:
        """Put a sample at place number `sample`, or make the place free.

        iterate : the point of its central path at which the sample begins: spins, bounds, slips and forces of all
            contacts. None makes the place free.
        """
        self._given[sample] = iterate and _without_point(iterate)
        if iterate is None:
            return
        rows = self._rows
        smooth = np.zeros_like(iterate.bound) if iterate.smooth is None else iterate.smooth
        for row, values in (
            (kernels.FRICTION_ROW, iterate.friction),
            (kernels.BOUND, iterate.bound),
            (kernels.SLIP, iterate.difference),
            (kernels.DUAL, iterate.dual),
            (kernels.SMOOTH, smooth),
        ):
            rows.put(row, sample, values)
        self._spins[rows.place, sample], self._most_correctors[sample] = iterate.spins, self._correctors_for(iterate)
        self._inertia = iterate.inertia.weight if iterate.inertia else 0.0
        self._moving = iterate.inertia is not None
        # forces balance torques that depend on the spins, so both have to change by the same length of the step
        self._together = iterate.inertia is not None or iterate.viscosity is not None
        is_rough = self._rough and not self._together and are_even(iterate.friction)
        self._enough[sample] = ROUGH_STEP_TORQUE if is_rough else STEP_TORQUE
        if iterate.viscosity is not None:
            # Viscosities as stiffnesses, and in the places that contacts have in memory, by way of the row of forces.
            stiffness = stacked(isotropic(iterate.difference, iterate.viscosity))
            if self._viscosity is None or self._viscous is None:
                self._viscosity = np.zeros_like(rows.two_components(kernels.FORCE))
                self._viscous = np.zeros((len(stiffness), self.samples))
            rows.put(kernels.FORCE, sample, iterate.viscosity * np.ones_like(iterate.difference))
            self._viscosity[:, sample] = rows.two_components(kernels.FORCE)[:, sample]
            self._viscous[:, sample] = stiffness

    @np.errstate(all="ignore")  # at the end, and where there is no sample, numbers that are not finite turn up
    def step(self, raised: int = 0) -> np.ndarray:
        """Take one Newton step of every sample: predictor, corrector and recentring, STEP_SHARE of the way to the
        boundary of the cones.

        raised : index in DIAGONAL_SHIFTS (newton_matrix.py) of the first addition to the diagonals to try, 0 for none.

        Returns a mask (S,), True where the step was taken; False where the Newton matrix is singular to working
        precision.
        """
        rows = self._rows
        # Scaling of all cones, factorisation, and the predictor: a step towards product 0.
        rows.run(kernels.prepare, (0, 0), LEAST_WORK)
        going = self._matrix.factorise_rows(rows, self.used, self._inertia, self._viscous, raised)
        taken: np.ndarray = going.copy()
        step = self._solved(0)
        target = self._target(step)
        # Mehrotra's corrector: aims at the target product, and makes up for second-order terms of the predictor.
        rows.run(kernels.correct, (0, 1), target)
        step = self._with_correctors(self._furthest(step, self._solved(1)), target, going)
        # Refine the last solve, and go STEP_SHARE of the way to the boundary.
        step = self._refined(step)
        along, dual_along = step.within(STEP_SHARE)
        found = rows.run(kernels.take, (step.slot, step.slot), along, dual_along)
        self._power, self._excess = found[kernels.POWER_FOUND], found[kernels.EXCESS]
        self._gaps, self._price = (self._excess / self._power).tolist(), []
        self._spins_before, self._spins = self._spins, self._spins + along * step.spins
        return taken

    def _with_correctors(self, step: _Step, target: np.ndarray, going: np.ndarray) -> _Step:
        """Return the step of S samples after Gondzio's correctors. A sample gets correctors as long as each lengthens
        its step by LEAST_GAIN or more.

        step : the step before.
        target : (S,), product friction * bound - slip . force to aim at.
        going : (S,) mask of the samples to correct.
        """
        rejected = np.zeros_like(going)
        for number in range(int(self._most_correctors[self.used].max(initial=0))):
            going = going & (number < self._most_correctors) & ~(step.shorter > FULL_STEP)
            if not going.any():
                break
            further = self._furthest(step, self._recentred(step, target, going, rejected))
            rejected = going & (further.reach < step.reach + LEAST_GAIN)
            step = further.with_samples_of(rejected, step) if rejected.any() else further
            going = going & ~rejected
        # The better step of a rejected sample is in the other one of the two places in memory.
        for sample in np.flatnonzero(rejected).tolist():
            self._rows.copy_step(1 - step.slot, step.slot, sample)
        return step

    def _correctors_for(self, iterate: Iterate) -> int:
        """Return the largest number of Gondzio's correctors in a step of a sample, by the table MOST_CORRECTORS. It is
        larger where a factorisation takes longer, and where frictions are decades apart, because steps are short then.

        iterate : the point where the path of the sample begins; its frictions are used.
        """
        if self._matrix.is_costly:
            return CORRECTORS_IF_COSTLY
        if not are_even(iterate.friction):
            return CORRECTORS_IF_UNEVEN
        return next(most for operations, most in MOST_CORRECTORS if self._matrix.operations_per_number <= operations)

    def _furthest(self, step: _Step, further: _Step) -> _Step:
        """Return the step that goes furthest among `further` and the mixtures step + share * (further - step), with the
        shares of SHARES (Colombo & Gondzio, Comput. Optim. Appl. 41, 2008). Shares are tried from the largest on, as
        long as the step gets longer; none is tried where a factorisation is quick, as that would not pay.

        step, further : two steps from one point, in the two places in memory, both with balanced torques. The result
            overwrites `further` there.
        """
        best, taken = further, 1.0
        for share in SHARES if self._matrix.is_costly else ():
            lengths = self._rows.run(kernels.between_steps, (step.slot, further.slot), share)[: kernels.LEAST_FOUND]
            found = further.found.copy()
            found[: kernels.LEAST_FOUND] = lengths.min(axis=0) if self._together else lengths
            trial = replace(further, found=found)
            if not trial.reach[0] > best.reach[0]:
                break
            best, taken = trial, share
        if taken < 1:
            self._rows.mix(step.slot, further.slot, taken)
            best = replace(best, spins=step.spins + taken * (further.spins - step.spins))
        return best

    def _target(self, step: _Step) -> np.ndarray:
        """Return the product friction * bound - slip . force (S,) that the next step of each of S samples aims at: x^2
        / 4 of the present mean product, if the predictor would leave a share x of it. (Mehrotra takes x^3.)

        step : the predictor, a step towards the product 0.
        """
        count = np.array([max(1, iterate.in_cones) if iterate else 1 for iterate in self._given])
        product, by_reach, by_dual_reach, by_both = step.found[kernels.PRODUCT :]
        along, dual_along = step.within(1.0)
        after = product + along * by_reach + dual_along * by_dual_reach + along * dual_along * by_both
        remaining = np.maximum(after, 0.0) / np.maximum(product, TINY)
        found: np.ndarray = np.minimum(1.0, remaining**2) * product / count / 4
        return found

    def _recentred(self, step: _Step, target: np.ndarray, going: np.ndarray, rejected: np.ndarray) -> _Step:
        """Return the step after one of Gondzio's correctors, made in the other place in memory. Contacts whose product
        friction * bound - slip . force, after a somewhat longer step, differs from the target by more than a factor
        PRODUCT_SPREAD, are brought closer to it.

        step : the present step of S samples.
        target : (S,), product to aim at.
        going : (S,) mask of the samples that are corrected. All others keep their best step:
        rejected : (S,) mask of those whose best step stands in the other place, as their last corrector was rejected.
        """
        lengths = np.minimum(1.0, 1.5 * step.lengths + 0.1)
        other = np.where(rejected, kernels.AS_WRITTEN, kernels.AS_READ)
        choice = np.where(going, kernels.GO_ON, other)
        slots = step.slot, 1 - step.slot
        self._rows.run(kernels.recentre, slots, *lengths, target / PRODUCT_SPREAD, target * PRODUCT_SPREAD, choice)
        return self._solved(1 - step.slot)

    def _refined(self, step: _Step) -> _Step:
        """Return the step of all samples after iterative refinement: the linear system is solved again for the torques
        that rounding leaves. A sample is refined, at most STEP_REFINEMENTS times, as long as its largest torque is
        above the number `_enough` and each solve has at least halved it.

        step : the step before.
        """
        rows, last, going = self._rows, np.full(self.samples, np.inf), self.used
        for _ in range(STEP_REFINEMENTS):
            rows.add(kernels.DUAL, _row_of_step(step.slot, kernels.DUAL_STEP), kernels.FORCE)
            if self._viscosity is not None:
                slip = rows.two_components(kernels.SLIP) + rows.two_components(_row_of_step(step.slot, kernels.CHANGE))
                rows.two_components(kernels.FORCE)[:] -= self._viscosity * slip
            self._imbalance(kernels.FORCE, self._spins + step.spins)
            size = np.abs(rows.spins.T.copy()).max(axis=1, initial=0.0)
            going &= (size > self._enough) & (size < last / 2)
            if not going.any():
                break
            last = size
            self._matrix.solve_rows(rows)
            rows.spins[:] = step.spins + np.where(going, rows.spins, 0.0)
            step = self._expanded(step.slot)
        return step

    def _solved(self, slot: int) -> _Step:
        """Solve the linear system of a Newton step for all samples, and return the step: changes of the spins, and of
        bounds, slips and forces, after which all torques balance. The right-hand side of each contact is the value that
        W^-2 d(bound, slip) + d(friction, -force) shall have; W is the Nesterov-Todd scaling of the contact.

        slot : 0 or 1, the place in memory that holds the right-hand sides; the step is written into the same place.
        """
        pull = _row_of_step(slot, kernels.PULL)
        if self._viscosity is not None:
            forces = self._rows.two_components(pull) - self._viscosity * self._rows.two_components(kernels.SLIP)
            pull, self._rows.two_components(kernels.FORCE)[:] = kernels.FORCE, forces
        self._imbalance(pull, self._spins)
        self._matrix.solve_rows(self._rows)
        return self._expanded(slot)

    def _imbalance(self, row: int, spins: np.ndarray) -> None:
        """Compute for each unknown spin the torque of the contact forces, less the torque that accelerates the sphere
        if it has inertia. Write it into `self._rows.spins` (unknowns or more, S samples), the right-hand side of the
        next solve.

        row : row of memory with the first component of the contact forces; the row after it has the second one.
        spins : (unknowns or more, S), spins at the end of the step in time; read only if spheres have inertia.
        """
        rows = self._rows
        rows.torques(row)
        if self._moving:
            for sample, iterate in enumerate(self._given):
                if iterate is not None:
                    rows.spins[rows.place, sample] -= iterate.to_balance(spins[rows.place, sample])

    def _expanded(self, slot: int) -> _Step:
        """Return the whole Newton step of all samples, computed from the changes of the spins in `self._rows.spins`:
        changes of slips, bounds and forces, and the largest factors at which primal and dual points are in their cones.
        With inertia or viscosity both have the smaller of the two factors.

        slot : 0 or 1, the place in memory into which the changes of slips, bounds and forces are written.
        """
        spins = self._rows.spins.copy()
        self._rows.change(_row_of_step(slot, kernels.CHANGE))
        found = self._rows.run(kernels.expand, (slot, slot))
        if self._together:
            found[: kernels.LEAST_FOUND] = found[: kernels.LEAST_FOUND].min(axis=0)
        return _Step(slot, spins, found)

    def gap(self, sample: int) -> float:
        """Return the relative gap (cost - lower bound) / cost of a sample after a step, if its forces balance. The cost
        is the power; with viscosity the potential.

        sample : number of its place.
        """
        if self._viscosity is not None:
            return self.iterate(sample).gap
        return self._gaps[sample]

    def price_of_torques(self, sample: int) -> float:
        """Return a bound on the relative loss of the lower bound of a sample by unbalanced torques: the sum of the
        sizes of the torques, divided by the cost. It holds if no spin of a minimum exceeds the unit of spin.

        sample : number of its place.
        """
        if self._viscosity is not None:
            return self.iterate(sample).price_of_torques
        if not self._price:
            self._rows.torques(kernels.DUAL)
            left = self._rows.spins[: len(self._rows.place)].T
            self._price = (np.abs(left).copy().sum(axis=1) / self._power).tolist()
        return self._price[sample]

    def iterate(self, sample: int) -> Iterate:
        """Return the point of the central path that sample number `sample` has reached."""
        return self._read(sample, self._spins, kernels.BOUND, kernels.SLIP, kernels.DUAL)

    def before(self, sample: int) -> Iterate:
        """Return the point of the central path at which sample number `sample` was one step ago."""
        of_before = kernels.BOUND_BEFORE, kernels.SLIP_BEFORE, kernels.DUAL_BEFORE
        return self._read(sample, self._spins_before, *of_before)

    def _read(self, sample: int, spins: np.ndarray, bound: int, slip: int, dual: int) -> Iterate:
        """Return a point of the central path of one sample, read from memory, in which a row has one number of each
        contact.

        sample : number of its place.
        spins : (unknowns or more, S), spins of all S samples.
        bound : row of the bounds of the slips.
        slip : first row of the slips, which take two rows.
        dual : first row of minus the friction forces, which take two rows.
        """
        iterate, rows = self._given[sample], self._rows
        assert iterate is not None
        d = len(iterate.difference)
        return replace(
            iterate,
            spins=spins[rows.place, sample],
            # not from the spins anew: their rounding is coarser than the last distances from the cones
            difference=rows.vectors(slip, sample, d),
            bound=rows.numbers(bound, sample),
            dual=rows.vectors(dual, sample, d),
        )


def _without_point(iterate: Iterate) -> Iterate:
    """Return a copy of an iterate with empty arrays as spins, bounds, slips and forces, which saves memory."""
    none = np.zeros((len(iterate.difference), 0))
    return replace(iterate, spins=none[0], bound=none[0], difference=none, dual=none)


def _row_of_step(slot: int, row: int) -> int:
    """Return the number, among all rows of memory, of one row of a Newton step; a row has one number of every contact.

    slot : 0 or 1, which of the two steps in memory.
    row : number of the row within the step.
    """
    return kernels.STATE_ROWS + slot * kernels.STEP_ROWS + row
