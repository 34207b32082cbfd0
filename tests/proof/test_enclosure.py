"""Every operation encloses the exact result, and hardly more."""

from decimal import Context, Decimal, getcontext, localcontext
from fractions import Fraction

import numpy as np
import pytest

from taichi_bearings.proof.enclosure import Enclosure, grouped_sum, length

CASES = 400


def numbers(seed, positive=False):
    """Pairs over many decades, some of them nearly equal, with some errors."""
    rng = np.random.default_rng(seed)
    high = rng.standard_normal(CASES) * 10.0 ** rng.integers(-30, 30, CASES)
    high = np.abs(high) if positive else high
    low = high * rng.standard_normal(CASES) * 2.0**-54
    error = np.abs(high) * 10.0 ** rng.integers(-40, -20, CASES) * (rng.random(CASES) < 0.5)
    pair = Enclosure.exact(high, low)
    return Enclosure(pair.high, pair.low, error)


def nearly(values, seed):
    """Numbers that all but cancel those given."""
    rng = np.random.default_rng(seed)
    return Enclosure.exact(values.high * (1 + 2.0**-52 * rng.integers(-3, 4, CASES)), values.low)


def corners(value):
    """The three points of an interval, exactly."""
    middle, error = Fraction(value.high.item()) + Fraction(value.low.item()), Fraction(value.error.item())
    return middle - error, middle, middle + error


def contains(result, index, exact):
    one = result[[index]]
    low, _, high = corners(one)
    assert low <= exact <= high
    assert one.lower()[0] <= exact <= one.upper()[0]
    assert one.least[0] <= abs(exact) <= one.most[0]


@pytest.mark.parametrize("name", ["+", "-", "*", "/"])
@pytest.mark.parametrize("close", [False, True])
def test_arithmetic_encloses_the_exact_result(name, close):
    apply = {
        "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b
    }[name]  # fmt: skip
    first = numbers(1)
    second = nearly(first, 2) if close else numbers(3)
    result = apply(first, second)
    for i in range(CASES):
        for a in corners(first[[i]]):
            for b in corners(second[[i]]):
                contains(result, i, apply(a, b))


def test_squares_enclose_the_exact_ones_and_are_the_products():
    value = numbers(4)
    squares, products = value.squared(), value * value
    for i in range(CASES):
        for of in corners(value[[i]]):
            contains(squares, i, of**2)
    for own, other in zip(squares.parts, products.parts, strict=True):
        assert (own == other).all()


def test_results_of_exact_numbers_are_known_to_a_hundred_bits():
    first, second = (Enclosure.exact(numbers(seed).high, numbers(seed).low) for seed in (4, 5))
    for result in (first + second, first * second, first / second):
        assert (result.error <= 2.0**-96 * np.abs(result.high)).all()


def test_the_root_is_enclosed():
    getcontext().prec = 90
    values = numbers(6, positive=True)
    result = values.sqrt()
    for i in range(CASES):
        for point in corners(values[[i]]):
            if point > 0:
                root = (Decimal(point.numerator) / Decimal(point.denominator)).sqrt()
                contains(result, i, Fraction(root))
    assert Enclosure.exact([0.0]).sqrt().error[0] == 0


def test_a_difference_of_equal_numbers_is_nothing():
    values = Enclosure.exact(numbers(7).high, numbers(7).low)
    nothing = values - values
    assert not nothing.high.any()
    assert not nothing.error.any()


def test_products_that_underflow_are_enclosed():
    small = Enclosure.exact(np.array([1e-170, 3e-200, 0.0]))
    square = small * small
    for i, value in enumerate((1e-170, 3e-200, 0.0)):
        contains(square, i, Fraction(value) ** 2)
    assert square.error[2] == 0


def test_sums_by_owner_are_enclosed():
    values, owner = numbers(8), np.random.default_rng(9).integers(0, 7, CASES)
    total = grouped_sum(values, owner, 8)
    for k in range(8):
        contains(total, k, sum((corners(values[[i]])[1] for i in np.flatnonzero(owner == k)), Fraction(0)))


def test_lengths_of_faint_vectors_are_enclosed_to_many_digits():
    rng = np.random.default_rng(11)
    parts = [Enclosure.exact(numbers(s).high * 10.0 ** -rng.integers(0, 250, CASES).astype(float)) for s in (12, 13)]
    found = length(parts)
    for i in range(CASES):
        exact = sum(Fraction(part.high[i]) ** 2 for part in parts)
        contains(found, i, Fraction((Decimal(exact.numerator) / Decimal(exact.denominator)).sqrt()))
    assert (found.error <= 1e-25 * found.high).all()
    assert length([Enclosure.exact([0.0]), Enclosure(np.zeros(1), np.zeros(1), np.array([1e-40]))]).error < 1e-38


def test_decimals_are_enclosed_whatever_digits_the_caller_rounds_to():
    third = Decimal(1).scaleb(-1) + Decimal(1) / 3
    with localcontext(Context(prec=3)):
        found = Enclosure.of_decimals([third])
    high, low, error = (Fraction(float(part[0])) for part in found.parts)
    assert abs(Fraction(third) - high - low) <= error
