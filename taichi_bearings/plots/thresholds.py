"""How the structure of a state depends on the slip speed below which a contact counts as slipless."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import THRESHOLDS
from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.plots.style import BLUE, GREEN, GREY, ORANGE, in_our_style, new_figure

PANELS = (
    ("slipless contacts", (("slipless", "slipless contacts", BLUE, "o"),)),
    (
        "number",
        (("domains", "rigid domains", BLUE, "o"), ("largest_intermediate", "largest intermediate", ORANGE, "s")),
    ),
    (
        "share of free spheres",
        (("reached_fraction", "reached", BLUE, "o"), ("spanning_fraction", "joining bottom and top", GREEN, "s")),
    ),
)


@in_our_style
def draw_thresholds(views: Sequence[Mapping[str, Any]], by_states: Mapping[str, Any], page: Page = PAGE) -> Figure:
    """Each number against the slip threshold, with its value by the contact states as a broken line.

    views : `Structure.view` for each of THRESHOLDS.
    """
    width = page.inches("single")
    figure = new_figure(width, 1.4 * width, page.dpi)
    panels: Any = figure.subplots(len(PANELS), 1, sharex=True)
    for axes, (name, curves) in zip(panels, PANELS, strict=True):
        for key, label, colour, mark in curves:
            values = [view[key] for view in views]
            look: dict[str, Any] = {"ms": 4.5, "mfc": "white"} if mark == "o" else {"ms": 2.5}
            axes.plot(THRESHOLDS, values, mark + "-", lw=1.2, color=colour, label=label, **look)
            axes.axhline(by_states[key], color=colour, ls=(0, (4, 2)), lw=1.0)
        axes.plot([], [], color=GREY, ls=(0, (4, 2)), lw=1.0, label="contact states")
        axes.set(xscale="log", ylabel=name)
        axes.legend()
    panels[0].yaxis.set_major_formatter("{x:,.0f}")
    numbers = np.array([(view["domains"], view["largest_intermediate"]) for view in views])
    if numbers.max() > 20:
        panels[1].set_yscale("log" if numbers.min() > 0 else "symlog")
    panels[2].set_ylim(-0.05, 1.05)
    panels[2].set_xlabel(r"slip threshold, $|v|\,/\,(R\,|\Delta\omega|)$")
    return figure
