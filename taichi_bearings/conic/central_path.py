"""Newton steps along the central path of a contact system: predictor, corrector, recentring.

At a point of the path every contact has the same product of slip bound and friction margin. Mehrotra's predictor and
corrector (1992) and Gondzio's further correctors (1996), in the Nesterov-Todd scaling, bring that product down by a
factor of about five a step, with one factorisation and a few solves.

Contacts can have a viscosity besides: the cost is the sum of mu b + eta |v|^2 / 2 over bounds b >= |v|, and a contact
bears the force of its cone and eta v. Nothing else changes: eta adds to the stiffness of the Newton matrix, eta v to
the torques that the forces leave, and cost less dual cost stays friction times slip less force times slip in the cones.
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.cone import length, longest_step
from taichi_bearings.conic.contact_system import ContactSystem, stacked
from taichi_bearings.conic.grouped import Arrays, each, isotropic
from taichi_bearings.conic.iterate import Inertia, Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.kernels import central_path as kernels

CORRECTORS = 3  # Gondzio's, at most; each costs a solve and spares a part of a factorisation
LONG_ENOUGH = 0.9  # step length beyond which no further corrector is tried
WORTHWHILE = 0.02  # gain in step length below which a corrector is dropped and none is tried after it
STEP_SHARE = 0.95  # of the way to the boundary of the cones
TINY = np.finfo(np.float64).tiny
WEAK = 1e-18  # product of slip and stiffness along it that keeps Newton matrices regular; it slows nothing down
REFINEMENTS, BALANCED = 4, 1e-11  # of the last solve, at most; torque, of the mean friction, that needs no second one
SPREAD = 10.0  # correctors bring products into [target / SPREAD, target * SPREAD]


def friction_stiffness(friction: np.ndarray, difference: np.ndarray, share: float = np.inf) -> np.ndarray:
    """Second derivative (d, d, n) of friction * |difference|, plus the weak WEAK / slip^2 along the slip, which is at
    most `share` of that across it."""
    size = length(difference)
    along = difference / size
    weak = np.minimum(WEAK / size**2, share * friction / size) if share < np.inf else WEAK / size**2
    stiffness = weak * along[:, None] * along[None, :]
    if len(along) == 2:
        across = np.stack([-along[1], along[0]])
        stiffness = stiffness + (friction / size) * across[:, None] * across[None, :]
    return stiffness


def newton_step(iterate: Iterate, matrix: NewtonMatrix) -> Iterate:
    """The next point along the path.

    Raises NotPositiveDefinite if the Newton matrix is singular to working precision.
    """
    directions = _Directions(iterate, matrix)
    step = directions.predicted()
    target = directions.target(step)
    step = directions.corrected(step, target)
    for _ in range(CORRECTORS):
        if min(step.along, step.dual_along) > LONG_ENOUGH:
            break
        further = directions.recentred(step, target)
        if further.reach < step.reach + WORTHWHILE:
            break
        step = further
    return directions.taken(directions.refined(step))


def flowing(
    system: ContactSystem, viscosity: Arrays, matrix: NewtonMatrix, spins: np.ndarray, inertia: Inertia | None = None
) -> np.ndarray:
    """Spins (unknowns,) at which viscous forces alone are in balance, refined as long as that helps.

    A path that begins there leaves no torque on its way. spins : where to begin. Raises NotPositiveDefinite if the
    contrast of the viscosities is too large.
    """
    matrix.factorise(isotropic(system.offset, viscosity), inertia.weight if inertia else 0.0)
    best, least = spins, np.inf
    for _ in range(REFINEMENTS + 1):
        left_over = system.torques(-viscosity * system.differences(spins))
        left_over = left_over if inertia is None else left_over - inertia.torques(spins)
        size, last = float(np.abs(left_over).max(initial=0.0)), least
        if size < last:
            best, least = spins, size
        if not size < last / 2:
            break
        spins = spins + matrix.solve(left_over)
    return best


def balance(iterate: Iterate, matrix: NewtonMatrix) -> Iterate:
    """Take away the torques that rounding has left, from contacts in cones in proportion to the square of their margin.

    Stiff contacts feel the rounding of the spins: over six decades of friction a Newton step leaves torques of 1e-8.
    Raises NotPositiveDefinite if the forces cannot be balanced.
    """
    friction, dual = iterate.friction, iterate.dual
    load = iterate.to_balance(iterate.spins)
    if iterate.viscosity is not None:
        load = load + iterate.system.torques(iterate.viscosity * iterate.difference)
    stiffness = isotropic(dual, each(np.maximum, friction - dual.length(), TINY) ** 2)
    change = matrix.balanced(dual, stiffness, load) - dual
    along = min(each(lambda mu, y, dy: longest_step((mu, y), (np.zeros_like(mu), dy)), friction, dual, change))
    return replace(iterate, dual=dual + min(1.0, STEP_SHARE * along) * change)


@dataclass(frozen=True)
class _Step:
    """A step of the spins (unknowns,), its contacts in slot `slot` of the rows.

    along, dual_along : how far primal and dual points may go.
    """

    slot: int
    spins: np.ndarray
    along: float
    dual_along: float

    @property
    def reach(self) -> float:
        return min(1.0, self.along) + min(1.0, self.dual_along)


class _Directions:
    """Search directions from one iterate, of right-hand sides that share one factorisation."""

    def __init__(self, iterate: Iterate, matrix: NewtonMatrix) -> None:
        self.iterate, self.matrix, self.rows = iterate, matrix, iterate.system.rows
        rows = self.rows
        for row, values in (
            (kernels.FRICTION, iterate.friction),
            (kernels.BOUND, iterate.bound),
            (kernels.SLIP, iterate.difference),
            (kernels.DUAL, iterate.dual),
            (kernels.SMOOTH, each(np.zeros_like, iterate.bound) if iterate.smooth is None else iterate.smooth),
        ):
            rows.put(row, values)
        rows.run(kernels.prepare, (0, 0), WEAK)
        stiffness, self.viscosity = rows.upper_stiffness(), None
        if iterate.viscosity is not None:
            self.viscosity = rows.flattened(
                each(lambda v, k: k * np.ones_like(v), iterate.difference, iterate.viscosity)
            )
            stiffness = stiffness + stacked(isotropic(iterate.difference, iterate.viscosity))
        matrix.factorise_stacked(stiffness, iterate.inertia.weight if iterate.inertia else 0.0)

    def predicted(self) -> _Step:
        """Straight at the solution: all products zero."""
        return self._solved(0)

    def target(self, step: _Step) -> float:
        """Mehrotra: a product that the predictor makes credible."""
        mean = self._mean_product(step, 0.0, 0.0)
        after = self._mean_product(step, min(1.0, step.along), min(1.0, step.dual_along))
        remaining = max(after, 0.0) / max(mean, TINY)
        return min(1.0, remaining**2) * mean / 4

    def corrected(self, step: _Step, target: float) -> _Step:
        """Aim at the target, and mend the second-order error of the predictor."""
        self.rows.run(kernels.correct, (step.slot, 1 - step.slot), target)
        return self._solved(1 - step.slot)

    def recentred(self, step: _Step, target: float) -> _Step:
        """Gondzio: bring outlying products of a longer step closer to the target."""
        lengths = min(1.0, 1.5 * step.along + 0.1), min(1.0, 1.5 * step.dual_along + 0.1)
        self.rows.run(kernels.recentre, (step.slot, 1 - step.slot), *lengths, target / SPREAD, target * SPREAD)
        return self._solved(1 - step.slot)

    def refined(self, step: _Step) -> _Step:
        """Solve for the torques that rounding left, as long as that helps."""
        last = np.inf
        for trial in range(REFINEMENTS):
            change, dual_step = (self.rows.two(_in(step.slot, row)) for row in (kernels.CHANGE, kernels.DUAL_STEP))
            imbalance = self._imbalance(
                self.iterate.spins + step.spins,
                self.rows.two(kernels.DUAL) + dual_step,
                self.rows.two(kernels.SLIP) + change,
            )
            size = float(np.abs(imbalance).max(initial=0.0))
            if trial > 0 and not BALANCED < size < last / 2:
                break
            last = size
            step = self._expanded(step.slot, step.spins + self.matrix.solve(imbalance))
        return step

    def taken(self, step: _Step) -> Iterate:
        """The iterate most of the way to the boundary."""
        iterate, rows, slot = self.iterate, self.rows, step.slot
        along, dual_along = min(1.0, STEP_SHARE * step.along), min(1.0, STEP_SHARE * step.dual_along)
        return replace(
            iterate,
            spins=iterate.spins + along * step.spins,
            # not from the spins anew: their rounding is coarser than the last distances from the cones
            difference=rows.vectors(rows.two(kernels.SLIP) + along * rows.two(_in(slot, kernels.CHANGE))),
            bound=iterate.bound + along * rows.numbers(_in(slot, kernels.BOUND_STEP)),
            dual=rows.vectors(rows.two(kernels.DUAL) + dual_along * rows.two(_in(slot, kernels.DUAL_STEP))),
        ).obeying()

    def _solved(self, slot: int) -> _Step:
        """Steps for W^-2 d(primal) + d(dual) = right-hand side that leave the forces balanced."""
        pull = self.rows.two(_in(slot, kernels.PULL))
        imbalance = self._imbalance(self.iterate.spins, pull, self.rows.two(kernels.SLIP))
        return self._expanded(slot, self.matrix.solve(imbalance))

    def _imbalance(self, spins: np.ndarray, dual: np.ndarray, slip: np.ndarray) -> np.ndarray:
        """As :meth:`Iterate.imbalance`, of two rows each."""
        whole = dual if self.viscosity is None else dual - self.viscosity * slip
        return self.rows.transposed @ whole - self.iterate.to_balance(spins)

    def _expanded(self, slot: int, spins: np.ndarray) -> _Step:
        """Steps of bounds, differences and duals that belong to the step of the spins, and how far they may go."""
        rows, iterate = self.rows, self.iterate
        rows.two(_in(slot, kernels.CHANGE))[:] = rows.operator @ spins
        rows.run(kernels.expand, (slot, slot))
        along, dual_along = (
            float(rows.values[_in(slot, row)].min(initial=np.inf)) for row in (kernels.REACH, kernels.DUAL_REACH)
        )
        if iterate.inertia is not None or iterate.viscosity is not None:
            along = dual_along = min(along, dual_along)  # spins and forces that balance each other go on together
        return _Step(slot, spins, along, dual_along)

    def _mean_product(self, step: _Step, along: float, dual_along: float) -> float:
        """Of the contacts in cones after steps of these lengths."""
        self.rows.run(kernels.multiply, (step.slot, step.slot), along, dual_along)
        cones = sum(map(len, self.iterate.friction))
        if self.iterate.smooth is not None:
            cones -= int(self.iterate.smooth.sum())
        return float(self.rows.values[_in(step.slot, kernels.PRODUCT)].sum()) / max(1, cones)


def _in(slot: int, row: int) -> int:
    """Where a row of a step is among all rows."""
    return kernels.STATE_ROWS + slot * kernels.STEP_ROWS + row
