"""Figure 1 of the paper: stationary states of 10x10 discs with the bottom at rest, viscous and Coulomb.

With Coulomb friction the discs form two rigid domains, one that rolls with the bottom and one with the top. The
contacts between them are the minimum cut: the set of least total friction that separates bottom and top. Its power is
computed in three ways that share no code: as a shortest path of the dual graph (planar/), as a largest flow
(minimum_cut.py), and by the interior-point method. The paper counts states that a gradient descent has reached in
finitely many steps, so such descents are made, too.

What a descent that has not ended shows of the minimum: each value between the staggered spins of bottom and top is a
level that divides the discs in two, those below it and those above. That is a cut, and the power is the mean of the
powers of the cuts at all levels. If the second lightest cut is heavier than the minimum cut by the factor 1 + e, and a
share s of the levels is not at the minimum cut, then P >= (1 + s e) P_min. (A level around an island of discs costs
more than one at a second cut of nearly the least weight: at least 0.3, for three contacts of 0.1 each.) So a contact
that is not of the cut can slip by s of the jump, or one of the cut by 1 - s, only if e <= (P / P_min - 1) / s.

Letters: R samples, E contacts, N the shape of the lattice. Units: powers energy/time, spins 1/time. The jump is the
difference of the imposed spins of top and bottom.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.minimum_cut import MinimumCut, flow_cut, next_cut
from taichi_bearings.plots.bearing import SPIN_COLOURS, Sheet, colour_bar
from taichi_bearings.plots.style import BLUE, DOUBLE, GREY, ORANGE, in_our_style, new_figure
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.scene.interface import cut_of, cut_unit, cut_weights
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.solvers import GradientDescent, InteriorPoint, LinearSolver, PlanarCut
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import each, stage

from .claims import Effort
from .samples import StudyResult, Table, joined, relax, solved

SHAPE, CUBE = (10, 10), (10, 10, 10)
PAPER_OTHERS = 17 / 1000  # share of the paper's samples that did not end at the minimum cut
CHEAP = 5  # factor of the number of samples where each takes milliseconds
CUBES = 5  # viscous samples in 3D
FEW = 20  # samples of each further distribution or driving, and of those followed in time
SAME = 1e-9  # relative difference up to which weights of cuts are taken for equal
DESCENT = 40_000  # iterations of gradient descent with momentum
VISIBLE = 0.1  # share of the jump: contacts that slip more are said to slip visibly at the end of a descent
DISTRIBUTIONS = ("lognormal:0.4,1", "power-law:0.001,1,-1", "bimodal:0.1,1,0.5")
BOTTOMS = (0.5, -0.5)  # spin of the bottom over that of the top
STARTS = ("random", "zero")


def study(folder: Path, effort: Effort) -> StudyResult:
    """Compute viscous states, minimum cuts with the descents to them, minima by the interior-point method, and
    relaxations; return tables, figure and values for the claims.

    folder : not used, since no sample takes long enough to be kept.
    effort : first seed and number of samples.
    """
    draw = partial(Scene.random, seed=effort.seed)
    few = partial(draw, SHAPE, replicas=min(FEW, effort.samples))
    with stage("viscous states"):
        viscous = solved(draw(SHAPE, replicas=effort.samples, law="viscous"), LinearSolver())
        cubes = solved(draw(CUBE, replicas=min(CUBES, effort.samples), law="viscous"), LinearSolver())
    with stage("minimum cuts"):
        scene = draw(SHAPE, replicas=CHEAP * effort.samples)
        minimum, cut = solved(scene, PlanarCut()), cut_of(scene)
        exact = cuts_of(minimum, cut, flow_cut(scene.lattice.by_axis(cut_weights(scene))))
    with stage("descents"):
        ended = solved(scene, GradientDescent(), StopRule(1e-12, DESCENT), "random")
        exact = compared_with_descent(exact, cut, ended)
    with stage("minima without cuts"):
        settled = compared_with_cut(draw(SHAPE, replicas=effort.samples))
    others = {name: compared_with_cut(few(distribution=name)) for name in each(DISTRIBUTIONS, "distribution")}
    driven = {f"{bottom:g}": compared_with_cut(few(spin_bottom=bottom)) for bottom in each(BOTTOMS, "driving")}
    with stage("relaxations"):
        apart = distance_from_cut(few())
    boundaries = two_boundaries(exact, cut, ended)
    # the figure shows the first sample whose cut is not level, or the first one if there is none
    shown = int(exact.is_level[: effort.samples].argmin())
    spins = {law: spins_of(solution, shown) for law, solution in (("viscous", viscous), ("coulomb", minimum))}
    named = {
        "sizes": {"x".join(map(str, of.scene.network.shape)): viscous_numbers(of) for of in (viscous, cubes)},
        "exact": exact, "settled": settled, "others": others, "driven": driven, "apart": apart,
        "few_samples": len(few().seeds), "boundaries": boundaries, "iterations": DESCENT, "visible_slip": VISIBLE,
        "paper_others": PAPER_OTHERS, "above": cut.above[shown],
        "viscous": np.abs(viscous.spin[shown]), "coulomb": np.abs(minimum.spin[shown]),
    }  # fmt: skip
    return StudyResult({".csv": joined(spins, "law"), "-samples.csv": exact}, draw_configurations, named)


def contacts_between(scene: Scene, above: np.ndarray) -> np.ndarray:
    """Return a mask (R samples, E contacts), True for contacts that join a disc above a cut with one below.

    scene : the lattice with its R samples.
    above : mask (R, *N spheres) of the discs above the cut.
    """
    low, high = above.reshape(len(above), scene.lattice.sites)[:, scene.lattice.ends].swapaxes(0, 1)
    return np.asarray(low != high)


def cuts_of(minimum: Solution, cut: MinimumCut, by_flow: MinimumCut) -> Table:
    """Return a table of the exact minima of 2D Coulomb samples, which are minimum cuts, found as shortest paths and, to
    compare, as largest flows.

    minimum : the solution from the shortest paths.
    cut, by_flow : the minimum cuts by shortest paths and by flows.

    Columns: `power`, its `lower_bound`, and `cut_power_by_flow`, energy/time; `distance`, weight of the second lightest
    cut over that of the minimum cut, less 1; `contacts_of_cut`, number of contacts of the cut; `is_level`, True if the
    cut lies between two layers; `unique`, True if no other cut is as light; `spread`, largest relative difference of
    the power from its lower bound and from weight and lower bound of the flow, as powers; `same_cut`, True if shortest
    paths and flows cut the same contacts.
    """
    scene, power = of_lattice(minimum.scene), minimum.power
    unit, contacts = cut_unit(scene), contacts_between(scene, cut.above)
    bounds = (minimum.lower_bound, unit * by_flow.weight, unit * by_flow.lower_bound)
    return Table(
        {
            "seed": scene.seeds,
            "power": power,
            "lower_bound": minimum.lower_bound,
            "cut_power_by_flow": unit * by_flow.weight,
            "distance": cut.next_weight / cut.weight - 1,
            "contacts_of_cut": contacts.sum(axis=1),
            "is_level": ~np.diff(cut.above, axis=1).any(axis=(1, 2)),
            "unique": cut.unique,
            "spread": np.max([np.abs(other / power - 1) for other in bounds], axis=0),
            "same_cut": (contacts == contacts_between(scene, by_flow.above)).all(axis=1),
        }
    )


def visible(scene: Scene, ended: Solution) -> np.ndarray:
    """Return a mask (R samples, E contacts), True for contacts that slip visibly at the end of a descent: by more than
    VISIBLE of the largest possible slip.

    scene : the lattice with its R samples.
    ended : the solution at that end.
    """
    return np.asarray(ended.slip > VISIBLE * scene.lattice.radius * scene.jump)


def compared_with_descent(exact: Table, cut: MinimumCut, ended: Solution) -> Table:
    """Return the table of exact minima with two more columns, which compare them with where gradient descents
    ended.

    exact : table with the `power` of each minimum, energy/time.
    cut : the minimum cuts.
    ended : the solution at the end of the descents.

    Columns: `excess`, power of the descent over that of the minimum, less 1; `differs`, True if the contacts that slip
    visibly are not exactly those of the cut.
    """
    scene = of_lattice(ended.scene)
    differs = (visible(scene, ended) != contacts_between(scene, cut.above)).any(axis=1)
    return exact | {"excess": ended.power / exact.power - 1, "differs": differs}


def compared_with_cut(scene: Scene) -> Table:
    """Return a table that compares minima by the interior-point method with the minimum cuts of the same samples, a
    row for each sample of the scene.

    Columns: `spread`, largest relative difference between the power of the cut and the two proven bounds of the
    minimum; `differing`, number of contacts that slip at the minimum but are not of the cut, or the other way round;
    `unique`, True if no other cut is as light; `proven`, True if the states of all contacts are proven.
    """
    solution, cut = solved(scene, InteriorPoint(), StopRule(1e-10)), cut_of(scene)
    power, slips = cut_unit(scene) * cut.weight, solution.state == ContactState.SLIPPING
    return Table(
        {
            "spread": np.max([np.abs(bound / power - 1) for bound in (solution.power, solution.lower_bound)], axis=0),
            "differing": (slips != contacts_between(scene, cut.above)).sum(axis=1),
            "unique": cut.unique,
            "proven": solution.states_proven,
        }
    )


def spins_of(solution: Solution, shown: int) -> Table:
    """Return a table with a row for each disc of one sample and the columns `seed`, of the sample; `x` and `y`, the
    lattice indices of the disc; and `spin_over_top`, its spin where the top has 1.

    solution : spins of some samples of a 2D lattice.
    shown : index of the sample among them.
    """
    spin = solution.spin[shown]
    x, y = np.indices(spin.shape).reshape(2, -1)
    return Table({"seed": [solution.scene.seeds[shown]] * spin.size, "x": x, "y": y, "spin_over_top": spin.ravel()})


def viscous_numbers(solution: Solution) -> dict[str, Any]:
    """Return three numbers of viscous samples, by name:

    samples : how many there are.
    least_slip, largest_slip : least slip and largest slip of the contacts that can slip, in units of radius times the
        difference of the imposed spins.
    least_rise : smallest rise of the mean spin from one layer to the next (see :func:`least_rise`).

    solution : the stationary states of the samples.
    """
    scene = of_lattice(solution.scene)
    slips = solution.slip[:, ~scene.lattice.between_driven] / (scene.lattice.radius * scene.jump)
    numbers = {"least_slip": float(slips.min()), "largest_slip": float(slips.max())}
    return {"samples": scene.replicas, **numbers, "least_rise": least_rise(scene, solution.spin)}


def least_rise(scene: Scene, spin: np.ndarray) -> float:
    """Return the smallest step of the mean spin from a layer to the next one above, among all layers of all samples.

    scene : the lattice with its R samples.
    spin : (R samples, *N spheres, ...), laboratory frame, 1/time.

    Spins are staggered (with opposite signs on neighbours). Their part along the jump, the difference of the imposed
    spins, is taken in units of the jump: its mean rises from 0 at the bottom to 1 at the top, and a negative step leads
    back towards the spin of the bottom.
    """
    axes = scene.minimum_spin_axes
    top = scene.top_spin(axes).reshape(len(axes), -1)[:, 0]
    staggered = scene.staggered_spin(spin, axes)
    layers = staggered.mean(axis=tuple(range(2, staggered.ndim - 1)))
    along = np.tensordot(top / scene.jump**2, layers, axes=1)
    return float(np.diff(along, axis=-1).min())


def two_boundaries(exact: Table, cut: MinimumCut, ended: Solution) -> Table:
    """Return the samples whose descent does not end at the minimum cut, with columns on the second lightest cut.

    exact : table of the minima, with the column `differs`: True if the descent ends elsewhere.
    cut : the minimum cuts of the samples in `exact`.
    ended : the solution at the end of the descents.

    Columns: `within`, True if all contacts that slip visibly belong to one of the two lightest cuts; `at_second`, True
    if some contact slips visibly that belongs to the second alone; `same`, True if the second lightest cuts found by
    flows and by shortest paths (in `cut`) have equal weights.
    """
    scene, chosen = of_lattice(ended.scene), np.flatnonzero(exact.differs)
    weight = scene.lattice.by_axis(cut_weights(scene)[chosen])
    chosen_cut = MinimumCut(*(getattr(cut, name)[chosen] for name in MinimumCut.__dataclass_fields__))
    second, second_weight = next_cut(weight, chosen_cut)
    of_first, of_second = (contacts_between(scene, above) for above in (chosen_cut.above, second))
    slips_beside_first = visible(scene, ended)[chosen] & ~of_first
    return exact[chosen] | {
        "within": ~(slips_beside_first & ~of_second).any(axis=1),
        "at_second": (slips_beside_first & of_second).any(axis=1),
        "same": np.isclose(second_weight, chosen_cut.next_weight, rtol=SAME, atol=0),
    }


def distance_from_cut(scene: Scene) -> dict[str, float]:
    """Return how far the spins at the end of Cundall-Strack dynamics are from those of the two rigid domains of the
    minimum cut: for each of STARTS, names of initial spins, the largest difference of any spin in any sample of the
    scene, in units of the jump (top minus bottom of the imposed spins). The bottom must be at rest.
    """
    cut = np.where(cut_of(scene).above, scene.spin_top, scene.spin_bottom)
    return {start: float(np.abs(relax(scene, start).last[0] - cut).max() / scene.jump) for start in STARTS}


@in_our_style
def draw_configurations(named: Any) -> Figure:
    """Draw the figure: (a) viscous and (b) Coulomb spins of one sample as colour, with its minimum cut in black, and
    (c) how much heavier the second lightest cut of each sample is; those whose descent ended elsewhere are marked.

    named : the values that :func:`study` names, as attributes. Used are `viscous` and `coulomb` (nx, ny), sizes of
        spins where the top has 1; `above` (nx, ny), True above the minimum cut; `exact`, a table with a row for each
        sample and the columns `distance`, weight of the second lightest cut over that of the lightest, less 1, and
        `differs`.
    """
    figure = new_figure(DOUBLE, 2.5)
    parts: Any = figure.subfigures(1, 2, width_ratios=(2.1, 1.1), wspace=0.05)
    panels, sheet = parts[0].subplots(1, 2), Sheet.of_lattice(Lattice(named.above.shape))
    names = ("(a) viscous", "(b) Coulomb, minimum cut in black")
    for axes, name, speed in zip(panels, names, (named.viscous, named.coulomb), strict=True):
        sheet.paint(axes, colormaps[SPIN_COLOURS](speed).reshape(-1, 4))
        sheet.box_driven(axes)
        axes.set_title(name)
    low, high = named.above.ravel()[sheet.ends]
    sheet.draw(panels[1], low != high, across=True, colors="black", lw=1.0)
    colour_bar(parts[0], panels, r"$|\omega|\,/\,\omega_T$", Normalize(0, 1), SPIN_COLOURS, pad=0.05)
    _draw_ranks(parts[1].subplots(), named.exact[np.argsort(named.exact.distance)])
    return figure


def _draw_ranks(axes: Any, exact: Any) -> None:
    """Draw how much heavier the second lightest cut of each sample is than the lightest, against the sample's rank.

    axes : panel of matplotlib.
    exact : table of the samples, sorted by `distance`, that difference over the weight of the lightest cut. Its column
        `differs` is True where a descent ended elsewhere than at the lightest cut; these are marked.
    """
    ranks = np.arange(1, len(exact) + 1)
    for chosen, mark, colour, ms, label in (
        (~exact.differs, ".", BLUE, 3, "descent ends at the cut"),
        (exact.differs, "x", ORANGE, 5, "other contacts slip too"),
    ):
        axes.loglog(ranks[chosen], exact.distance[chosen], mark, color=colour, ms=ms, label=label)
    axes.axvline(PAPER_OTHERS * len(exact) + 0.5, color=GREY, lw=0.8, ls="--", label="17 of 1000, as in the paper")
    axes.set(xlabel="rank of the sample", ylabel=r"$P_\mathrm{cut,2}\,/\,P_\mathrm{cut} - 1$")
    axes.set_title("(c) near ties of two cuts")
    axes.legend(loc="lower right")
