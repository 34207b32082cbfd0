"""How the structure of minima depends on the size of the sample, and on the threshold by which slips are judged."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, GREY, ORANGE, in_our_style, new_figure

THRESHOLDS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Slips over R times the imposed jump, which is the largest slip there can be."""
THRESHOLD = r"slip threshold, $|v|\,/\,(R\,|\Delta\omega|)$"
COARSE = ("#f2c14e", "#e07a5f", "#b56576")  # of the first thresholds


@in_our_style
def draw_sizes(table: Any, by_threshold: Mapping[int, Mapping[str, np.ndarray]]) -> Figure:
    """Power over that of the minimum cut, network, domains and paths against the side; what thresholds make of them.

    table : the samples of paper.network. by_threshold : side -> numbers (samples, thresholds + 1) by name, the last
    ones by certified contact states.
    """
    figure = new_figure(DOUBLE, 4.9)
    axes: Any = figure.subplots(2, 3)
    axes[0, 0].plot(table.side, table.power_over_cut, ".", color=BLUE, ms=3, alpha=0.25, mew=0)
    axes[0, 0].axhline(1.0, color=GREY, lw=0.8)
    for panel, of, name, colour, label in (
        (axes[0, 0], table, "power_over_cut", BLUE, r"$P_\mathrm{min} / P_\mathrm{cut}$"),
        (axes[0, 1], table, "reached_fraction", BLUE, "free spheres reached"),
        (axes[0, 1], table, "intermediate", GREEN, "free spheres not locked"),
        (axes[0, 1], table, "slipless_fraction", ORANGE, "contacts slipless"),
        (axes[1, 0], table[table.spans], "shortest_path", BLUE, "shortest path"),
        (axes[1, 0], table, "disjoint_paths", GREEN, "disjoint paths"),
        (axes[1, 1], table, "largest_intermediate", BLUE, "largest intermediate"),
    ):
        found = of.by(name)
        mean, error = mean_and_error(found.values())
        panel.errorbar(list(found), mean, error, fmt="o-", color=colour, ms=4, lw=1, capsize=2, label=label)
    sides = sorted(by_threshold)
    _spanning(axes[0, 2], sides, [by_threshold[side]["spans"] for side in sides])
    for panel in (*axes[0], *axes[1, :2]):
        panel.set(xscale="log", xlabel="side of the cube, $L$")
        panel.set_xticks(sides, [str(side) for side in sides])
        panel.minorticks_off()
        panel.legend()
    axes[0, 0].set_ylabel("least power over minimum cut")
    axes[0, 1].set(ylabel="share", ylim=(0, 1.04))
    axes[1, 0].set(yscale="symlog", ylim=(0, 2000), ylabel="number")
    axes[1, 0].legend(loc="upper left")
    axes[0, 2].legend(loc="upper left")
    axes[1, 1].set(ylim=(0, None), ylabel="spheres")
    _by_threshold(axes[1, 2], sides[-1], by_threshold[sides[-1]])
    return figure


def mean_and_error(values: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Of each array the mean and its standard error, 0 for a single sample."""
    pairs = [(of.mean(), of.std(ddof=1) / np.sqrt(len(of)) if len(of) > 1 else 0.0) for of in values]
    mean, error = np.array(pairs).reshape(-1, 2).T
    return mean, error


def _spanning(axes: Any, sides: Sequence[int], spans: Sequence[np.ndarray]) -> None:
    """Share of the samples whose slipless network joins the planes, by some thresholds and certified."""
    share = np.array([of.mean(axis=0) for of in spans])
    for place, colour in enumerate(COARSE):
        axes.plot(sides, share[:, place], "o--", ms=3.5, lw=1, color=colour, label=f"slips below {THRESHOLDS[place]:g}")
    error = np.sqrt(share[:, -1] * (1 - share[:, -1]) / [len(of) for of in spans])
    axes.errorbar(sides, share[:, -1], error, fmt="o-", color=GREEN, ms=4, lw=1.4, capsize=2, label="certified states")
    axes.set(ylabel="samples that span", ylim=(-0.03, 1.04))


def _by_threshold(axes: Any, side: int, seen: Mapping[str, np.ndarray]) -> None:
    for name, colour, label in (
        ("slipless", ORANGE, "slipless contacts"),
        ("domains", BLUE, "rigid domains"),
        ("largest_intermediate", GREEN, "largest intermediate"),
    ):
        values = seen[name].mean(axis=0)
        axes.loglog(THRESHOLDS, values[:-1], "o-", color=colour, ms=3.5, label=label)
        axes.axhline(values[-1], color=colour, lw=0.8, ls="--")
    axes.set(xlabel=THRESHOLD, ylabel="number")
    axes.set_title(f"$L = {side}$; dashed: certified")
    axes.legend()
