"""The slipless network in three dimensions: what the paper says of Figs. 3 and 4, over samples and sizes.

What counts as large, 24^3, was chosen after seeing which sizes span.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.analysis.structure import LatticeStructure
from taichi_bearings.lattice import Lattice
from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, GREY, ORANGE, in_our_style, new_figure
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.settings import RunSettings

from .claims import Effort
from .drawing import draw_means, name_sizes
from .samples import Found, Table, measured, told

SHARE_OF_SAMPLES = {3: 1.0, 4: 1.0, 6: 0.5, 8: 0.25, 10: 0.2, 16: 0.1, 24: 0.025, 32: 0.025}
"""Side of the cube -> samples of it, as a share of those that a claim may take."""
BULK, LARGE = 10, 24  # sides: the paper's own, and from which on most samples must span
PRACTICALLY_ALL = 0.99  # of the free spheres
Views = Mapping[int, Mapping[str, np.ndarray]]
"""Side -> numbers of `view_of` (samples, thresholds + 1): by each of THRESHOLDS, and by contact states."""
THRESHOLDS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Slips over R times the imposed jump, which is the largest slip there can be."""
THRESHOLD = r"slip threshold, $|v|\,/\,(R\,|\Delta\omega|)$"
COARSE = ("#f2c14e", "#e07a5f", "#b56576")  # of the first thresholds


def study(folder: Path, effort: Effort) -> Found:
    """Certified samples of all sizes."""
    chosen = [
        RunSettings(shape=(side, side, side), seed=effort.seed + number)
        for side, share in SHARE_OF_SAMPLES.items()
        for number in range(int(share * effort.samples))
    ]
    found = measured(chosen, numbers_of, folder / "network.jsonl")
    table = Table.of([of["sample"] for of in found])
    views = {
        side: by_threshold([of["views"] for of in found if of["sample"]["side"] == side]) for side in table.by("side")
    }
    return Found({".csv": table}, partial(draw_sizes, table, views), names_of(table, views))


def names_of(table: Table, views: Views) -> dict[str, Any]:
    """What the claims name."""
    bulk = table[table.side >= BULK]
    return {
        "table": table, "views": views, "side_of_bulk": BULK, "side_of_large": LARGE, "practically": PRACTICALLY_ALL,
        "bulk": bulk, "spanning": bulk[bulk.spans], "large": table[table.side >= LARGE], "thresholds": THRESHOLDS,
    }  # fmt: skip


def numbers_of(structure: LatticeStructure) -> dict[str, Any]:
    """The numbers of one sample, and what thresholds and then contact states show of it."""
    return {"sample": sample_of(structure), "views": [*views_by_threshold(structure), view_of(structure)]}


def view_of(structure: LatticeStructure) -> dict[str, Any]:
    """Network and domains in a few numbers: slipless contacts, whether their network spans, shares of the free spheres,
    rigid domains, spheres of the largest one that is not locked to one plane."""
    return {
        "slipless": len(structure.network.axis),
        "spans": structure.network.spans,
        "reached_fraction": structure.network.reached_fraction,
        "spanning_fraction": structure.network.spanning_fraction,
        "domains": structure.rigid_domains.number,
        "largest_intermediate": structure.rigid_domains.largest_intermediate,
    }


def views_by_threshold(structure: LatticeStructure) -> list[dict[str, Any]]:
    """The same for each of THRESHOLDS: what a solver would have seen that cannot tell tiny slips from none.

    At the minimum of a large sample the slips span many decades, so a coarse threshold merges slipping contacts into
    the network and domains into each other.
    """
    views: dict[int, dict[str, Any]] = {}
    chosen = []
    for threshold in THRESHOLDS:
        seen = structure.by_threshold(threshold * (structure.scene.lattice.radius * structure.scene.jump))
        count = seen.contacts_in(ContactState.SLIPLESS)  # the sets are nested: the same number, the same set
        if count not in views:
            views[count] = view_of(seen)
        chosen.append(views[count])
    return chosen


def by_threshold(views: Sequence[Sequence[Mapping[str, Any]]]) -> dict[str, np.ndarray]:
    return {name: np.array([[float(seen[name]) for seen in sample] for sample in views]) for name in views[0][-1]}


def sample_of(structure: LatticeStructure) -> dict[str, Any]:
    """The numbers of one sample. reached_by_chance : by as many contacts at random places."""
    scene, network = structure.scene, structure.network
    analysed = ("spanning_fraction", "domains", "disjoint_paths", "effective_links", "parting_links")
    shared = told(structure, *analysed)
    planes_x, planes_y = network.path_planes
    return {
        "side": scene.lattice.shape[0],
        "seed": scene.seeds[0],
        "power": structure.power,
        **shared,
        "unique": structure.minimum_is_unique is True,
        "reached_by_chance": reached_by_chance(scene.lattice, shared["slipless_fraction"]),
        "intermediate": intermediate_share(structure),
        "largest_intermediate": structure.rigid_domains.largest_intermediate,
        "shortest_path": max(len(network.shortest_path) - 1, 0),
        "planes_x": planes_x,
        "planes_y": planes_y,
        "busiest_link_share": float(structure.bottlenecks.share.max(initial=0.0)),
        "plane_spans": bool(any(spans_within_planes(network, axis).any() for axis in (0, 1))),
    }


def intermediate_share(structure: LatticeStructure) -> float:
    """Share of the free spheres that are not locked to a driven plane in all components."""
    free = ~structure.scene.lattice.is_driven
    locked = structure.rigid_domains.spheres_of_kind(free)
    return 1 - (locked["bottom"] + locked["top"]) / int(free.sum())


def spans_within_planes(network: SliplessNetwork, axis: int) -> np.ndarray:
    """For each lattice plane across `axis`: True if its slipless contacts alone join bottom and top."""
    inside, plane = network.axis != axis, network.contact[:, axis]
    pieces = [network.pieces(inside & (plane == index)) for index in range(network.lattice.shape[axis])]
    return np.array([label[0] == label[-1] for label in pieces])


def reached_by_chance(lattice: Lattice, density: float) -> float:
    """Share of the free spheres that contacts touch of which each is there with probability `density`, in the mean."""
    contacts = np.bincount(lattice.ends.ravel(), minlength=lattice.is_driven.size)  # of each sphere
    return float((1 - (1 - density) ** contacts[~lattice.is_driven.ravel()]).mean())


@in_our_style
def draw_sizes(table: Any, by_threshold: Mapping[int, Mapping[str, np.ndarray]]) -> Figure:
    """Power over that of the minimum cut, network, domains and paths against the side; what thresholds make of them.

    table : the samples. by_threshold : side -> numbers (samples, thresholds + 1) by name, the last
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
        draw_means(panel, of.by(name), color=colour, ms=4, lw=1, capsize=2, label=label)
    sides = sorted(by_threshold)
    _spanning(axes[0, 2], sides, [by_threshold[side]["spans"] for side in sides])
    for panel in (*axes[0], *axes[1, :2]):
        name_sizes(panel, sides, "side of the cube, $L$")
        panel.legend()
    axes[0, 0].set_ylabel("least power over minimum cut")
    axes[0, 1].set(ylabel="share", ylim=(0, 1.04))
    axes[1, 0].set(yscale="symlog", ylim=(0, 2000), ylabel="number")
    axes[1, 0].legend(loc="upper left")
    axes[0, 2].legend(loc="upper left")
    axes[1, 1].set(ylim=(0, None), ylabel="spheres")
    _by_threshold(axes[1, 2], sides[-1], by_threshold[sides[-1]])
    return figure


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
