"""Newton steps along the central path of a contact system: predictor, corrector, recentring.

At a point of the path every contact has the same product of slip bound and friction margin. Mehrotra's predictor and
corrector (1992) and Gondzio's further correctors (1996), in the Nesterov-Todd scaling, bring that product down by a
factor of about five a step, with one factorisation and a few solves.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from taichi_bearings.conic.cone import Point, Scaling, clipped_towards, inner, jordan_product, length, longest_step
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.newton_matrix import NewtonMatrix

CORRECTORS = 3  # Gondzio's, at most; each costs a solve and spares a part of a factorisation
LONG_ENOUGH = 0.9  # step length beyond which no further corrector is tried
WORTHWHILE = 0.02  # gain in step length below which a corrector is dropped and none is tried after it
STEP_SHARE = 0.95  # of the way to the boundary of the cones
TINY = np.finfo(np.float64).tiny
WEAK = 1e-18  # product of slip and stiffness along it that keeps Newton matrices regular; it slows nothing down
REFINEMENTS, BALANCED = 4, 1e-11  # of the last solve, at most; torque, of the mean friction, that needs no second one
SPREAD = 10.0  # correctors bring products into [target / SPREAD, target * SPREAD]


@dataclass(frozen=True)
class Inertia:
    """The cost weight / 2 |spins - origin|^2 beside the power: the torques then balance weight * (spins - origin)."""

    weight: float
    origin: np.ndarray

    def torques(self, spins: np.ndarray) -> np.ndarray:
        """Torques (unknowns,) that bring the spins from their origin to `spins`."""
        return self.weight * (spins - self.origin)


@dataclass
class Iterate:
    """A point inside all cones: spins (unknowns,); a group each: friction and bound (n,), difference and dual (d, n).

    The dual is minus the contact force. smooth : (n,) masks, contacts that are in no cone but obey the law of friction
    exactly: dual = - friction * direction of slip. inertia : what resists a change of the spins, None at the minimum.
    load : torques (unknowns,) that the forces have to balance, beside those of the inertia.
    """

    system: ContactSystem
    spins: np.ndarray
    friction: list[np.ndarray]
    bound: list[np.ndarray]
    difference: list[np.ndarray]
    dual: list[np.ndarray]
    smooth: list[np.ndarray] = field(default_factory=list)
    inertia: Inertia | None = None
    load: np.ndarray | float = 0.0

    def __post_init__(self) -> None:
        self.smooth = self.smooth or [np.zeros(len(mu), dtype=bool) for mu in self.friction]

    def copy(self) -> "Iterate":
        """A copy that a Newton step can change: the system and the friction are shared."""
        lists = ([array.copy() for array in arrays] for arrays in (self.bound, self.difference, self.dual, self.smooth))
        bound, difference, dual, smooth = lists
        return replace(self, bound=bound, difference=difference, dual=dual, smooth=smooth)

    @classmethod
    def start(cls, system: ContactSystem, spins: np.ndarray, friction: list[np.ndarray], slack: float) -> "Iterate":
        """Bounds above the slips by about `slack`, and no forces."""
        difference = [g.differences(spins) for g in system.groups]
        bound = [np.hypot(length(z), slack) for z in difference]
        return cls(system, spins, friction, bound, difference, [np.zeros_like(z) for z in difference])

    @classmethod
    def near(
        cls,
        system: ContactSystem,
        spins: np.ndarray,
        friction: list[np.ndarray],
        difference: list[np.ndarray],
        product: float,
    ) -> "Iterate":
        """With these slips, bounds and forces as the path has them at this product of slip bound and margin."""
        central = [_central(mu, z, product) for mu, z in zip(friction, difference, strict=True)]
        return cls(system, spins, friction, [b for b, _ in central], difference, [y for _, y in central])

    @property
    def cones(self) -> list[slice | np.ndarray]:
        """Selection of the contacts in cones, one a group."""
        return [np.flatnonzero(~s) if s.any() else slice(None) for s in self.smooth]

    def let_slip(self, limit: float) -> None:
        """Contacts that slip more than `limit` leave their cones, others come back into them."""
        mean = self.complementarity
        for mu, z, y, b, smooth in zip(self.friction, self.difference, self.dual, self.bound, self.smooth, strict=True):
            size = length(z)
            back = smooth & (size <= limit)
            b[back], y[:, back] = _central(mu[back], z[:, back], mean)
            smooth[:] = size > limit
            y[:, smooth] = -mu[smooth] * z[:, smooth] / size[smooth]

    @property
    def primal(self) -> list[Point]:
        """The points (bound, difference) of the contacts in cones."""
        return [(b[c], z[:, c]) for b, z, c in zip(self.bound, self.difference, self.cones, strict=True)]

    @property
    def opposite(self) -> list[Point]:
        """The dual points (friction, minus force) of the contacts in cones."""
        return [(mu[c], y[:, c]) for mu, y, c in zip(self.friction, self.dual, self.cones, strict=True)]

    @property
    def complementarity(self) -> float:
        """Mean over the contacts in cones of friction * bound - difference . force."""
        return mean_product(self.primal, self.opposite)

    @property
    def power(self) -> float:
        """Friction times slip, summed over the contacts."""
        return sum(float(mu @ length(z)) for mu, z in zip(self.friction, self.difference, strict=True))

    def imbalance(self, spins: np.ndarray, dual: list[np.ndarray]) -> np.ndarray:
        """Torques (unknowns,) that forces leave on the spheres, less what they are to balance there."""
        return self.system.torques(dual) - self.to_balance(spins)

    def to_balance(self, spins: np.ndarray) -> np.ndarray | float:
        """Torques (unknowns,) of the load and of the inertia."""
        return self.load if self.inertia is None else self.load + self.inertia.torques(spins)

    @property
    def price_of_torques(self) -> float:
        """What the torques left on the spheres take from the lower bound, at most, relative to the power."""
        return float(np.abs(self.system.torques(self.dual)).sum()) / self.power

    @property
    def excess(self) -> float:
        """Cost less dual cost for balanced forces, summed without cancellation, with inertia or without."""
        return sum(
            float((mu * length(z) + inner(z, y)).sum())
            for mu, z, y in zip(self.friction, self.difference, self.dual, strict=True)
        )

    @property
    def gap(self) -> float:
        """(power - work of the driven planes) / power for balanced forces."""
        return self.excess / self.power


def _central(friction: np.ndarray, difference: np.ndarray, product: float) -> tuple[np.ndarray, np.ndarray]:
    """Bound (n,) and dual (d, n) along the slip whose product is as given."""
    bound = (product / friction + np.hypot(product / friction, 2 * length(difference))) / 2
    return bound, -friction * difference / bound


def mean_product(primal: list[Point], dual: list[Point]) -> float:
    total = sum(float((p[0] * d[0] + inner(p[1], d[1])).sum()) for p, d in zip(primal, dual, strict=True))
    return total / max(1, sum(len(p[0]) for p in primal))


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


def balance(iterate: Iterate, matrix: NewtonMatrix) -> None:
    """Take away the torques that rounding has left, from contacts in cones in proportion to the square of their margin.

    Stiff contacts feel the rounding of the spins: over six decades of friction a Newton step leaves torques of 1e-8.
    Raises NotPositiveDefinite if the forces cannot be balanced.
    """
    stiffness = [
        np.eye(len(y))[:, :, None] * np.maximum(mu - length(y), TINY) ** 2
        for mu, y in zip(iterate.friction, iterate.dual, strict=True)
    ]
    balanced = matrix.balanced(iterate.dual, stiffness, iterate.to_balance(iterate.spins))
    changes = [new - y for new, y in zip(balanced, iterate.dual, strict=True)]
    along = min(
        longest_step((mu, y), (np.zeros_like(mu), dy))
        for mu, y, dy in zip(iterate.friction, iterate.dual, changes, strict=True)
    )
    for y, dy in zip(iterate.dual, changes, strict=True):
        y += min(1.0, STEP_SHARE * along) * dy


class _Direction:
    """Search direction, improved by right-hand sides that share one factorisation."""

    def __init__(self, iterate: Iterate, matrix: NewtonMatrix) -> None:
        self.iterate, self.matrix = iterate, matrix
        self.groups, self.cones = iterate.system.groups, iterate.cones
        self.primal, self.opposite = iterate.primal, iterate.opposite
        self.scalings = [Scaling.of(p, d) for p, d in zip(self.primal, self.opposite, strict=True)]
        self.blocks = [s.newton_blocks() for s in self.scalings]
        self.stiffness = []
        for mu, z, smooth, cone, (_, _, in_cone) in zip(
            iterate.friction, iterate.difference, iterate.smooth, self.cones, self.blocks, strict=True
        ):
            stiffness = in_cone
            if smooth.any():
                stiffness = np.empty((len(z), *z.shape))
                stiffness[:, :, cone] = in_cone
                stiffness[:, :, smooth] = friction_stiffness(mu[smooth], z[:, smooth])
            self.stiffness.append(stiffness)
        matrix.factorise(self.stiffness, iterate.inertia.weight if iterate.inertia else 0.0)
        self.mean = iterate.complementarity
        self.target = 0.0
        self.right: list[Point] = []
        self.spins = np.zeros(iterate.system.unknowns)
        self.steps: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self.pull: list[np.ndarray] = []
        self.along = self.dual_along = 0.0

    def predict(self) -> None:
        """Straight at the solution: all products zero."""
        self._solve([(-mu, -y) for mu, y in self.opposite])

    def correct(self) -> None:
        """Mehrotra: aim at a product that the predictor makes credible, and mend its second-order error."""
        primal, dual = self._after(min(1.0, self.along), min(1.0, self.dual_along))
        remaining = max(mean_product(primal, dual), 0.0) / max(self.mean, TINY)
        self.target = min(1.0, remaining**2) * self.mean / 4
        right = []
        for s, (dbound, ddifference, ddual), (mu, y), c in zip(
            self.scalings, self.steps, self.opposite, self.cones, strict=True
        ):
            scaled_dual = s.apply((np.zeros_like(mu), ddual[:, c]))
            second = jordan_product(scaled_dual, s.apply_inverse((dbound, ddifference[:, c])))
            head, tail = s.apply_inverse(s.divide((second[0] - self.target, second[1])))
            right.append((-mu - head, -y - tail))
        self._solve(right)

    def recentre(self) -> bool:
        """Gondzio: bring outlying products of a longer step closer to the target. True if that pays."""
        if min(self.along, self.dual_along) > LONG_ENOUGH:
            return False
        before = self.along, self.dual_along, self.steps, self.spins, self.right, self.pull
        primal, dual = self._after(min(1.0, 1.5 * self.along + 0.1), min(1.0, 1.5 * self.dual_along + 0.1))
        right = []
        for s, p, d, (head, tail) in zip(self.scalings, primal, dual, self.right, strict=True):
            product = jordan_product(s.apply(d), s.apply_inverse(p))
            change = clipped_towards(product, self.target / SPREAD, self.target * SPREAD)
            more = s.apply_inverse(s.divide(change))
            right.append((head + more[0], tail + more[1]))
        self._solve(right)
        if min(1.0, self.along) + min(1.0, self.dual_along) < min(1.0, before[0]) + min(1.0, before[1]) + WORTHWHILE:
            self.along, self.dual_along, self.steps, self.spins, self.right, self.pull = before
            return False
        return True

    def take(self) -> float:
        """Balance the forces to round-off and go most of the way to the boundary."""
        iterate = self.iterate
        self._refine()
        along, dual_along = min(1.0, STEP_SHARE * self.along), min(1.0, STEP_SHARE * self.dual_along)
        iterate.spins = iterate.spins + along * self.spins
        # not from the spins anew: their rounding is coarser than the last distances from the cones
        iterate.difference = [z + along * step[1] for z, step in zip(iterate.difference, self.steps, strict=True)]
        for mu, z, y, b, smooth, c, (dbound, _, ddual) in zip(
            iterate.friction,
            iterate.difference,
            iterate.dual,
            iterate.bound,
            iterate.smooth,
            self.cones,
            self.steps,
            strict=True,
        ):
            b[c] += along * dbound
            y[:, c] += dual_along * ddual[:, c]
            b[smooth] = length(z[:, smooth])
            y[:, smooth] = -mu[smooth] * z[:, smooth] / b[smooth]
        return min(along, dual_along)

    def _refine(self) -> None:
        """Solve for the torques that rounding left, as long as that helps."""
        last = np.inf
        for trial in range(REFINEMENTS):
            duals = [y + step[2] for y, step in zip(self.iterate.dual, self.steps, strict=True)]
            imbalance = self.iterate.imbalance(self.iterate.spins + self.spins, duals)
            size = float(np.abs(imbalance).max(initial=0.0))
            if trial > 0 and not BALANCED < size < last / 2:
                break
            last = size
            self.spins = self.spins + self.matrix.solve(imbalance)
            self._expand()

    def _solve(self, right: list[Point]) -> None:
        """Steps for W^-2 d(primal) + d(dual) = right that leave the forces balanced; `right` (n,), (d, n) a group."""
        self.right = right
        self.pull = [y.copy() for y in self.iterate.dual]
        for pull, (head, tail), (diagonal, off, _), c in zip(self.pull, right, self.blocks, self.cones, strict=True):
            pull[:, c] += tail - off * (head / diagonal)
        self.spins = self.matrix.solve(self.iterate.imbalance(self.iterate.spins, self.pull))
        self._expand()

    def _expand(self) -> None:
        """Steps of bounds, differences and duals that belong to the step of the spins, and how far they may go."""
        iterate = self.iterate
        self.steps, self.along, self.dual_along = [], np.inf, np.inf
        for number, (group, (head, _), (diagonal, off, _), c) in enumerate(
            zip(self.groups, self.right, self.blocks, self.cones, strict=True)
        ):
            difference = group.change(self.spins)
            bound = (head - inner(off, difference[:, c])) / diagonal
            new = self.pull[number] - np.einsum("ijn,jn->in", self.stiffness[number], difference)
            dual = new - iterate.dual[number]
            self.steps.append((bound, difference, dual))
            self.along = min(self.along, longest_step(self.primal[number], (bound, difference[:, c])))
            mu = self.opposite[number][0]
            self.dual_along = min(self.dual_along, longest_step(self.opposite[number], (np.zeros_like(mu), dual[:, c])))
            smooth = iterate.smooth[number]
            if smooth.any():  # the law of friction is far from linear once a slip changes by as much as itself
                share = length(iterate.difference[number][:, smooth]) / np.maximum(length(difference[:, smooth]), TINY)
                self.along = min(self.along, 0.5 * float(share.min()))
        if iterate.inertia is not None:  # spins and forces that balance each other go on together
            self.along = self.dual_along = min(self.along, self.dual_along)

    def _after(self, along: float, dual_along: float) -> tuple[list[Point], list[Point]]:
        """Primal and dual points after steps of these lengths."""
        primal = [
            (b + along * dbound, z + along * ddifference[:, c])
            for (b, z), (dbound, ddifference, _), c in zip(self.primal, self.steps, self.cones, strict=True)
        ]
        dual = [
            (mu, y + dual_along * ddual[:, c])
            for (mu, y), (_, _, ddual), c in zip(self.opposite, self.steps, self.cones, strict=True)
        ]
        return primal, dual
