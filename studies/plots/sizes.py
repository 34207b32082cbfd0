"""How the structure of minima depends on the size of the sample, and on the threshold by which slips are judged."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, GREY, ORANGE, in_our_style, new_figure

THRESHOLDS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Slips over R times the imposed jump, which is the largest slip there can be."""
THRESHOLD = r"slip threshold, $|v|\,/\,(R\,|\Delta\omega|)$"


@dataclass(frozen=True)
class Column:
    """side : (S,) sides of the cubes. values : one array a side, an entry a sample."""

    side: np.ndarray
    values: Sequence[np.ndarray]

    @property
    def mean(self) -> np.ndarray:
        return np.array([values.mean() for values in self.values])

    @property
    def standard_error(self) -> np.ndarray:
        """Of the mean; 0 for a single sample."""
        return np.array(
            [values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0.0 for values in self.values]
        )


@in_our_style
def draw_sizes(columns: Mapping[str, Column], by_threshold: Mapping[int, Mapping[str, np.ndarray]]) -> Figure:
    """Power over that of the minimum cut, network, domains and paths against the side; what thresholds make of them.

    columns : numbers of the samples by name (paper.network.Sample). by_threshold : side -> numbers (samples,
    thresholds + 1) by name (`Structure.view`), the last ones by certified contact states.
    """
    figure = new_figure(DOUBLE, 4.9)
    axes: Any = figure.subplots(2, 3)
    _against_side(axes[0, 0], columns, {"power_over_cut": (BLUE, r"$P_\mathrm{min} / P_\mathrm{cut}$")}, dots=True)
    axes[0, 0].axhline(1.0, color=GREY, lw=0.8)
    axes[0, 0].set_ylabel("least power over minimum cut")
    shares = {
        "reached_fraction": (BLUE, "free spheres reached"),
        "intermediate": (GREEN, "free spheres not locked"),
        "slipless_fraction": (ORANGE, "contacts slipless"),
    }
    _against_side(axes[0, 1], columns, shares)
    axes[0, 1].set(ylabel="share", ylim=(0, 1.04))
    _spanning(axes[0, 2], by_threshold)
    numbers = {
        "shortest_path": (BLUE, "shortest path"),
        "disjoint_paths": (GREEN, "disjoint paths"),
    }
    _against_side(axes[1, 0], columns, numbers)
    axes[1, 0].set(yscale="symlog", ylim=(0, 2000), ylabel="number")
    axes[1, 0].legend(loc="upper left")
    _against_side(axes[1, 1], columns, {"largest_intermediate": (BLUE, "largest intermediate")})
    axes[1, 1].set(ylim=(0, None), ylabel="spheres")
    side = max(by_threshold)
    for name, colour, label in (
        ("slipless", ORANGE, "slipless contacts"),
        ("domains", BLUE, "rigid domains"),
        ("largest_intermediate", GREEN, "largest intermediate"),
    ):
        values = by_threshold[side][name].mean(axis=0)
        axes[1, 2].loglog(THRESHOLDS, values[:-1], "o-", color=colour, ms=3.5, label=label)
        axes[1, 2].axhline(values[-1], color=colour, lw=0.8, ls="--")
    axes[1, 2].set(xlabel=THRESHOLD, ylabel="number")
    axes[1, 2].set_title(f"$L = {side}$; dashed: certified")
    axes[1, 2].legend()
    return figure


def _spanning(axes: Any, by_threshold: Mapping[int, Mapping[str, np.ndarray]]) -> None:
    """Share of the samples whose slipless network joins the planes, by some thresholds and certified."""
    sides = sorted(by_threshold)
    spans = np.array([by_threshold[side]["spans"].mean(axis=0) for side in sides])
    number = np.array([len(by_threshold[side]["spans"]) for side in sides])
    for place, colour in zip((0, 1, 2), ("#f2c14e", "#e07a5f", "#b56576"), strict=True):
        axes.plot(sides, spans[:, place], "o--", ms=3.5, lw=1, color=colour, label=f"slips below {THRESHOLDS[place]:g}")
    error = np.sqrt(spans[:, -1] * (1 - spans[:, -1]) / number)
    axes.errorbar(sides, spans[:, -1], error, fmt="o-", color=GREEN, ms=4, lw=1.4, capsize=2, label="certified states")
    _size_axis(axes, sides)
    axes.set(ylabel="samples that span", ylim=(-0.03, 1.04))
    axes.legend(loc="upper left")


def _against_side(
    axes: Any, columns: Mapping[str, Column], chosen: Mapping[str, tuple[str, str]], dots: bool = False
) -> None:
    for name, (colour, label) in chosen.items():
        column = columns[name]
        if dots:
            for side, values in zip(column.side, column.values, strict=True):
                axes.plot(np.full(len(values), side), values, ".", color=colour, ms=3, alpha=0.25, mew=0)
        axes.errorbar(
            column.side, column.mean, column.standard_error, fmt="o-", color=colour, ms=4, lw=1, capsize=2, label=label
        )
    _size_axis(axes, column.side)
    axes.legend()


def _size_axis(axes: Any, sides: Sequence[int] | np.ndarray) -> None:
    axes.set(xscale="log", xlabel="side of the cube, $L$")
    axes.set_xticks(sides, [str(side) for side in sides])
    axes.minorticks_off()
