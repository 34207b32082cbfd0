"""The distribution of dissipated power over the contacts."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.histogram import ENERGY_PER_TIME, PowerHistogram
from taichi_bearings.plots import style
from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.plots.style import BLUE, in_our_style, new_figure
from taichi_bearings.plots.symbols import as_text, over

POWER_SYMBOL = "P_{ij}"
MATHEMATICS = {
    "F_n R omega_T": r"F_n R\,\omega_T",
    "the mean power of a contact of the sample": r"\langle P_{ij} \rangle",
}


@in_our_style
def draw_histogram(histogram: PowerHistogram, page: Page = PAGE) -> Figure:
    """Number of slipping contacts against their power, logarithmic, with standard errors; no empty bins."""
    figure = style.plain_figure(height=2.2)
    axes = figure.add_subplot()
    axes.set(xscale="log", yscale="log", xlabel=_label(histogram), ylabel="slipping contacts per bin")
    style.label_in_plain_text(axes.xaxis, axes.yaxis)
    filled = histogram.count > 0
    if filled.any():
        centre, count, error = _centre(histogram)[filled], histogram.count[filled], histogram.standard_error[filled]
        low, width = histogram.edges[:-1][filled], np.diff(histogram.edges)[filled]
        axes.bar(low, count, width, align="edge", color=BLUE, alpha=0.25, linewidth=0)
        axes.errorbar(centre, count, error, fmt="o", ms=2.5, color=BLUE, elinewidth=0.8)
        axes.set_ylim(0.5, 2 * histogram.count.max())
    else:
        axes.text(0.5, 0.5, "no contact slips", transform=axes.transAxes, ha="center")
    whose = f" in {histogram.census}\n" if histogram.census.asked > 1 else " "
    threshold = f"; threshold {histogram.slip_threshold:.1e}" if histogram.slip_threshold > 0 else ""
    outside = f"({_outside(histogram)}{threshold})"
    style.put_title(figure, f"{histogram.slipping:,} slipping contacts{whose}{outside}", page)
    return figure


@in_our_style
def draw_overlay(histograms: Mapping[Any, PowerHistogram], by: str) -> Figure:
    """Share of the slipping contacts per decade of their power, with bands of a standard error up and down."""
    rows = -(-len(histograms) // (1 if len(histograms) < 9 else 2))
    figure = new_figure(style.DOUBLE if len(histograms) > 8 else 5.0, 3.0 + 0.15 * rows)
    axes = figure.add_subplot()
    first = next(iter(histograms.values()))
    axes.set(xscale="log", yscale="log", xlabel=_label(first), ylabel="share of slipping contacts a decade")
    for (value, found), colour in zip(histograms.items(), style.shades(len(histograms)), strict=True):
        empty, centre, error = found.count == 0, _centre(found), found.density_error
        density = np.where(empty, np.nan, found.density)  # no line leads over empty bins
        label = f"{as_text(value)}: {found.slipping:,} slipping, {_outside(found)}; {found.census}"
        axes.plot(centre, density, "o-", ms=2.5, lw=1.2, color=colour, label=label)
        low = np.maximum(density - error, 0.1 * density)  # a band that reaches zero has no end on this scale
        axes.fill_between(centre, low, density + error, color=colour, alpha=0.2, linewidth=0)
    figure.legend(title=as_text(by), loc="outside lower center", ncols=1 if len(histograms) < 9 else 2)
    return figure


def _centre(histogram: PowerHistogram) -> np.ndarray:
    return np.sqrt(histogram.edges[:-1] * histogram.edges[1:])


def _label(histogram: PowerHistogram) -> str:
    if histogram.units == ENERGY_PER_TIME:
        return f"power of a contact, ${POWER_SYMBOL}$ (energy / time)"
    return "power of a contact, " + over(POWER_SYMBOL, MATHEMATICS[histogram.units], "")


def _outside(histogram: PowerHistogram) -> str:
    return f"{histogram.slipless:,} slipless" + (f", {histogram.undecided:,} undecided" if histogram.undecided else "")
