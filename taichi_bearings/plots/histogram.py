"""The distribution of dissipated power over the contacts."""

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.histogram import PowerHistogram
from taichi_bearings.plots.style import BLUE, new_figure


def draw_histogram(histogram: PowerHistogram) -> Figure:
    """Number of slipping contacts against their power, both logarithmic; empty bins are left out."""
    figure = new_figure()
    axes = figure.add_subplot()
    axes.set(xscale="log", yscale="log", xlabel="power of a contact, $P_e$", ylabel="slipping contacts per bin")
    filled = histogram.count > 0
    if filled.any():
        centre = np.sqrt(histogram.edges[:-1] * histogram.edges[1:])
        axes.bar(
            histogram.edges[:-1][filled],
            histogram.count[filled],
            np.diff(histogram.edges)[filled],
            align="edge",
            color=BLUE,
            alpha=0.25,
            linewidth=0,
        )
        axes.plot(centre[filled], histogram.count[filled], "o", ms=3.5, color=BLUE)
        axes.set_ylim(0.5, 2 * histogram.count.max())
    else:
        axes.text(0.5, 0.5, "no contact slips", transform=axes.transAxes, ha="center")
    left_out = f"{histogram.slipless:,} slipless" + (
        f", {histogram.undecided:,} undecided" if histogram.undecided else ""
    )
    axes.set_title(
        f"{histogram.slipping:,} slipping contacts ({left_out}; threshold {histogram.slip_threshold:.1e})", fontsize=9
    )
    return figure
