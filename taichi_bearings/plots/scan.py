"""A number of the samples of a scan against a parameter."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from taichi_bearings.plots.style import BLUE, in_our_style, new_figure, shades

MARKERS = "osD^vP*X"
MOST_TICKS = 8  # values of a logarithmic axis that are named one by one


@dataclass(frozen=True)
class Curve:
    """x, y : (P,) points. low, high : (P,) ends of the bars; not-a-number where there are none."""

    label: str
    x: np.ndarray
    y: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True)
class Look:
    """log : the axes that are logarithmic, of "x", "y", "xy". ticks : names at x = 0, 1, ... if x has no numbers."""

    x_label: str
    y_label: str
    title: str = ""
    legend: str = ""
    log: str = ""
    ticks: Sequence[str] = ()


@in_our_style
def draw_scan(curves: Sequence[Curve], look: Look) -> Figure:
    """Points with bars, joined along each curve."""
    figure = new_figure(6.4, 4.2)
    axes = figure.add_subplot()
    for name in look.log:
        axes.set(**{f"{name}scale": "log"})
    colours = shades(len(curves)) if len(curves) > 1 else [BLUE]
    for number, (curve, colour) in enumerate(zip(curves, colours, strict=True)):
        bars = np.nan_to_num([curve.y - curve.low, curve.high - curve.y])
        axes.errorbar(
            curve.x, curve.y, bars, color=colour, label=curve.label, lw=1.0, elinewidth=0.9, capsize=2,
            fmt=f"{MARKERS[number % len(MARKERS)]}-", ms=4, mfc="none" if number % 2 else colour,
        )  # fmt: skip
    axes.set(xlabel=look.x_label, ylabel=look.y_label)
    values = np.unique(np.concatenate([curve.x for curve in curves]))
    if look.ticks:
        axes.set_xticks(range(len(look.ticks)), look.ticks)
    elif "x" in look.log and len(values) <= MOST_TICKS:
        axes.set_xticks(values, [f"{value:g}" for value in values])
        axes.xaxis.set_minor_locator(NullLocator())
    if len(curves) > 1:
        figure.legend(title=look.legend, loc="outside right upper", fontsize=8, title_fontsize=8)
    axes.set_title(look.title, fontsize=9)
    return figure
