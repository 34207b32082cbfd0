"""The algebra of second-order cones in NumPy, one formula after the other: the slow twin of kernels/central_path.py.

Primal points (bound, slip difference) and dual points (friction, minus force) meet on the central path where their
Jordan product is a multiple of (1, 0); the scaling W of Nesterov & Todd (1997) maps both to the same point,
W^-1 primal = W dual (Vandenberghe, The CVXOPT linear and quadratic cone program solvers, 2010).
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.conic.cones import Point, determinant, inner, length


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
