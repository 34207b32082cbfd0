"""Fits laws of the size to samples of several sizes: exponents, and limits of infinitely large samples, with their
errors.

Samples are given as arrays of numbers by size. Each law is fitted to all sizes, then without the smallest one, and so
on; the first fit that is good enough is taken. Errors come from resampling: drawing the samples of each size again with
replacement.

Letters: L size, R resamples, T trial exponents. A misfit is the sum of squares of deviations over errors, chi^2; the
goodness is the probability of a misfit as large if the law holds.
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
EXPONENTS, TRIALS, COLLAPSES = (-0.5, 2.5), 151, 50  # of a collapse: range of a, trials in it, number of resamples
MOST_MISFIT = 1.5  # curves fall onto one if chi^2 for each degree of freedom is no larger
LEAST_FREE, LEAST_CURVES = 2, 3  # least degrees of freedom of a fit, and curves of a collapse
POSSIBLE = {True: (0.05, 1.5), False: (-1.0, 1.5)}  # range of exponents of deviations, with a constant and without
FINELY = 500  # number of trial exponents in the range POSSIBLE
VARIANCE = partial(np.var, ddof=1)  # unbiased
LEAST_GOODNESS = 0.05  # a fit is good enough if a misfit as large has at least this probability
STATED = 1.0  # exponent w of a limit: the surface of a sample is a share L^-1 of it
OTHERS = (0.5, 2.0)  # other w; where they fit as well, the change of the limit is a systematic error
LEAST_OF_LIMIT, LEAST_SAMPLES = 3, 3  # least sizes of the fit of a limit, and samples of a size
ROUND_OFF = 1e-12  # a spread that is a smaller share of the mean is rounding


@dataclass(frozen=True)
class Fitted:
    """A number fitted to the sizes from `smallest` on, with its errors.

    value : the number.
    error : standard error, from the scatter of the samples.
    systematic : largest change of the value if the fit begins one size lower, or one or two sizes higher.
    smallest : smallest size of the fit.
    fits : results of all fits that were tried, by their smallest size.
    """

    value: float
    error: float
    systematic: float
    smallest: int
    fits: dict[int, Any]

    @property
    def total(self) -> float:
        """Root of the sum of the squares of both errors."""
        return float(np.hypot(self.error, self.systematic))

    @property
    def numbers(self) -> dict[str, Any]:
        """The attributes by name, as reports keep them; `fits` becomes a list, from the smallest size on."""
        return vars(self) | {"total": self.total, "fits": list(self.fits.values())}


@dataclass(frozen=True)
class Law(Fitted):
    """A fitted law in which a power of the size appears.

    goodness : probability of a misfit as large as this or larger if the law holds.
    amplitude : the factor of the power of the size.
    """

    goodness: float
    amplitude: float

    @property
    def follows(self) -> bool:
        """True if the sizes from `smallest` on follow the law; otherwise the value means nothing."""
        return self.goodness >= LEAST_GOODNESS


@dataclass(frozen=True)
class Exponent(Law):
    """The growth of a standard deviation with the size L: sd^2 = amplitude L^(2 value) + offset + further terms.

    offset : what single contacts add, whatever the size.
    errors : standard error of the value in each of the fits that were tried. If one is as large as the systematic
        error, that error is scatter, too.
    """

    offset: float
    errors: list[float]


def first_that_fits(goodness: Sequence[float]) -> int:
    """Return the index of the first fit whose goodness is at least LEAST_GOODNESS, or of the last one."""
    return next((number for number, one in enumerate(goodness) if one >= LEAST_GOODNESS), len(goodness) - 1)


def _largest_change(values: Sequence[float], chosen: int) -> float:
    """Return the largest difference of the chosen value from those of its neighbours: the fit with one size more, and
    those with one or two sizes less.

    values : values of all fits, from that with most sizes on.
    chosen : index of the fit that was taken.
    """
    return float(max(abs(value - values[chosen]) for value in values[max(chosen - 1, 0) : chosen + 3]))


def line_through(x: np.ndarray, spread: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the straight lines of least squares through points with errors, and the goodness of all lines together. A
    line is given by its value at 0 and its slope, (2, ...). The goodness is the probability that random errors alone
    give a worse fit (chi-squared).

    x : (sizes,), abscissae.
    spread : (sizes,), standard errors of y.
    y : (sizes, ...), ordinates; there is a line for each of the further indices.
    """
    rows = np.stack([np.ones(len(x)), x], axis=1) / spread[:, None]
    weighed = (y.T / spread).T
    found = np.linalg.lstsq(rows, weighed, rcond=None)[0]
    return found, float(chi2.sf(((rows @ found - weighed) ** 2).sum(), max(1, weighed.size - found.size)))


def exponent(
    samples: Mapping[int, np.ndarray], square: Callable[[np.ndarray], Any] = VARIANCE, further: Sequence[float] = (0.0,)
) -> Exponent:
    """Return the exponent with which the standard deviation of samples (or another quantity) grows with the size.

    samples : for each size, (samples, ...).
    square : function that returns, from the samples of one size, the quantity that grows like A L^(2 value); by default
        the variance.
    further : exponents of L in further terms that are fitted as well, first that of a constant offset, 0.
    """
    rng, sizes = np.random.default_rng(0), np.array(sorted(samples))
    # the quantity that grows, of the samples and of R resamples of each size; resampling makes deviations too small
    variance = np.array([square(samples[L]) for L in sizes])
    again = np.array([[square(rng.choice(samples[L], len(samples[L]))) for _ in range(RESAMPLES)] for L in sizes])
    again = variance[:, None] + (again - variance[:, None]) * _resampling_factors(samples)[:, None]
    spread, fits = again.std(axis=1, ddof=1), []
    columns = np.concatenate([variance[:, None], again], axis=1)
    # fits to all sizes, then without the smallest one, ...: the first column gives the value, the others its error
    for first in range(max(1, len(sizes) - LEAST_FREE - 1 - len(further))):
        values, misfit = _best_exponents(sizes[first:], spread[first:], further, columns[first:])
        goodness = float(chi2.sf(misfit, max(1, len(sizes) - first - 2 - len(further))))
        fits.append((int(sizes[first]), float(values[0]), float(values[1:].std(ddof=1)), goodness))
    chosen = first_that_fits([fit[-1] for fit in fits])
    smallest, value, error, goodness = fits[chosen]
    # amplitude and offset at the exponent found, by linear least squares
    rows = _terms_over_errors(sizes[chosen:], spread[chosen:], further, np.array([value]))[0]
    amplitude, offset = np.append(np.linalg.lstsq(rows, (variance / spread)[chosen:], rcond=None)[0], 0.0)[:2]
    beyond = _largest_change([fit[1] for fit in fits], chosen)
    by_smallest, errors = {fit[0]: fit[1] for fit in fits}, [fit[2] for fit in fits]
    return Exponent(value, error, beyond, smallest, by_smallest, goodness, float(amplitude), float(offset), errors)


def _resampling_factors(samples: Mapping[int, np.ndarray]) -> np.ndarray:
    """Return factors (sizes,), from the smallest size on, by which errors from resampling are too small: sqrt(n / (n -
    1)) for n samples.
    """
    number = np.array([len(samples[L]) for L in sorted(samples)])
    found: np.ndarray = np.sqrt(number / (number - 1))
    return found


def _terms_over_errors(
    sizes: np.ndarray, spread: np.ndarray, further: Sequence[float], values: np.ndarray
) -> np.ndarray:
    """Return the matrices of linear least squares, (trials, sizes, terms), one for each trial exponent, by which the
    factors of the terms of a law are fitted. Columns: L^(2 exponent) for the sizes L, then L to the power of each
    further exponent, all divided by the error of what is fitted.

    sizes, spread : (sizes,) the sizes, and the standard error of what is fitted at each.
    further : exponents of L in the further terms.
    values : (trials,) trial exponents.
    """
    exponents = [2 * values, *(np.full_like(values, power) for power in further)]
    found: np.ndarray = sizes[:, None] ** np.stack(exponents, axis=1)[:, None] / spread[:, None]
    return found


def _best_exponents(
    sizes: np.ndarray, spread: np.ndarray, further: Sequence[float], columns: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the exponents x (series,) of the best fits of A L^(2 x) and further terms to several series of numbers,
    which grow with the size L; and the misfit (chi-squared) of the first series.

    sizes, spread : (sizes,) the sizes, and the standard error of the numbers at each.
    further : exponents of L in the further terms.
    columns : (sizes, series) the numbers.

    For each trial exponent the law is fitted linearly; the best trial exponent is then refined by the parabola through
    its misfit and those of its two neighbours.
    """
    trials = np.linspace(*POSSIBLE[bool(further)], FINELY)
    target, series = columns / spread[:, None], np.arange(columns.shape[1])
    # misfit (trials, series) of linear least squares: |target|^2 less its projection on the span of the terms
    basis = np.linalg.qr(_terms_over_errors(sizes, spread, further, trials))[0]
    misfit = (target**2).sum(axis=0) - ((basis.transpose(0, 2, 1) @ target) ** 2).sum(axis=1)
    # lowest point of the parabola through the least misfit and its neighbours
    at = np.clip(misfit.argmin(axis=0), 1, FINELY - 2)
    before, here, after = (misfit[at + step, series] for step in (-1, 0, 1))
    bend = np.maximum(before - 2 * here + after, np.finfo(float).tiny)
    shift = np.clip((before - after) / (2 * bend), -1, 1)
    return trials[at] + shift * (trials[1] - trials[0]), float(here[0] - shift[0] ** 2 * bend[0] / 2)


@dataclass(frozen=True)
class Limit(Law):
    """The limit of a mean for infinite size: the value in q(L) = value + amplitude L^-w with w = STATED.

    systematic : largest change of the value if the fit begins at other sizes, or has another exponent w (OTHERS) that
        fits as well.
    sizes : number of sizes in the fit.
    """

    sizes: int


def limit(samples: Mapping[int, np.ndarray]) -> Limit | None:
    """Return the mean of samples extrapolated to infinite size L by the law value + amplitude L^-STATED. The fit begins
    at the smallest size from which the law fits, or else takes the three largest sizes. None is returned if fewer than
    three sizes have enough samples, or a size has no scatter.

    samples : for each size, numbers (samples,).
    """
    known = {L: samples[L] for L in sorted(samples) if len(samples[L]) >= LEAST_SAMPLES}
    mean = np.array([of.mean() for of in known.values()])
    spread = np.array([of.std(ddof=1) / len(of) ** 0.5 for of in known.values()])
    if len(known) < LEAST_OF_LIMIT or (spread <= ROUND_OFF * np.abs(mean)).any():
        return None
    rng, sizes = np.random.default_rng(0), np.array(list(known))
    # Resampled means; their deviations, which resampling makes too small, are widened.
    drawn = np.array([rng.choice(of, (RESAMPLES, len(of))).mean(axis=1) for of in known.values()]) - mean[:, None]
    again = mean[:, None] + drawn * _resampling_factors(known)[:, None]
    # A straight line in L^-STATED through all sizes from the first, the second, ... on.
    parts = [slice(first, None) for first in range(len(sizes) - LEAST_OF_LIMIT + 1)]
    fits = [line_through(sizes[part] ** -STATED, spread[part], mean[part]) for part in parts]
    chosen = first_that_fits([goodness for _, goodness in fits])
    part, ((value, amplitude), goodness) = parts[chosen], fits[chosen]
    error = line_through(sizes[part] ** -STATED, spread[part], again[part])[0][0].std(ddof=1)
    # Other exponents that fit as well are a systematic error.
    alternatives = [line_through(sizes[part] ** -w, spread[part], mean[part]) for w in OTHERS]
    others = [abs(found[0] - value) for found, fit in alternatives if fit >= LEAST_GOODNESS]
    by_smallest = {int(L): float(found[0]) for L, (found, _) in zip(sizes, fits, strict=False)}
    beyond, smallest = (
        float(max([_largest_change([found[0] for found, _ in fits], chosen), *others])),
        int(sizes[chosen]),
    )
    return Limit(
        float(value), float(error), beyond, smallest, by_smallest, goodness, float(amplitude), len(sizes[part])
    )


@dataclass(frozen=True)
class Collapse(Fitted):
    """The exponent a (`value`) for which curves of several sizes L, drawn against n / L^a, lie closest together. Sizes
    below `smallest` are left out, since their curves lie apart.

    fits : by the smallest size that was used, the value, its error and the misfit.
    misfit : chi^2 for each degree of freedom: the mean square distance of points from the other curves, in units of
        their errors.
    """

    misfit: float


def collapse(curves: Mapping[int, Mapping[int, np.ndarray]]) -> Collapse:
    """Find the exponent a for which the means of samples against n / L^a fall onto one curve for all sizes L; n is a
    number of contacts. Return it with its errors and the misfit. Each curve is a cubic spline in log n.

    curves : for each size L and each n, the measured quantity of each sample, (samples,).
    """
    rng, sizes = np.random.default_rng(0), sorted(curves)

    def best(sizes: Sequence[int], drawn: Callable[[np.ndarray], np.ndarray] = np.asarray) -> tuple[float, float]:
        """Return the trial exponent with which the curves of some sizes lie closest together, and their misfit.

        sizes : the sizes, keys of `curves`.
        drawn : function that resamples the samples of a point; by default they are taken as they are.
        """
        means = {L: np.array([drawn(v).mean() for v in curves[L].values()]) for L in sizes}
        courses = {L: CubicSpline(np.log(list(curves[L])), means[L]) for L in sizes}
        misfits = [_mean_square_distance(courses, means, errors, a) for a in trials]
        return float(trials[np.argmin(misfits)]), min(misfits)

    def fitted(sizes: Sequence[int]) -> tuple[float, float, float]:
        """Return for some sizes the exponent with which their curves lie closest together, its standard error from
        resampling, and the misfit (chi-squared for each degree of freedom).
        """
        value, misfit = best(sizes)
        again = [best(sizes, lambda v: rng.choice(v, len(v)))[0] for _ in range(COLLAPSES)]
        return value, float(np.std(again, ddof=1)), misfit

    trials = np.linspace(*EXPONENTS, TRIALS)
    errors = {L: np.array([v.std(ddof=1) / len(v) ** 0.5 for v in of.values()]) for L, of in curves.items()}
    # The smallest sizes are left out one by one until the curves of the others collapse.
    fits = {sizes[k]: fitted(sizes[k:]) for k in range(max(1, len(sizes) - LEAST_CURVES + 1))}
    found = list(fits.values())
    chosen = next((number for number, fit in enumerate(found) if fit[2] <= MOST_MISFIT), len(found) - 1)
    value, error, misfit = found[chosen]
    beyond = _largest_change([fit[0] for fit in found], chosen)
    return Collapse(value, error, beyond, sizes[chosen], fits, misfit)


def _mean_square_distance(
    courses: Mapping[int, CubicSpline], means: Mapping[int, np.ndarray], errors: Mapping[int, np.ndarray], a: float
) -> float:
    """Return the mean square distance of each point of a curve from every other curve, in units of the errors;
    infinite if no curves overlap.

    courses : for each size the mean as a spline in log n.
    means, errors : for each size the means (points,) and their standard errors.
    a : trial exponent: against log(n / L^a) the curve of size L is shifted by -a log L.
    """
    total, count = 0.0, 0
    for L, M in permutations(courses, 2):  # points of the curve L, compared with the curve M
        known = courses[M].x
        x = courses[L].x - a * np.log(L / M)
        inside = (x >= known[0]) & (x <= known[-1])
        error = np.hypot(errors[L][inside], np.interp(x[inside], known, errors[M]))
        total += float((((means[L][inside] - courses[M](x[inside])) / error) ** 2).sum())
        count += int(inside.sum())
    return total / count if count else np.inf


def skewness(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Return the skewness of some values (samples,), and its standard error from resampling."""
    found = np.asarray(values, dtype=float)
    rng = np.random.default_rng(0)
    several = [skew(rng.choice(found, len(found))) for _ in range(RESAMPLES)]
    return float(skew(found)), float(np.std(several, ddof=1))


def growing_skewness(samples: Mapping[int, np.ndarray], theta: float) -> Law:
    """Return the skewness s of the part of a weight that grows with the size.

    samples : for each size L the weights (samples,).
    theta : exponent with which the standard deviation of that part grows.

    The variance is fitted by A L^(2 theta) + B and the third cumulant by s A^(3/2) L^(3 theta) + C; B and C are what
    single contacts add. In the result `amplitude` is A.
    """
    rng, sizes = np.random.default_rng(0), np.array(sorted(samples))
    growth = sizes[:, None] ** (theta * np.array([2, 3]))
    # Both cumulants are straight lines in powers of the size; their slopes give the skewness.
    found = np.array([_cumulants(samples[L]) for L in sizes])
    again = np.array([[_cumulants(rng.choice(samples[L], len(samples[L]))) for _ in range(RESAMPLES)] for L in sizes])
    spread = again.std(axis=1, ddof=1)

    def fitted(first: int, values: np.ndarray) -> tuple[Any, float, float]:
        """Return three numbers that follow from the sizes with index `first` and above: the skewness s, the goodness of
        the fit, and A. The fit is variance = A L^(2 theta) + B and third cumulant = s A^(3/2) L^(3 theta) + C.

        values : (sizes, ..., 2), variance and third cumulant of each size.
        """
        lines = [line_through(growth[first:, k], spread[first:, k], values[first:, ..., k]) for k in range(2)]
        (variance, third), goodness = (line[0][1] for line in lines), min(line[1] for line in lines)
        return third / variance**1.5, goodness, variance

    fits = [fitted(first, found) for first in range(max(1, len(sizes) - LEAST_FREE - 1))]
    chosen = first_that_fits([fit[1] for fit in fits])
    value, goodness, amplitude = fits[chosen]
    error = float(fitted(chosen, again)[0].std(ddof=1))
    beyond = _largest_change([fit[0] for fit in fits], chosen)
    by_smallest = {int(L): float(fit[0]) for L, fit in zip(sizes, fits, strict=False)}
    return Law(float(value), error, beyond, int(sizes[chosen]), by_smallest, goodness, float(amplitude))


def _cumulants(values: np.ndarray) -> tuple[float, float]:
    """Return the second and the third cumulant of some values (samples,): the mean square and the mean cube of their
    deviation from the mean.
    """
    deviation = values - values.mean()
    return float((deviation**2).mean()), float((deviation**3).mean())


def skewness_of_least(values: np.ndarray, several: int) -> tuple[float, float]:
    """Return the skewness of the least of `several` numbers, drawn independently from a distribution, and its standard
    error from resampling.

    values : (samples,) numbers drawn from the distribution.
    """
    count, rng = len(values), np.random.default_rng(0)
    # all of them lie above the k smallest values with the probability ((count - k) / count) ** several; the differences
    # are the probabilities that the least one is each value
    share = -np.diff((np.arange(count, -1, -1) / count) ** several)

    def of(drawn: np.ndarray) -> float:
        """Return the skewness of the least of several numbers that are drawn independently from these (samples,)."""
        deviation = np.sort(drawn)
        deviation -= share @ deviation
        return float(share @ deviation**3 / (share @ deviation**2) ** 1.5)

    again = [of(rng.choice(values, count)) for _ in range(RESAMPLES)]
    return of(np.array(values)), float(np.std(again, ddof=1))
