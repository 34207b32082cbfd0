"""Minima of samples whose friction coefficients are drawn from other distributions."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, in_our_style, new_figure


@in_our_style
def draw_distributions(tables: Mapping[str, Any], spans: Mapping[str, Any]) -> Figure:
    """P_min / P_cut, samples that span, slipless contacts and decades of power, a row a distribution.

    tables, spans : the samples of paper.distributions and the shares of them that join bottom and top, by distribution.
    """
    figure = new_figure(7.1, 2.5)
    panels: Any = figure.subplots(1, 4, sharey=True)
    rows = range(len(tables), 0, -1)
    for row, (name, table) in zip(rows, tables.items(), strict=True):
        colour = BLUE if 2 * table.states_proven.sum() > len(table) else GREY
        for axes, column in zip(panels[[0, 2, 3]], ("power_over_cut", "slipless_fraction", "decades"), strict=True):
            values = getattr(table, column)
            if np.isfinite(values).any():
                place = row + np.linspace(-0.22, 0.22, len(values))
                axes.plot(values, place, ".", color=colour, ms=4, alpha=0.5, mew=0)
                axes.plot([np.nanmean(values)] * 2, [row - 0.32, row + 0.32], color=colour, lw=1.6)
        share, ends = table.spans.mean(), np.array([[spans[name].least], [spans[name].most]])
        panels[1].errorbar(share, row, xerr=np.abs(ends - share), fmt="o", color=colour, ms=4, capsize=2)
    panels[0].set_yticks(rows, list(tables))
    panels[0].set_xlabel(r"$P_\mathrm{min} / P_\mathrm{cut}$")
    panels[1].set(xlabel="samples that span", xlim=(-0.04, 1.04))
    panels[2].set_xlabel("slipless contacts")
    panels[3].set_xlabel("decades of power")
    figure.suptitle("blue: contact states proven; grey: minima tie")
    return figure
