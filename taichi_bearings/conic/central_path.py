"""Newton steps along the central path of a contact system: predictor, corrector, recentring.

At a point of the path every contact has the same product of slip bound and friction margin. Mehrotra's predictor and
corrector (1992) and Gondzio's further correctors (1996), in the Nesterov-Todd scaling, bring that product down by a
factor of about five a step, with one factorisation and a few solves.

Contacts can have a viscosity besides: the cost is the sum of mu b + eta |v|^2 / 2 over bounds b >= |v|, and a contact
bears the force of its cone and eta v. Nothing else changes: eta adds to the stiffness of the Newton matrix, eta v to
the torques that the forces leave, and cost less dual cost stays friction times slip less force times slip in the cones.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from taichi_bearings.conic.cone import length, longest_step
from taichi_bearings.conic.contact_system import ContactSystem, stacked
from taichi_bearings.conic.grouped import Arrays, each, isotropic
from taichi_bearings.conic.iterate import Inertia, Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.kernels import central_path as kernels
from taichi_bearings.kernels.elimination import LANES
from taichi_bearings.numerics.cholesky import NotPositiveDefinite

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


class Matrix(Protocol):
    """The matrices of one system in several samples S side by side."""

    def factorise_each(self, stiffness: np.ndarray, inertia: float | np.ndarray = 0.0) -> np.ndarray:
        """stiffness : (entries, S) upper triangles as `stacked` gives them. True (S,) where that succeeds."""
        ...

    def solve_each(self, right: np.ndarray) -> np.ndarray:
        """(unknowns, S)."""
        ...


def newton_step(iterate: Iterate, matrix: Matrix) -> Iterate:
    """The next point along the path.

    Raises NotPositiveDefinite if the Newton matrix is singular to working precision.
    """
    (found,) = newton_steps([iterate], matrix)
    if found is None:
        raise NotPositiveDefinite
    return found


def newton_steps(iterates: Sequence[Iterate], matrix: Matrix) -> list[Iterate | None]:
    """The next points along the paths of samples of one system, whose numbers do not depend on each other; None where
    the Newton matrix is singular to working precision."""
    directions = _Directions(iterates, matrix)
    step = directions.predicted()
    target = directions.target(step)
    step, going = directions.corrected(step, target), np.ones(len(target), dtype=bool)
    for _ in range(CORRECTORS):
        going &= ~(np.minimum(step.along, step.dual_along) > LONG_ENOUGH)
        if not going.any():
            break
        further = directions.recentred(step, target)
        going &= ~(further.reach < step.reach + WORTHWHILE)
        step = directions.chosen(going, further, step)
    step = directions.refined(step)
    return [directions.taken(step, sample) for sample in range(len(iterates))]


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
    """A step of the spins (unknowns, S), its contacts in slot `slot` of the rows.

    along, dual_along : (S,), how far primal and dual points may go.
    """

    slot: int
    spins: np.ndarray
    along: np.ndarray
    dual_along: np.ndarray

    @property
    def reach(self) -> np.ndarray:
        return np.minimum(1.0, self.along) + np.minimum(1.0, self.dual_along)


class _Directions:
    """Search directions from one iterate of each sample, of right-hand sides that share one factorisation."""

    def __init__(self, iterates: Sequence[Iterate], matrix: Matrix) -> None:
        self.iterates, self.matrix = iterates, matrix
        first, samples = iterates[0], 1 if len(iterates) == 1 else LANES
        self.all = [*iterates, *[first] * (samples - len(iterates))]  # where there is no sample, the first once more
        self.rows = first.system.rows(samples)
        for sample, iterate in enumerate(self.all):
            self._put(sample, iterate)
        self.spins = np.stack([iterate.spins for iterate in self.all], axis=1)
        self.rows.run(kernels.prepare, (0, 0), WEAK)
        stiffness, self.viscosity = self.rows.upper_stiffness(), None
        if first.viscosity is not None:
            flows = [(i.difference, i.viscosity) for i in self.all if i.viscosity is not None]
            stiffness = stiffness + np.stack([stacked(isotropic(z, eta)) for z, eta in flows], axis=1)
            self.viscosity = self.rows.flattened([eta * each(np.ones_like, z) for z, eta in flows])
        self.regular = matrix.factorise_each(stiffness, first.inertia.weight if first.inertia else 0.0)
        # spins and forces that balance each other go on together
        self.together = first.inertia is not None or first.viscosity is not None

    def _put(self, sample: int, iterate: Iterate) -> None:
        smooth = each(np.zeros_like, iterate.bound) if iterate.smooth is None else iterate.smooth
        for row, values in (
            (kernels.FRICTION, iterate.friction),
            (kernels.BOUND, iterate.bound),
            (kernels.SLIP, iterate.difference),
            (kernels.DUAL, iterate.dual),
            (kernels.SMOOTH, smooth),
        ):
            self.rows.put(row, sample, values)

    def predicted(self) -> _Step:
        """Straight at the solution: all products zero."""
        return self._solved(0)

    def target(self, step: _Step) -> np.ndarray:
        """Mehrotra: a product (S,) that the predictor makes credible."""
        mean = self._mean_product(step, 0.0, 0.0)
        after = self._mean_product(step, np.minimum(1.0, step.along), np.minimum(1.0, step.dual_along))
        remaining = np.maximum(after, 0.0) / np.maximum(mean, TINY)
        return np.minimum(1.0, remaining**2) * mean / 4

    def corrected(self, step: _Step, target: np.ndarray) -> _Step:
        """Aim at the target, and mend the second-order error of the predictor."""
        self.rows.run(kernels.correct, (step.slot, 1 - step.slot), target)
        return self._solved(1 - step.slot)

    def recentred(self, step: _Step, target: np.ndarray) -> _Step:
        """Gondzio: bring outlying products of a longer step closer to the target."""
        lengths = (np.minimum(1.0, 1.5 * length + 0.1) for length in (step.along, step.dual_along))
        self.rows.run(kernels.recentre, (step.slot, 1 - step.slot), *lengths, target / SPREAD, target * SPREAD)
        return self._solved(1 - step.slot)

    def chosen(self, better: np.ndarray, one: _Step, other: _Step) -> _Step:
        """The one step of the samples (S,) where it is better, and the other of the rest, that go no further."""
        if better.all() or not better.any():
            return one if better.all() else other
        here, there = (self.rows.values[_in(step.slot, 0) : _in(step.slot, kernels.REACH)] for step in (one, other))
        here[..., ~better] = there[..., ~better]
        return _Step(
            one.slot,
            np.where(better, one.spins, other.spins),
            np.where(better, one.along, other.along),
            np.where(better, one.dual_along, other.dual_along),
        )

    def refined(self, step: _Step) -> _Step:
        """Solve for the torques that rounding left, as long as that helps."""
        last, going = np.full(len(step.along), np.inf), np.ones(len(step.along), dtype=bool)
        for _ in range(REFINEMENTS):
            change, dual_step = (self.rows.two(_in(step.slot, row)) for row in (kernels.CHANGE, kernels.DUAL_STEP))
            slip = None if self.viscosity is None else self.rows.two(kernels.SLIP) + change
            imbalance = self._imbalance(self.spins + step.spins, self.rows.two(kernels.DUAL) + dual_step, slip)
            size = np.abs(imbalance).max(axis=0, initial=0.0)
            going &= (size > BALANCED) & (size < last / 2)
            if not going.any():
                break
            last = size
            correction = np.where(going, self.matrix.solve_each(imbalance), 0.0)
            step = self._expanded(step.slot, step.spins + correction)
        return step

    def taken(self, step: _Step, sample: int) -> Iterate | None:
        """The iterate of a sample most of the way to the boundary; None if it has no step."""
        if not self.regular[sample]:
            return None
        iterate, rows, slot = self.iterates[sample], self.rows, step.slot
        along, dual_along = (
            min(1.0, STEP_SHARE * length[sample]) for length in (step.along.tolist(), step.dual_along.tolist())
        )
        bound_step = rows.values[_in(slot, kernels.BOUND_STEP)]
        change, dual_step = (
            rows.vectors(rows.two(_in(slot, row)), sample) for row in (kernels.CHANGE, kernels.DUAL_STEP)
        )
        return replace(
            iterate,
            spins=iterate.spins + along * step.spins[:, sample],
            # not from the spins anew: their rounding is coarser than the last distances from the cones
            difference=iterate.difference + along * change,
            bound=iterate.bound + along * rows.numbers(bound_step, sample),
            dual=iterate.dual + dual_along * dual_step,
        ).obeying()

    def _solved(self, slot: int) -> _Step:
        """Steps for W^-2 d(primal) + d(dual) = right-hand side that leave the forces balanced."""
        pull = self.rows.two(_in(slot, kernels.PULL))
        imbalance = self._imbalance(self.spins, pull, self.rows.two(kernels.SLIP))
        return self._expanded(slot, self.matrix.solve_each(imbalance))

    def _imbalance(self, spins: np.ndarray, dual: np.ndarray, slip: np.ndarray | None) -> np.ndarray:
        """As :meth:`Iterate.imbalance`, (unknowns, S), of two rows each; nobody looks at slips without viscosity."""
        forces = dual if self.viscosity is None or slip is None else dual - self.viscosity * slip
        torques = self.rows.transposed @ forces
        for sample, iterate in enumerate(self.all):
            torques[:, sample] -= iterate.to_balance(spins[:, sample])
        return torques

    def _expanded(self, slot: int, spins: np.ndarray) -> _Step:
        """Steps of bounds, differences and duals that belong to the step of the spins, and how far they may go."""
        rows = self.rows
        rows.two(_in(slot, kernels.CHANGE))[:] = rows.operator @ spins
        rows.run(kernels.expand, (slot, slot))
        along, dual_along = (
            rows.values[_in(slot, row)].min(axis=0, initial=np.inf) for row in (kernels.REACH, kernels.DUAL_REACH)
        )
        if self.together:
            along = dual_along = np.minimum(along, dual_along)
        return _Step(slot, spins, along, dual_along)

    def _mean_product(self, step: _Step, along: float | np.ndarray, dual_along: float | np.ndarray) -> np.ndarray:
        """Of the contacts in cones after steps of these lengths, (S,)."""
        self.rows.run(kernels.multiply, (step.slot, step.slot), along, dual_along)
        total = self.rows.total(_in(step.slot, kernels.PRODUCT))
        return total / np.array([max(1, iterate.in_cones) for iterate in self.all])


def _in(slot: int, row: int) -> int:
    """Where a row of a step is among all rows."""
    return kernels.STATE_ROWS + slot * kernels.STEP_ROWS + row
