"""Arrays of real numbers, each enclosed in an interval: high + low, two doubles, and a bound on the error of this sum.

A result of +, -, *, / or sqrt encloses the exact result for all numbers that the operands enclose. A pair of doubles
carries some 106 bits (Dekker, Numer. Math. 18, 1971). Joldes, Muller and Popescu (ACM Trans. Math. Softw. 44, 2017)
prove relative errors of a few 2^-106 for one operation on pairs; 2^-100 is used here, several times as much. Bounds on
errors are themselves computed in doubles and rounded up by a factor. Products that may underflow have a larger error
bound; numbers beyond 1e140 in size are not allowed.

>>> from fractions import Fraction
>>> third = Enclosure.exact([1.0]) / Enclosure.exact([3.0])
>>> high, low, error = (Fraction(float(part[0])) for part in third.parts)
>>> abs(Fraction(1, 3) - high - low) <= error < Fraction(1, 10**29)
True
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from decimal import Context, Decimal, getcontext, localcontext
from functools import wraps
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.numerics.double_double import two_product, two_square, two_sum

LEAST_LENGTH = 2.0**-400  # length below which squares lose digits
LEAST_ROUNDING = 2.0**-1072  # twice what scaling back into the smallest doubles can round
PAIR_ROUNDING = 2.0**-100  # relative error of one operation on pairs
LEAST_DIGITS = 28  # digits of the rest of a decimal number, whatever the caller's decimals are rounded to
UP = 1 + 2.0**-30  # factor that covers the rounding of a bound that some million operations or less have computed
SLIGHTLY_UP = 1 + 2.0**-51  # factor that covers the rounding of a bound that two operations have computed
# size of a product below which parts of it may underflow, and a bound, amply, on what is lost by that
UNDERFLOWING_PRODUCT, UNDERFLOW_ERROR = 1e-250, 1e-290
IN_CACHE = 8192  # length of arrays of which some twenty fit the second-level cache of a processor
Made = TypeVar("Made", bound=Callable[..., Any])


def in_cache(function: Made) -> Made:
    """Return a function with the same results as `function`, bit by bit, that handles large arrays in parts of about
    IN_CACHE numbers. These fit the caches of a processor, so that only arguments and result pass through memory.

    function : a function of enclosures, arrays and numbers that works element by element."""

    @wraps(function)
    def in_parts(*given: Any) -> Any:
        """Return the result of `function`, computed part by part if the arrays are large.

        given : enclosures, arrays and numbers, which are broadcast to one shape."""
        shape = np.broadcast_shapes(*(np.shape(v.high if isinstance(v, Enclosure) else v) for v in given))
        if math.prod(shape) <= 2 * IN_CACHE:
            return function(*given)
        whole = [v.spread(shape) if isinstance(v, Enclosure) else np.broadcast_to(v, shape) for v in given]
        found: list[np.ndarray] = []
        for part in _parts_of(shape):
            of_part = function(*(v[part] for v in whole))
            values = of_part.parts if isinstance(of_part, Enclosure) else (of_part,)
            found = found or [np.empty(shape) for _ in values]
            for into, some in zip(found, values, strict=True):
                into[part] = some
        return Enclosure(*found) if len(found) > 1 else found[0]

    return in_parts  # type: ignore[return-value]


def _parts_of(shape: tuple[int, ...]) -> Iterator[tuple[int | slice, ...]]:
    """Yield indices of successive parts of an array with the shape `shape`, about IN_CACHE numbers each, that together
    cover it."""
    row = math.prod(shape[1:])
    if row > 2 * IN_CACHE:
        for first in range(shape[0]):
            yield from ((first, *part) for part in _parts_of(shape[1:]))
    else:
        step = max(1, IN_CACHE // max(row, 1))
        yield from ((slice(first, first + step),) for first in range(0, shape[0], step))


@dataclass(frozen=True)
class Enclosure:
    """Real numbers of which each is known but for a small error: |exact - (high + low)| <= error, element by element.

    high, low : arrays of doubles of one shape; their sum has twice the digits of a double.
    error : bound on what this sum misses, of the same shape; 0 where it is exact."""

    high: np.ndarray
    low: np.ndarray
    error: np.ndarray

    @classmethod
    def exact(cls, high: ArrayLike, low: ArrayLike = 0.0) -> Enclosure:
        """Return enclosures without any error, of the doubles `high`, or of the sums high + low of two doubles each.
        The result has the shape of `high`."""
        high = np.asarray(high, dtype=np.float64)
        if np.isscalar(low) and low == 0:
            return cls(high, np.zeros_like(high), np.zeros_like(high))
        total, rest = two_sum(high, np.broadcast_to(np.asarray(low, dtype=np.float64), high.shape))
        return cls(total, rest, np.zeros_like(total))

    @classmethod
    def of_decimals(cls, values: list[Decimal]) -> Enclosure:
        """Return an enclosure (n,) of n decimal numbers: each as the nearest sum of two doubles, with a bound on the
        error.

        values : the numbers, which may have many more digits than two doubles."""
        high = [float(v) for v in values]
        with localcontext(Context(prec=max(getcontext().prec, LEAST_DIGITS))):
            low = [float(v - Decimal(h)) for v, h in zip(values, high, strict=True)]
        pair = cls.exact(high, low)
        return cls(pair.high, pair.low, PAIR_ROUNDING * np.abs(pair.high))

    def __neg__(self) -> Enclosure:
        """Return the numbers with the opposite sign."""
        return Enclosure(-self.high, -self.low, self.error)

    @in_cache
    def __add__(self, other: Enclosure) -> Enclosure:
        """Return the sum, element by element."""
        high, rest = two_sum(self.high, other.high)
        low, more = two_sum(self.low, other.low)
        high, rest = _fast_two_sum(high, rest + low)
        high, rest = _fast_two_sum(high, rest + more)
        return Enclosure(high, rest, (self.error + other.error + PAIR_ROUNDING * np.abs(high)) * UP)

    @in_cache
    def __sub__(self, other: Enclosure) -> Enclosure:
        """Return the difference, element by element."""
        return self + (-other)

    @in_cache
    def plus(self, other: np.ndarray) -> Enclosure:
        """Return the sum with `other`, an array of doubles that are taken as exact, element by element."""
        high, rest = two_sum(self.high, other)
        high, rest = _fast_two_sum(high, rest + self.low)
        return Enclosure(high, rest, (self.error + PAIR_ROUNDING * np.abs(high)) * UP)

    @in_cache
    def __mul__(self, other: Enclosure) -> Enclosure:
        """Return the product, element by element."""
        product, rest = two_product(self.high, other.high)
        rest += self.high * other.low + self.low * other.high
        most, others = self.most, other.most
        return _rounded(product, rest, self.error * others + other.error * most, lambda: (most > 0) & (others > 0))

    @in_cache
    def squared(self) -> Enclosure:
        """Return the square: the same bits as the product with itself, in less time."""
        (product, rest), most = two_square(self.high), self.most
        twice, error = self.high * self.low, self.error * most
        rest += twice + twice
        return _rounded(product, rest, error + error, lambda: most > 0)

    @in_cache
    def times(self, other: np.ndarray) -> Enclosure:
        """Return the product with `other`, an array of doubles that are taken as exact, element by element."""
        product, rest = two_product(self.high, other)
        rest += self.low * other
        error = self.error * (np.abs(other) * SLIGHTLY_UP)
        return _rounded(product, rest, error, lambda: (self.most > 0) & (other != 0))

    @in_cache
    def __truediv__(self, other: Enclosure) -> Enclosure:
        """Return the quotient, element by element. Where the divisor may be 0 the error is infinite or NaN, so that
        nothing is proven."""
        first = self.high / other.high
        left = self - other.times(first)
        second = left.high / other.high
        high, low = _fast_two_sum(first, second)
        # exact quotient - (first + second) = (left - second * divisor) / divisor; first + second = high + low exactly
        missed = left - other.times(second)
        return Enclosure(high, low, missed.most / other.least * UP)

    @in_cache
    def sqrt(self) -> Enclosure:
        """Return the square root, element by element. The numbers must not be negative; but the interval around a
        number with `high` = 0 may reach below 0, and the root then encloses the roots of what is above."""
        zero = self.high == 0
        root = np.sqrt(np.where(zero, 1.0, self.high))
        about = Enclosure.exact(root)
        left = self - about.squared()
        high, low = _fast_two_sum(root, left.high / (2 * root))
        made = Enclosure(high, low, np.zeros_like(high))
        # |sqrt(a) - b| <= |a - b^2| / b for positive b
        missed = (self - made.squared()).most / made.least * UP
        return Enclosure(
            np.where(zero, 0.0, high), np.where(zero, 0.0, low), np.where(zero, np.sqrt(self.error) * UP, missed)
        )

    def __abs__(self) -> Enclosure:
        """Return the absolute values."""
        return Enclosure(np.abs(self.high), np.where(self.high < 0, -self.low, self.low), self.error)

    def signed(self, sign: np.ndarray | float) -> Enclosure:
        """Return the product with `sign`, an array whose numbers are +1, -1, 0 or a power of two, with either sign:
        none of these rounds anything."""
        return Enclosure(sign * self.high, sign * self.low, np.abs(sign) * self.error)

    def __getitem__(self, where: Any) -> Enclosure:
        """Return the enclosures at an index, slice or mask, as NumPy takes it."""
        return Enclosure(*(part[where] for part in self.parts))

    def at(self, places: np.ndarray) -> Enclosure:
        """Return the enclosures at the places `places` of the arrays, counted from 0 as if these were flat; the result
        has the shape of `places`."""
        return Enclosure(*(part.reshape(-1).take(places) for part in self.parts))

    def put(self, places: np.ndarray, others: Enclosure) -> None:
        """Overwrite the enclosures at the places `places` of the arrays by `others`, in place; places are counted from
        0 as if the arrays were flat, and each gets one of the others."""
        for part, other in zip(self.parts, others.parts, strict=True):
            part.put(places, other)

    def where(self, mask: np.ndarray) -> Enclosure:
        """Return the enclosures where `mask` is True, and exactly 0 elsewhere."""
        return Enclosure(*(np.where(mask, part, 0.0) for part in self.parts))

    def spread(self, shape: tuple[int, ...]) -> Enclosure:
        """Return the enclosures broadcast to a shape; read-only."""
        return Enclosure(*(np.broadcast_to(part, shape) for part in self.parts))

    def reshaped(self, shape: tuple[int, ...]) -> Enclosure:
        """Return the enclosures with another shape, as views."""
        return Enclosure(*(part.reshape(shape) for part in self.parts))

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The three arrays high, low and error."""
        return self.high, self.low, self.error

    @property
    def most(self) -> np.ndarray:
        """For each element a double that is not below the absolute value of the enclosed number; an array of the same
        shape."""
        found: np.ndarray = (np.abs(self.high) + (np.abs(self.low) + self.error)) * SLIGHTLY_UP
        return found

    @property
    def least(self) -> np.ndarray:
        """For each element a double, 0 or more, that is not above the absolute value of the enclosed number; an array
        of the same shape."""
        found: np.ndarray = (
            np.maximum(np.abs(self.high) - (np.abs(self.low) + self.error) * SLIGHTLY_UP, 0.0) / SLIGHTLY_UP
        )
        return found

    @property
    def value(self) -> np.ndarray:
        """The sums high + low, rounded to doubles; an array of the same shape."""
        found: np.ndarray = self.high + self.low
        return found

    @in_cache
    def upper(self) -> np.ndarray:
        """Return for each element a double that is not below the enclosed number: `high` itself where that is exact.
        The result is an array of the same shape."""
        change = self.low + self.error
        above = np.nextafter(self.high + (change + 2.0**-50 * np.abs(change)), np.inf)
        return np.where((self.low == 0) & (self.error == 0), self.high, above)

    def lower(self) -> np.ndarray:
        """Return for each element a double that is not above the enclosed number, an array of the same shape."""
        return -(-self).upper()


def joined(members: list[Enclosure]) -> Enclosure:
    """Return the concatenation of the enclosures `members`, (n_1,), (n_2,), ..., as one enclosure."""
    return Enclosure(*(np.concatenate(parts) for parts in zip(*(m.parts for m in members), strict=True)))


def row_sum(values: Enclosure) -> Enclosure:
    """Return for each of R rows the sum of its n numbers, an enclosure (R,). The second half of a row is added to the
    first, number by number, then these sums in the same way, and so on: few roundings, always in the same order.

    values : the numbers, an enclosure (R, n)."""
    while (size := values.high.shape[1]) > 1:
        half = size // 2
        paired, odd = values[:, :half] + values[:, half : 2 * half], values[:, 2 * half :]
        values = paired
        if size % 2:
            values = Enclosure(*(np.concatenate(both, axis=1) for both in zip(paired.parts, odd.parts, strict=True)))
    return values.reshaped((-1,)) if values.high.size else Enclosure.exact(np.zeros(len(values.high)))


def grouped_sum(values: Enclosure, owner: np.ndarray, count: int) -> Enclosure:
    """Return for each of `count` owners the sum of its values, an enclosure (count,). Neighbours among the values of an
    owner are added in pairs, then these sums, and so on.

    values : the values, an enclosure (n,).
    owner : (n,), the owner of each value, 0 to count - 1."""
    if count == 1:
        return row_sum(values.reshaped((1, -1)))
    order = np.argsort(owner.astype(np.uint16) if count <= 2**16 else owner, kind="stable")  # 16 bits: radix sort
    values, owner = values[order], owner[order]
    own = np.bincount(owner)
    place = np.arange(len(owner)) - (np.cumsum(own) - own)[owner]  # rank among the values of the same owner
    # Each pass keeps the values with an even rank, after adding to each the one after it, until each owner has one.
    while place.any():
        kept = np.flatnonzero(place % 2 == 0)
        with_next = np.append(place[1:], 0)[kept] % 2 == 1
        first = kept[with_next]
        pairs, values, owner, place = values[first] + values[first + 1], values[kept], owner[kept], place[kept] // 2
        for whole, part in zip(values.parts, pairs.parts, strict=True):
            whole[with_next] = part
    total = [np.zeros(count) for _ in range(3)]
    for whole, part in zip(total, values.parts, strict=True):
        whole[owner] = part
    return Enclosure(*total)


def length(parts: list[Enclosure]) -> Enclosure:
    """Return the lengths (n,) of n vectors: exactly the size of a component if it is the only one that is not 0.

    parts : the components of all vectors, one enclosure (n,) each."""
    parts = [part for part in parts if part.high.any() or part.error.any()] or parts[:1]  # leave out exact zeros
    there = np.array([(part.high != 0) | (part.error != 0) for part in parts])
    several = np.flatnonzero(there.sum(axis=0, dtype=np.int8) > 1)
    if len(several) == there.shape[1]:
        return _length_of_several(parts)
    # A sum over components is exactly the only one that is not 0; other lengths are overwritten.
    sums = (sum(of[1:], of[0]) for of in zip(*(part.parts for part in parts), strict=True))
    found = abs(Enclosure(*sums))
    if len(several):
        found.put(several, _length_of_several([part.at(several) for part in parts]))
    return found


def _length_of_several(parts: list[Enclosure]) -> Enclosure:
    """Return the lengths (n,) of n vectors of which more than one component is not exactly 0. Short vectors are scaled
    up by a power of two before they are squared, since small squares would lose digits.

    parts : the components of all vectors, one enclosure (n,) each."""
    sizes = np.max([part.most for part in parts], axis=0)
    faint = sizes < LEAST_LENGTH
    if not faint.any():
        squares = [part.squared() for part in parts]
        return sum(squares[1:], squares[0]).sqrt()
    scale = np.ldexp(1.0, -np.where(faint, np.maximum(np.frexp(sizes)[1], -1000), 0))
    squares = [part.signed(scale).squared() for part in parts]
    found = sum(squares[1:], squares[0]).sqrt().signed(1 / scale)
    found.error[scale > 1] += LEAST_ROUNDING
    return found


def _rounded(product: np.ndarray, rest: np.ndarray, error: np.ndarray, counts: Callable[[], np.ndarray]) -> Enclosure:
    """Return the enclosure of a product of enclosures.

    product, rest : its value, product + rest, but for rounding: two arrays of doubles of one shape.
    error : of the same shape, how far the errors of the two factors may move it.
    counts : function that returns the mask of the elements neither of whose factors is exactly 0: only these may have
        lost something by underflow. It is called for tiny products alone.
    """
    high, low = _fast_two_sum(product, rest)
    size = np.abs(high)
    error = error + PAIR_ROUNDING * size
    small = size < UNDERFLOWING_PRODUCT
    if small.any():
        error += np.where(small & counts(), UNDERFLOW_ERROR, 0.0)
    error *= UP
    return Enclosure(high, low, error)


def _fast_two_sum(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rounded sum of doubles |a| >= |b|, and its exact rounding error (Dekker)."""
    total = a + b
    part = total - a
    return total, np.subtract(b, part, out=part)
