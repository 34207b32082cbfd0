"""How fast kernels move their numbers, beside what memory and caches deliver."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from taichi_bearings.plots.style import BLUE, GREEN, GREY, ORANGE, in_our_style, label_in_plain_text, new_figure
from taichi_bearings.words import counted

COLOURS = (BLUE, ORANGE, GREEN, "#8C6BB1")
MARKERS = {1: "o", 2: "s", 3: "^"}  # by components


@in_our_style
def draw_bandwidth(rows: Sequence[Mapping[str, Any]]) -> Figure | None:
    """Bandwidth by working set, of the kernels in the first precision and with the fewest threads; a colour a kernel, a
    marker a number of components, a line for passes that do nothing else. None if nothing is counted.

    rows : bytes a second `bandwidth`, `bandwidth_here` of as large a `working_set`, in bytes.
    """
    rows = [row for row in rows if "bandwidth" in row]
    if not rows:
        return None
    precision, threads = rows[0]["precision"], min(row["threads"] for row in rows)
    rows = [row for row in rows if (row["precision"], row["threads"]) == (precision, threads)]
    figure = new_figure(5.2, 4.2)
    axes = figure.add_subplot()
    most = sorted((row["working_set"], row["bandwidth_here"] / 1e9) for row in rows)
    axes.plot(*zip(*most, strict=True), color="black", lw=1.2)
    names = list(dict.fromkeys(row["what"] for row in rows))
    for row in rows:
        looks: dict[str, Any] = {"color": COLOURS[names.index(row["what"])], "marker": MARKERS[row["components"]]}
        axes.plot(row["working_set"], row["bandwidth"] / 1e9, ls="", ms=4.5, mew=0, **looks)
    axes.set(xscale="log", yscale="log", xlabel="working set (bytes)", ylabel="bytes per second (10⁹)")
    label_in_plain_text(axes.xaxis, axes.yaxis)
    axes.grid(True, which="major", lw=0.4, color="0.9")
    handles = [Line2D([], [], color=COLOURS[n], lw=4, label=name) for n, name in enumerate(names)]
    for number in sorted({row["components"] for row in rows}):
        look: dict[str, Any] = {"marker": MARKERS[number], "ls": "", "ms": 4.5, "mew": 0}
        handles.append(Line2D([], [], color=GREY, label=counted(number, "component"), **look))
    handles.append(Line2D([], [], color="black", lw=1.2, label="memory and caches"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8)
    axes.set_title(f"{precision}, {counted(threads, 'thread')}; medians", fontsize=9)
    return figure
