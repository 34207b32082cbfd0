"""Arithmetic of second-order cones, contact by contact.

A point of a second-order cone is a head (n,) and a tail (d, n) with head > |tail|, one for each of n contacts. There
are two kinds: primal points (bound, slip) and dual points (friction, minus force). What Newton steps make of them is in
kernels/central_path.py.
"""

import numpy as np

Point = tuple[np.ndarray, np.ndarray]


def length(tail: np.ndarray) -> np.ndarray:
    """Return the length (n,) of each of n vectors (d, n). Letters: d slip components.

    tail : (d, n), the vectors.
    """
    found: np.ndarray = np.abs(tail[0]) if len(tail) == 1 else np.sqrt(inner(tail, tail))
    return found


def determinant(point: Point) -> np.ndarray:
    """Return head^2 - |tail|^2 (n,) of the point of each contact's cone, without cancellation beyond that of head -
    |tail|. It is positive inside the cone.

    point : head (n,) and tail (d, n).

    Letters: n contacts with up to d slip components.
    """
    head, size = point[0], length(point[1])
    found: np.ndarray = (head - size) * (head + size)
    return found


def inner(tail: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the scalar products (n,) of n pairs of vectors.

    tail, other : (d, n), the vectors, with d slip components each.
    """
    found: np.ndarray = np.einsum("dn,dn->n", tail, other)
    return found


def longest_step(point: Point, step: Point) -> float:
    """Return the largest number a for which point + a * step is in the cones of all contacts; infinity if every a > 0
    is.

    point, step : head (n,) and tail (d, n) each; a cone is |tail| <= head. The point lies inside all cones.

    Letters: n contacts with up to d slip components.
    """
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
    """Return the stiffness matrices (d, d, n) of n contacts that resist every slip alike: `strength` times the unit
    matrix.

    vectors : any vectors (d, n) on the contacts, which tell the shape; or (d, n, S) of S samples, for (d, d, n, S).
    strength : a number, or one for each contact, (n,).

    Letters: d slip components.
    """
    found: np.ndarray = np.multiply.outer(np.eye(len(vectors)), strength * np.ones_like(vectors[0]))
    return found
