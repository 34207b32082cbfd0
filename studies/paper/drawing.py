"""Draws what the figures of several studies share: means and deviations of samples against their size, and fitted
laws.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np


def draw_deviations(axes: Any, found: Mapping[int, np.ndarray], **look: Any) -> None:
    """Draw standard deviations of samples with their errors against the size. look : arguments of errorbar."""
    pairs = [(of.std(), of.std() / (2 * len(of)) ** 0.5) for of in found.values()]
    axes.errorbar(list(found), *zip(*pairs, strict=True), **{"fmt": "o", "ms": 3, "lw": 0.8, **look})


def draw_growth(axes: Any, found: Mapping[int, np.ndarray], fit: Any, color: str, text: str) -> None:
    """Draw the fitted growth of the deviations of samples with the size. fit : an Exponent. text : for the legend."""
    sizes = np.array([L for L in found if fit.smallest <= L])
    law = np.sqrt(np.maximum(fit.amplitude * sizes ** (2 * fit.value) + fit.offset, 0.0))
    axes.plot(sizes, law, color=color, lw=1, label=text)


def mean_and_error(values: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of each array and its standard error, 0 for a single sample."""
    pairs = [(of.mean(), of.std(ddof=1) / np.sqrt(len(of)) if len(of) > 1 else 0.0) for of in values]
    mean, error = np.array(pairs).reshape(-1, 2).T
    return mean, error


def draw_means(axes: Any, found: Mapping[Any, np.ndarray], x: Any = None, **look: Any) -> None:
    """Draw means of samples with their errors against their keys, or against x. look : arguments of errorbar."""
    at = np.array(list(found)) if x is None else x
    axes.errorbar(at, *mean_and_error(found.values()), **{"fmt": "o-", "ms": 3, "lw": 0.8, **look})


def draw_row(axes: Any, row: float, values: np.ndarray, color: str) -> None:
    """Draw samples as dots side by side in a row, and their mean as a bar across; not-a-number is left out."""
    if np.isfinite(values).any():
        axes.plot(values, row + np.linspace(-0.22, 0.22, len(values)), ".", color=color, ms=4, alpha=0.4, mew=0)
        axes.plot([np.nanmean(values)] * 2, [row - 0.32, row + 0.32], color=color, lw=1.6)


def name_sizes(axes: Any, sizes: Sequence[int] | np.ndarray, label: str) -> None:
    """Make the x axis one of sizes: logarithmic, each named by its number."""
    axes.set(xscale="log", xlabel=label)
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.minorticks_off()
