"""Run time against error of every method: what each second buys."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from taichi_bearings.plots.style import DOUBLE, in_our_style, new_figure
from taichi_bearings.solvers import METHODS

Curve = Mapping[str, Any]
PEERS = {"clarabel": ("black", "s"), "scs": ("#8a8a8a", "X")}
MOST_MARKERS = 12  # a curve, so that long histories stay lines
MOST_COLUMNS = 3
LEAST = 1e-17  # below anything that double precision can tell


@in_our_style
def draw_accuracy(scenes: Sequence[tuple[str, Sequence[Curve]]]) -> Figure:
    """Error above and proven gap below against the wall time, log-log, a column a scene; wrapped after three scenes.

    scenes : title and curves of each. A curve has the relative error and the proven gap, all positive, at each of its
    `seconds`; `method`, which fixes its colour, and `what`, which the legend says; `reference_gap`, the relative
    uncertainty of the least power: errors below it are not resolved.
    """
    columns = min(len(scenes), MOST_COLUMNS)
    blocks = [scenes[start : start + columns] for start in range(0, len(scenes), columns)]
    figure = new_figure(DOUBLE, 3.9 * len(blocks) + 0.7)
    curves = [curve for _, of_scene in scenes for curve in of_scene]
    least = min(1e-6, *(min(*curve["error"], *curve["gap"]) for curve in curves)) / 3
    for part, block in zip(figure.subfigures(len(blocks), 1, squeeze=False)[:, 0], blocks, strict=True):
        axes = part.subplots(2, columns, sharex="col", sharey=True, squeeze=False)
        for (error, gap), (title, of_scene) in zip(axes.T, block, strict=False):
            error.set_title(title)
            error.axhspan(LEAST, of_scene[0]["reference_gap"], color="0.9", lw=0)
            gap.set_xlabel("time (s)")
            for one, key in ((error, "error"), (gap, "gap")):
                one.set(xscale="log", yscale="log", ylim=(least, 1.5))
                one.grid(True, which="major", lw=0.4, color="0.85")
                one.set_axisbelow(True)
                for curve in of_scene:
                    _draw(one, curve, curve[key])
        for unused in axes[:, len(block) :].flat:
            unused.set_axis_off()
        axes[0, 0].set_ylabel("relative error of the power")
        axes[1, 0].set_ylabel("relative gap that is proven")
    _legend(figure, curves, columns)
    return figure


def look_of(method: str) -> dict[str, Any]:
    """Colour, marker and dashes of a method, the same in every figure."""
    colour, marker = PEERS[method] if method in PEERS else (METHODS[method].colour, METHODS[method].marker)
    return {"color": colour, "marker": marker, "ls": "--" if method in PEERS else "-", "ms": 3, "lw": 1.0}


def _draw(axes: Axes, curve: Curve, values: Sequence[float]) -> None:
    """With at most MOST_MARKERS markers, about evenly spread over the logarithm of the time, one at the end."""
    seconds = np.array(curve["seconds"])
    wanted = np.geomspace(max(seconds[0], seconds[-1] * 1e-4), seconds[-1], MOST_MARKERS)
    every = np.unique(np.minimum(np.searchsorted(seconds, wanted), len(seconds) - 1))
    axes.plot(seconds, values, markevery=every.tolist(), **look_of(curve["method"]))


def _legend(figure: Figure, curves: Sequence[Curve], columns: int) -> None:
    """One entry a method; the label of a peer names its linear solver only if it is the same in all panels."""
    labels: dict[str, set[str]] = {}
    for curve in curves:
        labels.setdefault(curve["method"], set()).add(curve["what"])
    handles: list[Line2D | Patch] = []
    for method, names in labels.items():
        label = names.pop() if len(names) == 1 else f"{method} (its fastest linear solver)"
        handles.append(Line2D([], [], label=label, **look_of(method)))
    handles.append(Patch(color="0.9", lw=0, label="least power not known better"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 1 + columns))
