"""Statistics over samples: exact small cases, known distributions, and the coverage of the bootstrap intervals."""

import numpy as np
import pytest
from scipy import stats

from taichi_bearings.analysis.statistics import (
    FEW_SAMPLES,
    MANY_SAMPLES,
    groups,
    mean_interval,
    ratio_interval,
)


def test_too_few_samples_have_no_interval_and_equal_ones_one_without_width():
    for values in ([0.7], [0.7, 0.9]):
        found = mean_interval(np.array(values))
        assert found.value == pytest.approx(np.mean(values))
        assert np.isnan([found.low, found.high]).all()
    assert np.isnan(mean_interval(np.array([])).value)
    same = mean_interval(np.full(7, 0.1))
    assert (same.low, same.high) == (same.value, same.value)
    assert ratio_interval(np.full(3, 0.3), np.full(3, 0.1)).high == pytest.approx(3)
    nought = ratio_interval(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0]))  # some draws divide by nothing
    assert nought.value == 6
    assert np.isnan(nought.high)


def test_the_same_samples_give_the_same_bits():
    values = np.random.default_rng(3).lognormal(size=200)
    assert mean_interval(values) == mean_interval(values.copy())


@pytest.mark.parametrize("number", [3, 19, MANY_SAMPLES + 1])
def test_the_mean_of_few_or_of_many_samples_has_the_interval_of_student(number):
    values = np.random.default_rng(17).lognormal(size=number)
    found = mean_interval(values)
    assert (found.low, found.high) == pytest.approx(stats.ttest_1samp(values, 0).confidence_interval(0.95))


def test_the_interval_of_a_ratio_of_few_samples_is_that_of_fieller():
    """Ends are the ratios that Student's t of above - r below just excludes."""
    rng = np.random.default_rng(29)
    below = rng.gamma(9.0, size=8)
    above = 2 * below + rng.normal(size=8)
    found = ratio_interval(above, below)
    for end in (found.low, found.high):
        assert stats.ttest_1samp(above - end * below, 0).pvalue == pytest.approx(0.05)
    assert found.low < found.value < found.high


def test_the_interval_of_twenty_samples_is_a_bootstrap_one():
    """It leans to where the samples lean, which no interval of a normal distribution does."""
    values = np.random.default_rng(31).lognormal(size=20)
    found = mean_interval(values)
    assert found.high - found.value > 1.2 * (found.value - found.low)


def coverage(trials, held):
    """Share of the trials that hold the truth; its standard error at 0.95 and 500 trials is 0.01."""
    return sum(held(np.random.default_rng([5, trial])) for trial in range(trials)) / trials


@pytest.mark.parametrize(("number", "trials"), [(3, 2000), (5, 2000), (10, 2000), (19, 2000), (20, 200)])
def test_the_interval_of_a_mean_of_normal_numbers_covers_it_as_often_as_stated(number, trials):
    """BCa alone would cover 64, 82 and 90 % of 3, 5 and 10 samples."""

    def holds(rng):
        found = mean_interval(rng.normal(1.0, 1.0, number))
        return found.low <= 1.0 <= found.high

    assert abs(coverage(trials, holds) - 0.95) < (0.02 if number < FEW_SAMPLES else 0.06)


def test_the_interval_of_a_mean_covers_it_as_often_as_stated():
    def holds(rng):
        found = mean_interval(rng.exponential(2.0, 200))
        return found.low <= 2.0 <= found.high

    assert 0.90 <= coverage(300, holds) <= 0.985


@pytest.mark.parametrize("number", [6, 50])
def test_the_interval_of_a_ratio_covers_it_as_often_as_stated(number):
    def holds(rng):
        below = rng.gamma(4.0, 1.0, number)  # mean 4
        found = ratio_interval(below + rng.exponential(2.0, number), below)  # mean 6
        return found.low <= 1.5 <= found.high

    assert 0.90 <= coverage(300, holds) <= 0.985


def test_rows_are_grouped_by_values_to_the_last_bit_in_natural_order():
    columns = {
        "shape": np.array(["10x10", "8x8", "10x10", "8x8", "8x8"], dtype=object),
        "spin_bottom": np.array([0.3, 0.1 + 0.2, 0.3, np.nan, np.nan]),
        "seed": np.arange(5),
    }
    found = {key: rows.tolist() for key, rows in groups(columns, ["shape", "spin_bottom"]).items()}
    assert found == {("8x8", None): [3, 4], ("8x8", 0.1 + 0.2): [1], ("10x10", 0.3): [0, 2]}
    assert list(found) == [("8x8", None), ("8x8", 0.1 + 0.2), ("10x10", 0.3)]
    assert list(groups(columns, [])) == [()]
