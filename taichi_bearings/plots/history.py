"""How the power and its proven lower bound approached each other."""

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, label_in_plain_text, plain_figure
from taichi_bearings.scene import Solution


@in_our_style
def draw_history(solution: Solution) -> Figure:
    """Power and lower bound, and below it their relative gap, against iterations (or time, for a dynamics)."""
    history, scene = solution.history, solution.scene
    figure = plain_figure(5.5, 5.0)
    top, bottom = figure.subplots(2, 1, sharex=True)
    along = "time" if "time" in history else "iteration"
    x = history[along]
    title = f"{'x'.join(map(str, scene.lattice.shape))} {scene.law}, {solution.method}"
    power, bound = history["power"], history["lower_bound"]
    started = x > 0
    top.plot(x[started], power[started], color=BLUE, lw=1.2)
    top.plot(x[started], bound[started], color=ORANGE, lw=1.2)
    top.plot([], [], color=BLUE, label="power P")
    top.plot([], [], color=ORANGE, label="proven lower bound")
    top.set(ylabel="power", title=title)
    top.legend(fontsize=8)
    gap = (np.minimum.accumulate(power) - bound) / np.where(power > 0, power, 1.0)
    shown = started & (gap > 0).any(axis=1)
    bottom.plot(x[shown], gap[shown], color=GREY, lw=1.2)
    scale = "log" if shown.any() else "linear"
    bottom.set(xscale=scale, yscale=scale, xlabel=along, ylabel="relative gap")
    if scale == "log":
        label_in_plain_text(bottom.xaxis, bottom.yaxis)
    return figure
