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
from .claims import Claim, Effort, Share, judge, span
from .samples import SAME, Minima, Run, minima_of, relax, relax_rigidly, save_both

SHAPE, LARGER = (3, 3, 3), (6, 6, 6)
STARTS = {"random": "random spins", "minimum-cut": "the minimum cut"}
RUNS, RIGID_RUNS = 8, 3  # samples that are followed in time, by Cundall-Strack dynamics and without springs
LARGER_SAMPLES = 20
STIFFER, STIFFER_STEPS = 10.0, 30_000  # factor of the damping; all loads have been taken up by then


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
    largest = scene.fastest
    shown = shown_sample(minima, rigid_scene.replicas)
    drawn = []
    for run, hard in zip(runs, rigid, strict=True):
        ends = [np.moveaxis(without_idle_spin(spin)[:, shown], 0, -1) / largest for spin in (run.first, run.last)]
        curves = (run.time, run.power[:, shown], hard.time, hard.power[:, shown])
        drawn.append(Relaxation(STARTS[run.start], *curves, *ends))
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


def without_idle_spin(staggered: np.ndarray) -> np.ndarray:
    """Staggered spins (3, R, nx, ny, nz) less the mean of each free layer about the height.

    That part makes no contact slip and never changes (equations.md, 3).
    """
    rest = staggered.copy()
    free = rest[2, ..., 1:-1]
    free -= free.mean(axis=(1, 2), keepdims=True)
    return rest


def intermediate_spheres(scene: Scene, spin: np.ndarray) -> np.ndarray:
    """Number (R,) of free spheres that turn neither with the bottom nor with the top, to 1e-3 of the jump."""
    axes = scene.minimum_spin_axes
    staggered = scene.staggered_spin(spin, axes)
    apart = [
        np.linalg.norm(staggered - value, axis=0) > 1e-3 * scene.jump
        for value in (0.0, scene.top_spin(axes)[:, None, ..., None])
    ]
    return np.asarray((apart[0] & apart[1] & ~scene.lattice.is_driven).reshape(scene.replicas, -1).sum(axis=1))


def _falls_rigidly(scene: Scene, runs: Sequence[Run]) -> Claim:
    rise = {f"largest_rise_from_{run.start}": run.largest_rise.tolist() for run in runs}
    falls = {STARTS[run.start]: {"ends": run.power[-1] / run.power[0]} for run in runs}
    steps = " and ".join(str(len(run.time) - 1) for run in runs)
    worst = max(map(max, rise.values()))
    numbers = {"seeds": list(scene.seeds)} | rise
    return judge("fig2.falls_rigidly", numbers, falls=falls, steps=steps, worst=worst, samples=scene.replicas)


def _falls(scene: Scene, run: Run, stiffer: Run, rigid: Run) -> Claim:
    fall = 1 - run.power[-1] / run.power[0]
    falls = fall > SAME
    most, with_less = (float((of.largest_rise[falls] / fall[falls]).max(initial=0.0)) for of in (run, stiffer))
    numbers = {
        "seeds": list(scene.seeds),
        "fall_over_initial": fall.tolist(),
        "largest_rise_over_initial": run.largest_rise.tolist(),
        "largest_rise_with_more_damping": stiffer.largest_rise.tolist(),
        "damping_factor": STIFFER,
        "largest_distance_from_rigid_over_initial": distance_of_power(run, rigid).tolist(),
    }
    return judge(
        "fig2.falls", numbers, start=STARTS[run.start], ends=run.power[-1] / run.power[0], falls=falls, most=most,
        with_less=with_less, rigid_rise=rigid.largest_rise,
    )  # fmt: skip


def _excess(scene: Scene, runs: Sequence[Run], minima: Minima) -> dict[str, list[float]]:
    """Of the last power over the proven bound of all spins, relative, by the start."""
    bound = minima.lower_bound[: scene.replicas]
    return {f"excess_from_{run.start}": (run.power[-1] / bound - 1).tolist() for run in runs}


def _same_end(scene: Scene, runs: Sequence[Run], minima: Minima) -> Claim:
    excess = _excess(scene, runs, minima)
    apart = np.abs(without_idle_spin(runs[0].last) - without_idle_spin(runs[1].last)).max() / scene.jump
    numbers = {"seeds": list(scene.seeds), "largest_difference_of_spins": float(apart)} | excess
    return judge("fig2.same_end", numbers, worst=max(map(max, excess.values())), samples=scene.replicas)


def _same_rigid_end(scene: Scene, runs: Sequence[Run], minima: Minima) -> Claim:
    excess = _excess(scene, runs, minima)
    numbers = {"seeds": list(scene.seeds)} | excess
    return judge("fig2.same_rigid_end", numbers, worst=max(map(max, excess.values())), samples=scene.replicas)


def _below_cut(minima: Minima, scene: Scene, shown: int) -> Claim:
    ratio, share = minima.power / minima.cut_power, Share.of(minima.below_cut)
    numbers = {
        "samples": len(ratio),
        "below": share.hits,
        "cut_is_minimum": int(minima.cut_is_minimum.sum()),
        "seeds": list(scene.seeds),
        "minimum_over_cut": ratio[: scene.replicas].tolist(),
        "minimum_over_cut_median": float(np.median(ratio)),
        "minimum_over_cut_least": float(ratio.min()),
    }
    return judge("fig2.below_cut", numbers, share=share, ratio=ratio, shown=ratio[shown], seed=scene.seeds[shown])


def _leaves_cut(scene: Scene, run: Run, minima: Minima) -> Claim:
    below = minima.below_cut[: scene.replicas]
    falls = 1 - run.power[-1] / minima.cut_power[: scene.replicas]
    left = below & (falls > SAME)
    numbers = {"seeds": list(scene.seeds), "not_the_minimum": below.tolist(), "fall_over_cut": falls.tolist()}
    return judge(
        "fig2.leaves_cut", numbers, below=below, left=left, others=int((~below).sum()),
        stayed=~below & (np.abs(falls) <= SAME), reached=f", to {span(1 - falls[left])} of P_cut" if left.any() else "",
    )  # fmt: skip


def _intermediate_states(scene: Scene, minima: Minima) -> Claim:
    count = intermediate_spheres(scene, minima.spin[: scene.replicas])
    below = minima.below_cut[: scene.replicas]
    free = int((~scene.lattice.is_driven).sum())
    least = f"{count[below].min()} of {free} free spheres at least" if below.any() else "no sample"
    numbers = {"seeds": list(scene.seeds), "intermediate_spheres": count.tolist(), "free_spheres": free}
    return judge("fig2.intermediate_states", numbers, count=count, below=below, least=least)


def _larger_systems(minima: Minima) -> Claim:
    ratio, share = minima.power / minima.cut_power, Share.of(minima.below_cut)
    numbers = {"shape": list(LARGER), "samples": len(ratio), "below": share.hits, "minimum_over_cut": ratio.tolist()}
    return judge("fig2.larger_systems", numbers, size="x".join(map(str, LARGER)), share=share, ratio=ratio)
