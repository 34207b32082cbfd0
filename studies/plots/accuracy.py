"""Run time against error of every method: what each second buys."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from taichi_bearings.plots.style import DOUBLE, in_our_style, new_figure
from taichi_bearings.solvers import METHODS, MethodOptions

PEERS = {"clarabel": ("black", "s"), "scs": ("#8a8a8a", "X"), "moreau": ("#5a5a5a", "d")}
MOST_MARKERS = 12  # a curve, so that long histories stay lines
MOST_COLUMNS = 3
LEAST = 1e-17  # below anything that double precision can tell


@dataclass(frozen=True)
class Curve:
    """One method on one scene: relative error and proven gap, all positive, at each of `seconds`.

    method : what fixes its colour. label : what the legend says.
    """

    method: str
    label: str
    seconds: np.ndarray
    error: np.ndarray
    gap: np.ndarray


@dataclass(frozen=True)
class Panel:
    """One scene. reference_gap : relative uncertainty of the least power; errors below it are not resolved."""

    title: str
    reference_gap: float
    curves: Sequence[Curve]


@in_our_style
def draw_accuracy(panels: Sequence[Panel]) -> Figure:
    """Error above and proven gap below against the wall time, log-log, a column a scene; wrapped after three scenes."""
    columns = min(len(panels), MOST_COLUMNS)
    blocks = [panels[start : start + columns] for start in range(0, len(panels), columns)]
    figure = new_figure(DOUBLE, 3.9 * len(blocks) + 0.7)
    values = np.concatenate([v for panel in panels for curve in panel.curves for v in (curve.error, curve.gap)])
    least = min(float(values.min()), 1e-6) / 3
    for part, block in zip(figure.subfigures(len(blocks), 1, squeeze=False)[:, 0], blocks, strict=True):
        axes = part.subplots(2, columns, sharex="col", sharey=True, squeeze=False)
        for (error, gap), panel in zip(axes.T, block, strict=False):
            _draw_panel(error, gap, panel, least)
        for unused in axes[:, len(block) :].flat:
            unused.set_axis_off()
        axes[0, 0].set_ylabel("relative error of the power")
        axes[1, 0].set_ylabel("relative gap that is proven")
    _legend(figure, panels, columns)
    return figure


def _draw_panel(error: Axes, gap: Axes, panel: Panel, least: float) -> None:
    error.set_title(panel.title)
    error.axhspan(LEAST, panel.reference_gap, color="0.9", lw=0)
    gap.set_xlabel("time (s)")
    for axes in (error, gap):
        axes.set(xscale="log", yscale="log", ylim=(least, 1.5))
        axes.grid(True, which="major", lw=0.4, color="0.85")
        axes.set_axisbelow(True)
        for curve in panel.curves:
            _draw(axes, curve, curve.error if axes is error else curve.gap)


def style_of(method: str) -> tuple[str, str]:
    """Colour and marker of a method, the same in every figure."""
    if method in PEERS:
        return PEERS[method]
    row = METHODS.get(method, MethodOptions)
    return row.colour, row.marker


def _draw(axes: Axes, curve: Curve, values: np.ndarray) -> None:
    colour, marker = style_of(curve.method)
    every = _spread(curve.seconds, MOST_MARKERS)
    dashed = "--" if curve.method in PEERS else "-"
    axes.plot(curve.seconds, values, dashed, color=colour, marker=marker, markevery=every, ms=3, lw=1.0)


def _spread(seconds: np.ndarray, most: int) -> list[int]:
    """Indices of at most `most` points, about evenly spread over the logarithm of the time, with the last one."""
    if len(seconds) <= most:
        return list(range(len(seconds)))
    wanted = np.geomspace(max(seconds[0], seconds[-1] * 1e-4), seconds[-1], most)
    return sorted({min(int(np.searchsorted(seconds, time)), len(seconds) - 1) for time in wanted})


def _legend(figure: Figure, panels: Sequence[Panel], columns: int) -> None:
    """One entry a method; the label of a peer names its linear solver only if it is the same in all panels."""
    labels: dict[str, set[str]] = {}
    for panel in panels:
        for curve in panel.curves:
            labels.setdefault(curve.method, set()).add(curve.label)
    handles: list[Line2D | Patch] = []
    for method, names in labels.items():
        colour, marker = style_of(method)
        label = names.pop() if len(names) == 1 else f"{method} (its fastest linear solver)"
        dashed = "--" if method in PEERS else "-"
        handles.append(Line2D([], [], color=colour, marker=marker, ms=3, lw=1.0, ls=dashed, label=label))
    handles.append(Patch(color="0.9", lw=0, label="least power not known better"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 1 + columns))
