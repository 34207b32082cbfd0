"""Exponents with their errors: power laws fitted from each smallest size on, resampled over the disorder."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

RESAMPLES = 400
EXPONENTS, TRIALS, COLLAPSES = (-0.5, 2.5), 151, 50  # of collapses: looked at, how finely, and resampled how often
LEAST_SIZES = 3  # that a fit takes
LEAST_GOODNESS = 0.05  # probability of a misfit as large as that of a fit that counts
Statistic = Callable[[np.ndarray], float]


@dataclass(frozen=True)
class Exponent:
    """value, with its error from the disorder and the systematic one: how much it changes where the next size, or the
    next two, are left out.

    smallest : size from which on it is fitted. goodness : probability of such a misfit. fits : smallest size -> value.
    """

    value: float
    error: float
    systematic: float
    smallest: int
    goodness: float
    fits: dict[int, float]

    @property
    def total(self) -> float:
        return float(np.hypot(self.error, self.systematic))


def exponent(samples: dict[int, np.ndarray], statistic: Statistic, seed: int = 0) -> Exponent:
    """Of `statistic` of the samples against their size: from the smallest size on from which a power law fits.

    samples : size -> (samples,). The statistic takes the samples of one size.
    """
    rng, sizes = np.random.default_rng(seed), sorted(samples)
    value = np.log([statistic(samples[size]) for size in sizes])
    again = np.log([[statistic(rng.choice(samples[L], len(samples[L]))) for _ in range(RESAMPLES)] for L in sizes])
    spread, log = again.std(axis=1, ddof=1), np.log(sizes)
    fits: list[tuple[int, float, float, float]] = []
    for first in range(len(sizes) - LEAST_SIZES + 1):
        part = slice(first, None)
        weight = spread[part] ** -2.0
        slope, rest = _line(log[part], value[part], weight)
        several = [_line(log[part], column, weight)[0] for column in again[part].T]
        goodness = float(chi2.sf((weight * rest**2).sum(), len(weight) - 2))
        fits.append((sizes[first], slope, float(np.std(several, ddof=1)), goodness))
    chosen = next((number for number, fit in enumerate(fits) if fit[-1] >= LEAST_GOODNESS), len(fits) - 1)
    smallest, slope, error, goodness = fits[chosen]
    beyond = [abs(fit[1] - slope) for fit in fits[chosen : chosen + 3]]
    return Exponent(slope, error, max(beyond), smallest, goodness, {fit[0]: fit[1] for fit in fits})


def _line(x: np.ndarray, y: np.ndarray, weight: np.ndarray) -> tuple[float, np.ndarray]:
    """Slope of the weighted least-squares line, and what is left of y."""
    x0, y0 = np.average(x, weights=weight), np.average(y, weights=weight)
    slope = float((weight * (x - x0) * (y - y0)).sum() / (weight * (x - x0) ** 2).sum())
    return slope, y - y0 - slope * (x - x0)


@dataclass(frozen=True)
class Collapse:
    """value : of the exponent a at which curves against n / L^a lie closest together, with its error from the disorder.
    misfit : chi^2 a degree of freedom there."""

    value: float
    error: float
    misfit: float


def collapse(curves: dict[int, dict[int, np.ndarray]]) -> Collapse:
    """Of the means of samples, L -> n -> (samples,), as functions of log n, taken as straight between its points."""
    rng = np.random.default_rng(0)
    trials = np.linspace(*EXPONENTS, TRIALS)

    def best(means: dict[int, np.ndarray]) -> tuple[float, float]:
        misfits = [_apart(curves, means, errors, a) for a in trials]
        return float(trials[np.argmin(misfits)]), min(misfits)

    errors = {L: np.array([v.std(ddof=1) / len(v) ** 0.5 for v in of.values()]) for L, of in curves.items()}
    value, misfit = best({L: np.array([v.mean() for v in of.values()]) for L, of in curves.items()})
    again = [
        best({L: np.array([rng.choice(v, len(v)).mean() for v in of.values()]) for L, of in curves.items()})[0]
        for _ in range(COLLAPSES)
    ]
    return Collapse(value, float(np.std(again, ddof=1)), misfit)


def _apart(
    curves: dict[int, dict[int, np.ndarray]], means: dict[int, np.ndarray], errors: dict[int, np.ndarray], a: float
) -> float:
    """Mean square distance, in errors, of each point of a curve from every other curve, where that has neighbours."""
    total, count = 0.0, 0
    for L, of in curves.items():
        x = np.log(list(of)) - a * np.log(L)
        for M, other in curves.items():
            if M != L:
                at = np.log(list(other)) - a * np.log(M)
                inside = (x >= at[0]) & (x <= at[-1])
                there, error = np.interp(x[inside], at, means[M]), np.interp(x[inside], at, errors[M])
                total += float(((means[L][inside] - there) ** 2 / (errors[L][inside] ** 2 + error**2)).sum())
                count += int(inside.sum())
    return total / count if count else np.inf


def skewness(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """With its standard error, from the disorder."""
    found = np.asarray(values, dtype=float)
    rng = np.random.default_rng(0)

    def of(x: np.ndarray) -> float:
        return float(((x - x.mean()) ** 3).mean() / x.std() ** 3)

    return of(found), float(np.std([of(rng.choice(found, len(found))) for _ in range(RESAMPLES)], ddof=1))
