"""Statistics over samples: exact small cases, known distributions, and the coverage of the bootstrap intervals."""

import numpy as np
import pytest
from scipy import stats

from taichi_bearings.analysis.statistics import describe, groups, mean_interval, ratio_interval


def test_a_small_case_by_hand():
    found = describe(np.array([1.0, np.nan, 2.0, 6.0]))
    assert (found.number, found.missing) == (3, 1)
    assert found.mean == 3
    assert found.standard_error == pytest.approx(np.sqrt(((4 + 1 + 9) / 2) / 3))
    assert found.quantiles == pytest.approx([1.1, 1.5, 2, 4, 5.6])
    assert 1 <= found.low < 3 < found.high <= 6


def test_too_few_samples_have_no_error_and_equal_ones_none_to_speak_of():
    one = describe(np.array([0.7]))
    assert one.mean == 0.7
    assert np.isnan([one.standard_error, one.low, one.high]).all()
    assert np.isnan(describe(np.full(3, np.nan)).mean)
    assert describe(np.array([])).number == 0
    same = describe(np.full(7, 0.1))
    assert (same.low, same.high) == (same.mean, same.mean)
    assert same.standard_error < 1e-16
    assert ratio_interval(np.full(3, 0.3), np.full(3, 0.1)).high == pytest.approx(3)
    nought = ratio_interval(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0]))  # some draws divide by nothing
    assert nought.value == 6
    assert np.isnan(nought.high)


def test_the_same_samples_give_the_same_bits():
    values = np.random.default_rng(3).lognormal(size=200)
    assert describe(values).low == describe(values.copy()).low
    assert mean_interval(values, seed=1) != mean_interval(values, seed=2)


def test_intervals_agree_with_scipy():
    """Both draw 20000 times; the ends may differ by the noise of the draws, some hundredths of the width."""
    rng = np.random.default_rng(17)
    top, bottom, other = rng.lognormal(size=60), rng.gamma(3, size=60), rng.gamma(3, size=25)

    def reference(samples, statistic, paired):
        return stats.bootstrap(
            samples, statistic, n_resamples=20000, paired=paired, vectorized=True, batch=500
        ).confidence_interval

    ratio = lambda a, b, axis: a.mean(axis=axis) / b.mean(axis=axis)  # noqa: E731
    for ours, theirs in (
        (mean_interval(top, resamples=20000), reference((top,), np.mean, False)),
        (ratio_interval(top, bottom, resamples=20000), reference((top, bottom), ratio, True)),
        (ratio_interval(top, other, paired=False, resamples=20000), reference((top, other), ratio, False)),
    ):
        width = theirs.high - theirs.low
        assert abs(ours.low - theirs.low) < 0.04 * width
        assert abs(ours.high - theirs.high) < 0.04 * width


def coverage(trials, held):
    """Share of the trials that hold the truth; its standard error at 0.95 and 500 trials is 0.01."""
    return sum(held(np.random.default_rng([5, trial])) for trial in range(trials)) / trials


def test_the_interval_of_a_mean_covers_it_as_often_as_stated():
    def holds(rng):
        found = mean_interval(rng.exponential(2.0, 200), 0.9, 1000)
        return found.low <= 2.0 <= found.high

    assert 0.86 <= coverage(500, holds) <= 0.93


@pytest.mark.parametrize("paired", [True, False])
def test_the_interval_of_a_ratio_covers_it_as_often_as_stated(paired):
    def holds(rng):
        bottom = rng.gamma(4.0, 1.0, 50)  # mean 4
        shared = bottom if paired else rng.gamma(4.0, 1.0, 50)
        found = ratio_interval(shared + rng.exponential(2.0, 50), bottom, paired, 0.95, 1000)  # mean 6
        return found.low <= 1.5 <= found.high

    assert 0.91 <= coverage(500, holds) <= 0.98


def test_pairs_that_vary_together_have_a_ratio_known_better_than_pairs_that_do_not():
    rng = np.random.default_rng(23)
    bottom = rng.gamma(2.0, size=100)
    top = 3 * bottom * rng.uniform(0.99, 1.01, 100)
    together, apart = (ratio_interval(top, bottom, paired) for paired in (True, False))
    assert together.value == pytest.approx(apart.value)
    assert together.high - together.low < 0.1 * (apart.high - apart.low)


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
