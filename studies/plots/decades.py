"""The power of single contacts over many decades: where descents end, and at the certified minimum."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import (
    BLUE,
    GREY,
    ORANGE,
    in_our_style,
    label_in_plain_text,
    new_figure,
    shades,
)

POWER = r"power, $P_e\,/\,(F_n R\,\omega_T)$"
COUNT = "contacts per bin"


@in_our_style
def draw_decades(
    least: np.ndarray, slips: np.ndarray, descents: Mapping[str, np.ndarray], bins_per_decade: int
) -> Figure:
    """(a) histograms of the minimum and of the descents; (b) the longest descent, and which of its contacts rest at the
    minimum; (c) power by power, of those that slip.

    least : (n,) power of each contact at the minimum. slips : (n,), whether it slips there. descents : name -> (n,)
    powers of the same contacts, shortest descent first.
    """
    figure = new_figure(7.1, 2.6)
    panels: Any = figure.subplots(1, 3)
    powers = [least[slips], *descents.values()]
    low = min(float(values[values > 0].min()) for values in powers)
    high = max(float(values.max()) for values in powers)
    first, last = np.floor(np.log10(low) * bins_per_decade), np.ceil(np.log10(high) * bins_per_decade)
    edges = 10.0 ** (np.arange(first, last + 1) / bins_per_decade)
    _draw_histograms(panels[0], least[slips], descents, edges)
    longest = list(descents.values())[-1]
    _draw_split(panels[1], longest, slips, edges)
    panels[1].set_title("(b) longest descent")
    _draw_pairs(panels[2], least, longest, slips)
    for axes in panels[:2]:
        axes.set(xscale="log", yscale="log", xlabel=POWER, ylabel=COUNT)
        axes.set_ylim(0.5, 300 * axes.dataLim.ymax)  # room for the legend
    for axes in panels:
        label_in_plain_text(axes.xaxis, axes.yaxis)
    return figure


def _draw_histograms(axes: Any, least: np.ndarray, descents: Mapping[str, np.ndarray], edges: np.ndarray) -> None:
    axes.hist(least, edges, color=BLUE, alpha=0.3, label="minimum, certified")
    for (name, values), colour in zip(descents.items(), reversed(shades(len(descents))), strict=True):
        axes.hist(values, edges, histtype="step", color=colour, lw=1.0, label=name)
    axes.set_title("(a) all histograms")
    axes.legend(loc="upper left", fontsize="small")


def _draw_split(axes: Any, longest: np.ndarray, slips: np.ndarray, edges: np.ndarray) -> None:
    parts = [longest[slips], longest[~slips]]
    for values, colour, label in zip(parts, (BLUE, ORANGE), ("slip", "rest"), strict=True):
        axes.hist(
            values, edges, histtype="stepfilled", color=colour, alpha=0.35,
            label=f"{len(values):,} {label} at min.",
        )  # fmt: skip
        axes.hist(values, edges, histtype="step", color=colour, lw=1.0)
    axes.legend(loc="upper left", fontsize="small")


def _draw_pairs(axes: Any, least: np.ndarray, longest: np.ndarray, slips: np.ndarray) -> None:
    axes.plot(longest[slips], least[slips], ".", color=BLUE, ms=1.2, alpha=0.25, mew=0, rasterized=True)
    ends = [least[slips].min(), max(least.max(), longest.max())]
    axes.plot(ends, ends, color=GREY, lw=0.8)
    axes.set(xscale="log", yscale="log", xlabel=POWER, ylabel="the same at the minimum")
    axes.set_title("(c) those that slip")
