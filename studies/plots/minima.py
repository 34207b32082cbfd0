"""How minima depend on the size of the sample, on the threshold by which slips are judged, on the distribution of the
friction and on the driving: networks, domains and the least power."""

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


@in_our_style
def draw_distributions(tables: Mapping[str, Any], spans: Mapping[str, Any]) -> Figure:
    """P_min / P_cut, samples that span, slipless contacts and decades of power, a row a distribution.

    tables, spans : the samples of paper.distributions and the shares of them that join bottom and top, by distribution.
    """
    figure = new_figure(7.1, 2.5)
    panels: Any = figure.subplots(1, 4, sharey=True)
    rows = range(len(tables), 0, -1)
    for row, (name, table) in zip(rows, tables.items(), strict=True):
        colour = BLUE if 2 * table.states_proven.sum() > len(table) else GREY
        for axes, column in zip(panels[[0, 2, 3]], ("power_over_cut", "slipless_fraction", "decades"), strict=True):
            values = getattr(table, column)
            if np.isfinite(values).any():
                place = row + np.linspace(-0.22, 0.22, len(values))
                axes.plot(values, place, ".", color=colour, ms=4, alpha=0.5, mew=0)
                axes.plot([np.nanmean(values)] * 2, [row - 0.32, row + 0.32], color=colour, lw=1.6)
        share, ends = table.spans.mean(), np.array([[spans[name].least], [spans[name].most]])
        panels[1].errorbar(share, row, xerr=np.abs(ends - share), fmt="o", color=colour, ms=4, capsize=2)
    panels[0].set_yticks(rows, list(tables))
    panels[0].set_xlabel(r"$P_\mathrm{min} / P_\mathrm{cut}$")
    panels[1].set(xlabel="samples that span", xlim=(-0.04, 1.04))
    panels[2].set_xlabel("slipless contacts")
    panels[3].set_xlabel("decades of power")
    figure.suptitle("blue: contact states proven; grey: minima tie")
    return figure


@in_our_style
def draw_drivings(axes_of: Sequence[Any], rates: Mapping[float, Any]) -> Figure:
    """(a) share of the slipless contacts that two axes have in common, (b) P_min / P_cut; both against the angle, and
    (c) that share with and without C, against C: dots are samples, the line is their mean.

    axes_of : the samples of paper.drivings for each axis, by its angle with x. rates : by C, over A_x over the lattice
    spacing, rising.
    """
    figure = new_figure(7.1, 2.5)
    panels: Any = figure.subplots(1, 3)
    angle = [table.angle[0] for table in axes_of]
    for axes, x, tables, column in (
        (panels[0], angle, axes_of, "overlap"),
        (panels[1], angle, axes_of, "power_over_cut"),
        (panels[2], list(rates), list(rates.values()), "overlap"),
    ):
        values = np.array([getattr(table, column) for table in tables])
        axes.plot(x, values, ".", color=BLUE, ms=4, alpha=0.35, mew=0)
        axes.plot(x, values.mean(axis=1), "o-", color=BLUE, ms=4, lw=1.2)
        axes.axhline(1.0, color=GREY, lw=0.8)
        axes.set(xlabel="axis of the spins, degrees from x", ylabel="slipless in both / in either")
    for axes in panels[:2]:
        axes.set_xticks(range(0, 91, 30))
    panels[1].set_ylabel(r"$P_\mathrm{min} / P_\mathrm{cut}$")
    panels[2].set(xlabel=r"$2 R C / A_x$", xscale="log")
    panels[0].set_title("(a) network beside that at 45°")
    panels[1].set_title("(b) least power")
    panels[2].set_title("(c) network beside that at C = 0")
    return figure
