"""Figure 2 of the paper: a 3x3x3 Coulomb bearing relaxes to a power below that of the minimum cut.

Followed by the paper's Cundall-Strack dynamics and, with the same inertia, under rigid friction without springs.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.scene import Scene
from taichi_bearings.solvers import CundallStrack
from taichi_bearings.stages import each, stage
from taichi_bearings.words import counted

from ..plots.relaxation import Relaxation, draw_relaxation
from .claims import FEWEST, HALF, Claim, Effort, Share, every, interval_of_mean
from .relaxation import (
    SAME,
    Minima,
    Run,
    intermediate_spheres,
    minima_of,
    relax,
    relax_rigidly,
    without_idle_spin,
)
from .samples import save_both

SHAPE, LARGER = (3, 3, 3), (6, 6, 6)
STARTS = {"random": "random spins", "minimum-cut": "the minimum cut"}
RUNS, RIGID_RUNS = 8, 3  # samples that are followed in time, by Cundall-Strack dynamics and without springs
LARGER_SAMPLES = 20
MONOTONIC = 0.01  # of the whole fall that a monotonic one may rise by on its way
STIFFER = 10.0  # factor of the damping at which creep must be a fifth
ROUND_OFF = 1e-12  # of P_0: what a power that cannot rise may rise by
RIGID_SAME = 1e-9  # relative excess over the proven bound at which a rigid run has reached the minimum
STIFFER_STEPS = 30_000  # all loads have been taken up by then


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write fig2.png, fig2.pdf and fig2.csv into `folder`; returns the claims with their verdicts."""
    runtime.start("cpu", "f64")
    runs_of = min(RUNS, effort.samples)
    scene = Scene.random(SHAPE, effort.seed, replicas=runs_of)
    runs = [relax(scene, start) for start in each(tuple(STARTS), "relaxation")]
    stiff = CundallStrack(damping=STIFFER * CundallStrack().damping)
    stiffer = [relax(scene, start, stiff, STIFFER_STEPS) for start in each(list(STARTS), "stiffer relaxation")]
    rigid_scene = Scene.random(SHAPE, effort.seed, replicas=min(RIGID_RUNS, effort.samples))
    rigid = [relax_rigidly(rigid_scene, start) for start in each(list(STARTS), "rigid relaxation")]
    with stage(f"minima of {counted(effort.samples, 'sample')}"):
        minima = minima_of(Scene.random(SHAPE, effort.seed, replicas=effort.samples))
    with stage("minima of larger samples"):
        larger = minima_of(Scene.random(LARGER, effort.seed, replicas=min(LARGER_SAMPLES, effort.samples)))
    write_curves(folder / "fig2.csv", scene, {"cundall-strack": runs, "rigid-limit": rigid}, minima)
    largest = max(abs(scene.spin_top), abs(scene.spin_bottom))
    shown = shown_sample(minima, rigid_scene.replicas)
    drawn = [
        Relaxation(
            name=STARTS[run.start],
            time=run.time,
            power=run.power[:, shown],
            rigid_time=without_springs.time,
            rigid_power=without_springs.power[:, shown],
            first=np.moveaxis(without_idle_spin(run.first)[:, shown], 0, -1) / largest,
            last=np.moveaxis(without_idle_spin(run.last)[:, shown], 0, -1) / largest,
        )
        for run, without_springs in zip(runs, rigid, strict=True)
    ]
    with stage("drawing"):
        figure = draw_relaxation(drawn, float(minima.power[shown]), float(minima.cut_power[shown]))
        save_both(figure, folder, "fig2")
    return [
        _falls_rigidly(rigid_scene, rigid),
        *(_falls(scene, *three) for three in zip(runs, stiffer, rigid, strict=True)),
        _same_end(scene, runs, minima),
        _same_rigid_end(rigid_scene, rigid, minima),
        _below_cut(minima, scene, shown),
        _leaves_cut(scene, runs[1], minima),
        _intermediate_states(scene, minima),
        _larger_systems(larger),
    ]


def distance_of_power(run: Run, rigid: Run) -> np.ndarray:
    """Largest difference (R,) of the power over P_0, at the times of the rigid run that both have, linear between the
    times of the other one. R : samples of the rigid run."""
    both = rigid.time <= run.time[-1]
    apart = [
        np.abs(np.interp(rigid.time[both], run.time, p) - q[both]).max() / q[0]
        for p, q in zip(run.power.T, rigid.power.T, strict=False)
    ]
    return np.array(apart)


def shown_sample(minima: Minima, runs: int) -> int:
    """Of the samples that are followed in time the first whose minimum is below its minimum cut, else the first."""
    return int(np.argmax(minima.below_cut[:runs]))


def write_curves(path: Path, scene: Scene, runs: Mapping[str, Sequence[Run]], minima: Minima) -> None:
    """The curves: dynamics, start, seed, time, power, power over the initial one, power over the certified minimum."""
    rows = []
    for dynamics, run in ((name, run) for name, both in runs.items() for run in both):
        for n, power_of in enumerate(run.power.T):
            for time, power in zip(run.time, power_of, strict=True):
                numbers = (time, power, power / power_of[0], power / minima.power[n])
                rows.append([dynamics, run.start, scene.seeds[n], *map(float, numbers)])
    names = ["dynamics", "start", "seed", "time", "power", "power_over_initial", "power_over_minimum"]
    write_csv(path, names, rows)


def _falls_rigidly(scene: Scene, runs: Sequence[Run]) -> Claim:
    rise = {run.start: run.largest_rise for run in runs}
    worst = max(float(values.max()) for values in rise.values())
    falls = "; ".join(f"from {STARTS[run.start]} to {_range(run.power[-1] / run.power[0])} of P_0" for run in runs)
    return Claim(
        "3x3x3: under rigid friction P(t) falls monotonically, from both starts.",
        f"Without springs P falls {falls}. In {counted(scene.replicas, 'sample')} and "
        f"{' and '.join(str(len(run.time) - 1) for run in runs)} time steps it never rises above an earlier value by "
        f"more than {worst:.1e} P_0 (limit {ROUND_OFF:g}, round-off).",
        worst <= ROUND_OFF,
        {"seeds": list(scene.seeds)} | {f"largest_rise_from_{name}": values.tolist() for name, values in rise.items()},
        kind="theorem",
        samples=scene.replicas,
        paper="monotonically",
        ours=f"rises by {worst:.0e} P_0 at most",
        uncertainty="none but rounding: a theorem",
    )


def _falls(scene: Scene, run: Run, stiffer: Run, rigid: Run) -> Claim:
    fall = 1 - run.power[-1] / run.power[0]
    falls = fall > SAME
    rise, less = run.largest_rise[falls] / fall[falls], stiffer.largest_rise[falls] / fall[falls]
    most, with_less = float(rise.max(initial=0.0)), float(less.max(initial=0.0))
    creeps = with_less <= max(most / 5, MONOTONIC) and bool((rigid.largest_rise <= ROUND_OFF).all())
    apart = distance_of_power(run, rigid)
    return Claim(
        f"3x3x3: from {STARTS[run.start]} the power decreases monotonically.",
        f"P ends at {_range(run.power[-1] / run.power[0])} of P_0. Where it falls, in {falls.sum()} of "
        f"{counted(len(fall), 'sample')}, it rises along the trajectory by up to {most:.2g} times the whole fall "
        f"(limit for a monotonic one: {MONOTONIC:g}). The rigid curve, which P follows within {apart.max():.1e} P_0, "
        f"rises by {rigid.largest_rise.max():.1e} P_0. With {STIFFER:g} times the damping A_t, which slows the "
        f"creep of contacts that take up load, it is {with_less:.2g} times (limit for creep: a fifth of that).",
        bool(most <= MONOTONIC or creeps),
        {
            "seeds": list(scene.seeds),
            "fall_over_initial": fall.tolist(),
            "largest_rise_over_initial": run.largest_rise.tolist(),
            "largest_rise_with_more_damping": stiffer.largest_rise.tolist(),
            "damping_factor": STIFFER,
            "largest_distance_from_rigid_over_initial": apart.tolist(),
        },
        refined=most > MONOTONIC,
        samples=int(falls.sum()),
        needed=FEWEST,
        paper="monotonically, one sample",
        ours=f"rises by up to {most:.2g} times the fall",
        uncertainty=f"largest of {int(falls.sum())}: not exceeded {every(int(falls.sum()))}",
        after_data="that the rise is judged against the fall, and the factor of the damping",
    )


def _same_end(scene: Scene, runs: list[Run], minima: Minima) -> Claim:
    excess = {run.start: run.power[-1] / minima.lower_bound[: scene.replicas] - 1 for run in runs}
    worst = max(float(values.max()) for values in excess.values())
    apart = np.abs(without_idle_spin(runs[0].last) - without_idle_spin(runs[1].last)).max() / scene.jump
    return Claim(
        "The stationary state is that of least dissipation, whatever the initial one.",
        f"From random spins and from the minimum cut P ends at most {worst:.1e} above the proven lower bound of all "
        f"spins (limit {SAME:g}) in {counted(scene.replicas, 'sample')}. The spins at both ends differ by up to "
        f"{apart:.1e} of the jump, but for what is free: the mean of the layer about the height.",
        worst <= SAME,
        {"seeds": list(scene.seeds), "largest_difference_of_spins": float(apart)}
        | {f"excess_from_{name}": values.tolist() for name, values in excess.items()},
        kind="theorem",
        samples=scene.replicas,
        paper="the global minimum, always",
        ours=f"within {worst:.0e} of the minimum",
        uncertainty="the excess is proven, sample by sample",
    )


def _same_rigid_end(scene: Scene, runs: Sequence[Run], minima: Minima) -> Claim:
    excess = {run.start: run.power[-1] / minima.lower_bound[: scene.replicas] - 1 for run in runs}
    worst = max(float(values.max()) for values in excess.values())
    return Claim(
        "Rigid friction ends at the certified minimum too, from both starts.",
        f"P ends at most {worst:.1e} above the proven lower bound of all spins (limit {RIGID_SAME:g}) in "
        f"{counted(scene.replicas, 'sample')}.",
        worst <= RIGID_SAME,
        {"seeds": list(scene.seeds)} | {f"excess_from_{name}": values.tolist() for name, values in excess.items()},
        kind="theorem",
        samples=scene.replicas,
        paper="not given",
        ours=f"within {worst:.0e} of the minimum",
        uncertainty="the excess is proven, sample by sample",
    )


def _below_cut(minima: Minima, scene: Scene, shown: int) -> Claim:
    ratio, equal = minima.power / minima.cut_power, int(minima.cut_is_minimum.sum())
    below = Share(int(minima.below_cut.sum()), len(ratio))
    return Claim(
        "3x3x3: the stationary power is generally below that of the minimum cut.",
        f"P_min < P_cut is proven in {below}; limit: more than half. In {equal} the minimum "
        f"cut is itself the minimum. P_min / P_cut: median {np.median(ratio):.4f}, least {ratio.min():.4f}; "
        f"{ratio[shown]:.4f} in the figure (seed {scene.seeds[shown]}).",
        numbers={
            "samples": len(ratio),
            "below": below.hits,
            "cut_is_minimum": equal,
            "seeds": list(scene.seeds),
            "minimum_over_cut": ratio[: scene.replicas].tolist(),
            "minimum_over_cut_median": float(np.median(ratio)),
            "minimum_over_cut_least": float(ratio.min()),
        },
        **below.above(HALF),
        paper="below, one sample",
        ours=f"below in {below.hits} of {below.samples}, P_min / P_cut {ratio.mean():.4f} in the mean",
        uncertainty=f"share: {below.interval}; mean: {interval_of_mean(ratio)}",
    )


def _leaves_cut(scene: Scene, run: Run, minima: Minima) -> Claim:
    below = minima.below_cut[: scene.replicas]
    falls = 1 - run.power[-1] / minima.cut_power[: scene.replicas]
    left = below & (falls > SAME)
    stayed = ~below & (np.abs(falls) <= SAME)
    reached = f", to {_range(1 - falls[left])} of P_cut" if left.any() else ""
    return Claim(
        "3x3x3: the minimum-cut state is not stationary where it is not the minimum.",
        f"The dynamics leaves it in {left.sum()} of the {below.sum()} samples whose minimum is proven to be lower"
        f"{reached}; in the other {(~below).sum()} it comes back to it in {stayed.sum()}.",
        bool((left == below).all()),
        {"seeds": list(scene.seeds), "not_the_minimum": below.tolist(), "fall_over_cut": falls.tolist()},
        samples=int(below.sum()),
        kind="theorem",
        paper="it evolves to less power",
        ours=f"left in {left.sum()} of {below.sum()}",
        uncertainty="none: a theorem; which samples have a lower minimum is proven",
    )


def _intermediate_states(scene: Scene, minima: Minima) -> Claim:
    count = intermediate_spheres(scene, minima.spin[: scene.replicas])
    below = minima.below_cut[: scene.replicas]
    free = int((~scene.lattice.is_driven).sum())
    return Claim(
        "3x3x3: in the stationary state some spheres belong to neither of the two imposed bearing states.",
        f"So do {', '.join(map(str, count))} of {free} free spheres (seeds {', '.join(map(str, scene.seeds))}), "
        "and at least one wherever the minimum is below the minimum cut.",
        bool((count[below] > 0).all()),
        {"seeds": list(scene.seeds), "intermediate_spheres": count.tolist(), "free_spheres": free},
        samples=int(below.sum()),
        kind="theorem",
        paper="some spheres",
        ours=f"{int(count[below].min(initial=free))} of {free} free spheres at least" if below.any() else "no sample",
        uncertainty="none: a theorem",
    )


def _larger_systems(minima: Minima) -> Claim:
    ratio = minima.power / minima.cut_power
    below = Share(int(minima.below_cut.sum()), len(ratio))
    return Claim(
        "The same behaviour is observed for larger systems.",
        f"{'x'.join(map(str, LARGER))}: P_min < P_cut is proven in {below}; limit: more "
        f"than half. P_min / P_cut {_range(ratio)}.",
        numbers={"shape": list(LARGER), "samples": len(ratio), "below": below.hits, "minimum_over_cut": ratio.tolist()},
        **below.above(HALF),
        paper="the same behaviour",
        ours=f"below in {below.hits} of {below.samples}, P_min / P_cut {ratio.mean():.4f} in the mean",
        uncertainty=f"share: {below.interval}; mean: {interval_of_mean(ratio)}",
    )


def _range(values: np.ndarray) -> str:
    return f"{values.min():.4f} ... {values.max():.4f}" if len(values) > 1 else f"{values[0]:.4f}"
