"""What the axis of the imposed spins, and their rate C, make of the slipless network and of the least power."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, in_our_style, new_figure


@in_our_style
def draw_drivings(axes_of: Sequence[Any], rates: Mapping[float, Any]) -> Figure:
    """(a) share of the slipless contacts that two axes have in common, (b) P_min / P_cut; both against the angle, and
    (c) that share with and without C, against C: dots are samples, the line is their mean.

    axes_of : the samples of paper.drivings for each axis, by its angle with x. rates : by C, over A_x over the lattice
    spacing, rising.
    """
    figure = new_figure(7.1, 2.5)
    panels: Any = figure.subplots(1, 3)
    angle = [table.angle[0] for table in axes_of]
    for axes, x, tables, column in (
        (panels[0], angle, axes_of, "overlap"),
        (panels[1], angle, axes_of, "power_over_cut"),
        (panels[2], list(rates), list(rates.values()), "overlap"),
    ):
        values = np.array([getattr(table, column) for table in tables])
        axes.plot(x, values, ".", color=BLUE, ms=4, alpha=0.35, mew=0)
        axes.plot(x, values.mean(axis=1), "o-", color=BLUE, ms=4, lw=1.2)
        axes.axhline(1.0, color=GREY, lw=0.8)
        axes.set(xlabel="axis of the spins, degrees from x", ylabel="slipless in both / in either")
    for axes in panels[:2]:
        axes.set_xticks(range(0, 91, 30))
    panels[1].set_ylabel(r"$P_\mathrm{min} / P_\mathrm{cut}$")
    panels[2].set(xlabel=r"$2 R C / A_x$", xscale="log")
    panels[0].set_title("(a) network beside that at 45°")
    panels[1].set_title("(b) least power")
    panels[2].set_title("(c) network beside that at C = 0")
    return figure
