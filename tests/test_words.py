"""Numbers in sentences: nothing short of all is called all."""

import pytest

from taichi_bearings.words import counted, share


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
