"""Numbers (n,) and vectors (d, n) on contacts, and second-order cones of them.

A point of a second-order cone is a head (n,) and a tail (d, n) with head > |tail|: primal points (bound, slip
difference) and dual points (friction, minus force). What Newton steps make of them is in kernels/central_path.py.
"""

import numpy as np

Point = tuple[np.ndarray, np.ndarray]


def length(tail: np.ndarray) -> np.ndarray:
    """Euclidean length over the first axis, (n,)."""
    return np.abs(tail[0]) if len(tail) == 1 else np.sqrt(inner(tail, tail))


def determinant(point: Point) -> np.ndarray:
    """head^2 - |tail|^2 without cancellation beyond that of head - |tail|."""
    head, size = point[0], length(point[1])
    return (head - size) * (head + size)


def inner(tail: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Scalar products over the first axis, (n,)."""
    return np.einsum("dn,dn->n", tail, other)


def longest_step(point: Point, step: Point) -> float:
    """Largest factor a for which point + a * step stays in the cone of every contact; infinity if it never leaves."""
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


def isotropic(vectors: np.ndarray, strength: np.ndarray | float = 1.0) -> np.ndarray:
    """Stiffness `strength` (a number or (n,)) in every direction, as (d, d, n), for contacts with `vectors` (d, n); or
    (d, d, n, S) for vectors (d, n, S)."""
    return np.multiply.outer(np.eye(len(vectors)), strength * np.ones_like(vectors[0]))
