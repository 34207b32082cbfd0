"""How the weight and the course of minimum cuts fluctuate with their length, and how skewed the weights are."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, new_figure


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
