"""Asks what of the paper's picture survives in large samples: shares, networks and domains, extrapolated in the side.

The scans in examples/studies have the samples, and anybody can start them alone: the paper's bearing from 4^3 to 48^3,
and beside it, one thing at a time, periodic sides, another state of the top, a rate C, other distributions of friction.
Every share q is taken to its limit by q(L) = q_inf + a L^-w (:func:`.fits.limit`): the driven planes and the free
sides are a share 1/L of a sample, so w = 1 is stated and not fitted.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, ORANGE, in_our_style, new_figure
from taichi_bearings.runs.settings import RunSettings

from .claims import Effort
from .drawing import draw_means, draw_row, name_sizes
from .fits import Limit, limit
from .network import LARGE, sample_of
from .samples import Found, Table, measured, planned

QUICK = {"limits": 16, "limits-variants": 16, "limits-rate": 16, "limits-large": 24, "limits-largest": 32}
"""Scans, and the largest side of their samples in the quick form."""
PAPER, PERIODIC = "as in the paper", "periodic sides"
WEAK, BROAD = ("uniform:0.5,1", "uniform:0.9,1"), ("lognormal:0.4,1", "power-law:0.001,1,-1", "bimodal:0.1,1,0.5")
OF_ALL = ("power_over_cut", "slipless_fraction", "intermediate", "domains_a_sphere", "largest_share")
OF_SPANNING = ("path_over_height", "busiest_link_share")
COLUMNS = ("value", "error", "systematic", "smallest", "sizes", "goodness", "amplitude", "follows")  # from a Limit


def study(folder: Path, effort: Effort) -> Found:
    """Find certified samples of all scans, and the limits of their shares."""
    settings = list(planned(QUICK, effort))
    found = measured(settings, sample_of, folder / "limits.jsonl")
    table = with_ratios(Table({"system": [system_of(of) for of in settings], **found.columns}))
    of_systems = {name: table[table.system == name] for name in dict.fromkeys(table.system.tolist())}
    limits = {name: limits_of(of) for name, of in of_systems.items()}
    rows = [
        {"system": system, "quantity": quantity} | {name: getattr(of, name) for name in COLUMNS}
        for system, of_system in limits.items()
        for quantity, of in of_system.items()
    ]
    return Found({".csv": table, "-limits.csv": Table.of(rows)}, draw_limits, names_of(of_systems, limits))


def with_ratios(table: Table) -> Table:
    """Return the table with the shares whose limits are asked for.

    They are rigid domains, and spheres of the largest intermediate one, over all spheres; contacts of the shortest path
    over the height.
    """
    spheres = table.side**3
    return table | {
        "domains_a_sphere": table.domains / spheres,
        "largest_share": table.largest_intermediate / spheres,
        "path_over_height": table.shortest_path / (table.side - 1),
    }


def limits_of(table: Table) -> dict[str, Limit]:
    """Return the limit of each quantity over samples of one system, where there are enough."""
    spanning = table[table.spans]
    found = {name: limit(table.by(name)) for name in OF_ALL} | {name: limit(spanning.by(name)) for name in OF_SPANNING}
    return {name: of for name, of in found.items() if of is not None}


def names_of(of_systems: Mapping[str, Table], limits: Mapping[str, Mapping[str, Limit]]) -> dict[str, Any]:
    """Return the values that the claims use, by name.

    of_systems : samples of each system. limits : the limits of its shares.

    variants : samples of each other system, of the largest size that all have. beside : those of the paper's bearing.
    """
    paper = of_systems[PAPER]
    common = min(of.side.max() for of in of_systems.values())
    return {
        "paper": paper, "large": paper[paper.side >= LARGE], "large_side": LARGE, "spanning": paper[paper.spans],
        "limits": limits[PAPER], "periodic": limits.get(PERIODIC, {}), "closed_name": PERIODIC, "weak": WEAK,
        "common": int(common), "beside": paper[paper.side == common],
        "variants": {name: of[of.side == common] for name, of in of_systems.items() if name != PAPER},
        "broad": [name for name in BROAD if name in of_systems], "of_systems": of_systems, "limits_of": limits,
    }  # fmt: skip


def system_of(settings: RunSettings) -> str:
    """Return what differs from the paper's bearing, in words."""
    _, y, _, rate = settings.top or (1.0, 1.0, 0.0, 0.0)
    words = {
        PERIODIC: settings.periodic, f"state (1, {y:g})": y != 1, "C (L - 1) = 1": rate,
        settings.distribution: settings.distribution != RunSettings().distribution,
    }  # fmt: skip
    return ", ".join(word for word, differs in words.items() if differs) or PAPER


@in_our_style
def draw_limits(named: Any) -> Figure:
    """Draw how shares, spanning samples and paths depend on the size.

    (a, b, c) Shares against 1/L of the first system and of the second one, with the fitted laws and, at 1/L = 0, their
    limits with all errors; (d) samples that span, (e) shortest paths and busiest links against L, of the first system;
    (f) least power of all systems over that of the cut, at the largest size that all have.
    """
    of_systems, figure = named.of_systems, new_figure(DOUBLE, 4.6)
    panels: Any = figure.subplots(2, 3).ravel()
    shares = {
        "power_over_cut": r"$P_\mathrm{min} / P_\mathrm{cut}$",
        "slipless_fraction": "slipless contacts / all",
        "domains_a_sphere": "rigid domains / spheres",
    }
    for axes, letter, (name, label) in zip(panels, "abc", shares.items(), strict=False):
        for system, colour in zip(of_systems, (BLUE, ORANGE), strict=False):
            found = of_systems[system].by(name)
            draw_means(axes, found, 1 / np.array(list(found)), fmt="o", color=colour, label=system)
            _draw_limit(axes, named.limits_of[system].get(name), colour)
        axes.set(xlabel="$1/L$", xlim=(-0.01, 0.26), ylabel=label)
        axes.set_title(f"({letter})")
    panels[0].legend(loc="lower right")
    paper, spanning = named.paper, named.spanning
    for system, colour in zip(of_systems, (BLUE, ORANGE), strict=False):
        draw_means(panels[3], of_systems[system].by("spans"), color=colour, label=system)
    draw_means(panels[4], spanning.by("path_over_height"), color=BLUE, label="shortest path / height")
    draw_means(panels[4], paper.by("disjoint_paths"), color=GREEN, label="disjoint paths")
    draw_means(panels[4], spanning.by("busiest_link_share"), color=ORANGE, label="share of the busiest link")
    for axes in panels[3:5]:
        name_sizes(axes, list(paper.by("side")), "$L$")
    panels[3].set(ylabel="samples that span", ylim=(-0.03, 1.04), title="(d)")
    panels[4].set(yscale="symlog", ylim=(0, 300), title="(e)")
    panels[4].set_yticks([0, 1, 3, 10, 30], ["0", "1", "3", "10", "30"])
    panels[4].legend(loc="upper left")
    for row, of in enumerate(reversed(list(of_systems.values()))):
        draw_row(panels[5], row, of.power_over_cut[of.side == named.common], BLUE)
    panels[5].set_yticks(range(len(of_systems)), list(of_systems)[::-1])
    panels[5].set(xlabel=r"$P_\mathrm{min} / P_\mathrm{cut}$", title=f"(f) $L = {named.common}$")
    return figure


def _draw_limit(axes: Any, limit: Limit | None, colour: str) -> None:
    """Draw a fitted law and its limit, if the samples follow one."""
    if limit is not None and limit.follows:
        x = np.array([0, 1 / limit.smallest])
        axes.plot(x, limit.value + limit.amplitude * x, color=colour, lw=0.8)
        axes.errorbar(0, limit.value, limit.total, fmt="s", ms=3, lw=0.8, capsize=2, mfc="white", color=colour)
