"""Limits of large samples with their errors: a stated law of the size, fitted from each smallest size on and resampled
over the disorder."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .fits import LEAST_GOODNESS, RESAMPLES, Fitted, first_that_fits, line_through

STATED = 1.0  # w: a surface over its volume
OTHERS = (0.5, 2.0)  # w that it might be; they count where they fit as well
LEAST_SIZES, LEAST_SAMPLES = 3, 3  # that a fit takes, and that a size needs
ROUND_OFF = 1e-12  # of the mean, which a spread exceeds


@dataclass(frozen=True)
class Limit(Fitted):
    """Of a mean: q(L) = value + amplitude L^-w, w = STATED.

    systematic : also where the last size that is left out is not, or with w of OTHERS. sizes : number of those fitted.
    """

    sizes: int


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
    fits = [line_through(sizes[part] ** -STATED, spread[part], mean[part]) for part in parts]
    chosen = first_that_fits([goodness for _, goodness in fits])
    part, ((value, amplitude), goodness) = parts[chosen], fits[chosen]
    error = line_through(sizes[part] ** -STATED, spread[part], again[part])[0][0].std(ddof=1)
    beside = [line_through(sizes[part] ** -w, spread[part], mean[part]) for w in OTHERS]
    values = [found[0] for found, _ in fits[max(chosen - 1, 0) : chosen + 3]]
    values += [found[0] for found, fit in beside if fit >= LEAST_GOODNESS]
    return Limit(
        float(value), float(error), float(np.abs(np.array(values) - value).max()), int(sizes[chosen]), goodness,
        float(amplitude), {int(L): float(found[0]) for L, (found, _) in zip(sizes, fits, strict=False)},
        len(sizes[part]),
    )  # fmt: skip
