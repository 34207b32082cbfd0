"""Questions beyond the paper: how minimum cuts fluctuate with their length, and what odd contacts make of a bearing."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, new_figure, shades

from .minima import mean_and_error


@in_our_style
def draw_exponents(
    weight: Mapping[int, np.ndarray], middle: Mapping[int, np.ndarray], theta: Any, zeta: Any, held: Any, free: Any
) -> Figure:
    """(a) standard deviations of the weight and of the height in the middle of held cuts against their length, with the
    fitted laws; (b) skewness of the weight, held ends against the length and free ends against the height.

    weight, middle : length -> (samples,). theta, zeta : Exponent. held, free : the points of paper.exponents.
    """
    figure = new_figure(7.1, 2.8)
    left, right = figure.subplots(1, 2)
    for found, fit, color, text in (
        (weight, theta, BLUE, r"weight, $\theta$"),
        (middle, zeta, ORANGE, r"middle, $\zeta$"),
    ):
        sizes = np.array(sorted(found))
        spread = np.array([found[L].std() for L in sizes])
        error = spread / np.sqrt([2 * len(found[L]) for L in sizes])
        left.errorbar(sizes, spread, error, fmt="o", ms=3, color=color, lw=0.8)
        fitted = sizes >= fit.smallest
        law = np.sqrt(np.maximum(fit.amplitude * sizes[fitted] ** (2 * fit.value) + fit.offset, 0.0))
        left.plot(sizes[fitted], law, color=color, lw=1, label=f"{text} = {fit.value:.3f} ± {fit.total:.3f}")
    left.set(xscale="log", yscale="log", xlabel="length of the cut, discs", ylabel="standard deviation")
    few = sizes[:: max(1, len(sizes) // 5)]
    left.set_xticks(few, few.astype(str))
    left.minorticks_off()
    left.set_title("(a) held ends")
    left.legend(loc="upper left")
    for table, x, color, text in (
        (held, held.length, BLUE, "held ends, against the length"),
        (free, free.height, ORANGE, f"free ends, length {free.length[0]}, against the height"),
    ):
        right.errorbar(x, table.skewness, table.its_error, fmt="o-", ms=3, lw=0.8, color=color, label=text)
    for value, text in ((-0.2241, "Tracy–Widom"), (-1.1395, "Gumbel")):
        right.axhline(value, color=GREY, lw=0.8)
        right.annotate(
            text, (1.0, value), xycoords=("axes fraction", "data"), ha="right", va="bottom", color=GREY, fontsize=7
        )
    right.set(xscale="log", xlabel="length or height, discs", ylabel="skewness of the weight")
    right.set_title("(b) distribution of the weight")
    right.set_ylim(-1.7, 0.3)
    right.legend(loc="lower left")
    return figure


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
    for (L, of), color in zip(rolling.items(), shades(len(rolling)), strict=True):
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
