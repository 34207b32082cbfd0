"""A number of the samples of a scan against a parameter."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from taichi_bearings.plots import style
from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.plots.symbols import as_text

MARKERS = "osD^vP*X"
MOST_NAMED_TICKS = 8  # values of a logarithmic axis that are named one by one
BESIDE = 0.5  # of the distance of two names on an axis, over which curves stand beside each other


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


@style.in_our_style
def draw_scan(curves: Sequence[Curve], look: Look, page: Page = PAGE) -> Figure:
    """Points with bars, joined along each curve where x has numbers."""
    width = page.inches("single")
    entries = len(curves) if len(curves) > 1 else 0
    longest = max(len(curve.label) for curve in curves)
    across = max(1, min(entries, int(style.LETTERS_AN_INCH * width / (longest + 6))))
    rows = -(-entries // across) + (entries > 0)
    figure = style.new_figure(width, 0.68 * min(width, 5.0) + 0.15 * rows, page.dpi)
    axes = figure.add_subplot()
    for name in look.log:
        axes.set(**{f"{name}scale": "log"})
        style.label_in_plain_text(getattr(axes, f"{name}axis"))
    colours = style.shades(len(curves)) if len(curves) > 1 else [style.BLUE]
    beside = BESIDE * (np.arange(len(curves)) / len(curves) - 0.5 + 0.5 / len(curves)) * bool(look.ticks)
    for number, (curve, colour) in enumerate(zip(curves, colours, strict=True)):
        bars = np.nan_to_num([curve.y - curve.low, curve.high - curve.y])
        axes.errorbar(
            curve.x + beside[number], curve.y, bars, color=colour, label=as_text(curve.label or "samples"),
            lw=0.0 if look.ticks else 0.9, elinewidth=0.8, capsize=1.5, marker=MARKERS[number % len(MARKERS)], ms=3.5,
            mfc="none" if number % 2 else colour,
        )  # fmt: skip
    axes.set(xlabel=look.x_label, ylabel=look.y_label)
    values = np.unique(np.concatenate([curve.x for curve in curves]))
    if look.ticks:
        long = sum(map(len, look.ticks)) + 2 * len(look.ticks) > style.LETTERS_AN_INCH * (width - 0.8)
        turned: dict[str, Any] = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if long else {}
        axes.set_xticks(range(len(look.ticks)), [as_text(tick) for tick in look.ticks], **turned)
        axes.set_xlim(-0.5, len(look.ticks) - 0.5)
    elif "x" in look.log and len(values) <= MOST_NAMED_TICKS:
        axes.set_xticks(values, [f"{value:g}" for value in values])
        axes.xaxis.set_minor_locator(NullLocator())
    if entries:
        figure.legend(title=as_text(look.legend) or None, loc="outside lower center", ncols=across)
    style.put_title(figure, as_text(look.title), page)
    return figure
