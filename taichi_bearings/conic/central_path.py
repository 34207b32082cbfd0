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

from taichi_bearings.conic.cone import Point, Scaling, clipped_towards, inner, jordan_product, length, longest_step
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.grouped import Arrays, each, isotropic
from taichi_bearings.conic.iterate import Inertia, Iterate, Points, mean_product
from taichi_bearings.conic.newton_matrix import NewtonMatrix, resisted

CORRECTORS = 3  # Gondzio's, at most; each costs a solve and spares a part of a factorisation
LONG_ENOUGH = 0.9  # step length beyond which no further corrector is tried
WORTHWHILE = 0.02  # gain in step length below which a corrector is dropped and none is tried after it
STEP_SHARE = 0.95  # of the way to the boundary of the cones
TINY = np.finfo(np.float64).tiny
WEAK = 1e-18  # product of slip and stiffness along it that keeps Newton matrices regular; it slows nothing down
REFINEMENTS, BALANCED = 4, 1e-11  # of the last solve, at most; torque, of the mean friction, that needs no second one
SPREAD = 10.0  # correctors bring products into [target / SPREAD, target * SPREAD]

Blocks = tuple[np.ndarray, np.ndarray, np.ndarray]


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
    """A step of the spins (unknowns,) with those of differences and duals (d, n) and of the points in cones, a group.

    right, pull : what it solves. along, dual_along : how far primal and dual points may go.
    """

    right: Points
    pull: Arrays
    spins: np.ndarray
    difference: Arrays
    dual: Arrays
    primal: Points
    opposite: Points
    along: float
    dual_along: float

    @property
    def reach(self) -> float:
        return min(1.0, self.along) + min(1.0, self.dual_along)


class _Directions:
    """Search directions from one iterate, of right-hand sides that share one factorisation."""

    def __init__(self, iterate: Iterate, matrix: NewtonMatrix) -> None:
        self.iterate, self.matrix, self.cones = iterate, matrix, iterate.cones
        self.primal, self.opposite = iterate.primal, iterate.opposite
        self.scalings = each(Scaling.of, self.primal, self.opposite)
        self.blocks = each(Scaling.newton_blocks, self.scalings)
        self.stiffness = each(lambda block: block[2], self.blocks)
        if iterate.smooth is not None:
            self.stiffness = each(_outside, self.stiffness, iterate.friction, iterate.difference, iterate.smooth)
        whole = self.stiffness
        if iterate.viscosity is not None:
            whole = whole + isotropic(iterate.difference, iterate.viscosity)
        matrix.factorise(whole, iterate.inertia.weight if iterate.inertia else 0.0)

    def predicted(self) -> _Step:
        """Straight at the solution: all products zero."""
        return self._solved(each(lambda point: (-point[0], -point[1]), self.opposite))

    def target(self, step: _Step) -> float:
        """Mehrotra: a product that the predictor makes credible."""
        mean = mean_product(self.primal, self.opposite)
        after = mean_product(*self._after(step, min(1.0, step.along), min(1.0, step.dual_along)))
        remaining = max(after, 0.0) / max(mean, TINY)
        return min(1.0, remaining**2) * mean / 4

    def corrected(self, step: _Step, target: float) -> _Step:
        """Aim at the target, and mend the second-order error of the predictor."""

        def right(scaling: Scaling, primal: Point, opposite: Point, point: Point) -> Point:
            head, tail = jordan_product(scaling.apply(opposite), scaling.apply_inverse(primal))
            head, tail = scaling.apply_inverse(scaling.divide((head - target, tail)))
            return -point[0] - head, -point[1] - tail

        return self._solved(each(right, self.scalings, step.primal, step.opposite, self.opposite))

    def recentred(self, step: _Step, target: float) -> _Step:
        """Gondzio: bring outlying products of a longer step closer to the target."""

        def right(scaling: Scaling, primal: Point, opposite: Point, before: Point) -> Point:
            product = jordan_product(scaling.apply(opposite), scaling.apply_inverse(primal))
            change = clipped_towards(product, target / SPREAD, target * SPREAD)
            head, tail = scaling.apply_inverse(scaling.divide(change))
            return before[0] + head, before[1] + tail

        after = self._after(step, min(1.0, 1.5 * step.along + 0.1), min(1.0, 1.5 * step.dual_along + 0.1))
        return self._solved(each(right, self.scalings, *after, step.right))

    def refined(self, step: _Step) -> _Step:
        """Solve for the torques that rounding left, as long as that helps."""
        at, last = self.iterate, np.inf
        for trial in range(REFINEMENTS):
            imbalance = at.imbalance(at.spins + step.spins, at.dual + step.dual, at.difference + step.difference)
            size = float(np.abs(imbalance).max(initial=0.0))
            if trial > 0 and not BALANCED < size < last / 2:
                break
            last = size
            step = self._expanded(step.right, step.pull, step.spins + self.matrix.solve(imbalance))
        return step

    def taken(self, step: _Step) -> Iterate:
        """The iterate most of the way to the boundary."""
        iterate = self.iterate
        along, dual_along = min(1.0, STEP_SHARE * step.along), min(1.0, STEP_SHARE * step.dual_along)
        primal, opposite = self._after(step, along, dual_along)
        return replace(
            iterate,
            spins=iterate.spins + along * step.spins,
            # not from the spins anew: their rounding is coarser than the last distances from the cones
            difference=iterate.difference + along * step.difference,
            bound=iterate.bound.placed(self.cones, each(lambda point: point[0], primal)),
            dual=iterate.dual.placed(self.cones, each(lambda point: point[1], opposite)),
        ).obeying()

    def _solved(self, right: Points) -> _Step:
        """Steps for W^-2 d(primal) + d(dual) = right that leave the forces balanced; `right` (n,), (d, n) a group."""

        def pull(dual: np.ndarray, right: Point, blocks: Blocks, cone: slice | np.ndarray) -> np.ndarray:
            (head, tail), (diagonal, off, _) = right, blocks
            changed = dual.copy()
            changed[:, cone] += tail - off * (head / diagonal)
            return changed

        at, pulls = self.iterate, each(pull, self.iterate.dual, right, self.blocks, self.cones)
        return self._expanded(right, pulls, self.matrix.solve(at.imbalance(at.spins, pulls, at.difference)))

    def _expanded(self, right: Points, pull: Arrays, spins: np.ndarray) -> _Step:
        """Steps of bounds, differences and duals that belong to the step of the spins, and how far they may go."""

        def point(right: Point, blocks: Blocks, change: np.ndarray, cone: slice | np.ndarray) -> Point:
            (head, _), (diagonal, off, _) = right, blocks
            tail = change[:, cone]
            return (head - inner(off, tail)) / diagonal, tail

        iterate, difference = self.iterate, self.iterate.system.change(spins)
        dual = pull - resisted(self.stiffness, difference) - iterate.dual
        primal = each(point, right, self.blocks, difference, self.cones)
        opposite = each(
            lambda at, change, cone: (np.zeros_like(at[0]), change[:, cone]), self.opposite, dual, self.cones
        )
        along = min(np.inf, *each(longest_step, self.primal, primal))
        dual_along = min(np.inf, *each(longest_step, self.opposite, opposite))
        if iterate.smooth is not None:  # their law is far from linear once a slip changes by as much as itself
            share = iterate.difference.length() / each(np.maximum, difference.length(), TINY)
            along = min(along, *each(lambda s: 0.5 * float(s.min(initial=np.inf)), share[iterate.smooth]))
        if iterate.inertia is not None or iterate.viscosity is not None:
            along = dual_along = min(along, dual_along)  # spins and forces that balance each other go on together
        return _Step(right, pull, spins, difference, dual, primal, opposite, along, dual_along)

    def _after(self, step: _Step, along: float, dual_along: float) -> tuple[Points, Points]:
        """Primal and dual points after steps of these lengths."""

        def moved(point: Point, change: Point, share: float) -> Point:
            return point[0] + share * change[0], point[1] + share * change[1]

        return each(moved, self.primal, step.primal, along), each(moved, self.opposite, step.opposite, dual_along)


def _outside(stiffness: np.ndarray, friction: np.ndarray, difference: np.ndarray, smooth: np.ndarray) -> np.ndarray:
    """Stiffness (d, d, n) of all contacts; stiffness : of those in cones only."""
    if not smooth.any():
        return stiffness
    whole = np.empty((len(difference), *difference.shape))
    whole[:, :, ~smooth] = stiffness
    whole[:, :, smooth] = friction_stiffness(friction[smooth], difference[:, smooth])
    return whole
