"""Shares, networks and domains of samples of all sizes, and the limits of large ones."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, ORANGE, in_our_style, new_figure

from .minima import mean_and_error


@in_our_style
def draw_limits(of_systems: Mapping[str, Any], limits: Mapping[str, Mapping[str, Any]]) -> Figure:
    """(a, b, c) shares against 1/L of the first system and of the second one, with the fitted laws and, at 1/L = 0,
    their limits with all errors; (d) samples that span, (e) shortest paths and busiest links against L, of the first
    system; (f) least power of all systems over that of the cut, at the largest size that all have.

    of_systems, limits : samples and limits of paper.limits by the system, in its order.
    """
    figure = new_figure(DOUBLE, 4.6)
    panels: Any = figure.subplots(2, 3).ravel()
    shares = {
        "power_over_cut": r"$P_\mathrm{min} / P_\mathrm{cut}$",
        "slipless_fraction": "slipless contacts / all",
        "domains_a_sphere": "rigid domains / spheres",
    }
    for axes, letter, (name, label) in zip(panels, "abc", shares.items(), strict=False):
        for system, colour in zip(of_systems, (BLUE, ORANGE), strict=False):
            _towards_limit(axes, of_systems[system].by(name), limits[system].get(name), colour, system)
        axes.set(xlabel="$1/L$", xlim=(-0.01, 0.26), ylabel=label)
        axes.set_title(f"({letter})")
    panels[0].legend(loc="lower right")
    paper = next(iter(of_systems.values()))
    spanning = paper[paper.spans]
    for system, colour in zip(of_systems, (BLUE, ORANGE), strict=False):
        _against_size(panels[3], of_systems[system].by("spans"), colour, system)
    _against_size(panels[4], spanning.by("path_over_height"), BLUE, "shortest path / height")
    _against_size(panels[4], paper.by("disjoint_paths"), GREEN, "disjoint paths")
    _against_size(panels[4], spanning.by("busiest_link_share"), ORANGE, "share of the busiest link")
    for axes in panels[3:5]:
        axes.set(xscale="log", xlabel="$L$")
        axes.set_xticks(sizes := list(paper.by("side")), list(map(str, sizes)))
        axes.minorticks_off()
    panels[3].set(ylabel="samples that span", ylim=(-0.03, 1.04), title="(d)")
    panels[4].set(yscale="symlog", ylim=(0, 60), title="(e)")
    panels[4].set_yticks([0, 1, 3, 10, 30], ["0", "1", "3", "10", "30"])
    panels[4].legend(loc="upper left")
    common = min(of.side.max() for of in of_systems.values())
    for row, of in enumerate(reversed(list(of_systems.values()))):
        values = of.power_over_cut[of.side == common]
        panels[5].plot(values, row + np.linspace(-0.22, 0.22, len(values)), ".", color=BLUE, ms=3, alpha=0.4, mew=0)
        panels[5].plot([values.mean()] * 2, [row - 0.32, row + 0.32], color=BLUE, lw=1.6)
    panels[5].set_yticks(range(len(of_systems)), list(of_systems)[::-1])
    panels[5].set(xlabel=r"$P_\mathrm{min} / P_\mathrm{cut}$", title=f"(f) $L = {common}$")
    return figure


def _towards_limit(axes: Any, found: Mapping[int, np.ndarray], limit: Any, colour: str, label: str) -> None:
    mean, error = mean_and_error(found.values())
    axes.errorbar(1 / np.array(list(found)), mean, error, fmt="o", ms=3, lw=0.8, color=colour, label=label)
    if limit is not None and limit.follows:
        x = np.array([0, 1 / limit.smallest])
        axes.plot(x, limit.value + limit.amplitude * x, color=colour, lw=0.8)
        axes.errorbar(0, limit.value, limit.total, fmt="s", ms=3, lw=0.8, capsize=2, mfc="white", color=colour)


def _against_size(axes: Any, found: Mapping[int, np.ndarray], colour: str, label: str) -> None:
    mean, error = mean_and_error(found.values())
    axes.errorbar(list(found), mean, error, fmt="o-", ms=3, lw=0.8, color=colour, label=label)
