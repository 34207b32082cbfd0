"""Minima of samples whose friction coefficients are drawn from other distributions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, in_our_style, new_figure


@dataclass(frozen=True)
class Case:
    """power_over_cut, slipless, decades : one entry a sample. spans : lower end, share and upper end of those that join
    bottom and top. proven : are the contact states, so that the last three are facts of the sample?"""

    power_over_cut: np.ndarray
    spans: tuple[float, float, float]
    slipless: np.ndarray
    decades: np.ndarray
    proven: bool


@in_our_style
def draw_distributions(cases: Mapping[str, Case]) -> Figure:
    """P_min / P_cut, samples that span, slipless contacts and decades of power, a row a distribution."""
    figure = new_figure(7.1, 2.5)
    panels: Any = figure.subplots(1, 4, sharey=True)
    rows = range(len(cases), 0, -1)
    for row, case in zip(rows, cases.values(), strict=True):
        colour = BLUE if case.proven else GREY
        numbers = (case.power_over_cut, None, case.slipless, case.decades)
        for axes, values in zip(panels, numbers, strict=True):
            if values is not None and np.isfinite(values).any():
                place = row + np.linspace(-0.22, 0.22, len(values))
                axes.plot(values, place, ".", color=colour, ms=4, alpha=0.5, mew=0)
                axes.plot([np.nanmean(values)] * 2, [row - 0.32, row + 0.32], color=colour, lw=1.6)
        low, share, high = case.spans
        panels[1].errorbar(share, row, xerr=[[share - low], [high - share]], fmt="o", color=colour, ms=4, capsize=2)
    panels[0].set_yticks(rows, list(cases))
    panels[0].set_xlabel(r"$P_\mathrm{min} / P_\mathrm{cut}$")
    panels[1].set(xlabel="samples that span", xlim=(-0.04, 1.04))
    panels[2].set_xlabel("slipless contacts")
    panels[3].set_xlabel("decades of power")
    figure.suptitle("blue: contact states proven; grey: minima tie")
    return figure
