"""The slipless network in three dimensions: what the paper says of Figs. 3 and 4, over samples and sizes.

The network consists of the slipless contacts, whose spheres roll on each other. It spans if it joins bottom and top.
Samples of 24^3 and more are called large; that was chosen after seeing which sizes span.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.lattice import Lattice
from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, GREY, ORANGE, in_our_style, new_figure
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import ANALYSED
from taichi_bearings.runs.settings import RunSettings

from .claims import Effort
from .drawing import draw_means, name_sizes
from .samples import StudyResult, Table, measured, shared_numbers

SHARE_OF_SAMPLES = {3: 1.0, 4: 1.0, 6: 0.5, 8: 0.25, 10: 0.2, 16: 0.1, 24: 0.025, 32: 0.025}
"""For each side of the cube, the number of samples as a share of those of the effort."""
BULK, LARGE = 10, 24  # sides: the paper's own, and from which on most samples must span
PRACTICALLY_ALL = 0.99  # share of the free spheres
THRESHOLDS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Slips over R times the imposed jump, which is the largest slip there can be."""
THRESHOLD = r"slip threshold, $|v|\,/\,(R\,|\Delta\omega|)$"
COARSE = ("#f2c14e", "#e07a5f", "#b56576")  # colours of the first thresholds
VIEWED: dict[str, Callable[[Structure], Any]] = {
    "slipless": lambda structure: structure.contacts_in(ContactState.SLIPLESS),
    **{name: ANALYSED[name].of for name in ("spans", "reached_fraction", "spanning_fraction", "domains")},
    "largest_intermediate": ANALYSED["largest_intermediate_domain"].of,
}
"""Numbers of network and domains that are compared between thresholds, and functions that return them."""


def study(folder: Path, effort: Effort) -> StudyResult:
    """Solve cubes of several sizes, each sample to its certified minimum. Return table, figure and values for the
    claims.

    folder : folder where finished samples are kept until the study ends.
    effort : first seed and number of samples.
    """
    chosen = [
        RunSettings(shape=(side, side, side), seed=seed)
        for side, share in SHARE_OF_SAMPLES.items()
        for seed in effort.seeds(int(share * effort.samples))
    ]
    table = measured(chosen, numbers_of, folder / "network.jsonl")
    return StudyResult({".csv": table}, draw_sizes, names_of(table))


def names_of(table: Table) -> dict[str, Any]:
    """Return the values that the figure and the claims use, by name.

    table : a row for each sample.

    `bulk`: samples of the paper's size and larger; `spanning`: those of them whose slipless contacts join bottom and
    top; `large`: samples of LARGE spheres a side and more; `viewed`: names of the numbers that are compared between
    thresholds.
    """
    bulk = table[table.side >= BULK]
    return {
        "table": table, "side_of_bulk": BULK, "side_of_large": LARGE, "practically": PRACTICALLY_ALL, "bulk": bulk,
        "spanning": bulk[bulk.spans], "large": table[table.side >= LARGE], "thresholds": THRESHOLDS,
        "viewed": tuple(VIEWED),
    }  # fmt: skip


def numbers_of(structure: Structure) -> dict[str, Any]:
    """Return the columns of one sample by name: numbers of its network at the minimum and, for some of them (VIEWED), a
    list NAME_seen.

    structure : network, domains, cut and bottlenecks of the sample.

    The list has, for each of THRESHOLDS, the number that would be found if contacts with a smaller slip were taken for
    slipless; its last entry is by the proven contact states. At the minimum of a large sample the slips span many
    decades, so a coarse threshold adds slipping contacts to the network and merges domains.
    """
    unit = structure.scene.slip_radius * structure.scene.jump
    seen = [*(structure.by_threshold(threshold * unit) for threshold in THRESHOLDS), structure]
    # sets of slipless contacts are nested, so sets of the same size are equal and are looked at once
    sizes = [of.contacts_in(ContactState.SLIPLESS) for of in seen]
    different = dict(zip(sizes, seen, strict=True))
    views = {size: {name: float(look(of)) for name, look in VIEWED.items()} for size, of in different.items()}
    return sample_of(structure) | {f"{name}_seen": [views[size][name] for size in sizes] for name in VIEWED}


def sample_of(structure: Structure) -> dict[str, Any]:
    """Return the columns of one sample at its minimum, by name.

    structure : network, domains, cut and bottlenecks of the sample.

    The columns of :func:`.samples.shared_numbers` are followed by:

    unique : True if the minimum is proven to be the only one.
    reached_by_chance : share of the free spheres that as many contacts at random places would touch.
    shortest_path : contacts of the shortest slipless path from bottom to top; 0 without one.
    planes_x, planes_y : numbers of lattice planes across x and across y that the path goes through.
    busiest_link_share : the largest share of shortest paths that use one contact.
    plane_spans : True if the slipless contacts of a single upright lattice plane join bottom and top.
    """
    network, bottlenecks = structure.network, structure.bottlenecks
    assert bottlenecks is not None  # as a lattice has two planes
    analysed = ("spanning_fraction", "domains", "disjoint_paths", "effective_links", "parting_links")
    shared = shared_numbers(structure, *analysed)
    planes_x, planes_y = network.path_planes
    return shared | {
        "unique": structure.minimum_is_unique is True,
        "reached_by_chance": reached_by_chance(network.lattice, shared["slipless_fraction"]),
        "shortest_path": max(len(network.shortest_path) - 1, 0),
        "planes_x": planes_x,
        "planes_y": planes_y,
        "busiest_link_share": float(bottlenecks.share.max(initial=0.0)),
        "plane_spans": bool(any(spans_within_planes(network, axis).any() for axis in (0, 1))),
    }


def spans_within_planes(network: SliplessNetwork, axis: int) -> np.ndarray:
    """Return a mask (planes,) of the lattice planes across an axis: True if the slipless contacts within a plane join
    bottom and top.

    network : the slipless contacts of a lattice.
    axis : number of the axis.
    """
    inside, plane = network.axis != axis, network.contact[:, axis]
    pieces = [network.pieces(inside & (plane == index)) for index in range(network.lattice.shape[axis])]
    return np.array([label[0] == label[-1] for label in pieces])


def reached_by_chance(lattice: Lattice, density: float) -> float:
    """Return the expected share of free spheres that are touched by a contact, if each contact of the lattice is
    present with probability `density`.
    """
    degree = np.bincount(lattice.ends.ravel(), minlength=lattice.is_driven.size)
    return float((1 - (1 - density) ** degree[~lattice.is_driven.ravel()]).mean())


@in_our_style
def draw_sizes(named: Any) -> Figure:
    """Draw the figure, six panels.

    named : the values of :func:`names_of` as attributes. Used is `table`, with a row for each sample and the columns of
        :func:`numbers_of`.

    Against the side of the cube: least power over that of the minimum cut; shares of spheres and contacts; share of
    samples that span; paths; spheres of the largest domain that is locked to no driven plane. The last panel shows what
    slip thresholds make of the largest cubes.
    """
    table, figure = named.table, new_figure(DOUBLE, 4.9)
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
    sides = list(table.by("side"))
    _draw_spanning(axes[0, 2], sides, list(table.by("spans_seen").values()))
    for panel in (*axes[0], *axes[1, :2]):
        name_sizes(panel, sides, "side of the cube, $L$")
        panel.legend()
    axes[0, 0].set_ylabel("least power over minimum cut")
    axes[0, 1].set(ylabel="share", ylim=(0, 1.04))
    axes[1, 0].set(yscale="symlog", ylim=(0, 2000), ylabel="number")
    axes[1, 0].legend(loc="upper left")
    axes[0, 2].legend(loc="upper left")
    axes[1, 1].set(ylim=(0, None), ylabel="spheres")
    _draw_by_threshold(axes[1, 2], table[table.side == sides[-1]])
    return figure


def _draw_spanning(axes: Any, sides: Sequence[int], spans: Sequence[np.ndarray]) -> None:
    """Draw against the size the share of samples whose slipless contacts join bottom and top: by the proven contact
    states, and if contacts slower than some threshold are taken for slipless.

    axes : where it is drawn.
    sides : sides of the cubes.
    spans : for each side (samples, thresholds + 1), True where bottom and top are joined; the last column is by the
        proven states.
    """
    share = np.array([of.mean(axis=0) for of in spans])
    for place, colour in enumerate(COARSE):
        axes.plot(sides, share[:, place], "o--", ms=3.5, lw=1, color=colour, label=f"slips below {THRESHOLDS[place]:g}")
    error = np.sqrt(share[:, -1] * (1 - share[:, -1]) / [len(of) for of in spans])
    axes.errorbar(sides, share[:, -1], error, fmt="o-", color=GREEN, ms=4, lw=1.4, capsize=2, label="certified states")
    axes.set(ylabel="samples that span", ylim=(-0.03, 1.04))


def _draw_by_threshold(axes: Any, largest: Any) -> None:
    """Draw numbers of the slipless network and of rigid domains, means over samples, against the slip threshold below
    which contacts are taken for slipless.

    axes : where it is drawn.
    largest : table of the largest cubes, with columns NAME_seen (samples, thresholds + 1); the last number is by the
        certified states.
    """
    for name, colour, label in (
        ("slipless", ORANGE, "slipless contacts"),
        ("domains", BLUE, "rigid domains"),
        ("largest_intermediate", GREEN, "largest intermediate"),
    ):
        values = largest.columns[f"{name}_seen"].mean(axis=0)
        axes.loglog(THRESHOLDS, values[:-1], "o-", color=colour, ms=3.5, label=label)
        axes.axhline(values[-1], color=colour, lw=0.8, ls="--")
    axes.set(xlabel=THRESHOLD, ylabel="number")
    axes.set_title(f"$L = {largest.side[0]}$; dashed: certified")
    axes.legend()
