"""A map of outcomes: a row for each thing tested, a column for each value it was tested with."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from taichi_bearings.plots.style import in_our_style, new_figure

COLOURS = {"right": "#8fce9b", "not reached": "#f3d98a", "refused": "#c9d3e0", "wrong": "#d62728", "crash": "#222222"}
NOTHING = "#ffffff"


@in_our_style
def draw_outcomes(
    title: str, columns: Sequence[str], rows: Sequence[str], cells: Mapping[tuple[str, str], tuple[str, str]]
) -> Figure:
    """cells : outcome and a short text by (row, column); absent where there is none."""
    kinds = list(COLOURS)
    codes = np.full((len(rows), len(columns)), len(kinds))
    figure = new_figure(2.3 + 0.42 * len(columns), 1.1 + 0.19 * len(rows))
    axes = figure.add_subplot()
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            outcome, text = cells.get((row, column), ("", ""))
            if outcome:
                codes[i, j] = kinds.index(outcome)
                dark = outcome in ("wrong", "crash")
                axes.text(j, i, text, ha="center", va="center", fontsize=7, color="white" if dark else "black")
    colours = ListedColormap([*COLOURS.values(), NOTHING])
    axes.imshow(codes, cmap=colours, vmin=-0.5, vmax=len(kinds) + 0.5, aspect="auto")
    axes.set_xticks(range(len(columns)), columns, rotation=30 if max(map(len, columns)) > 6 else 0)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", lw=1)
    axes.tick_params(which="both", length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_xlabel(title)
    used = [kind for number, kind in enumerate(kinds) if (codes == number).any()]
    handles = [Patch(color=COLOURS[kind], label=kind) for kind in used]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(used))
    return figure
