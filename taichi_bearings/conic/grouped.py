"""Values on the contacts of a system, one array a group, with NumPy's arithmetic on all groups at once.

Groups differ in the number of their slipping components, so one array would not do: a scalar field has the shapes (n,),
a vector field (d, n). `friction * difference` is then the product in every group, `.sum()` the sum over all contacts.

A point of a second-order cone is a head (n,) and a tail (d, n) with head > |tail|: primal points (bound, slip
difference) and dual points (friction, minus force). What Newton steps make of them is in kernels/central_path.py.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import repeat
from typing import Generic, TypeVar

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

T = TypeVar("T")
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


class Grouped(NDArrayOperatorsMixin, Generic[T]):
    """One value a group of contacts: an array of theirs, or whatever :func:`each` has made of one."""

    def __init__(self, parts: Iterable[T]) -> None:
        self.parts = tuple(parts)

    def __iter__(self) -> Iterator[T]:
        return iter(self.parts)

    def __len__(self) -> int:
        return len(self.parts)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: object, **options: object) -> "Grouped":
        if method != "__call__" or options:
            return NotImplemented
        return each(ufunc, *inputs)

    def __getitem__(self: "Arrays", chosen: "Grouped") -> "Arrays":
        """The values of the chosen contacts; chosen : masks, places or a slice, one a group."""
        return each(lambda values, some: values[..., some], self, chosen)

    def placed(self: "Arrays", places: "Grouped", new: "Grouped") -> "Arrays":
        """The same with `new` values in some places."""

        def replaced(values: np.ndarray, some: np.ndarray, others: np.ndarray) -> np.ndarray:
            changed = values.copy()
            changed[..., some] = others
            return changed

        return each(replaced, self, places, new)

    def length(self: "Arrays") -> "Arrays":
        """Euclidean length of vectors, (n,) a group."""
        return each(length, self)

    def sum(self: "Arrays") -> float:
        return sum(float(values.sum()) for values in self)

    def max(self: "Arrays") -> float:
        """Largest of values that are not negative; 0 of none."""
        return max(float(values.max(initial=0.0)) for values in self)

    def any(self: "Arrays") -> bool:
        return any(bool(values.any()) for values in self)

    def all(self: "Arrays") -> bool:
        return all(bool(values.all()) for values in self)


Arrays = Grouped[np.ndarray]


def each(function: Callable[..., T], *values: object) -> Grouped[T]:
    """function(*values) of every group; what is not :class:`Grouped` is the same for all."""
    return Grouped(map(function, *[value.parts if isinstance(value, Grouped) else repeat(value) for value in values]))


def together(samples: Sequence[Arrays]) -> Arrays:
    """Values (..., n) of alike samples, one sample after the other in every group."""
    return samples[0] if len(samples) == 1 else each(lambda *parts: np.concatenate(parts, axis=-1), *samples)


def apart(values: Arrays, samples: int) -> list[Arrays]:
    """Inverse of :func:`together`."""
    if samples == 1:
        return [values]
    return list(map(Grouped, zip(*(np.split(part, samples, axis=-1) for part in values), strict=True)))


def side_by_side(values: Arrays, samples: int) -> Arrays:
    """(..., n, samples) from values (..., samples * n) of alike samples one after the other."""
    return each(lambda v: np.ascontiguousarray(np.swapaxes(v.reshape(*v.shape[:-1], samples, -1), -2, -1)), values)


def one_by_one(values: Arrays) -> Arrays:
    """Inverse of :func:`side_by_side`."""
    return each(lambda v: np.swapaxes(v, -2, -1).reshape(*v.shape[:-2], -1), values)


def where(chosen: Arrays, values: Arrays | float, others: Arrays | float) -> Arrays:
    """`values` of the chosen contacts, (n,) masks a group, and `others` of the rest."""
    return each(np.where, chosen, values, others)


def isotropic(like: Arrays, strength: Grouped | float = 1.0) -> Arrays:
    """Stiffness (d, d, n) a group, `strength` in every direction, of contacts with vectors `like`; or (d, d, n, S)."""
    return each(lambda vector, k: np.multiply.outer(np.eye(len(vector)), k * np.ones_like(vector[0])), like, strength)


def power(friction: Arrays, difference: Arrays) -> float:
    """Friction times slip, summed over the contacts."""
    return sum(each(lambda mu, z: float(mu @ length(z)), friction, difference))
