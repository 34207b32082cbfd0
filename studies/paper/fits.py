"""Exponents and limits of large samples with their errors: laws of the size, fitted to samples of several sizes.

Each law is fitted from each smallest size on, and the first fit that is good enough is taken. Errors come from
resampling the disorder. Letters: L size, R resamples, T trial exponents.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import permutations
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import chi2, skew

RESAMPLES = 400
EXPONENTS, TRIALS, COLLAPSES = (-0.5, 2.5), 151, 50  # of collapses: range, trials in it, and number of resamples
MOST_MISFIT = 1.5  # curves lie together if chi^2 a degree of freedom is no larger
LEAST_FREE, LEAST_CURVES = 2, 3  # least degrees of freedom of a fit, and curves of a collapse
POSSIBLE = {True: (0.05, 1.5), False: (-1.0, 1.5)}  # range of exponents of deviations, with a constant and without
FINELY = 500  # trial exponents in that range
VARIANCE = partial(np.var, ddof=1)  # unbiased
LEAST_GOODNESS = 0.05  # a fit is good enough if a misfit as large has at least this probability
STATED = 1.0  # exponent w of a surface over its volume
OTHERS = (0.5, 2.0)  # other w, which add to the error where they fit as well
LEAST_OF_LIMIT, LEAST_SAMPLES = 3, 3  # least sizes of the fit of a limit, and samples of a size
ROUND_OFF = 1e-12  # a spread that is a smaller share of the mean is rounding


@dataclass(frozen=True)
class Fitted:
    """A number that is fitted from a smallest size on, with its errors.

    error : from the disorder.
    systematic : largest change of the value if the next size, or the next two, are left out, or the last one that was
        left out is not.
    smallest : size from which on it is fitted.
    fits : the value for each smallest size.
    """

    value: float
    error: float
    systematic: float
    smallest: int
    fits: dict[int, Any]

    @property
    def total(self) -> float:
        return float(np.hypot(self.error, self.systematic))

    @property
    def numbers(self) -> dict[str, Any]:
        """The attributes by name, as reports keep them; fits become a list by the smallest size."""
        return vars(self) | {"total": self.total, "fits": list(self.fits.values())}


@dataclass(frozen=True)
class Law(Fitted):
    """A fitted law of the size. goodness : probability of a misfit as large. amplitude : factor of the power of the
    size.
    """

    goodness: float
    amplitude: float

    @property
    def follows(self) -> bool:
        """False where no sizes follow the law; the value then means nothing."""
        return self.goodness >= LEAST_GOODNESS


@dataclass(frozen=True)
class Exponent(Law):
    """The growth of a standard deviation with the size L: sd^2 = amplitude L^(2 value) + offset + further terms.

    The offset is what single contacts add. errors : of the value of each of `fits`, from the disorder; where one is as
    large as the systematic error, both are the same scatter.
    """

    offset: float
    errors: list[float]


def first_that_fits(goodness: Sequence[float]) -> int:
    """Return the number of the first fit that is good enough, or of the last one."""
    return next((number for number, one in enumerate(goodness) if one >= LEAST_GOODNESS), len(goodness) - 1)


def _changed(values: Sequence[float], chosen: int) -> float:
    """Return the largest change of the chosen value if one or two more sizes are left out, or one less.

    values : of the fits, by rising smallest size.
    """
    return float(max(abs(value - values[chosen]) for value in values[max(chosen - 1, 0) : chosen + 3]))


def line_through(x: np.ndarray, spread: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float]:
    """Return value at 0 and slope (2, ...) of least squares, and the probability of a misfit as large, all together.

    x, spread : (sizes,) abscissae, and errors of y. y : (sizes, ...).
    """
    rows = np.stack([np.ones(len(x)), x], axis=1) / spread[:, None]
    weighed = (y.T / spread).T
    found = np.linalg.lstsq(rows, weighed, rcond=None)[0]
    return found, float(chi2.sf(((rows @ found - weighed) ** 2).sum(), max(1, weighed.size - found.size)))


def exponent(
    samples: Mapping[int, np.ndarray], square: Callable[[np.ndarray], Any] = VARIANCE, beside: Sequence[float] = (0.0,)
) -> Exponent:
    """Return the growth of the deviation of samples, from the smallest size on from which the law fits.

    samples : (samples, ...) by size.
    square : returns what grows like A L^(2 value), from the samples of a size.
    beside : exponents of terms that are added to it, that of the offset first.
    """
    rng, sizes = np.random.default_rng(0), np.array(sorted(samples))
    variance = np.array([square(samples[L]) for L in sizes])
    again = np.array([[square(rng.choice(samples[L], len(samples[L]))) for _ in range(RESAMPLES)] for L in sizes])
    again = variance[:, None] + (again - variance[:, None]) * _unbiased(samples)[:, None]
    spread, fits = again.std(axis=1, ddof=1), []
    columns = np.concatenate([variance[:, None], again], axis=1)
    for first in range(max(1, len(sizes) - LEAST_FREE - 1 - len(beside))):
        values, misfit = _grown(sizes[first:], spread[first:], beside, columns[first:])
        goodness = float(chi2.sf(misfit, max(1, len(sizes) - first - 2 - len(beside))))
        fits.append((int(sizes[first]), float(values[0]), float(values[1:].std(ddof=1)), goodness))
    chosen = first_that_fits([fit[-1] for fit in fits])
    smallest, value, error, goodness = fits[chosen]
    rows = _rows(sizes[chosen:], spread[chosen:], beside, np.array([value]))[0]
    amplitude, offset = np.append(np.linalg.lstsq(rows, (variance / spread)[chosen:], rcond=None)[0], 0.0)[:2]
    beyond = _changed([fit[1] for fit in fits], chosen)
    by_smallest, errors = {fit[0]: fit[1] for fit in fits}, [fit[2] for fit in fits]
    return Exponent(value, error, beyond, smallest, by_smallest, goodness, float(amplitude), float(offset), errors)


def _unbiased(samples: Mapping[int, np.ndarray]) -> np.ndarray:
    """Return for each size, rising, the factor by which errors of resampling are too small."""
    number = np.array([len(samples[L]) for L in sorted(samples)])
    return np.sqrt(number / (number - 1))


def _rows(sizes: np.ndarray, spread: np.ndarray, beside: Sequence[float], values: np.ndarray) -> np.ndarray:
    """Return (T, sizes, terms): for each trial exponent the value of the terms at each size, in units of its error."""
    exponents = [2 * values, *(np.full_like(values, power) for power in beside)]
    return sizes[:, None] ** np.stack(exponents, axis=1)[:, None] / spread[:, None]


def _grown(
    sizes: np.ndarray, spread: np.ndarray, beside: Sequence[float], columns: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return exponents (R,) of least squares of several courses (sizes, R), and the least sum of squares of the first.

    For each trial exponent it is a linear fit in L^(2 value); the best one is refined by a parabola.
    """
    trials = np.linspace(*POSSIBLE[bool(beside)], FINELY)
    target, every = columns / spread[:, None], np.arange(columns.shape[1])
    basis = np.linalg.qr(_rows(sizes, spread, beside, trials))[0]
    misfit = (target**2).sum(axis=0) - ((basis.transpose(0, 2, 1) @ target) ** 2).sum(axis=1)
    at = np.clip(misfit.argmin(axis=0), 1, FINELY - 2)
    before, here, after = (misfit[at + step, every] for step in (-1, 0, 1))
    bend = np.maximum(before - 2 * here + after, np.finfo(float).tiny)
    shift = np.clip((before - after) / (2 * bend), -1, 1)
    return trials[at] + shift * (trials[1] - trials[0]), float(here[0] - shift[0] ** 2 * bend[0] / 2)


@dataclass(frozen=True)
class Limit(Law):
    """The limit of a mean: q(L) = value + amplitude L^-w with w = STATED.

    systematic : covers w of OTHERS, too. sizes : number of sizes in the fit.
    """

    sizes: int


def limit(samples: Mapping[int, np.ndarray]) -> Limit | None:
    """Return the limit of the mean of samples, from the smallest size on from which the law fits.

    If none fits it is that of the largest three sizes; None where fewer than three sizes have a spread.

    samples : (samples,) by size.
    """
    known = {L: samples[L] for L in sorted(samples) if len(samples[L]) >= LEAST_SAMPLES}
    mean = np.array([of.mean() for of in known.values()])
    spread = np.array([of.std(ddof=1) / len(of) ** 0.5 for of in known.values()])
    if len(known) < LEAST_OF_LIMIT or (spread <= ROUND_OFF * np.abs(mean)).any():
        return None
    rng, sizes = np.random.default_rng(0), np.array(list(known))
    drawn = np.array([rng.choice(of, (RESAMPLES, len(of))).mean(axis=1) for of in known.values()]) - mean[:, None]
    again = mean[:, None] + drawn * _unbiased(known)[:, None]
    parts = [slice(first, None) for first in range(len(sizes) - LEAST_OF_LIMIT + 1)]
    fits = [line_through(sizes[part] ** -STATED, spread[part], mean[part]) for part in parts]
    chosen = first_that_fits([goodness for _, goodness in fits])
    part, ((value, amplitude), goodness) = parts[chosen], fits[chosen]
    error = line_through(sizes[part] ** -STATED, spread[part], again[part])[0][0].std(ddof=1)
    beside = [line_through(sizes[part] ** -w, spread[part], mean[part]) for w in OTHERS]
    others = [abs(found[0] - value) for found, fit in beside if fit >= LEAST_GOODNESS]
    by_smallest = {int(L): float(found[0]) for L, (found, _) in zip(sizes, fits, strict=False)}
    beyond, smallest = float(max([_changed([found[0] for found, _ in fits], chosen), *others])), int(sizes[chosen])
    return Limit(
        float(value), float(error), beyond, smallest, by_smallest, goodness, float(amplitude), len(sizes[part])
    )


@dataclass(frozen=True)
class Collapse(Fitted):
    """The exponent a at which curves against n / L^a lie closest together, from the smallest size on from which they
    do.

    misfit : chi^2 a degree of freedom. fits : value, error and misfit for each smallest size.
    """

    misfit: float


def collapse(curves: Mapping[int, Mapping[int, np.ndarray]]) -> Collapse:
    """Return the collapse of the means of samples, as functions of log n, cubic between its points.

    curves : for each L and each n, (samples,).
    """
    rng, sizes = np.random.default_rng(0), sorted(curves)

    def best(sizes: Sequence[int], drawn: Callable[[np.ndarray], np.ndarray] = np.asarray) -> tuple[float, float]:
        """Return the exponent at which curves lie closest together, and their misfit. drawn : resamples the samples
        of a point.
        """
        means = {L: np.array([drawn(v).mean() for v in curves[L].values()]) for L in sizes}
        courses = {L: CubicSpline(np.log(list(curves[L])), means[L]) for L in sizes}
        misfits = [_apart(courses, means, errors, a) for a in trials]
        return float(trials[np.argmin(misfits)]), min(misfits)

    def fitted(sizes: Sequence[int]) -> tuple[float, float, float]:
        """Return the exponent for these sizes, its error from resampling, and the misfit."""
        value, misfit = best(sizes)
        again = [best(sizes, lambda v: rng.choice(v, len(v)))[0] for _ in range(COLLAPSES)]
        return value, float(np.std(again, ddof=1)), misfit

    trials = np.linspace(*EXPONENTS, TRIALS)
    errors = {L: np.array([v.std(ddof=1) / len(v) ** 0.5 for v in of.values()]) for L, of in curves.items()}
    fits = {sizes[k]: fitted(sizes[k:]) for k in range(max(1, len(sizes) - LEAST_CURVES + 1))}
    found = list(fits.values())
    chosen = next((number for number, fit in enumerate(found) if fit[2] <= MOST_MISFIT), len(found) - 1)
    value, error, misfit = found[chosen]
    beyond = _changed([fit[0] for fit in found], chosen)
    return Collapse(value, error, beyond, sizes[chosen], fits, misfit)


def _apart(
    courses: Mapping[int, CubicSpline], means: Mapping[int, np.ndarray], errors: Mapping[int, np.ndarray], a: float
) -> float:
    """Return the mean square distance, in errors, of each point of a curve from every other curve.

    Points beyond the ends of the other curve are left out. courses : of log n. a : exponent that shifts them.
    """
    total, count = 0.0, 0
    for L, M in permutations(courses, 2):
        known = courses[M].x
        x = courses[L].x - a * np.log(L / M)
        inside = (x >= known[0]) & (x <= known[-1])
        error = np.hypot(errors[L][inside], np.interp(x[inside], known, errors[M]))
        total += float((((means[L][inside] - courses[M](x[inside])) / error) ** 2).sum())
        count += int(inside.sum())
    return total / count if count else np.inf


def skewness(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Return the skewness with its standard error, from the disorder."""
    found = np.asarray(values, dtype=float)
    rng = np.random.default_rng(0)
    several = [skew(rng.choice(found, len(found))) for _ in range(RESAMPLES)]
    return float(skew(found)), float(np.std(several, ddof=1))


def growing_skewness(samples: Mapping[int, np.ndarray], theta: float) -> Law:
    """Return the skewness s of the part of a weight that grows with the size, from the smallest size on from which it
    fits.

    The variance is A L^(2 theta) + B, the third cumulant s A^(3/2) L^(3 theta) + C; B and C are what single contacts
    add.
    """
    rng, sizes = np.random.default_rng(0), np.array(sorted(samples))
    growth = sizes[:, None] ** (theta * np.array([2, 3]))
    found = np.array([_cumulants(samples[L]) for L in sizes])
    again = np.array([[_cumulants(rng.choice(samples[L], len(samples[L]))) for _ in range(RESAMPLES)] for L in sizes])
    spread = again.std(axis=1, ddof=1)

    def fitted(first: int, values: np.ndarray) -> tuple[Any, float, float]:
        """Return skewness, probability of a misfit as large, and A, for cumulants (sizes, ..., 2)."""
        lines = [line_through(growth[first:, k], spread[first:, k], values[first:, ..., k]) for k in range(2)]
        (variance, third), goodness = (line[0][1] for line in lines), min(line[1] for line in lines)
        return third / variance**1.5, goodness, variance

    fits = [fitted(first, found) for first in range(max(1, len(sizes) - LEAST_FREE - 1))]
    chosen = first_that_fits([fit[1] for fit in fits])
    value, goodness, amplitude = fits[chosen]
    error = float(fitted(chosen, again)[0].std(ddof=1))
    beyond = _changed([fit[0] for fit in fits], chosen)
    by_smallest = {int(L): float(fit[0]) for L, fit in zip(sizes, fits, strict=False)}
    return Law(float(value), error, beyond, int(sizes[chosen]), by_smallest, goodness, float(amplitude))


def _cumulants(values: np.ndarray) -> tuple[float, float]:
    """Return the second and the third cumulant."""
    apart = values - values.mean()
    return float((apart**2).mean()), float((apart**3).mean())


def skewness_of_least(values: np.ndarray, several: int) -> tuple[float, float]:
    """Return the skewness of the least of `several` independently drawn values, with its standard error from the
    disorder.
    """
    count, rng = len(values), np.random.default_rng(0)
    share = -np.diff((np.arange(count, -1, -1) / count) ** several)  # of the least, in the order of the values

    def of(drawn: np.ndarray) -> float:
        apart = np.sort(drawn)
        apart -= share @ apart
        return float(share @ apart**3 / (share @ apart**2) ** 1.5)

    again = [of(rng.choice(values, count)) for _ in range(RESAMPLES)]
    return of(np.array(values)), float(np.std(again, ddof=1))
