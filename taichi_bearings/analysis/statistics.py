"""Statistics over samples with the same parameters: means with confidence intervals, and grouping of a table by
columns.

Samples are independent draws. The interval of a mean, or of a ratio of means, depends on their number:

* fewer than LEAST_SAMPLES have none;
* from FEW_SAMPLES to MANY_SAMPLES it is the bias-corrected and accelerated (BCa) bootstrap interval (B. Efron, J. Am.
  Stat. Assoc. 82, 171, 1987), with a fixed seed: the same samples give the same bits;
* fewer or more have the interval of normally distributed numbers: with few samples the bootstrap covers too little,
  with many the two agree.

docs/figures.md has the measured coverage of these intervals.
"""

import re
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

CONFIDENCE = 0.95
RESAMPLES = 2000  # draws of a bootstrap
LEAST_SAMPLES, FEW_SAMPLES, MANY_SAMPLES = 3, 20, 10_000
MOST_AT_ONCE = 2**22  # random numbers held in memory at a time


@dataclass(frozen=True)
class Estimate:
    """A number with its confidence interval, from `low` to `high`, which holds the true value with probability
    CONFIDENCE.

    Both ends are not-a-number where there is no interval, for example with too few samples.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Census:
    """Numbers of samples that were used and that were not.

    used : number of samples that were used.
    left_out : number of those that were left out, by reason, in words that follow a number ("failed").
    """

    used: int
    left_out: Mapping[str, int] = field(default_factory=dict)

    @staticmethod
    def of(reasons: Iterable[str]) -> "Census":
        """Return how many samples are used and how many are left out.

        reasons : for each sample why it is left out, in words that follow a number ("failed"); "" if it is used.
        """
        counts = Counter(reasons)
        return Census(counts.pop("", 0), dict(sorted(counts.items(), key=lambda item: -item[1])))

    @property
    def asked(self) -> int:
        """Number of samples that were asked for."""
        return self.used + sum(self.left_out.values())

    @property
    def reasons(self) -> str:
        """Reasons in words, such as ``2 failed, 1 not computed yet``; empty if none is left out."""
        return ", ".join(f"{number:,} {reason}" for reason, number in self.left_out.items())

    @property
    def share(self) -> str:
        """Number of samples in words, such as ``57 of 60 samples``."""
        if not self.left_out:
            return "1 sample" if self.used == 1 else f"all {self.used:,} samples"
        return f"{format(self.used, ',') if self.used else 'none'} of {self.asked:,} samples"

    def __str__(self) -> str:
        """Return the numbers in words, such as ``57 of 60 samples (3 failed)``."""
        return f"{self.share} ({self.reasons})" if self.left_out else self.share


def mean_interval(values: np.ndarray) -> Estimate:
    """Return the mean of numbers and its 95 % confidence interval; the interval has no width if all numbers are equal,
    and its ends are not-a-number for fewer than LEAST_SAMPLES numbers.

    values : (samples,).
    """
    return ratio_interval(values, np.ones(len(values)))


def ratio_interval(numerator: np.ndarray, denominator: np.ndarray) -> Estimate:
    """Return the mean of the numerator over the mean of the denominator, with its 95 % confidence interval. The ends of
    the interval are not-a-number for fewer than LEAST_SAMPLES samples.

    numerator, denominator : (samples,) numbers of the same samples, in the same order; all denominators have one sign.
    """
    above, below = (np.asarray(values, dtype=float) for values in (numerator, denominator))
    number = len(above)
    if number == 0:
        return Estimate(np.nan, np.nan, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(above.mean() / below.mean())
    if number < LEAST_SAMPLES or not np.isfinite(value):
        return Estimate(value, np.nan, np.nan)
    # all samples have the same ratio but for rounding
    if np.abs(above - value * below).max() <= 8 * np.finfo(float).eps * np.abs(above).max():
        return Estimate(value, value, value)
    interval = _bootstrap if FEW_SAMPLES <= number <= MANY_SAMPLES else _student
    return Estimate(value, *interval(above, below))


def _student(above: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """Return the confidence interval (low, high) of mean(above) / mean(below), by Fieller's theorem (J. R. Stat. Soc. B
    16, 175, 1954).

    above, below : (samples,), numerators and denominators.

    The interval holds all ratios r at which Student's t test of above - r * below does not exclude a mean of 0: between
    the roots of square r^2 - 2 linear r + constant. It is (NaN, NaN) where the test does not exclude mean(below) = 0.
    With below = 1 it is Student's interval of a mean.
    """
    number, means = len(above), np.array([above.mean(), below.mean()])
    from scipy.special import stdtrit  # a tenth of a second that runs do not need

    spread = stdtrit(number - 1, 0.5 + 0.5 * CONFIDENCE) ** 2 * np.cov(above, below) / number
    (constant, linear), (_, square) = np.outer(means, means) - spread
    root = linear**2 - square * constant
    if square <= 0 or root < 0:
        return np.nan, np.nan
    low, high = (linear + np.array([-1, 1]) * np.sqrt(root)) / square
    return float(low), float(high)


def _bootstrap(above: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """Return the BCa bootstrap interval (low, high) of mean(above) / mean(below); NaN where some draw divides by 0.

    above, below : (samples,), numerators and denominators.
    """
    from scipy import stats

    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        found = stats.bootstrap(
            (above, below), lambda a, b, axis: a.mean(axis=axis) / b.mean(axis=axis), paired=True, vectorized=True,
            n_resamples=RESAMPLES, batch=max(1, MOST_AT_ONCE // len(above)), confidence_level=CONFIDENCE,
            random_state=np.random.default_rng(0),
        )  # fmt: skip
    if not np.isfinite(found.bootstrap_distribution).all():
        return np.nan, np.nan
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def independent(values: np.ndarray, disorder: np.ndarray) -> np.ndarray:
    """Return one number for each disorder (set of coefficients), (disorders,): the mean of the samples that share it.

    values : (samples,), numbers of the samples.
    disorder : (samples,), equal for samples with the same coefficients.
    """
    _, which, number = np.unique(disorder, return_inverse=True, return_counts=True)
    return values if len(number) == len(values) else np.bincount(which, values) / number


def groups(columns: Mapping[str, np.ndarray], keys: Sequence[str]) -> dict[tuple[Any, ...], np.ndarray]:
    """Return the numbers of the rows of a table in groups, by the tuple of values that a group shares in some columns.

    columns : arrays of equal lengths by name.
    keys : names of the columns to group by.

    Numbers are compared exactly; not-a-number counts as one value, None. Groups are in the order of
    `sort_key` of their values, and the rows of each in rising order.
    """
    rows: dict[tuple[Any, ...], list[int]] = {}
    listed = [[_plain(value) for value in columns[key].tolist()] for key in keys]
    for row in range(len(next(iter(columns.values())))):
        rows.setdefault(tuple(values[row] for values in listed), []).append(row)
    return {values: np.array(rows[values]) for values in sorted(rows, key=lambda values: [*map(sort_key, values)])}


def sort_key(value: object) -> tuple[Any, ...]:
    """Return a key by which `sorted` puts values of a column in order: first None, then truth values and numbers, then
    texts, where numbers within texts are compared by size (8x8 before 10x10).

    value : one value of the column.
    """
    if value is None:
        return (0,)
    if not isinstance(value, str):
        return (1, value)
    parts = re.split(r"(\d+)", value)
    return (2, [(part, 0) if place % 2 == 0 else ("", int(part)) for place, part in enumerate(parts)])


def _plain(value: object) -> Any:
    """Return None for not-a-number, and any other value unchanged, so that two missing numbers compare equal."""
    return None if value != value else value
