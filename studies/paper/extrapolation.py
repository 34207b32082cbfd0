"""Limits of large samples with their errors: a stated law of the size, fitted from each smallest size on and resampled
over the disorder."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

RESAMPLES = 400
STATED = 1.0  # w: a surface over its volume
OTHERS = (0.5, 2.0)  # w that it might be; they count where they fit as well
LEAST_SIZES, LEAST_SAMPLES = 3, 3  # that a fit takes, and that a size needs
ROUND_OFF = 1e-12  # of the mean, which a spread exceeds
FITS = 0.05  # probability of a misfit as large, from which on a law counts as followed


@dataclass(frozen=True)
class Limit:
    """Of a mean: q(L) = value + amplitude L^-w, w = STATED.

    error : from the disorder. systematic : how much the value changes, at most, where the next size or the next two are
    left out too, or the last one that is left out is not, or with w of OTHERS. smallest, sizes : from which size on it
    is fitted, and to how many. goodness : probability of such a misfit. fits : smallest size -> value.
    """

    value: float
    error: float
    systematic: float
    smallest: int
    sizes: int
    goodness: float
    amplitude: float
    fits: dict[int, float]

    @property
    def total(self) -> float:
        return float(np.hypot(self.error, self.systematic))

    @property
    def follows(self) -> bool:
        """False where no three sizes follow the law: then the value is none."""
        return self.goodness >= FITS


def limit(samples: Mapping[int, np.ndarray]) -> Limit | None:
    """Of the mean of samples, size -> (samples,), from the smallest size on from which the law fits, or of the largest
    three sizes. None where there are not three with a spread."""
    known = {L: samples[L] for L in sorted(samples) if len(samples[L]) >= LEAST_SAMPLES}
    mean = np.array([of.mean() for of in known.values()])
    spread = np.array([of.std(ddof=1) / len(of) ** 0.5 for of in known.values()])
    if len(known) < LEAST_SIZES or (spread <= ROUND_OFF * np.abs(mean)).any():
        return None
    rng, sizes = np.random.default_rng(0), np.array(list(known))
    drawn = np.array([rng.choice(of, (RESAMPLES, len(of))).mean(axis=1) for of in known.values()]) - mean[:, None]
    unbiased = np.array([(len(of) / (len(of) - 1)) ** 0.5 for of in known.values()])
    again = mean[:, None] + drawn * unbiased[:, None]
    parts = [slice(first, None) for first in range(len(sizes) - LEAST_SIZES + 1)]
    fits = [_fitted(sizes[part], spread[part], mean[part], STATED) for part in parts]
    chosen = next((number for number, (_, goodness) in enumerate(fits) if goodness >= FITS), len(fits) - 1)
    part, ((value, amplitude), goodness) = parts[chosen], fits[chosen]
    error = _fitted(sizes[part], spread[part], again[part], STATED)[0][0].std(ddof=1)
    beside = [_fitted(sizes[part], spread[part], mean[part], w) for w in OTHERS]
    values = [found[0] for found, _ in fits[max(chosen - 1, 0) : chosen + 3]]
    values += [found[0] for found, fit in beside if fit >= FITS]
    return Limit(
        float(value), float(error), float(np.abs(np.array(values) - value).max()), int(sizes[chosen]),
        len(sizes[part]), goodness, float(amplitude),
        {int(L): float(found[0]) for L, (found, _) in zip(sizes, fits, strict=False)},
    )  # fmt: skip


def _fitted(sizes: np.ndarray, spread: np.ndarray, mean: np.ndarray, w: float) -> tuple[np.ndarray, float]:
    """q_inf and a of least squares, (2, ...), for means (sizes, ...); and the probability of a misfit as large, all
    together."""
    rows = np.stack([np.ones(len(sizes)), sizes**-w], axis=1) / spread[:, None]
    weighed = (mean.T / spread).T
    found = np.linalg.lstsq(rows, weighed, rcond=None)[0]
    return found, float(chi2.sf(((rows @ found - weighed) ** 2).sum(), weighed.size - found.size))
