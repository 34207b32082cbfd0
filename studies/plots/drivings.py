"""What the axis of the imposed spins makes of the slipless network and of the least power."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, in_our_style, new_figure


@in_our_style
def draw_drivings(angle: np.ndarray, kept: np.ndarray, ratio: np.ndarray) -> Figure:
    """(a) share of the slipless contacts that two axes have in common, (b) P_min / P_cut; both
    against the angle: dots are samples, the line is their mean.

    angle : (D,) of the axis with x, degrees, rising. kept, ratio : (D, S), an entry a sample.
    """
    figure = new_figure(7.1, 2.7)
    panels: Any = figure.subplots(1, 2)
    for axes, values in zip(panels, (kept, ratio), strict=True):
        axes.plot(angle, values, ".", color=BLUE, ms=4, alpha=0.35, mew=0)
        axes.plot(angle, values.mean(axis=1), "o-", color=BLUE, ms=4, lw=1.2)
        axes.axhline(1.0, color=GREY, lw=0.8)
        axes.set(xlabel="axis of the spins, degrees from x", xticks=range(0, 91, 15))
    panels[0].set_ylabel("slipless in both / in either")
    panels[0].set_title("(a) network beside that at 45°")
    panels[1].set_ylabel(r"$P_\mathrm{min} / P_\mathrm{cut}$")
    panels[1].set_title("(b) least power")
    return figure
