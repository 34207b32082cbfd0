"""Other friction, and other imposed bearing states: which of the paper's findings in three dimensions hold for them.

In two dimensions the least power is the minimum cut's whatever the distribution of the friction coefficients: `fig1`.
Equal coefficients, or two values, leave minima that tie; then the slipless network of the state found is one of many,
and it is not judged.

The planes have two constant staggered spins, and P depends on differences of staggered spins alone. So only the jump
between the two matters. Its length is a factor of P, and mirrors change the sign of each of its components. Its
component along the height has no influence: contacts between layers do not depend on it, so it may change from layer to
layer at no cost. What is left is |d_x| : |d_y|, one angle from 0 to 90 degrees. Bearing states A + C x have a fourth
number, C; if it differs between the planes, the jump varies over the plane.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import Structure
from taichi_bearings.plots.style import BLUE, GREY, in_our_style, new_figure
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene.scene import of_lattice

from .claims import Effort, Share
from .drawing import draw_row
from .network import BULK, PRACTICALLY_ALL
from .samples import StudyResult, Table, joined, measured, shared_numbers

Variants = Mapping[str, Mapping[str, Any]]
"""Settings of a run, by the name of the variant."""
SPREAD = ("uniform:0.1,1", "uniform:0.5,1", "uniform:0.9,1", "lognormal:0.4,1", "power-law:0.001,1,-1")
"""Distributions whose values all differ; the first is the paper's."""
TIED = ("bimodal:0.1,1,0.5",)  # two values of friction, so that minima tie
EQUAL = "constant:0.5"
SHARE_OF_SAMPLES = 0.25
MOST_SAMPLES = 10  # most samples of each driving
REFERENCE = "axis (1, 1, 0), omega_B = 0"
SAME: Variants = {  # the same problem, rescaled, shifted or mirrored
    "omega_B = 0.1 omega_T": {"spin_bottom": 0.1},
    "omega_B = -omega_T": {"spin_bottom": -1.0},
    "omega_T = 3, omega_B = 0.5": {"spin_top": 3.0, "spin_bottom": 0.5},
    "axis (1, -1, 0)": {"direction": (1.0, -1.0, 0.0)},
    "axis (1, 1, 1)": {"direction": (1.0, 1.0, 1.0)},
    "A_z = 2 above, -1 below": {"top": (1.0, 1.0, 2.0, 0.0), "bottom": (0.0, 0.0, -1.0, 0.0)},
    "A and C of both raised": {"top": (1.5, 1.25, 0.25, 0.5), "bottom": (0.5, 0.25, 0.25, 0.5)},
}
AXES = [(1, 0, 0), (4, 1, 0), (2, 1, 0), (10, 9, 0), (1, 2, 0), (1, 4, 0), (0, 1, 0)]
OTHER = {f"axis ({x}, {y}, {z})": {"direction": (float(x), float(y), float(z))} for x, y, z in AXES}
ALONG = ("axis (1, 0, 0)", "axis (0, 1, 0)")  # drivings whose jump lies along a lattice axis
HEIGHT = "axis (0, 0, 1)"
RATES = {  # bearing states of the top with different C, for the lattice spacing 1
    f"A = (1, 1, 0), C = {rate:g}": {"top": (1.0, 1.0, 0.0, rate), "bottom": (0.0, 0.0, 0.0, 0.0)}
    for rate in (0.001, 0.01, 0.1, 0.3, 1.0, 10.0, 1000.0)
}
DRIVINGS: Variants = {REFERENCE: {}, **SAME, **OTHER, HEIGHT: {"direction": (0.0, 0.0, 1.0)}, **RATES}


def distributions(folder: Path, effort: Effort) -> StudyResult:
    """Solve samples for several distributions of the friction, each to its certified minimum. Return table, figure and
    values for the claims.

    folder : folder where finished samples are kept until the study ends.
    effort : first seed and number of samples.
    """
    variants = {name: {"distribution": name} for name in (*SPREAD, *TIED, EQUAL)}
    seeds = effort.seeds(max(1, int(SHARE_OF_SAMPLES * effort.samples)))
    found = samples_of(variants, seeds, spread_numbers, folder / "distributions.jsonl")
    return StudyResult({".csv": joined(found, "distribution")}, draw_distributions, names_of_distributions(found))


def drivings(folder: Path, effort: Effort) -> StudyResult:
    """Solve samples for several drivings (motions that are imposed on bottom and top), each to its certified minimum.
    Return table, figure and values for the claims.

    folder : folder where finished samples are kept until the study ends.
    effort : first seed and number of samples.
    """
    seeds = effort.seeds(max(1, min(MOST_SAMPLES, effort.samples // 4)))
    tables = samples_of(DRIVINGS, seeds, driven_numbers, folder / "drivings.jsonl")
    found = compared_with_reference(tables)
    return StudyResult({".csv": joined(found, "driving")}, draw_drivings, names_of_drivings(found))


def samples_of(
    variants: Variants, seeds: range, numbers: Callable[[Structure], dict[str, Any]], journal: Path
) -> dict[str, Table]:
    """Return for each variant a table of its cubes, solved to their certified minima; all variants have the same seeds.

    variants : settings in which each variant differs from the paper's bearing.
    seeds : seeds of the samples.
    numbers : function that returns the columns of a row, from the structure of a solved sample.
    journal : file that keeps finished samples.
    """
    chosen = [RunSettings(shape=(BULK,) * 3, seed=seed, **variant) for variant in variants.values() for seed in seeds]
    found, each = measured(chosen, numbers, journal), len(seeds)
    return {name: found[each * number : each * (number + 1)] for number, name in enumerate(variants)}


def spread_numbers(structure: Structure) -> dict[str, Any]:
    """Return the columns of one sample of a distribution: those of :func:`.samples.shared_numbers`, and `decades`, the
    orders of magnitude from the smallest to the largest power of a slipping contact; None where it is not proven which
    contacts slip.

    structure : network, domains and cut of the sample.
    """
    scene = structure.scene
    power = scene.law.power(scene.material, structure.slip[None])[0][structure.state == ContactState.SLIPPING]
    power = power[power > 0]
    decades = float(np.log10(power.max() / power.min())) if structure.states_proven else None
    return shared_numbers(structure) | {"decades": decades}


def driven_numbers(structure: Structure) -> dict[str, Any]:
    """Return the columns of one sample under a driving, by name.

    structure : network, domains and cut of the sample.

    The jump is the difference of the imposed spins of top and bottom. Columns that several studies have (side, seed,
    gap, ...) are followed by:

    slipless : list with an entry for each contact: 1 if it is slipless, else 0.
    power_over_jump : power over F_n R |(jump_x, jump_y)|; for a jump along the height alone over F_n R |jump|.
    angle : direction of the jump, degrees from x.
    """
    scene = of_lattice(structure.scene)
    jump = np.abs(scene.driving.difference.spin[0])
    unit = scene.normal_force * scene.lattice.radius * (np.hypot(*jump[:2]) or np.linalg.norm(jump))
    return shared_numbers(structure) | {
        "slipless": structure.network.slipless.astype(int).tolist(),
        "power_over_jump": float(structure.power / unit),
        "angle": float(np.degrees(np.arctan2(jump[1], jump[0]))),
    }


def names_of_distributions(found: Mapping[str, Table]) -> dict[str, Any]:
    """Return the values that the figure and the claims use, by name.

    found : table of the samples of each distribution, by the name of the distribution.

    bulk : side of the lattices, spheres.
    practically : share of the free spheres that counts as practically all of them.
    paper_name, equal_name : names of the distribution of the paper, and of that in which all values are equal.
    equal : its table.
    all : all tables, by the name of the distribution.
    random : the tables of the distributions in which not all values are equal.
    judged : the samples whose contact states are all proven, of the distributions in which all values differ.
    """
    return {
        "bulk": BULK, "practically": PRACTICALLY_ALL, "paper_name": SPREAD[0],
        "equal_name": EQUAL, "equal": found[EQUAL], "all": found,
        "random": {name: table for name, table in found.items() if name != EQUAL},
        "judged": {name: found[name][found[name].states_proven] for name in SPREAD},
    }  # fmt: skip


def compared_with_reference(tables: Mapping[str, Table]) -> dict[str, Table]:
    """Return for each driving its table with two columns that compare its slipless contacts with those of the same
    sample under the driving REFERENCE.

    tables : table of the samples of each driving, by its name; column `slipless` (samples, contacts) is 1 for slipless
        contacts.

    `changed`: number of contacts that are slipless under one of the two drivings only. `overlap`: number of those
    slipless under both, over the number of those slipless under either.
    """
    reference = tables[REFERENCE].slipless.astype(bool)
    found = {}
    for name, table in tables.items():
        slipless = table.slipless.astype(bool)
        both, either = (slipless & reference).sum(axis=1), (slipless | reference).sum(axis=1)
        found[name] = table | {"changed": either - both, "overlap": both / either}
    return found


def names_of_drivings(found: Mapping[str, Table]) -> dict[str, Any]:
    """Return the values that the figure and the claims use, by name.

    found : table of the samples of each driving, by the name of the driving.

    `same`: drivings that pose the same problem as the reference. `other`: other axes of rotation. `rates`: tops whose
    spin A + C x changes with the place x. `along`: rotation about x and about y, in one table.
    """
    return {
        "bulk": BULK, "reference": found[REFERENCE], "seeds": found[REFERENCE].seed, "height": found[HEIGHT],
        "same": {name: found[name] for name in SAME}, "other": {name: found[name] for name in OTHER},
        "rates": {name: found[name] for name in RATES}, "along": joined({name: found[name] for name in ALONG}, "axis"),
    }  # fmt: skip


@in_our_style
def draw_distributions(named: Any) -> Figure:
    """Draw the figure, a row for each distribution: least power over that of the minimum cut, share of samples whose
    slipless contacts join bottom and top, share of slipless contacts, and decades of power.

    named : the values of :func:`names_of_distributions` as attributes. Used is `all`: by distribution of the friction a
        table of samples, with the columns `power_over_cut`, `slipless_fraction`, `decades`, and the masks `spans` and
        `states_proven`.
    """
    figure = new_figure(7.1, 2.5)
    panels: Any = figure.subplots(1, 4, sharey=True)
    rows = range(len(named.all), 0, -1)
    for row, table in zip(rows, named.all.values(), strict=True):
        colour = BLUE if 2 * table.states_proven.sum() > len(table) else GREY
        for axes, column in zip(panels[[0, 2, 3]], ("power_over_cut", "slipless_fraction", "decades"), strict=True):
            draw_row(axes, row, getattr(table, column), colour)
        share, spans = table.spans.mean(), Share.of(table.spans)
        ends = np.array([[spans.least], [spans.most]])
        panels[1].errorbar(share, row, xerr=np.abs(ends - share), fmt="o", color=colour, ms=4, capsize=2)
    panels[0].set_yticks(rows, list(named.all))
    panels[0].set_xlabel(r"$P_\mathrm{min} / P_\mathrm{cut}$")
    panels[1].set(xlabel="samples that span", xlim=(-0.04, 1.04))
    panels[2].set_xlabel("slipless contacts")
    panels[3].set_xlabel("decades of power")
    figure.suptitle("blue: contact states proven; grey: minima tie")
    return figure


@in_our_style
def draw_drivings(named: Any) -> Figure:
    """Draw the figure of samples under several drivings. Dots are samples, the line is their mean.

    named : the values of :func:`names_of_drivings` as attributes. Used are tables of the same samples: `reference`,
        under the reference driving; `other`, by name under other axes of rotation; `rates`, by name under tops with
        the spin A + C x at x. Their columns are `angle`, degrees, `overlap` and `power_over_cut`.

    (a) Overlap of the slipless contacts with those under the reference, and (b) least power over that of the minimum
    cut, both against the direction of the difference of the imposed spins. (c) Overlap of the slipless contacts with
    and without C, against C.
    """
    figure = new_figure(7.1, 2.5)
    panels: Any = figure.subplots(1, 3)
    by_angle = sorted((named.reference, *named.other.values()), key=lambda table: float(table.angle[0]))
    angle, rates = [table.angle[0] for table in by_angle], [DRIVINGS[name]["top"][3] for name in named.rates]
    for axes, x, tables, column in (
        (panels[0], angle, by_angle, "overlap"),
        (panels[1], angle, by_angle, "power_over_cut"),
        (panels[2], rates, named.rates.values(), "overlap"),
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
