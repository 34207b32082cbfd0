"""How the power and its proven lower bound approached each other."""

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, label_in_plain_text, plain_figure
from taichi_bearings.plots.symbols import describe, driving, over, power_unit
from taichi_bearings.scene import Solution


@in_our_style
def draw_history(solution: Solution, page: Page = PAGE) -> Figure:
    """Power and lower bound, and below it their relative gap, against iterations (or time, for a dynamics)."""
    history, scene = solution.history, solution.scene
    width = page.inches("single")
    figure = plain_figure(width, 0.85 * width + 0.4, page.dpi)
    top, bottom = figure.subplots(2, 1, sharex=True)
    spin, spin_symbol = driving(scene)
    unit, symbol = power_unit(scene)
    x, name = history["iteration"], "iteration"
    if "time" in history:
        x, name = history["time"] * spin, rf"time, ${spin_symbol}\,t$"
    power, bound = history["power"], history["lower_bound"]
    started = x > 0
    top.plot(x[started], power[started] / unit, color=BLUE)
    top.plot(x[started], bound[started] / unit, "--", color=ORANGE)
    top.plot([], [], color=BLUE, label="power")
    top.plot([], [], "--", color=ORANGE, label="proven lower bound")
    title = f"{describe(scene, None)}\n{solution.method}"
    top.set(ylabel=over("P", symbol, "energy / time"), title=title)
    top.legend(frameon=True, framealpha=0.85, edgecolor="none")
    gap = (np.minimum.accumulate(power) - bound) / np.where(power > 0, power, 1.0)
    shown = started & (gap > 0).any(axis=1)
    bottom.plot(x[shown], np.where(gap > 0, gap, np.nan)[shown], color=GREY)
    scale = "log" if shown.any() else "linear"
    bottom.set(xscale=scale, yscale=scale, xlabel=name, ylabel=r"gap, $(P - P_\mathrm{low})\,/\,P$")
    if scale == "log":
        label_in_plain_text(bottom.xaxis, bottom.yaxis)
    figure.align_ylabels()
    return figure
