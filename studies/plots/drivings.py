"""What the axis of the imposed spins, and their rate C, make of the slipless network and of the least power."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, in_our_style, new_figure


@in_our_style
def draw_drivings(
    angle: np.ndarray, kept: np.ndarray, ratio: np.ndarray, rate: np.ndarray, kept_at: np.ndarray
) -> Figure:
    """(a) share of the slipless contacts that two axes have in common, (b) P_min / P_cut; both against the angle, and
    (c) that share with and without C, against C: dots are samples, the line is their mean.

    angle : (D,) of the axis with x, degrees, rising. kept, ratio : (D, S), an entry a sample. rate : (C,), rising, over
    A_x over the lattice spacing. kept_at : (C, S).
    """
    figure = new_figure(7.1, 2.5)
    panels: Any = figure.subplots(1, 3)
    for axes, x, values in zip(panels, (angle, angle, rate), (kept, ratio, kept_at), strict=True):
        axes.plot(x, values, ".", color=BLUE, ms=4, alpha=0.35, mew=0)
        axes.plot(x, values.mean(axis=1), "o-", color=BLUE, ms=4, lw=1.2)
        axes.axhline(1.0, color=GREY, lw=0.8)
    for axes in panels[:2]:
        axes.set(xlabel="axis of the spins, degrees from x", xticks=range(0, 91, 30))
    panels[2].set(xlabel=r"$2 R C / A_x$", xscale="log", ylabel="slipless in both / in either")
    panels[2].set_title("(c) network beside that at C = 0")
    panels[0].set_ylabel("slipless in both / in either")
    panels[0].set_title("(a) network beside that at 45°")
    panels[1].set_ylabel(r"$P_\mathrm{min} / P_\mathrm{cut}$")
    panels[1].set_title("(b) least power")
    return figure
