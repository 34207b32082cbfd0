"""Draws what figures of several studies share: means and standard deviations of samples against their size, and fitted
laws.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np


def draw_deviations(axes: Any, found: Mapping[int, np.ndarray], **look: Any) -> None:
    """Draw the standard deviation over the samples of each size, with its standard error, against the size.

    axes : panel of matplotlib.
    found : for each size, the numbers (samples,).
    look : further arguments of matplotlib's errorbar.
    """
    pairs = [(of.std(), of.std() / (2 * len(of)) ** 0.5) for of in found.values()]  # error of normal samples
    axes.errorbar(list(found), *zip(*pairs, strict=True), **{"fmt": "o", "ms": 3, "lw": 0.8, **look})


def draw_growth(axes: Any, found: Mapping[int, np.ndarray], fit: Any, color: str, text: str) -> None:
    """Draw the fitted law sqrt(amplitude L^(2 value) + offset) of the standard deviation against the size L, over the
    sizes that the fit has used.

    axes : panel of matplotlib.
    found : for each size, the numbers (samples,); only the sizes are used.
    fit : the :class:`.fits.Exponent` that was fitted.
    color : color of the line.
    text : label in the legend.
    """
    sizes = np.array([L for L in found if fit.smallest <= L])
    law = np.sqrt(np.maximum(fit.amplitude * sizes ** (2 * fit.value) + fit.offset, 0.0))
    axes.plot(sizes, law, color=color, lw=1, label=text)


def mean_and_error(values: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays with an entry for each array (samples,) in `values`: the mean of its numbers, and the standard
    error of that mean, 0 for a single sample.
    """
    pairs = [(of.mean(), of.std(ddof=1) / np.sqrt(len(of)) if len(of) > 1 else 0.0) for of in values]
    mean, error = np.array(pairs).reshape(-1, 2).T
    return mean, error


def draw_means(axes: Any, found: Mapping[Any, np.ndarray], x: Any = None, **look: Any) -> None:
    """Draw the mean over the samples of each size or other key, with its standard error.

    axes : panel of matplotlib.
    found : for each key, the numbers (samples,).
    x : abscissae in the order of the keys; None for the keys themselves.
    look : further arguments of matplotlib's errorbar.
    """
    at = np.array(list(found)) if x is None else x
    axes.errorbar(at, *mean_and_error(found.values()), **{"fmt": "o-", "ms": 3, "lw": 0.8, **look})


def draw_row(axes: Any, row: float, values: np.ndarray, color: str) -> None:
    """Draw numbers of samples as dots in a row of the panel, and their mean as an upright bar; nothing if none is
    finite.

    axes : panel of matplotlib.
    row : height of the row.
    values : (samples,), abscissae of the dots; not-a-number has no dot.
    color : color of dots and bar.
    """
    if np.isfinite(values).any():
        axes.plot(values, row + np.linspace(-0.22, 0.22, len(values)), ".", color=color, ms=4, alpha=0.4, mew=0)
        axes.plot([np.nanmean(values)] * 2, [row - 0.32, row + 0.32], color=color, lw=1.6)


def name_sizes(axes: Any, sizes: Sequence[int] | np.ndarray, label: str) -> None:
    """Make the x axis logarithmic, with one tick for each size, labelled by that number.

    axes : panel of matplotlib.
    sizes : (sizes,), the numbers.
    label : label of the axis.
    """
    axes.set(xscale="log", xlabel=label)
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.minorticks_off()
