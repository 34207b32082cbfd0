"""Second-order cones: |slip| <= bound, |force| <= friction, and the Nesterov-Todd scaling that joins the two.

A point is a head (n,) and a tail (d, n) with head > |tail|, one for each of n contacts. Primal points (bound, slip
difference) and dual points (friction, minus force) meet on the central path where their Jordan product is a multiple of
(1, 0); the scaling W of Nesterov & Todd (1997) maps both to the same point, W^-1 primal = W dual
(Vandenberghe, The CVXOPT linear and quadratic cone program solvers, 2010).
"""

from dataclasses import dataclass

import numpy as np

Point = tuple[np.ndarray, np.ndarray]


def length(tail: np.ndarray) -> np.ndarray:
    """Euclidean length over the first axis, (n,)."""
    return np.abs(tail[0]) if len(tail) == 1 else np.sqrt(np.einsum("dn,dn->n", tail, tail))


def determinant(point: Point) -> np.ndarray:
    """head^2 - |tail|^2 without cancellation beyond that of head - |tail|."""
    head, size = point[0], length(point[1])
    return (head - size) * (head + size)


def inner(tail: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.einsum("dn,dn->n", tail, other)


def longest_step(point: Point, step: Point) -> float:
    """Largest a for which point + a * step stays in the cone; infinity if it never leaves."""
    (head, tail), (dhead, dtail) = point, step
    # a solves quadratic * a^2 + 2 linear * a + constant = 0; the smallest positive root counts
    quadratic = dhead * dhead - inner(dtail, dtail)
    linear = head * dhead - inner(tail, dtail)
    constant = determinant(point)
    root = np.sqrt(np.maximum(linear * linear - quadratic * constant, 0.0))
    # inside the cone constant > 0: a positive root exists if the quadratic is negative or (linear < 0 and real roots)
    leaves = (quadratic < 0) | ((linear < 0) & (linear * linear >= quadratic * constant))
    away = root - linear  # > 0 wherever the point leaves
    reach = constant[leaves] / np.maximum(away[leaves], np.finfo(float).tiny)
    return float(reach.min(initial=np.inf))


@dataclass(frozen=True)
class Scaling:
    """Nesterov-Todd scaling of n pairs of interior points: W = weight * hyperbolic rotation by (head, tail)."""

    weight: np.ndarray
    head: np.ndarray
    tail: np.ndarray
    point: Point  # W^-1 primal = W dual

    @classmethod
    def of(cls, primal: Point, dual: Point) -> "Scaling":
        size, dual_size = np.sqrt(determinant(primal)), np.sqrt(determinant(dual))
        head, tail = primal[0] / size, primal[1] / size
        dual_head, dual_tail = dual[0] / dual_size, dual[1] / dual_size
        half = np.sqrt((1 + head * dual_head + inner(tail, dual_tail)) / 2)
        made = cls(
            np.sqrt(size / dual_size), (head + dual_head) / (2 * half), (tail - dual_tail) / (2 * half), (head, tail)
        )
        object.__setattr__(made, "point", made.apply(dual))
        return made

    def _rotate(self, head: np.ndarray, tail: np.ndarray, sign: float) -> Point:
        along = inner(self.tail, tail)
        return self.head * head + sign * along, tail + self.tail * (sign * head + along / (1 + self.head))

    def apply(self, point: Point) -> Point:
        """W point."""
        head, tail = self._rotate(*point, 1.0)
        return self.weight * head, self.weight * tail

    def apply_inverse(self, point: Point) -> Point:
        """W^-1 point."""
        head, tail = self._rotate(*point, -1.0)
        return head / self.weight, tail / self.weight

    def divide(self, product: Point) -> Point:
        """The x with (scaled point) o x = product, where o is the Jordan product."""
        head, tail = self.point
        first = (head * product[0] - inner(tail, product[1])) / determinant(self.point)
        return first, (product[1] - tail * first) / head

    def newton_blocks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Parts of W^-2: head-head (n,), head-tail (d, n), and the stiffness (d, d, n) once the head is eliminated."""
        strength = 1 / self.weight**2
        core = 2 * self.head**2 - 1
        size = length(self.tail)
        along = self.tail / np.where(size > 0, size, 1.0)
        along[0, size == 0] = 1.0  # any direction will do
        stiffness = (strength / core) * along[:, None] * along[None, :]
        if len(along) == 2:  # the part across the slip; written out, so that nothing cancels
            across = np.stack([-along[1], along[0]])
            stiffness += strength * across[:, None] * across[None, :]
        return strength * core, -2 * strength * self.head * self.tail, stiffness


def jordan_product(first: Point, second: Point) -> Point:
    """(h, t) o (h', t') = (h h' + t.t', h t' + h' t)."""
    (a, b), (c, d) = first, second
    return a * c + inner(b, d), a * d + c * b


def clipped_towards(product: Point, low: float, high: float) -> Point:
    """What to add to a Jordan product to move its eigenvalues head -+ |tail| into [low, high], at most `high` each."""
    head, tail = product
    size = length(tail)
    lower, upper = head - size, head + size
    change_lower = np.maximum(np.clip(lower, low, high) - lower, -high)
    change_upper = np.maximum(np.clip(upper, low, high) - upper, -high)
    direction = tail / np.where(size > 0, size, 1.0)
    return (change_lower + change_upper) / 2, (change_upper - change_lower) / 2 * direction
