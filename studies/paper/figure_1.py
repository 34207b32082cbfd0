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

from ..plots.configurations import draw_configurations
from .claims import Claim, Effort, Share, judge
from .samples import relax, save_both, solved

SHAPE, CUBE = (10, 10), (10, 10, 10)
PAPER_SAMPLES, PAPER_OTHERS = 1000, 17  # the paper's, and how many of them did not end at the minimum cut
CHEAP = 5  # times as many samples as asked for, of what takes milliseconds each
CUBES = 5  # viscous samples in 3D
FEW = 20  # samples of each further distribution or driving, and of those followed in time
SAME = 1e-9  # relative difference up to which the weights of cuts count as the same
DESCENT = 40_000  # iterations of gradient descent with momentum
VISIBLE = 0.1  # of the jump: contacts that slip more count as slipping at the end of a descent
DISTRIBUTIONS = ("lognormal:0.4,1", "power-law:0.001,1,-1", "bimodal:0.1,1,0.5")
BOTTOMS = (0.5, -0.5)  # spin of the bottom over that of the top
STARTS = ("random", "zero")


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
    sizes = {}
    for solution in (flat, cubes):
        scene = solution.scene
        least, largest = slip_range(solution)
        numbers = {"least_slip": least, "largest_slip": largest, "least_rise": least_rise(solution)}
        sizes["x".join(map(str, scene.lattice.shape))] = {"samples": scene.replicas, **numbers}
    return judge("fig1.continuous", sizes, sizes=sizes)


def slip_range(solution: Solution) -> tuple[float, float]:
    """Least and largest slip of the contacts of all samples that can slip, over R times the jump."""
    scene = solution.scene
    slips = solution.slip[:, ~scene.lattice.between_driven] / (scene.lattice.radius * scene.jump)
    return float(slips.min()), float(slips.max())


def least_rise(solution: Solution) -> float:
    """Least difference of the mean staggered spin from a layer to the next, over the jump, towards the top."""
    scene = solution.scene
    axes = scene.minimum_spin_axes
    top = scene.top_spin(axes).reshape(len(axes), -1)[:, 0]
    staggered = scene.staggered_spin(solution.spin, axes)
    layers = staggered.mean(axis=tuple(range(2, staggered.ndim - 1)))
    along = np.tensordot(top / scene.jump**2, layers, axes=1)
    return float(np.diff(along, axis=-1).min())


def _least_power(minimum: Minimum, settled: Settled) -> Claim:
    spread, apart = float(minimum.spread.max()), float(settled.spread.max())
    numbers = {"samples": len(minimum.spread), "spread": spread}
    numbers |= {"other_samples": len(settled.spread), "other_spread": apart}
    return judge("fig1.least_power", numbers, same_cut=minimum.same_cut, worst=max(spread, apart))


def _interface(minimum: Minimum, settled: Settled) -> Claim:
    numbers = {
        "samples": len(minimum.cut.unique),
        "unique": int(minimum.cut.unique.sum()),
        "nearest_second_cut": float(minimum.distance.min()),
        "settled": len(settled.differing),
        "identical": int((settled.differing == 0).sum()),
        "proven": int(settled.solution.states_proven.sum()),
    }
    return judge("fig1.interface", numbers)


def _counted(minimum: Minimum, descent: Descent) -> Claim:
    samples, failed = len(descent.differs), int(descent.differs.sum())
    expected = round(PAPER_OTHERS * samples / PAPER_SAMPLES)
    explained = minimum.distance[descent.differs] <= descent.excess[descent.differs] / VISIBLE
    last = int((minimum.distance <= minimum.distance[descent.differs].max()).sum()) if failed else 0
    numbers = {
        "samples": samples,
        "iterations": DESCENT,
        "visible_slip": VISIBLE,
        "identical": samples - failed,
        "explained": int(explained.sum()),
        "pairs_in_order": share_above(minimum.distance[~descent.differs], minimum.distance[descent.differs]),
        "highest_rank_of_others": last,
        "distance_for_the_papers_count": float(np.sort(minimum.distance)[min(expected, samples - 1)]),
        "median_excess": float(np.median(descent.excess)),
    }
    farthest = f" The largest e among them has rank {last} of all." if failed else ""
    return judge("fig1.counted", numbers, others=Share(failed, samples), expected=expected, farthest=farthest)


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
    numbers = {
        "seeds": [minimum.solution.scene.seeds[n] for n in chosen],
        "distance": minimum.distance[chosen].tolist(),
        "excess": descent.excess[chosen].tolist(),
        "on_two_cuts": within.tolist(),
    }
    return judge("fig1.two_boundaries", numbers, within=within, at_second=at_second, same=same,
                 found=Share.of(within & at_second))  # fmt: skip


def _any_start(scene: Scene) -> Claim:
    above, bottom, top = cut_of(scene).above, scene.spin_bottom, scene.spin_top
    cut = np.where(above, top, bottom)
    apart = {start: float(np.abs(relax(scene, start).last[0] - cut).max() / scene.jump) for start in STARTS}
    numbers = {"samples": scene.replicas} | {f"apart_from_{start}": value for start, value in apart.items()}
    return judge("fig1.any_start", numbers, worst=max(apart.values()), starts=" and from ".join(STARTS))


def _any_distribution(others: Sequence[Settled]) -> Claim:
    numbers = {}
    for name, settled in zip(DISTRIBUTIONS, others, strict=True):
        unique, same = settled.cut.unique, settled.differing == 0
        spread = {"samples": len(unique), "spread": float(settled.spread.max())}
        numbers[name] = spread | {
            "unique": int(unique.sum()),
            "alike": int((same & unique).sum()),
            "same": same.tolist(),
        }
    return judge("fig1.any_distribution", numbers, of=numbers)


def _any_bottom(driven: Sequence[Settled]) -> Claim:
    numbers = {}
    for bottom, settled in zip(BOTTOMS, driven, strict=True):
        spread = {"samples": len(settled.differing), "spread": float(settled.spread.max())}
        numbers[f"{bottom:g}"] = spread | {"identical": int((settled.differing == 0).sum())}
    return judge("fig1.any_bottom", numbers, of=numbers)
