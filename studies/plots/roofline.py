"""How fast kernels are beside what the machine allows: operations against intensity, and bandwidth by working set."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from taichi_bearings.plots.style import BLUE, GREEN, GREY, ORANGE, in_our_style, label_in_plain_text, new_figure
from taichi_bearings.words import counted

COLOURS = (BLUE, ORANGE, GREEN, "#8C6BB1", "#7A5230", "#CC79A7")
MARKERS = {1: "o", 2: "s", 3: "^"}  # by components


@dataclass(frozen=True)
class Measured:
    """A kernel on one lattice, with so many spin components.

    intensity : operations a byte. speed : operations a second. bandwidth : bytes a second. working_set : bytes.
    """

    name: str
    components: int
    intensity: float
    speed: float
    bandwidth: float
    working_set: float


@dataclass(frozen=True)
class Ceilings:
    """What the machine does at most: bandwidth (n,) in bytes a second of working sets (n,) in bytes; operations a
    second. caches : level -> bytes."""

    working_set: np.ndarray
    bandwidth: np.ndarray
    operations: float
    caches: dict[str, int]

    def levels(self) -> dict[str, float]:
        """Bandwidth of each cache and of memory: that of the working set that fills half of it, or of the largest."""
        found = {
            level: float(np.interp(np.log(size / 2), np.log(self.working_set), self.bandwidth))
            for level, size in self.caches.items()
            if size / 2 <= self.working_set[-1]
        }
        return found | {"memory": float(self.bandwidth[-1])}


@in_our_style
def draw_roofline(measured: Sequence[Measured], ceilings: Ceilings, title: str) -> Figure:
    """Left the roofline, right the bandwidth by working set; a colour a kernel, a marker a number of components."""
    figure = new_figure(7.6, 4.2)
    left, right = figure.subplots(1, 2)
    names = list(dict.fromkeys(one.name for one in measured))
    _draw_roof(left, measured, ceilings)
    _draw_bandwidth(right, ceilings)
    for one in measured:
        colour = COLOURS[names.index(one.name) % len(COLOURS)]
        look = {"color": colour, "marker": MARKERS[one.components], "ms": 4.5, "mew": 0, "ls": ""}
        left.plot(one.intensity, one.speed / 1e9, **look)
        right.plot(one.working_set, one.bandwidth / 1e9, **look)
    handles = [
        Line2D([], [], color=COLOURS[n % len(COLOURS)], lw=4, label=name, solid_capstyle="butt")
        for n, name in enumerate(names)
    ]
    handles += [
        Line2D([], [], color=GREY, marker=MARKERS[number], ls="", ms=4.5, mew=0, label=counted(number, "component"))
        for number in sorted({one.components for one in measured})
    ]
    handles.append(Line2D([], [], color="black", lw=1.2, label="what the machine does at most"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8)
    figure.suptitle(title, fontsize=9)
    return figure


def _draw_roof(axes: Axes, measured: Sequence[Measured], ceilings: Ceilings) -> None:
    intensities = [one.intensity for one in measured]
    low, high = min(intensities) / 4, 3 * max(ceilings.operations / ceilings.bandwidth[-1], *intensities)
    axes.set(xscale="log", yscale="log", xlabel="operations per byte", ylabel="operations per second (10⁹)")
    axes.set_xlim(low, high)
    axes.set_ylim(min(one.speed for one in measured) / 3e9, ceilings.operations / 1e9 * 2)
    label_in_plain_text(axes.xaxis, axes.yaxis)
    x, last = np.geomspace(low, high, 200), 0.0
    for level, bandwidth in sorted(ceilings.levels().items(), key=lambda item: item[1]):
        width = 1.2 if level == "memory" else 0.7
        axes.plot(x, np.minimum(x * bandwidth, ceilings.operations) / 1e9, color="black", lw=width)
        if bandwidth > 1.3 * last:  # names that would lie on each other are left out
            _name_slope(axes, f"{level} {bandwidth / 1e9:.0f} GB/s", bandwidth / 1e9)
            last = bandwidth
    peak = ceilings.operations / 1e9
    axes.annotate(f"{peak:.0f} Gflop/s", (high, peak), (-2, 3), textcoords="offset points", fontsize=7, ha="right")
    axes.grid(True, which="major", lw=0.4, color="0.9")


def _name_slope(axes: Axes, name: str, slope: float) -> None:
    """A name along the line y = slope x, from where it enters the axes on."""
    x = 1.15 * max(axes.get_xlim()[0], axes.get_ylim()[0] / slope)
    turned = {"rotation": np.rad2deg(np.arctan(slope)), "rotation_mode": "anchor", "transform_rotates_text": True}
    axes.text(x, 1.06 * slope * x, name, fontsize=7, va="bottom", **turned)


def _draw_bandwidth(axes: Axes, ceilings: Ceilings) -> None:
    axes.plot(ceilings.working_set, ceilings.bandwidth / 1e9, color="black", lw=1.2)
    for level, size in ceilings.caches.items():
        axes.axvline(size, color=GREY, lw=0.6, ls=":")
        axes.annotate(
            level, (size, 1), (-2, 0), xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=7,
            ha="right", va="top",
        )  # fmt: skip
    axes.set(xscale="log", yscale="log", xlabel="working set (bytes)", ylabel="bytes per second (10⁹)")
    label_in_plain_text(axes.xaxis, axes.yaxis)
    axes.grid(True, which="major", lw=0.4, color="0.9")
