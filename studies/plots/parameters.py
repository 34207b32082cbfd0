"""Courses of the power under other springs, dampers and normal forces."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from taichi_bearings.plots.style import in_our_style, new_figure

COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#D55E00", "#CC79A7", "#8a8a8a", "#0072B2")


@in_our_style
def draw_parameters(courses: Mapping[str, Any], seed: int) -> Figure:
    """(a) P / P_0 and (b) its excess over the least power against F_n t, of the first sample; the first course, the
    paper's, is black. courses : as of paper.parameters."""
    figure = new_figure(7.1, 3.2)
    left, right = figure.subplots(1, 2)
    for (name, course), colour in zip(courses.items(), COLOURS, strict=True):
        look: dict[str, Any] = {"color": colour, "lw": 1.8 if colour == COLOURS[0] else 1.1, "label": name}
        later = course.scaled > 0
        left.plot(course.scaled[later], course.power[later, 0], **look)
        shown = later & (course.excess[:, 0] > 0)
        right.plot(course.scaled[shown], course.excess[shown, 0], **look)
    time = r"time, $\omega_T\, t\, F_n / 50$"
    left.set(xscale="log", xlabel=time, ylabel=r"$P\,/\,P_0$", ylim=(0, 1.04))
    right.set(xscale="log", yscale="log", xlabel=time, ylabel=r"$P\,/\,P_{\min} - 1$", ylim=(1e-8, 10))
    left.set_title(f"(a) seed {seed}, random spins")
    right.set_title("(b) above the minimum")
    figure.legend(handles=left.lines, loc="outside lower center", ncols=4)
    return figure
