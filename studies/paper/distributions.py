"""Other distributions of the friction coefficients in three dimensions: what of the paper's findings holds for them.

In two dimensions the least power is the minimum cut's whatever the distribution: `fig1`. Equal coefficients, or two
values, leave minima that tie; then the slipless network of the state found is one of many, and it is not judged.
"""

from collections.abc import Mapping
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import Structure
from taichi_bearings.plots.style import BLUE, GREY, in_our_style, new_figure
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.settings import RunSettings

from .claims import Effort, Share
from .network import BULK, PRACTICALLY_ALL
from .samples import Found, Table, joined, measured, told

SPREAD = ("uniform:0.1,1", "uniform:0.5,1", "uniform:0.9,1", "lognormal:0.4,1", "power-law:0.001,1,-1")
"""Distributions whose values all differ; the first is the paper's."""
TIED = ("bimodal:0.1,1,0.5",)
EQUAL = "constant:0.5"
SHARE_OF_SAMPLES = 0.25


def study(folder: Path, effort: Effort) -> Found:
    """Certified samples of each distribution."""
    seeds = range(effort.seed, effort.seed + max(1, int(SHARE_OF_SAMPLES * effort.samples)))
    names = (*SPREAD, *TIED, EQUAL)
    chosen = [RunSettings(shape=(BULK,) * 3, seed=seed, distribution=name) for name, seed in product(names, seeds)]
    numbers = measured(chosen, numbers_of, folder / "distributions.jsonl")
    rows = [{"seed": settings.seed} | found for settings, found in zip(chosen, numbers, strict=True)]
    found = {name: Table.of(rows[k * len(seeds) : (k + 1) * len(seeds)]) for k, name in enumerate(names)}
    spans = {name: Share.of(table.spans) for name, table in found.items()}
    return Found({".csv": joined(found, "distribution")}, partial(draw_distributions, found, spans), names_of(found))


def numbers_of(structure: Structure) -> dict[str, Any]:
    """decades : of power of the contacts that slip, None where that is not proven."""
    scene = structure.scene
    power = scene.law.power(scene.contact, structure.slip[None])[0][structure.state == ContactState.SLIPPING]
    power = power[power > 0]
    decades = float(np.log10(power.max() / power.min())) if structure.states_proven else None
    return told(structure) | {"decades": decades}


def names_of(found: Mapping[str, Table]) -> dict[str, Any]:
    """What the claims name; judged : samples whose contact states are proven, of the distributions whose values all
    differ."""
    return {
        "bulk": BULK, "practically": PRACTICALLY_ALL, "paper_name": SPREAD[0],
        "equal_name": EQUAL, "equal": found[EQUAL],
        "random": {name: table for name, table in found.items() if name != EQUAL},
        "judged": {name: found[name][found[name].states_proven] for name in SPREAD},
    }  # fmt: skip


@in_our_style
def draw_distributions(tables: Mapping[str, Any], spans: Mapping[str, Any]) -> Figure:
    """P_min / P_cut, samples that span, slipless contacts and decades of power, a row a distribution.

    tables, spans : the samples and the shares of them that join bottom and top, by distribution.
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
