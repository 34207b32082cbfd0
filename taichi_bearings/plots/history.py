"""How the power and its proven lower bound approached each other."""

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, label_in_plain_text, plain_figure
from taichi_bearings.plots.symbols import describe, driving, over, power_unit
from taichi_bearings.scene import Solution


@in_our_style
def draw_history(solution: Solution, page: Page = PAGE) -> Figure:
    """Power and lower bound, and below it their relative gap, against iterations (or time, for a dynamics); where a
    torque turns the top, how fast it does."""
    history, scene = solution.history, solution.scene
    if "torque" in history:
        return _draw_turning(solution, page)
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


def _draw_turning(solution: Solution, page: Page) -> Figure:
    """Strength of the motion of the top against a torque that grows, with the bounds between which it is proven to set
    it in motion, or else against time; and the moment at which it begins to turn."""
    history, found = solution.history, solution.findings
    torque, strength = history["torque"], np.abs(history["amplitude"])
    x, name, marks = history["time"], "time", [("time_at_yield", "begins to turn", ":", GREY)]
    if np.ptp(torque) > 0:
        x, name, marks = torque, "torque (force · length)", [("torque_at_yield", "begins to turn", ":", GREY)]
        marks += [("yield_torque_lower_bound", "proven to be held", "--", ORANGE)]
        marks += [("yield_torque", "proven not to be held", "-", ORANGE)]
    width = page.inches("single")
    figure = plain_figure(width, 0.75 * width, page.dpi)
    axes = figure.subplots()
    axes.plot(x, np.where(strength > 0, strength, np.nan), color=BLUE)
    for key, label, dashes, colour in marks:
        values = np.copysign(found[key], x[-1])[np.isfinite(found[key])]
        for n, value in enumerate(values):
            axes.axvline(value, color=colour, ls=dashes, label="_" * n + label)
    title = f"{describe(solution.scene, None)}\n{solution.method}"
    axes.set(yscale="log", xlabel=name, ylabel="strength $|a|$ of the motion of the top", title=title)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(frameon=True, framealpha=0.85, edgecolor="none")
    label_in_plain_text(axes.yaxis)
    return figure
