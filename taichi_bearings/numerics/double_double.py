"""Arithmetic of numbers stored as sums of two doubles, some 106 bits, for what float64 would round away.

A number is a `Pair` (high, low) of arrays of one shape: its value is high + low, where high is that sum rounded to
float64. Operations work element by element, as NumPy's do. After Dekker, Numer. Math. 18, 1971; Joldes, Muller and
Popescu, ACM Trans. Math. Softw. 44, 2017. Equal operands give equal results, bit by bit.
"""

import numpy as np

Pair = tuple[np.ndarray, np.ndarray]
SPLIT = 2.0**27 + 1  # Dekker's factor: splits the 53 bits of a double into two halves whose products are exact


def two_sum(a: np.ndarray, b: np.ndarray) -> Pair:
    """Return a + b rounded to float64, and exactly what the rounding leaves out."""
    total = a + b
    part = total - a
    rest = total - part
    rest = np.subtract(a, rest, out=rest)
    rest += np.subtract(b, part, out=part)
    return total, rest


def two_product(a: np.ndarray, b: np.ndarray) -> Pair:
    """Return a * b rounded to float64, and exactly what the rounding leaves out."""
    product = a * b
    (a1, a2), (b1, b2) = _halves(a), _halves(b)
    rest = a1 * b1
    rest -= product
    rest += a1 * b2
    rest += a2 * b1
    rest += a2 * b2
    return product, rest


def two_square(a: np.ndarray) -> Pair:
    """Return a * a rounded to float64, and exactly what the rounding leaves out."""
    product, (a1, a2) = a * a, _halves(a)
    rest, both = a1 * a1, a1 * a2
    rest -= product
    rest += both
    rest += both
    rest += a2 * a2
    return product, rest


def _halves(a: np.ndarray) -> Pair:
    """Return the doubles `a` as sums of two doubles (head, tail) of at most 26 bits each, exactly (Dekker's split)."""
    head = SPLIT * a
    head -= head - a
    return head, a - head


def add(x: Pair, y: Pair) -> Pair:
    """Return x + y. High and low parts are summed each, with what their rounding leaves out."""
    high, rest = two_sum(x[0], y[0])
    low, more = two_sum(x[1], y[1])
    high, rest = two_sum(high, rest + low)
    return two_sum(high, rest + more)


def subtract(x: Pair, y: Pair) -> Pair:
    """Return x - y as a sum of two doubles."""
    return add(x, (-y[0], -y[1]))


def multiply(x: Pair, y: Pair) -> Pair:
    """Return x * y as a sum of two doubles; the product of the low parts, below 2^-104 of it, is left out."""
    high, rest = two_product(x[0], y[0])
    return two_sum(high, rest + (x[0] * y[1] + x[1] * y[0]))


def scaled(factor: np.ndarray, x: Pair) -> Pair:
    """Return factor * x as a sum of two doubles, where the factor is an array of doubles."""
    high, rest = two_product(factor, x[0])
    return two_sum(high, rest + factor * x[1])


def square(x: Pair) -> Pair:
    """Return x * x as a sum of two doubles."""
    high, rest = two_square(x[0])
    return two_sum(high, rest + 2 * (x[0] * x[1]))


def divide(x: Pair, y: Pair) -> Pair:
    """Return x / y as a sum of two doubles: the quotient of the high parts, plus what is left of x divided by y."""
    first = x[0] / y[0]
    left = subtract(x, scaled(first, y))
    return two_sum(first, left[0] / y[0])


def square_root(x: Pair) -> Pair:
    """Return the square root of positive numbers x as a sum of two doubles, by one Newton step."""
    first = np.sqrt(x[0])
    left = subtract(x, two_square(first))
    return two_sum(first, left[0] / (2 * first))


def along(size: np.ndarray, x: Pair) -> Pair:
    """Return the vectors (d, n) of given sizes along the vectors x, as sums of two doubles: size / |x| * x.

    size : (n,) doubles.
    x : (d, n) of d = 1 or 2 components, none of them 0, and with squares that neither overflow nor underflow.

    The inverse length is r = 1 / |x|, computed in doubles, times 1 + e / 2 + 3 e^2 / 8 with e = 1 - r^2 |x|^2. As e is
    some 1e-16, what is left out is below 1e-47.
    """
    squares, rests = two_square(x[0])
    rests += 2 * (x[0] * x[1])
    (high, low), rest = two_sum(squares[0], squares[-1]) if len(squares) > 1 else (squares[0], 0.0), rests.sum(axis=0)
    low = low + rest
    inverse = 1 / np.sqrt(high)
    square, lacks = two_square(inverse)
    one, more = two_product(square, high)
    e = ((1 - one) - more) - (lacks * high + square * low)
    factor, rest = two_product(size, inverse)
    rest += factor * (e * (0.5 + 0.375 * e))
    found, low = two_product(np.broadcast_to(factor, x[0].shape), x[0])
    low += factor * x[1] + rest * x[0]
    return two_sum(found, low)


def exactly(values: np.ndarray) -> Pair:
    """Return doubles (`values`) as pairs (high, low) whose low parts are 0."""
    values = np.asarray(values, dtype=np.float64)
    return values, np.zeros_like(values)
