"""Numbers in sentences: nothing short of all is called all."""

import math

import pytest

from taichi_bearings.words import counted, share, with_error


@pytest.mark.parametrize(
    ("value", "digits", "words"),
    [
        (0.5, 1, "50.0%"), (1.0, 1, "100.0%"), (0.0, 2, "0.00%"), (0.99996, 1, "99.996%"), (0.9996, 0, "99.96%"),
        (0.9994, 0, "99.9%"), (2e-5, 1, "0.002%"),
        (1 - 1e-9, 4, "99.9999999%"), (0.0049, 0, "0.5%"), (1.00001, 1, "100.001%"),
    ],
)  # fmt: skip
def test_shares_that_are_not_quite_all_or_nothing_say_so(value, digits, words):
    assert share(value, digits) == words


def test_one_has_no_plural():
    assert [counted(number, "iteration") for number in (0, 1, 2, 1200)] == [
        "0 iterations", "1 iteration", "2 iterations", "1,200 iterations",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("value", "error", "words"),
    [
        (135.278, 41.2, "140 +- 40"), (135.278, 14.2, "135 +- 14"), (0.51972, 0.0121, "0.520 +- 0.012"),
        (2.0, 0.577, "2.0 +- 0.6"), (5.0, 0.96, "5.0 +- 1.0"), (-12345.6, 250.0, "-12300 +- 200"),
        (1.0, math.nan, "1"), (1.0, 0.0, "1"), (0.0, 0.03, "0.00 +- 0.03"), (3.21e-9, 2.2e-10, "(3.2 +- 0.2)e-9"),
        (math.nan, 1.0, "nan"),
    ],
)  # fmt: skip
def test_a_value_ends_where_its_error_does(value, error, words):
    assert with_error(value, error) == words
