"""Least dissipation by the central path: sums of norms with second-order cones, one a contact.

min sum w t + h |y|^2 / 2 with |y| <= t and y = K u + b. The dual of a cone is (w, -z) with the friction |z| <= w, whose
first entry never changes, so bounds t are eliminated contact by contact. Scaling of Nesterov and Todd, predictor and
corrector of Mehrotra (Andersen, Christiansen, Conn & Overton, SIAM J. Sci. Comput. 22, 2000).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.interrupts import look_up
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.packing.newton import NewtonMatrix, isotropic
from taichi_bearings.packing.system import System

MOST_STEPS, WAY_SHARE, SHORT_STEP, SLACK = 80, 0.99, 0.2, 0.3
PATIENCE = 6  # steps without a smaller gap
LEAST_MARGIN = 1e-4  # of a contact that takes a share of the torques that rounding has left, over w
ALONG = 1e-7  # springs along the slips of settled contacts, over w
HOLD, MOST_HOLD, STIFFER = 1e5, 1e11, 100.0  # springs of resting contacts over w, and over the stiffest that slip
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Point:
    """spins (unknowns,), slips y and friction z (d, A), bounds t (A,). Forces z + h y are balanced but for rounding.

    friction w, viscosity h : (A,).
    """

    spins: np.ndarray
    slip: np.ndarray
    bound: np.ndarray
    held: np.ndarray
    friction: np.ndarray
    viscosity: np.ndarray

    @property
    def force(self) -> np.ndarray:
        return self.held + self.viscosity * self.slip

    @property
    def speed(self) -> np.ndarray:
        return np.linalg.norm(self.slip, axis=0)

    @property
    def cost(self) -> float:
        return float((self.friction * self.speed + self.viscosity * self.speed**2 / 2).sum())

    @property
    def excess(self) -> float:
        """Cost less dual cost of balanced forces, at most, summed without cancellation."""
        return float((self.friction * self.speed - (self.held * self.slip).sum(axis=0)).sum())


@np.errstate(all="ignore")  # numbers that are not finite end the path
def followed(system: System, matrix: NewtonMatrix, friction: np.ndarray, viscosity: np.ndarray, gap: float) -> Point:
    """The last point of the path, or an earlier one if that is closer. gap : relative, at which it ends."""
    d = len(system.offset)
    weight = friction + viscosity
    spins = viscous_spins(system, matrix, weight)
    slip = system.difference(spins)
    speed = np.linalg.norm(slip, axis=0)
    slack = SLACK * max(float(speed.mean()), TINY)
    point = Point(spins, slip, np.hypot(speed, slack), np.zeros_like(slip), friction, viscosity)
    if viscosity.any():
        point = _flowing(point, system, matrix, d)
    best, least, last = point, np.inf, 0
    for number in range(MOST_STEPS):
        look_up()
        if point.excess < least:
            best, least, last = point, point.excess, number
        if not np.isfinite(point.cost) or least <= gap * point.cost or number > last + PATIENCE:
            break
        try:
            point = stepped(point, system, matrix)
        except NotPositiveDefinite:
            break
    return best


def viscous_spins(system: System, matrix: NewtonMatrix, weight: np.ndarray) -> np.ndarray:
    """Spins (unknowns,) at which viscous forces of this weight (A,) are in balance."""
    matrix.factorise(isotropic(weight, len(system.offset)))
    spins = np.zeros(system.unknowns)
    for _ in range(4):
        left = -system.torques(weight * system.difference(spins))
        spins = spins + matrix.solve(left)
    return spins


def _flowing(point: Point, system: System, matrix: NewtonMatrix, d: int) -> Point:
    """Frictions half as large as they may be, that balance the viscous forces as far as that goes."""
    size = np.maximum(point.friction, 1e-12 * point.friction.max(initial=1.0))
    need = matrix.balanced(point.force, isotropic(size, d)) - point.viscosity * point.slip
    ratio = np.linalg.norm(need, axis=0) / np.maximum(point.friction, TINY)
    worst = float(ratio[point.friction > 0].max(initial=0.0))
    return replace(point, held=need * min(1.0, 0.5 / max(worst, TINY)) * (point.friction > 0))


def balanced(point: Point, system: System, matrix: NewtonMatrix) -> Point:
    """Take away the torques that rounding has left, in proportion to friction and the square of the margin."""
    d, speed = len(point.slip), _length(point.held)
    margin = 1 - speed / np.where(point.friction > 0, point.friction, 1.0)
    soft = point.friction * np.maximum(margin, LEAST_MARGIN) ** 2 + point.viscosity
    try:
        force = matrix.balanced(point.force, isotropic(soft, d))
    except NotPositiveDefinite:
        return point
    return replace(point, held=force - point.viscosity * point.slip)


@dataclass(frozen=True)
class Settled:
    """Contacts (A,) that are known to slip, and others that are known to rest."""

    slips: np.ndarray
    rests: np.ndarray

    @property
    def all(self) -> np.ndarray:
        return self.slips | self.rests


@dataclass(frozen=True)
class Outside:
    """Of settled contacts: their stiffness (d, d, A), and what the law asks for beside the present friction, (d, A)."""

    stiffness: np.ndarray
    pull: np.ndarray

    @classmethod
    def of(cls, point: Point, settled: Settled | None) -> "Outside":
        """Slipping ones bend with their slip, resting ones are held by springs stiffer than any of those."""
        d, w, speed = len(point.slip), point.friction, np.maximum(point.speed, TINY)
        if settled is None:
            return cls(np.zeros((d, *point.slip.shape)), np.zeros_like(point.slip))
        along, slips = point.slip / speed, settled.slips & (w > 0)
        curved = np.where(slips, w / speed, 0.0)
        stiffest = float((curved[slips] / w[slips]).max(initial=0.0))
        springs = np.where(settled.rests, min(max(HOLD, STIFFER * stiffest), MOST_HOLD) * w, 0.0)
        outer = along[:, None] * along[None]
        bent = curved * (np.eye(d)[:, :, None] - outer) + np.where(slips, ALONG * w, 0.0) * outer
        pull = np.where(slips, w * along - point.held, 0.0) + springs * point.slip
        return cls(bent + isotropic(springs, d), pull)


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt((vectors * vectors).sum(axis=0))


@dataclass(frozen=True)
class _Scaling:
    """Of the cones with friction, (c,): W^-2 = (2 a a^T - J) / eta^2, a = (a0, a1)."""

    eta: np.ndarray
    a0: np.ndarray
    a1: np.ndarray
    scaled0: np.ndarray
    scaled1: np.ndarray

    @classmethod
    def of(cls, bound: np.ndarray, slip: np.ndarray, friction: np.ndarray, held: np.ndarray) -> "_Scaling":
        speed, force = _length(slip), _length(held)
        primal = np.maximum((bound - speed) * (bound + speed), TINY) ** 0.5
        dual = np.maximum((friction - force) * (friction + force), TINY) ** 0.5
        s0, s1, z0, z1 = bound / primal, slip / primal, friction / dual, -held / dual
        gamma = np.sqrt((1 + s0 * z0 + (s1 * z1).sum(axis=0)) / 2)
        w1 = (s1 - z1) / (2 * gamma)
        eta, w0 = np.sqrt(primal / dual), np.sqrt(1 + (w1 * w1).sum(axis=0))
        found = cls(eta, w0, -w1, w0, w1)
        scaled = found.stretched(friction, -held)
        return replace(found, scaled0=scaled[0], scaled1=scaled[1])

    def stretched(self, x0: np.ndarray, x1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W x."""
        dot = -(self.a1 * x1).sum(axis=0)
        return self.eta * (self.a0 * x0 + dot), self.eta * (x1 - self.a1 * (x0 + dot / (1 + self.a0)))

    def shrunk(self, x0: np.ndarray, x1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W^-1 x."""
        dot = (self.a1 * x1).sum(axis=0)
        return (self.a0 * x0 + dot) / self.eta, (x1 + self.a1 * (x0 + dot / (1 + self.a0))) / self.eta

    @property
    def stiffness(self) -> np.ndarray:
        """(d, d, c), W^-2 without its bounds."""
        size = (self.a1 * self.a1).sum(axis=0)
        along = self.a1 / np.sqrt(np.maximum(size, TINY))
        d = len(self.a1)
        outer = along[:, None] * along[None]
        if d == 1:
            return outer * 0 + (1 / (1 + 2 * size)) / self.eta**2
        other = np.stack([-along[1], along[0]])
        full = other[:, None] * other[None] + outer / (1 + 2 * size)
        return np.where(size > TINY, full, np.eye(d)[:, :, None]) / self.eta**2

    def product(self, wider: np.ndarray, change: np.ndarray, harder: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(W^-1 ds) o (W dz) of a step."""
        (x0, x1), (y0, y1) = self.shrunk(wider, change), self.stretched(np.zeros_like(wider), -harder)
        return x0 * y0 + (x1 * y1).sum(axis=0), x0 * y1 + y0 * x1

    def divided(self, r0: np.ndarray | float, r1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x with (scaled point) o x = r."""
        l0, l1 = self.scaled0, self.scaled1
        size = _length(l1)
        x0 = (l0 * r0 - (l1 * r1).sum(axis=0)) / np.maximum((l0 - size) * (l0 + size), TINY)
        return x0, (r1 - x0 * l1) / l0


def stepped(point: Point, system: System, matrix: NewtonMatrix, settled: Settled | None = None) -> Point:
    """One step of predictor and corrector; contacts that are `settled` are in no cone."""
    inside = np.flatnonzero((point.friction > 0) & ~settled.all if settled else point.friction > 0)
    outside = Outside.of(point, settled)
    bound, slip, friction, held = (v[..., inside] for v in (point.bound, point.slip, point.friction, point.held))
    scaling = _Scaling.of(bound, slip, friction, held)
    d, together = len(slip), settled is not None or bool(point.viscosity.any())
    stiffness = isotropic(point.viscosity, d)
    soft = scaling.stiffness
    stiffness[..., inside] += soft
    stiffness += outside.stiffness
    matrix.factorise(stiffness)
    m0 = (1 + 2 * (scaling.a1**2).sum(axis=0)) / scaling.eta**2
    m1 = 2 * scaling.a0 * scaling.a1 / scaling.eta**2

    def solved(q0: np.ndarray, q1: np.ndarray, solve: Callable = matrix.refined) -> tuple[np.ndarray, ...]:
        """Steps of spins, slips, bounds and frictions that leave no torque, for W^-2 ds + dz = q."""
        rest = m1 * q0 / m0 - q1
        force = point.force + outside.pull
        force[:, inside] += rest
        step = solve(-system.torques(force))
        change = system.change(step)
        own = change[:, inside]
        return step, change, (q0 - (m1 * own).sum(axis=0)) / m0, np.einsum("tse,se->te", soft, own) + rest

    def lengths(change: np.ndarray, wider: np.ndarray, harder: np.ndarray) -> tuple[float, float]:
        primal = _reach(bound, slip, wider, change[:, inside])
        dual = _reach(friction, held, np.zeros_like(friction), harder)
        return (min(primal, dual),) * 2 if together else (primal, dual)

    product = friction * bound - (held * slip).sum(axis=0)
    mean = float(product.mean()) if len(inside) else 0.0
    _, change, wider, harder = solved(-friction, held, matrix.solve)
    one, two = (min(1.0, length) for length in lengths(change, wider, harder))
    after = friction * (bound + one * wider) - ((held + two * harder) * (slip + one * change[:, inside])).sum(axis=0)
    target = mean * min(1.0, max(float(after.mean()) / mean, 0.0)) ** 3 if mean > 0 else 0.0
    second = scaling.product(wider, change[:, inside], harder)
    for goal, (b0, b1) in ((target, second), (mean, (0.0, np.zeros_like(held)))):
        g0, g1 = scaling.divided(goal - b0, -b1)
        step, change, wider, harder = solved(*scaling.shrunk(g0 - scaling.scaled0, g1 - scaling.scaled1))
        one, two = (min(1.0, WAY_SHARE * length) for length in lengths(change, wider, harder))
        if min(one, two) > SHORT_STEP:
            break  # else back to the middle of the cones
    # of those outside the next step finds the friction anew
    bounds, frictions = point.bound.copy(), point.held.copy()
    bounds[inside] += one * wider
    frictions[:, inside] += two * harder
    frictions += two * (outside.pull + np.einsum("tse,se->te", outside.stiffness, change))
    spins = point.spins + one * step
    slips = point.slip + one * change
    return replace(point, spins=spins, slip=slips, bound=_outside(bounds, slips), held=frictions)


def _outside(bound: np.ndarray, slip: np.ndarray) -> np.ndarray:
    """Bounds that rounding has not put below the slips."""
    return np.maximum(bound, _length(slip) * (1 + 1e-15) + TINY)


def _reach(x0: np.ndarray, x1: np.ndarray, d0: np.ndarray, d1: np.ndarray) -> float:
    """How far x + a d stays in all cones."""
    size = _length(x1)
    a = d0**2 - (d1 * d1).sum(axis=0)
    b = x0 * d0 - (x1 * d1).sum(axis=0)
    c = np.maximum((x0 - size) * (x0 + size), 0.0)
    inner = b * b - a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        below = np.sqrt(np.maximum(inner, 0.0)) - b
        reach = np.where((inner >= 0) & (below > 0), c / below, np.inf)
    return float(reach.min(initial=np.inf))
