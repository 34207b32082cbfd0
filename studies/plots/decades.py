"""The power of single contacts over many decades: where descents end, and at the certified minimum."""

from collections.abc import Sequence
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
def draw_decades(minimum: Any, descents: Sequence[Any], bins_per_decade: int) -> Figure:
    """(a) histograms of the minimum and of the descents; (b) the longest descent, and which of its contacts rest at the
    minimum; (c) power by power, of those that slip.

    minimum, descents : Ending of paper.supplement, of the same contacts; shortest descent first.
    """
    figure = new_figure(7.1, 2.6)
    panels: Any = figure.subplots(1, 3)
    slips, longest = minimum.slips, descents[-1].power
    powers = [minimum.power[slips], *(descent.power for descent in descents)]
    low = min(float(values[values > 0].min()) for values in powers)
    high = max(float(values.max()) for values in powers)
    first, last = np.floor(np.log10(low) * bins_per_decade), np.ceil(np.log10(high) * bins_per_decade)
    edges = 10.0 ** (np.arange(first, last + 1) / bins_per_decade)
    panels[0].hist(powers[0], edges, color=BLUE, alpha=0.3, label="minimum, certified")
    for descent, colour in zip(descents, reversed(shades(len(descents))), strict=True):
        label = f"descent, {descent.iterations:,}"
        panels[0].hist(descent.power, edges, histtype="step", color=colour, lw=1.0, label=label)
    panels[0].set_title("(a) all histograms")
    for values, colour, label in ((longest[slips], BLUE, "slip"), (longest[~slips], ORANGE, "rest")):
        label = f"{len(values):,} {label} at min."
        panels[1].hist(values, edges, histtype="stepfilled", color=colour, alpha=0.35, label=label)
        panels[1].hist(values, edges, histtype="step", color=colour, lw=1.0)
    panels[1].set_title("(b) longest descent")
    for axes in panels[:2]:
        axes.set(xscale="log", yscale="log", xlabel=POWER, ylabel=COUNT)
        axes.set_ylim(0.5, 300 * axes.dataLim.ymax)  # room for the legend
        axes.legend(loc="upper left", fontsize="small")
    panels[2].plot(longest[slips], powers[0], ".", color=BLUE, ms=1.2, alpha=0.25, mew=0, rasterized=True)
    ends = [powers[0].min(), max(powers[0].max(), longest.max())]
    panels[2].plot(ends, ends, color=GREY, lw=0.8)
    panels[2].set(xscale="log", yscale="log", xlabel=POWER, ylabel="the same at the minimum")
    panels[2].set_title("(c) those that slip")
    for axes in panels:
        label_in_plain_text(axes.xaxis, axes.yaxis)
    return figure
