"""Figure 1 of the paper: stationary states of 10x10 discs with the bottom at rest, viscous and Coulomb.

The least power of the Coulomb law is computed in three ways that share no code: the shortest path of the dual graph
with the friction forces that it implies (planar/), the largest flow of a general graph (minimum_cut.py), and the
interior-point method, which settles each contact by forces of its own. The paper counts states that a descent has
reached in finitely many steps, so a descent is followed too.

What a descent shows of the cut before its end is a matter of levels. Each level between the spins of bottom and top
parts the discs in two, and the power is the mean of the powers of all these cuts. If the second cut is heavier than the
minimum cut by the factor 1 + e, and a share s of the levels is not at the minimum cut, then P >= (1 + s e) P_min. (A
level around an island of discs costs more than one at a near second cut: here 0.3 for three contacts, 0.1 each.) So a
contact off the cut can slip by s of the jump, or one of the cut by 1 - s, only if e <= (P / P_min - 1) / s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.numerics.minimum_cut import MinimumCut, flow_cut, next_cut
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.scene.initial_spins import cut_of, cut_unit, cut_weights
from taichi_bearings.solvers import GradientDescent, InteriorPoint, LinearSolver, PlanarCut
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import each, stage
from taichi_bearings.words import counted, share

from ..plots.configurations import draw_configurations
from .claims import FEWEST, HALF, Claim, Effort, Share, every
from .relaxation import relax
from .samples import save_both, solved

SHAPE, CUBE = (10, 10), (10, 10, 10)
PAPER_SAMPLES, PAPER_OTHERS = 1000, 17  # the paper's, and how many of them did not end at the minimum cut
CHEAP = 5  # times as many samples as asked for, of what takes milliseconds each
CUBES = 5  # viscous samples in 3D
FEW = 20  # samples of each further distribution or driving, and of those followed in time
SAME = 1e-9  # relative difference up to which powers count as the same
STILL = 1e-9  # of R times the jump: viscous contacts that slip less would count as slipless; rounding is below 1e-14
DESCENT = 40_000  # iterations of gradient descent with momentum
VISIBLE = 0.1  # of the jump: contacts that slip more count as slipping at the end of a descent
MOST, IN_ORDER = 0.05, 0.75  # samples that may end elsewhere, and share of pairs that must be in order; by chance 0.5
DISTRIBUTIONS = ("lognormal:0.4,1", "power-law:0.001,1,-1", "bimodal:0.1,1,0.5")
BOTTOMS = (0.5, -0.5)  # spin of the bottom over that of the top
STARTS = ("random", "zero")
END = 1e-6  # of the jump: spins at rest this close to one of the driven ones belong to its domain


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write fig1.png, fig1.pdf, fig1.csv and fig1-samples.csv into `folder`; returns the claims with their verdicts."""
    runtime.start("cpu", "f64")
    draw = partial(Scene.random, seed=effort.seed)
    with stage("viscous states"):
        viscous = solved(draw(SHAPE, replicas=effort.samples, law="viscous"), LinearSolver())
        cubes = solved(draw(CUBE, replicas=min(CUBES, effort.samples), law="viscous"), LinearSolver())
    with stage("minimum cuts"):
        coulomb = Minimum.of(draw(SHAPE, replicas=CHEAP * effort.samples))
    with stage("descents"):
        descent = Descent.of(coulomb)
    with stage("minima without cuts"):
        settled = Settled.of(draw(SHAPE, replicas=effort.samples))
    draw_few = partial(draw, SHAPE, replicas=min(FEW, effort.samples))
    others = [Settled.of(draw_few(distribution=name)) for name in each(DISTRIBUTIONS, "distribution")]
    driven = [Settled.of(draw_few(spin_bottom=bottom)) for bottom in each(BOTTOMS, "driving")]
    with stage("relaxations"):
        any_start = _any_start(draw_few())
    shown = shown_sample(coulomb, len(viscous.spin))
    write_spins(folder / "fig1.csv", shown, viscous, coulomb.solution)
    write_samples(folder / "fig1-samples.csv", coulomb, descent)
    with stage("drawing"):
        figure = draw_configurations(
            np.abs(viscous.spin[shown]),
            np.abs(coulomb.solution.spin[shown]),
            [values[shown] for values in coulomb.contacts],
            coulomb.distance,
            descent.differs,
        )
        save_both(figure, folder, "fig1")
    return [
        _continuous(viscous, cubes),
        _least_power(coulomb, settled),
        _interface(coulomb, settled),
        _counted(coulomb, descent),
        _two_boundaries(coulomb, descent),
        any_start,
        _any_distribution(others),
        _any_bottom(driven),
    ]


def contacts_between(above: np.ndarray) -> tuple[np.ndarray, ...]:
    """Contacts whose ends lie on different sides (R, *N), one mask (R, *contacts) an axis."""
    return tuple(np.diff(above, axis=axis) for axis in range(1, above.ndim))


def count(masks: Sequence[np.ndarray]) -> np.ndarray:
    """Number (R,) of contacts in masks (R, *contacts), one an axis."""
    return np.sum([values.sum(axis=tuple(range(1, values.ndim))) for values in masks], axis=0)


def slipping(solution: Solution) -> tuple[np.ndarray, ...]:
    return solution.scene.lattice.by_axis(solution.state == ContactState.SLIPPING)


@dataclass(frozen=True)
class Minimum:
    """The exact Coulomb minima of a 2D scene by shortest paths, and the same cuts by flows."""

    solution: Solution
    cut: MinimumCut
    by_flow: MinimumCut

    @classmethod
    def of(cls, scene: Scene) -> "Minimum":
        return cls(solved(scene, PlanarCut()), cut_of(scene), flow_cut(scene.lattice.by_axis(cut_weights(scene))))

    @cached_property
    def contacts(self) -> tuple[np.ndarray, ...]:
        return contacts_between(self.cut.above)

    @property
    def distance(self) -> np.ndarray:
        """Weight (R,) of the second cut over that of the minimum cut, less 1."""
        return self.cut.next_weight / self.cut.weight - 1

    @property
    def spread(self) -> np.ndarray:
        """Largest relative difference (R,) of the power, its bound by friction forces and those of the flow."""
        power, unit = self.solution.power, cut_unit(self.solution.scene)
        flow = (unit * self.by_flow.weight, unit * self.by_flow.lower_bound)
        return np.max([np.abs(other / power - 1) for other in (self.solution.lower_bound, *flow)], axis=0)

    @property
    def same_cut(self) -> np.ndarray:
        """True where path and flow cut the same contacts, (R,)."""
        return (self.cut.above == self.by_flow.above).reshape(len(self.cut.above), -1).all(axis=1)


@dataclass(frozen=True)
class Settled:
    """Minima by the interior-point method with the states of all contacts, and the minimum cuts of the same scene."""

    solution: Solution
    cut: MinimumCut

    @classmethod
    def of(cls, scene: Scene) -> "Settled":
        return cls(solved(scene, InteriorPoint(), StopRule(1e-10)), cut_of(scene))

    @property
    def cut_power(self) -> np.ndarray:
        return cut_unit(self.solution.scene) * self.cut.weight

    @property
    def spread(self) -> np.ndarray:
        """Largest relative difference (R,) of the cut's power and both proven bounds of the interior-point method."""
        bounds = (self.solution.power, self.solution.lower_bound)
        return np.max([np.abs(bound / self.cut_power - 1) for bound in bounds], axis=0)

    @property
    def differing(self) -> np.ndarray:
        """Number (R,) of contacts that slip but are not of the cut, or the other way round."""
        pairs = zip(slipping(self.solution), contacts_between(self.cut.above), strict=True)
        return count([slips != cut for slips, cut in pairs])


@dataclass(frozen=True)
class Descent:
    """Ends of a gradient descent: what slips visibly there, and excess (R,) of the power over the minimum, relative."""

    slipping: tuple[np.ndarray, ...]
    excess: np.ndarray
    differs: np.ndarray

    @classmethod
    def of(cls, minimum: Minimum) -> "Descent":
        scene = minimum.solution.scene
        ended = solved(scene, GradientDescent(), StopRule(1e-12, DESCENT), "random")
        visible = scene.lattice.by_axis(ended.slip > VISIBLE * scene.lattice.radius * scene.jump)
        differing = count([slips != cut for slips, cut in zip(visible, minimum.contacts, strict=True)])
        return cls(visible, ended.power / minimum.solution.power - 1, differing > 0)


def shown_sample(minimum: Minimum, among: int) -> int:
    """The first sample whose cut is not level, else the first one."""
    level = count(minimum.contacts[:-1])[:among] == 0
    return int(level.argmin())


def write_spins(path: Path, shown: int, viscous: Solution, coulomb: Solution) -> None:
    """The states of panels (a) and (b): law, seed, x, y, spin over that of the top."""
    rows = [
        [law, solution.scene.seeds[shown], x, y, float(spin)]
        for law, solution in (("viscous", viscous), ("coulomb", coulomb))
        for (x, y), spin in np.ndenumerate(solution.spin[shown])
    ]
    write_csv(path, ["law", "seed", "x", "y", "spin_over_top"], rows)


def write_samples(path: Path, minimum: Minimum, descent: Descent) -> None:
    """One row a Coulomb sample: the exact minimum, the distance of the second cut, and the end of the descent."""
    names = ["seed", "power", "lower_bound", "cut_power_by_flow", "second_cut_over_minimum_less_1", "contacts_of_cut"]
    columns = [
        minimum.solution.scene.seeds,
        minimum.solution.power,
        minimum.solution.lower_bound,
        cut_unit(minimum.solution.scene) * minimum.by_flow.weight,
        minimum.distance,
        count(minimum.contacts),
        descent.excess,
        descent.differs.astype(int),
    ]
    rows = [
        [value.item() if isinstance(value, np.generic) else value for value in row]
        for row in zip(*columns, strict=True)
    ]
    write_csv(path, [*names, "descent_excess", "descent_differs"], rows)


def _continuous(flat: Solution, cubes: Solution) -> Claim:
    found, smooth = [], True
    numbers: dict[str, dict[str, Any]] = {}
    for solution in (flat, cubes):
        scene = solution.scene
        least, largest = slip_range(solution)
        rising = least_rise(solution)
        smooth &= least > STILL and rising > 0 and largest < 0.5
        name = "x".join(map(str, scene.lattice.shape))
        found.append(
            f"{name}, {counted(scene.replicas, 'sample')}: every contact slips, by {least:.1e} to {largest:.2f} of the "
            f"jump, and the mean spin rises by at least {rising:.3f} of it from each layer to the next"
        )
        numbers[name] = {"samples": scene.replicas, "least_slip": least, "largest_slip": largest, "least_rise": rising}
    return Claim(
        "Viscous: the spin changes continuously from top to bottom.",
        f"{'; '.join(found)} (limits: more than {STILL:g}, less than 0.5, more than 0).",
        bool(smooth),
        numbers,
        samples=min(flat.scene.replicas, cubes.scene.replicas),
        needed=FEWEST,
        paper="continuous, one sample",
        ours="; ".join(
            f"{name}: slips of {of['least_slip']:.0e} to {of['largest_slip']:.2f}" for name, of in numbers.items()
        ),
        uncertainty="; ".join(f"{name}: {every(of['samples'])}" for name, of in numbers.items()),
    )


def slip_range(solution: Solution) -> tuple[float, float]:
    """Least and largest slip of the contacts of all samples that can slip, over R times the jump."""
    scene = solution.scene
    slips = solution.slip[:, ~scene.lattice.between_driven] / (scene.lattice.radius * scene.jump)
    return float(slips.min()), float(slips.max())


def least_rise(solution: Solution) -> float:
    """Least difference of the mean staggered spin from a layer to the next, over the jump, towards the top."""
    scene = solution.scene
    axes = scene.minimum_spin_axes
    bottom, top = scene.driven_values(axes)
    staggered = scene.staggered_spin(solution.spin, axes)
    layers = staggered.mean(axis=tuple(range(2, staggered.ndim - 1)))
    along = np.tensordot((top - bottom) / scene.jump**2, layers, axes=1)
    return float(np.diff(along, axis=-1).min())


def _least_power(minimum: Minimum, settled: Settled) -> Claim:
    spread, apart = float(minimum.spread.max()), float(settled.spread.max())
    return Claim(
        "Coulomb, 2D: the least power is that of the minimum cut.",
        f"Shortest path, largest flow and the friction forces that prove the path agree to {spread:.1e} in "
        f"{counted(len(minimum.spread), 'sample')}, and cut the same contacts in {minimum.same_cut.sum()}. Both bounds "
        f"of the interior-point method, which knows of no cut, agree with them to {apart:.1e} in "
        f"{counted(len(settled.spread), 'sample')} (limit {SAME:g}).",
        bool(max(spread, apart) <= SAME and minimum.same_cut.all()),
        {"samples": len(minimum.spread), "spread": spread, "other_samples": len(settled.spread), "other_spread": apart},
        kind="theorem",
        samples=len(minimum.spread),
        paper="exactly the minimum cut",
        ours=f"the same to {max(spread, apart):.0e}",
        uncertainty="none but rounding: a theorem",
    )


def _interface(minimum: Minimum, settled: Settled) -> Claim:
    unique, proven, same = minimum.cut.unique, settled.solution.states_proven, settled.differing == 0
    nearest = float(minimum.distance.min())
    return Claim(
        "Coulomb, 2D: two bearing states, and their interface is the minimum cut.",
        f"The minimum cut is unique in {unique.sum()} of {counted(len(unique), 'sample')} (the nearest second cut is "
        f"heavier by {nearest:.1e}), so the minimum is, and all its slip is at the cut. The contacts that slip by the "
        f"interior-point method are exactly those of the cut in {same.sum()} of {counted(len(same), 'sample')}, proven "
        f"by forces in {proven.sum()}.",
        bool(unique.all() and same.all()),
        {
            "samples": len(unique),
            "unique": int(unique.sum()),
            "nearest_second_cut": nearest,
            "settled": len(same),
            "identical": int(same.sum()),
            "proven": int(proven.sum()),
        },
        kind="theorem",
        samples=len(unique),
        paper="identical, 983 of 1000",
        ours=f"identical in {same.sum()} of {len(same)}, at the exact minimum",
        uncertainty=f"none where the cut is unique: a theorem; unique in {unique.sum()} of {len(unique)}",
    )


def _counted(minimum: Minimum, descent: Descent) -> Claim:
    samples, failed = len(descent.differs), int(descent.differs.sum())
    others = Share(failed, samples)
    order = np.sort(minimum.distance)
    expected = round(PAPER_OTHERS * samples / PAPER_SAMPLES)
    limit = float(order[min(expected, samples - 1)])
    explained = minimum.distance[descent.differs] <= descent.excess[descent.differs] / VISIBLE
    last = int((minimum.distance <= minimum.distance[descent.differs].max()).sum()) if failed else 0
    higher = share_above(minimum.distance[~descent.differs], minimum.distance[descent.differs])
    farthest = f" The largest e among them has rank {last} of all." if failed else ""
    return Claim(
        "The boundary that a descent reaches is the minimum cut in 983 of 1000 samples; the others nearly tie.",
        f"After {DESCENT} iterations with momentum, from random spins, the contacts that slip by more than {VISIBLE:g} "
        f"of the jump are those of the cut, but for {others}; limit: {MOST:.0%}. In "
        f"{explained.sum()} of the {failed} others the second cut, heavier by e, is near enough to explain it (e <= "
        f"excess of the power / {VISIBLE:g}).{farthest} In {share(higher)} of all pairs the sample that ends at the "
        f"cut has the larger e (limit {IN_ORDER:.0%}, from {FEWEST} others on). {expected} of {samples} have e below "
        f"{limit:.1e}: if two cuts that near count as tied, the paper's count follows. The count of a descent "
        "depends on its length and on what counts as slip; at the exact minimum it is all of them.",
        bool(others.most <= MOST and explained.all() and (failed < FEWEST or higher >= IN_ORDER)),
        {
            "samples": samples,
            "iterations": DESCENT,
            "visible_slip": VISIBLE,
            "identical": samples - failed,
            "explained": int(explained.sum()),
            "pairs_in_order": higher,
            "highest_rank_of_others": last,
            "distance_for_the_papers_count": limit,
            "median_excess": float(np.median(descent.excess)),
        },
        refined=True,
        samples=samples,
        needed=others.needed_for(MOST),
        paper="983 of 1000",
        ours=f"{samples - failed} of {samples}",
        uncertainty=f"others: {others.interval}",
        after_data=f"{DESCENT} iterations and {VISIBLE:g} of the jump: both decide the count",
    )


def share_above(values: np.ndarray, others: np.ndarray) -> float:
    """Share of all pairs whose value is larger than the other one; 1 without pairs (Mann and Whitney)."""
    return float((values[:, None] > others).mean()) if values.size and others.size else 1.0


def _two_boundaries(minimum: Minimum, descent: Descent) -> Claim:
    chosen = np.flatnonzero(descent.differs)
    scene = minimum.solution.scene
    weight = scene.lattice.by_axis(cut_weights(scene)[chosen])
    pick = MinimumCut(*(getattr(minimum.cut, name)[chosen] for name in MinimumCut.__dataclass_fields__))
    second, second_weight = next_cut(weight, pick)
    same = np.isclose(second_weight, pick.next_weight, rtol=SAME, atol=0)
    outside, both = [], []
    for slips, first, other in zip(descent.slipping, minimum.contacts, contacts_between(second), strict=True):
        outside.append(slips[chosen] & ~first[chosen] & ~other)
        both.append(slips[chosen] & other & ~first[chosen])
    within, at_second = count(outside) == 0, count(both) > 0
    found = Share(int((within & at_second).sum()), len(chosen))
    return Claim(
        "In the remaining cases two boundaries are present, at two minimal cuts of nearly equal value.",
        f"In {within.sum()} of {len(chosen)} such samples all visible slip is on the lightest two cuts, and in "
        f"{at_second.sum()} contacts of the second cut alone do slip; both: {found}; limit: more than half. "
        f"Flows that spare a contact of the cut find the second cut as heavy as the paths do in {same.sum()}.",
        bool(found.least > HALF and same.all()),
        {
            "seeds": [minimum.solution.scene.seeds[n] for n in chosen],
            "distance": minimum.distance[chosen].tolist(),
            "excess": descent.excess[chosen].tolist(),
            "on_two_cuts": within.tolist(),
        },
        samples=found.samples,
        needed=found.needed_for(HALF),
        paper="the final state can present two boundaries, 17 samples",
        ours=f"{found.hits} of {counted(found.samples, 'sample')}",
        uncertainty=found.interval,
        after_data="what slips visibly, as above",
    )


def _any_start(scene: Scene) -> Claim:
    above, bottom, top = cut_of(scene).above, scene.spin_bottom, scene.spin_top
    cut = np.where(above, top, bottom)
    apart = {start: np.abs(relax(scene, start).last[0] - cut).max() / scene.jump for start in STARTS}
    worst = float(max(apart.values()))
    return Claim(
        "Whatever the initial spins, the system evolves to the same stationary state.",
        f"Cundall-Strack dynamics from {' and from '.join(STARTS)} spins end with all spins within {worst:.1e} of the "
        f"jump of the two domains of the minimum cut, in {counted(scene.replicas, 'sample')} (limit {END:g}).",
        worst <= END,
        {"samples": scene.replicas} | {f"apart_from_{start}": float(value) for start, value in apart.items()},
        samples=scene.replicas,
        needed=FEWEST,
        paper="always the same",
        ours=f"the same to {worst:.0e} of the jump",
        uncertainty=every(scene.replicas),
    )


def _any_distribution(others: Sequence[Settled]) -> Claim:
    found, numbers, holds = [], {}, True
    for name, settled in zip(DISTRIBUTIONS, others, strict=True):
        unique, same, spread = settled.cut.unique, settled.differing == 0, float(settled.spread.max())
        holds &= spread <= SAME and bool(same[unique].all())
        found.append(f"{name} {spread:.1e}, {(same & unique).sum()} of {unique.sum()}")
        numbers[name] = {"samples": len(unique), "spread": spread, "unique": int(unique.sum()), "same": same.tolist()}
    return Claim(
        "Coulomb, 2D: this holds for any distribution of friction coefficients.",
        f"Largest difference between the power of the cut and the interior-point method's bounds (limit {SAME:g}), and "
        f"samples whose slipping contacts are those of the cut, of those whose cut is unique: {'; '.join(found)}.",
        holds,
        numbers,
        kind="theorem",
        samples=min(len(settled.differing) for settled in others),
        paper="any distribution",
        ours=f"holds for {len(others)} more",
        uncertainty="none but rounding: a theorem",
    )


def _any_bottom(driven: Sequence[Settled]) -> Claim:
    found, numbers, holds = [], {}, True
    for bottom, settled in zip(BOTTOMS, driven, strict=True):
        same, spread = settled.differing == 0, float(settled.spread.max())
        holds &= spread <= SAME and bool(same.all())
        found.append(f"omega_B = {bottom:g} omega_T {spread:.1e}, {same.sum()} of {len(same)}")
        numbers[f"{bottom:g}"] = {"samples": len(same), "spread": spread, "identical": int(same.sum())}
    return Claim(
        "Coulomb, 2D: the same with the bottom rotating.",
        "The cut does not depend on it. Largest difference between F_n R |omega_T - omega_B| times its weight and the "
        f"interior-point method's bounds (limit {SAME:g}), and samples whose slipping contacts are those of the cut: "
        f"{'; '.join(found)}.",
        holds,
        numbers,
        kind="theorem",
        samples=min(len(settled.differing) for settled in driven),
        paper="only the coefficients matter",
        ours=f"the same cut for {len(driven)} more",
        uncertainty="none: a theorem",
    )
