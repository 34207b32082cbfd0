"""Statistics over the samples of a parameter point: means with errors, quantiles, bootstrap intervals, and the grouping
of a table of samples by its parameters.

Samples are independent draws. Intervals are bias-corrected and accelerated (BCa) bootstrap intervals (B. Efron, J. Am.
Stat. Assoc. 82, 171, 1987), for means and for ratios of means, with a fixed seed: the same samples give the same bits.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
CONFIDENCE = 0.95
RESAMPLES = 2000
MOST_AT_ONCE = 2**22  # random numbers held at a time


@dataclass(frozen=True)
class Estimate:
    """A number and the interval that holds it with the stated confidence; NaN ends where no interval can be given."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Description:
    """Statistics of one number over the samples of a parameter point.

    number : samples that have it. missing : samples that have not (failed, or not-a-number); they are left out.
    standard_error : of the mean, from the spread of the samples; NaN for fewer than two. quantiles : those of
    QUANTILES, interpolated. low, high : ends of the bootstrap interval of the mean.
    """

    number: int
    missing: int
    mean: float
    standard_error: float
    quantiles: np.ndarray
    low: float
    high: float


def describe(values: np.ndarray, confidence: float = CONFIDENCE, resamples: int = RESAMPLES) -> Description:
    """Statistics of a number of the samples, (samples,)."""
    values = np.asarray(values, dtype=float)
    present = values[np.isfinite(values)]
    number = len(present)
    mean = mean_interval(present, confidence, resamples)
    return Description(
        number=number,
        missing=len(values) - number,
        mean=mean.value,
        standard_error=float(present.std(ddof=1) / np.sqrt(number)) if number > 1 else np.nan,
        quantiles=np.quantile(present, QUANTILES) if number else np.full(len(QUANTILES), np.nan),
        low=mean.low,
        high=mean.high,
    )


def mean_interval(
    values: np.ndarray, confidence: float = CONFIDENCE, resamples: int = RESAMPLES, seed: int = 0
) -> Estimate:
    """Mean of (samples,) numbers with its bootstrap interval; without width where all are equal."""
    return _bootstrap(
        [np.asarray(values, dtype=float)[:, None]], lambda mean: mean[..., 0], confidence, resamples, seed
    )


def ratio_interval(
    numerator: np.ndarray,
    denominator: np.ndarray,
    paired: bool = True,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Estimate:
    """Mean of the numerator over the mean of the denominator, with its bootstrap interval.

    numerator, denominator : (samples,) numbers, the latter of one sign. paired : both of the same samples, in the same
    order, which are drawn together; else two sets of samples, of any lengths, drawn apart.
    """
    both = [np.asarray(values, dtype=float)[:, None] for values in (numerator, denominator)]
    sets = [np.hstack(both)] if paired else both
    return _bootstrap(sets, lambda mean: mean[..., 0] / mean[..., 1], confidence, resamples, seed)


def _bootstrap(
    sets: Sequence[np.ndarray],
    statistic: Callable[[np.ndarray], np.ndarray],
    confidence: float,
    resamples: int,
    seed: int,
) -> Estimate:
    """BCa interval of a function of means.

    sets : independent sets of samples, (samples, numbers) each. statistic : of the means (..., numbers) of all sets.
    """
    means = [values.mean(axis=0) if len(values) else np.full(values.shape[1], np.nan) for values in sets]
    rng = np.random.default_rng(seed)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(statistic(np.concatenate(means)))
        if min(len(values) for values in sets) < 2:
            return Estimate(value, np.nan, np.nan)
        drawn = np.sort(statistic(np.hstack([_resampled_means(values, resamples, rng) for values in sets])))
    if not np.isfinite(drawn).all():
        return Estimate(value, np.nan, np.nan)
    spread = 8 * np.finfo(float).eps * abs(value)
    if drawn[-1] - drawn[0] <= spread:
        return Estimate(value, value, value)
    below = np.searchsorted(drawn, value - spread) + np.searchsorted(drawn, value + spread)
    bias = ndtri(np.clip(0.5 * below / resamples, 1 / resamples, 1 - 1 / resamples))
    tail = ndtri(0.5 * (1 - confidence)) * np.array([1, -1]) + bias
    level = ndtr(bias + tail / (1 - _acceleration(sets, means, statistic) * tail))
    low, high = np.quantile(drawn, level)
    return Estimate(value, float(low), float(high))


def _resampled_means(values: np.ndarray, resamples: int, rng: np.random.Generator) -> np.ndarray:
    """Means (resamples, numbers) of samples drawn anew with replacement."""
    number = len(values)
    block = max(1, MOST_AT_ONCE // number)
    return np.vstack([
        values[rng.integers(0, number, (min(block, resamples - start), number))].mean(axis=1)
        for start in range(0, resamples, block)
    ])  # fmt: skip


def _acceleration(
    sets: Sequence[np.ndarray], means: Sequence[np.ndarray], statistic: Callable[[np.ndarray], np.ndarray]
) -> float:
    """Efron's acceleration from the jackknife: skewness of the influence of single samples, over six."""
    cubes = squares = 0.0
    for place, values in enumerate(sets):
        without = (len(values) * means[place] - values) / (len(values) - 1)  # means without one sample each
        others = [np.broadcast_to(mean, (len(values), len(mean))) for mean in means]
        left = statistic(np.hstack([*others[:place], without, *others[place + 1 :]]))
        influence = (len(values) - 1) * (left.mean() - left) / len(values)
        cubes += float((influence**3).sum())
        squares += float((influence**2).sum())
    return cubes / (6 * squares**1.5) if squares > 0 else 0.0


def disorder_of(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """(rows,) numbers, equal for samples of the same disorder: of one seed, or with coefficients from one file.

    Those depend on each other, whatever else tells them apart. Every row is alone if the table has no seeds.
    """
    keys = [key for key in ("seed", "coefficients") if key in columns]
    number = np.arange(len(next(iter(columns.values()))))
    if "seed" in keys:
        for place, rows in enumerate(groups(columns, keys).values()):
            number[rows] = place
    return number


def independent(values: np.ndarray, disorder: np.ndarray) -> np.ndarray:
    """One number for each disorder: the mean of its samples. values, disorder : (samples,)."""
    _, which, number = np.unique(disorder, return_inverse=True, return_counts=True)
    return values if len(number) == len(values) else np.bincount(which, values) / number


def groups(columns: Mapping[str, np.ndarray], keys: Sequence[str]) -> dict[tuple[Any, ...], np.ndarray]:
    """Rows of a table by the values of some of its columns.

    columns : arrays of equal lengths by name. returns : values of the keys, as Python values -> numbers of the rows in
    rising order. Values are the same if they are equal to the last bit; not-a-number is one value, None. Groups come in
    the order of their values: numbers rise, texts too, numbers within them (8x8 before 10x10) by size.
    """
    rows: dict[tuple[Any, ...], list[int]] = {}
    listed = [[_plain(value) for value in columns[key].tolist()] for key in keys]
    for row in range(len(next(iter(columns.values())))):
        rows.setdefault(tuple(values[row] for values in listed), []).append(row)
    return {values: np.array(rows[values]) for values in sorted(rows, key=lambda values: [*map(natural, values)])}


def natural(value: Any) -> tuple[Any, ...]:
    """What puts values of a column in order: None, then truth values and numbers, then texts with numbers by size."""
    if value is None:
        return (0,)
    if not isinstance(value, str):
        return (1, value)
    parts = re.split(r"(\d+)", value)
    return (2, [(part, 0) if place % 2 == 0 else ("", int(part)) for place, part in enumerate(parts)])


def _plain(value: Any) -> Any:
    """A value that is equal to itself."""
    return None if value != value else value
