"""Asks how the results of the paper change with the size of the sample, and what they become in infinitely large ones.

The samples are those of the scan files limits*.toml in examples/studies: the paper's bearing with sides from 4 to 48
spheres, and systems that differ from it in one thing: periodic sides, another axis of the top, a rate C (the spin of
the top changes with the place), or another distribution of friction.

A quantity q that is a share is extrapolated in the side L by q(L) = q_inf + a L^-w (:func:`.fits.limit`) with w = 1,
which is not fitted: driven planes and free sides are a share 1/L of a sample.
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
from .samples import StudyResult, Table, measured, planned

QUICK = {"limits": 16, "limits-variants": 16, "limits-rate": 16, "limits-large": 24, "limits-largest": 32}
"""The scan files by name, and the largest side of their samples that the quick form takes."""
PAPER, PERIODIC = "as in the paper", "periodic sides"  # names of systems
WEAK, BROAD = ("uniform:0.5,1", "uniform:0.9,1"), ("lognormal:0.4,1", "power-law:0.001,1,-1", "bimodal:0.1,1,0.5")
# quantities that are extrapolated: of all samples, and of those whose slipless contacts join bottom and top
OF_ALL = ("power_over_cut", "slipless_fraction", "intermediate", "domains_a_sphere", "largest_share")
OF_SPANNING = ("path_over_height", "busiest_link_share")
# attributes of a Limit that are written to the table
COLUMNS = ("value", "error", "systematic", "smallest", "sizes", "goodness", "amplitude", "follows")


def study(folder: Path, effort: Effort) -> StudyResult:
    """Solve the samples of all scans, extrapolate their shares to infinite size, and return tables, figure and values
    for the claims.

    folder : folder where finished samples are kept until the study ends.
    effort : first seed, number of samples, and whether it is the quick form.
    """
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
    return StudyResult({".csv": table, "-limits.csv": Table.of(rows)}, draw_limits, names_of(of_systems, limits))


def with_ratios(table: Table) -> Table:
    """Return the table with three columns more: rigid domains over spheres (`domains_a_sphere`), spheres of the
    largest domain that is locked to no driven plane over all spheres (`largest_share`), and contacts of the
    shortest slipless path over the height (`path_over_height`).
    """
    spheres = table.side**3
    return table | {
        "domains_a_sphere": table.domains / spheres,
        "largest_share": table.largest_intermediate / spheres,
        "path_over_height": table.shortest_path / (table.side - 1),
    }


def limits_of(table: Table) -> dict[str, Limit]:
    """Return for each quantity its value extrapolated to infinite size. A quantity is left out if fewer than three
    sizes have enough samples.

    table : samples of one system, with several sizes. Quantities of paths from bottom to top (OF_SPANNING) are taken
        only from samples in which slipless contacts join the two.
    """
    spanning = table[table.spans]
    found = {name: limit(table.by(name)) for name in OF_ALL} | {name: limit(spanning.by(name)) for name in OF_SPANNING}
    return {name: of for name, of in found.items() if of is not None}


def names_of(of_systems: Mapping[str, Table], limits: Mapping[str, Mapping[str, Limit]]) -> dict[str, Any]:
    """Return the values that the figure and the claims use, by name.

    of_systems : for each system (kind of bearing, such as the paper's) the table of its samples.
    limits : for each system and quantity the extrapolated value.

    Samples of the paper's bearing: `paper`, all; `large`, with at least LARGE spheres a side; `spanning`, whose
    slipless contacts join bottom and top; `beside`, with the side `common`, the largest that all systems have. Samples
    of each other system with this side are in `variants`, by its name.
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
    """Return in words how a sample with these settings differs from the paper's bearing, or "as in the paper"."""
    _, y, _, rate = settings.top or (1.0, 1.0, 0.0, 0.0)
    words = {
        PERIODIC: settings.periodic, f"state (1, {y:g})": y != 1, "C (L - 1) = 1": rate,
        settings.distribution: settings.distribution != RunSettings().distribution,
    }  # fmt: skip
    return ", ".join(word for word, differs in words.items() if differs) or PAPER


@in_our_style
def draw_limits(named: Any) -> Figure:
    """Draw the figure in six panels, for cubes of side L.

    named : the values of `names_of` as attributes. Used are `of_systems`: by name of a system (lattice, driving and
        friction) the table of its samples; `limits_of`: by system and quantity its extrapolation to infinite size;
        `paper` and `spanning`: tables of the samples of the paper's bearing, all of them and those whose slipless
        contacts join bottom and top; `common`, the largest side that all systems have.

    (a, b, c) Three shares against 1/L, for the first two systems: means, fitted lines, and the extrapolated values with
    all errors at 1/L = 0.
    (d) Share of the samples whose slipless contacts join bottom and top, against L.
    (e) Shortest path, number of disjoint paths and busiest contact of the paper's bearing, against L.
    (f) Least power over that of the minimum cut, for each system at the largest side that all have.
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
    """Draw the fitted line of a limit, and the extrapolated value with its error at 1/L = 0; nothing if there is no
    limit or the samples do not follow the law.

    axes : panel of matplotlib.
    limit : the fit of value + amplitude / L to the sizes L, or None.
    colour : colour of line and value.
    """
    if limit is not None and limit.follows:
        x = np.array([0, 1 / limit.smallest])
        axes.plot(x, limit.value + limit.amplitude * x, color=colour, lw=0.8)
        axes.errorbar(0, limit.value, limit.total, fmt="s", ms=3, lw=0.8, capsize=2, mfc="white", color=colour)
