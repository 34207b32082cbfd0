"""What odd contacts make of a bearing of discs: how many discs still roll, and what rules it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, in_our_style, new_figure

from .sizes import mean_and_error


@in_our_style
def draw_odd_loops(
    rolling: Mapping[int, Mapping[int, np.ndarray]], ruled: Any, resting: Mapping[float, np.ndarray]
) -> Figure:
    """(a) share of the discs that roll with the top against the number n of odd contacts, (b) against n / L^a, with the
    exponent a at which the sizes lie closest together; (c) share of the discs that rest, against the bottom's speed.

    rolling : L -> n -> (samples,). ruled : Collapse. resting : omega_B / omega_T -> (samples,), with as many odd
    contacts as are drawn in (a) at most.
    """
    figure = new_figure(7.1, 2.5)
    panels: Any = figure.subplots(1, 3)
    colors = colormaps["viridis"](np.linspace(0.0, 0.85, len(rolling)))
    for (L, of), color in zip(rolling.items(), colors, strict=True):
        n = np.array([odd for odd in of if odd])
        mean, error = mean_and_error([of[odd] for odd in n])
        panels[0].axhline(of[0].mean(), color=color, lw=0.6, ls=":")
        for axes, x in ((panels[0], n), (panels[1], n / L**ruled.value)):
            axes.errorbar(x, mean, error, fmt="o-", ms=3, lw=0.8, color=color, label=f"L = {L}")
    panels[0].set(xscale="log", xlabel="odd contacts n", ylabel="share of discs that roll", ylim=(0, 0.85))
    panels[0].set_xticks(n, [str(number) for number in n])
    panels[0].minorticks_off()
    panels[0].set_title("(a) dotted: no odd contact")
    panels[0].legend(loc="upper right", ncols=2)
    panels[1].set(xscale="log", xlabel=f"$n / L^{{{ruled.value:.2f}}}$", ylim=(0, None))
    panels[1].set_title("(b) the sizes together")
    bottoms = np.array(list(resting))
    panels[2].plot(bottoms, [values.mean() for values in resting.values()], "o-", color=BLUE, ms=3)
    panels[2].axhline(1.0, color=GREY, lw=0.8)
    panels[2].set(xlabel=r"$\omega_B / \omega_T$", ylabel="share of discs that rest", ylim=(0, 1.05))
    panels[2].set_title("(c) most odd contacts")
    return figure
