"""Newton steps along the central path of a contact system: predictor, corrector, recentring.

At a point of the path every contact has the same product of slip bound and friction margin. Mehrotra's predictor and
corrector (1992) and Gondzio's further correctors (1996), in the Nesterov-Todd scaling, bring that product down by a
factor of about five a step, with one factorisation and a few solves.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.solvers.cone import Point, Scaling, clipped_towards, inner, jordan_product, length, longest_step
from taichi_bearings.solvers.contact_system import ContactSystem
from taichi_bearings.solvers.newton_matrix import NewtonMatrix

CORRECTORS = 3  # Gondzio's, at most; each costs a solve and spares a part of a factorisation
LONG_ENOUGH = 0.9  # step length beyond which no further corrector is tried
WORTHWHILE = 0.02  # gain in step length below which a corrector is dropped and none is tried after it
STEP_SHARE = 0.95  # of the way to the boundary of the cones
SPREAD = 10.0  # correctors bring products into [target / SPREAD, target * SPREAD]


@dataclass
class Iterate:
    """A point inside all cones: spins (unknowns,); a group each: friction and bound (n,), difference and dual (d, n).

    The dual is minus the contact force.
    """

    system: ContactSystem
    spins: np.ndarray
    friction: list[np.ndarray]
    bound: list[np.ndarray]
    difference: list[np.ndarray]
    dual: list[np.ndarray]

    @classmethod
    def start(cls, system: ContactSystem, spins: np.ndarray, friction: list[np.ndarray], slack: float) -> "Iterate":
        """Bounds above the slips by about `slack`, and no forces."""
        difference = [g.differences(spins) for g in system.groups]
        bound = [np.hypot(length(z), slack) for z in difference]
        return cls(system, spins, friction, bound, difference, [np.zeros_like(z) for z in difference])

    @property
    def primal(self) -> list[Point]:
        return list(zip(self.bound, self.difference, strict=True))

    @property
    def opposite(self) -> list[Point]:
        """The dual points (friction, minus force)."""
        return list(zip(self.friction, self.dual, strict=True))

    @property
    def complementarity(self) -> float:
        """Mean over the contacts of friction * bound - difference . force."""
        return mean_product(self.primal, self.opposite)

    @property
    def gap(self) -> float:
        """(power - work of the driven planes) / power for balanced forces, summed without cancellation."""
        power = sum(float(mu @ length(z)) for mu, z in zip(self.friction, self.difference, strict=True))
        excess = sum(
            float((mu * length(z) + inner(z, y)).sum())
            for mu, z, y in zip(self.friction, self.difference, self.dual, strict=True)
        )
        return excess / power


def mean_product(primal: list[Point], dual: list[Point]) -> float:
    total = sum(float((p[0] * d[0] + inner(p[1], d[1])).sum()) for p, d in zip(primal, dual, strict=True))
    return total / sum(len(p[0]) for p in primal)


def newton_step(iterate: Iterate, matrix: NewtonMatrix) -> float:
    """Move `iterate` along the path, in place; returns the shorter of the two step lengths.

    Raises NotPositiveDefinite if the Newton matrix is singular to working precision.
    """
    direction = _Direction(iterate, matrix)
    direction.predict()
    direction.correct()
    for _ in range(CORRECTORS):
        if not direction.recentre():
            break
    return direction.take()


class _Direction:
    """Search direction, improved by right-hand sides that share one factorisation."""

    def __init__(self, iterate: Iterate, matrix: NewtonMatrix) -> None:
        self.iterate, self.matrix = iterate, matrix
        self.groups = iterate.system.groups
        self.scalings = [Scaling.of(p, d) for p, d in zip(iterate.primal, iterate.opposite, strict=True)]
        self.blocks = [s.newton_blocks() for s in self.scalings]
        matrix.factorise([stiffness for _, _, stiffness in self.blocks])
        self.mean = iterate.complementarity
        self.target = 0.0
        self.right: list[Point] = []
        self.spins = np.zeros(iterate.system.unknowns)
        self.steps: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self.along = self.dual_along = 0.0

    def predict(self) -> None:
        """Straight at the solution: all products zero."""
        self._solve([(-mu, -y) for mu, y in self.iterate.opposite])

    def correct(self) -> None:
        """Mehrotra: aim at a product that the predictor makes credible, and mend its second-order error."""
        primal, dual = self._after(min(1.0, self.along), min(1.0, self.dual_along))
        remaining = max(mean_product(primal, dual), 0.0) / self.mean
        self.target = min(1.0, remaining**2) * self.mean / 4
        right = []
        for s, (dbound, ddifference, ddual), (mu, y) in zip(
            self.scalings, self.steps, self.iterate.opposite, strict=True
        ):
            second = jordan_product(s.apply((np.zeros_like(mu), ddual)), s.apply_inverse((dbound, ddifference)))
            head, tail = s.apply_inverse(s.divide((second[0] - self.target, second[1])))
            right.append((-mu - head, -y - tail))
        self._solve(right)

    def recentre(self) -> bool:
        """Gondzio: bring outlying products of a longer step closer to the target. True if that pays."""
        if min(self.along, self.dual_along) > LONG_ENOUGH:
            return False
        before = self.along, self.dual_along, self.steps, self.spins, self.right
        primal, dual = self._after(min(1.0, 1.5 * self.along + 0.1), min(1.0, 1.5 * self.dual_along + 0.1))
        right = []
        for s, p, d, (head, tail) in zip(self.scalings, primal, dual, self.right, strict=True):
            product = jordan_product(s.apply(d), s.apply_inverse(p))
            change = clipped_towards(product, self.target / SPREAD, self.target * SPREAD)
            more = s.apply_inverse(s.divide(change))
            right.append((head + more[0], tail + more[1]))
        self._solve(right)
        if min(1.0, self.along) + min(1.0, self.dual_along) < min(1.0, before[0]) + min(1.0, before[1]) + WORTHWHILE:
            self.along, self.dual_along, self.steps, self.spins, self.right = before
            return False
        return True

    def take(self) -> float:
        """Refine the last solve, which balances the forces to round-off, and go most of the way to the boundary."""
        iterate = self.iterate
        imbalance = iterate.system.torques([y + step[2] for y, step in zip(iterate.dual, self.steps, strict=True)])
        self.spins = self.spins + self.matrix.solve(imbalance)
        self._expand()
        along, dual_along = min(1.0, STEP_SHARE * self.along), min(1.0, STEP_SHARE * self.dual_along)
        iterate.spins = iterate.spins + along * self.spins
        # not from the spins anew: their rounding is coarser than the last distances from the cones
        iterate.difference = [z + along * step[1] for z, step in zip(iterate.difference, self.steps, strict=True)]
        iterate.bound = [b + along * step[0] for b, step in zip(iterate.bound, self.steps, strict=True)]
        iterate.dual = [y + dual_along * step[2] for y, step in zip(iterate.dual, self.steps, strict=True)]
        return min(along, dual_along)

    def _solve(self, right: list[Point]) -> None:
        """Steps for W^-2 d(primal) + d(dual) = right that leave the forces balanced; `right` (n,), (d, n) a group."""
        self.right = right
        pull = [
            y + tail - off * (head / diagonal)
            for (head, tail), y, (diagonal, off, _) in zip(right, self.iterate.dual, self.blocks, strict=True)
        ]
        self.spins = self.matrix.solve(self.iterate.system.torques(pull))
        self._expand()

    def _expand(self) -> None:
        """Steps of bounds, differences and duals that belong to the step of the spins, and how far they may go."""
        self.steps = []
        for group, (head, tail), (diagonal, off, stiffness) in zip(self.groups, self.right, self.blocks, strict=True):
            difference = group.change(self.spins)
            bound = (head - inner(off, difference)) / diagonal
            dual = tail - off * (head / diagonal) - np.einsum("ijn,jn->in", stiffness, difference)
            self.steps.append((bound, difference, dual))
        self.along = min(longest_step(p, s[:2]) for p, s in zip(self.iterate.primal, self.steps, strict=True))
        self.dual_along = min(
            longest_step(d, (np.zeros_like(d[0]), s[2])) for d, s in zip(self.iterate.opposite, self.steps, strict=True)
        )

    def _after(self, along: float, dual_along: float) -> tuple[list[Point], list[Point]]:
        """Primal and dual points after steps of these lengths."""
        primal = [
            (b + along * s[0], z + along * s[1]) for (b, z), s in zip(self.iterate.primal, self.steps, strict=True)
        ]
        dual = [(mu, y + dual_along * s[2]) for (mu, y), s in zip(self.iterate.opposite, self.steps, strict=True)]
        return primal, dual
