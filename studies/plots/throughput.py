"""How fast kernels go through the contacts of small and of large lattices."""

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from taichi_bearings.plots.style import BLUE, GREEN, GREY, ORANGE, in_our_style, label_in_plain_text, new_figure
from taichi_bearings.words import counted

COLOURS = (BLUE, ORANGE, GREEN, "#8C6BB1", GREY, "black")
MARKERS = {1: "o", 2: "s", 3: "^"}  # by components


@in_our_style
def draw_throughput(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Contacts a second by spheres, in the first precision and with the fewest threads: left discs, right spheres; a
    colour a kernel, a marker a number of components."""
    precision, threads = rows[0]["precision"], min(row["threads"] for row in rows)
    rows = [row for row in rows if (row["precision"], row["threads"]) == (precision, threads)]
    figure = new_figure(7.1, 4.2)
    panels: Any = figure.subplots(1, 2, sharey=True)
    colours = dict(zip(dict.fromkeys(row["what"] for row in rows), COLOURS, strict=False))
    curves: dict[tuple[int, str, int], list[tuple[int, float]]] = {}
    for row in rows:
        point = prod(row["shape"]), row["contact_updates"] / 1e6
        curves.setdefault((len(row["shape"]) - 2, row["what"], row["components"]), []).append(point)
    for (panel, what, components), points in curves.items():
        look = {"color": colours[what], "marker": MARKERS[components], "ms": 4, "lw": 1.0}
        panels[panel].plot(*zip(*sorted(points), strict=True), **look)
    for axes, name in zip(panels, ("discs", "spheres"), strict=True):
        axes.set(xscale="log", yscale="log", xlabel=name)
        label_in_plain_text(axes.xaxis, axes.yaxis)
        axes.grid(True, which="major", lw=0.4, color="0.9")
    panels[0].set_ylabel("contacts per second (10⁶)")
    handles = [Line2D([], [], color=colour, lw=4, label=name) for name, colour in colours.items()]
    for number in sorted({components for _, _, components in curves}):
        label = counted(number, "component")
        handles.append(Line2D([], [], color=GREY, marker=MARKERS[number], ls="", ms=4, label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8)
    figure.suptitle(f"{precision}, {counted(threads, 'thread')}; medians", fontsize=9)
    return figure
