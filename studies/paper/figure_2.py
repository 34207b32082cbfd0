"""Figure 2 of the paper: a 3x3x3 Coulomb bearing relaxes to a power below that of the minimum cut.

Followed by the paper's Cundall-Strack dynamics and, with the same inertia, under rigid friction without springs.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.scene import Scene
from taichi_bearings.solvers import CundallStrack
from taichi_bearings.stages import each, stage
from taichi_bearings.words import counted

from ..plots.relaxation import draw_relaxation
from .claims import Effort
from .samples import SAME, Found, Run, Table, curves, joined, minima_of, relax, relax_rigidly

SHAPE, LARGER = (3, 3, 3), (6, 6, 6)
STARTS = {"random": "random spins", "minimum-cut": "the minimum cut"}
RUNS, RIGID_RUNS = 8, 3  # samples that are followed in time, by Cundall-Strack dynamics and without springs
LARGER_SAMPLES = 20
STIFFER, STIFFER_STEPS = 10.0, 30_000  # factor of the damping; all loads have been taken up by then


def study(folder: Path, effort: Effort) -> Found:
    """Samples followed from both starts, and the minima of more."""
    draw = partial(Scene.random, seed=effort.seed)
    scene, rigid_scene = (draw(SHAPE, replicas=min(most, effort.samples)) for most in (RUNS, RIGID_RUNS))
    stiff = CundallStrack(damping=STIFFER * CundallStrack().damping)
    runs = [relax(scene, start) for start in each(tuple(STARTS), "relaxation")]
    stiffer = [relax(scene, start, stiff, STIFFER_STEPS) for start in each(tuple(STARTS), "stiffer relaxation")]
    rigid = [relax_rigidly(rigid_scene, start) for start in each(tuple(STARTS), "rigid relaxation")]
    with stage(f"minima of {counted(effort.samples, 'sample')}"):
        minima = minima_of(draw(SHAPE, replicas=effort.samples))
    with stage("minima of larger samples"):
        larger = minima_of(draw(LARGER, replicas=min(LARGER_SAMPLES, effort.samples)))
    spheres = intermediate_spheres(scene, minima.spin[: scene.replicas])
    named = names_of(runs, stiffer, rigid, minima, larger) | {"intermediate": spheres, "seeds": scene.seeds}
    named |= {"free_spheres": int((~scene.lattice.is_driven).sum()), "apart": apart(*runs) / scene.jump}
    dynamics = {"cundall-strack": runs, "rigid-limit": rigid}
    courses = {
        name: joined({run.start: course_of(run, scene.seeds, minima) for run in both}, "start")
        for name, both in dynamics.items()
    }
    shown = named["place"]
    ends = [[shown_spins(spin, shown) / scene.fastest for spin in (run.first, run.last)] for run in runs]
    figure = partial(draw_relaxation, tuple(STARTS.values()), runs, rigid, ends, minima, shown)
    return Found({".csv": joined(courses, "dynamics")}, figure, named)


def names_of(
    runs: Sequence[Run], stiffer: Sequence[Run], rigid: Sequence[Run], minima: Table, larger: Table
) -> dict[str, Any]:
    """What the claims name; followed, rigidly : the minima of the samples that are followed. place : of the sample
    shown, of those that are followed the first whose minimum is below its minimum cut, else the first."""
    samples, rigid_samples = (of[0].power.shape[1] for of in (runs, rigid))
    pairs = [
        {"start": STARTS[run.start], "run": run, "stiff": stiff, "hard": hard, "distance": distance_of_power(run, hard)}
        for run, stiff, hard in zip(runs, stiffer, rigid, strict=True)
    ]
    return {
        "pairs": pairs, "runs": runs, "rigid": rigid, "rigid_samples": rigid_samples, "damping_factor": STIFFER,
        "minima": minima, "followed": minima[:samples], "rigidly": minima[:rigid_samples], "larger": larger,
        "same_power": SAME, "shape": LARGER, "place": int(np.argmax(minima.below_cut[:rigid_samples])),
        "falls": {STARTS[run.start]: {"ends": run.ends} for run in rigid},
    }  # fmt: skip


def apart(run: Run, other: Run) -> float:
    """Largest difference of the spins at the end, but for what is free."""
    return float(np.abs(without_idle_spin(run.last) - without_idle_spin(other.last)).max())


def distance_of_power(run: Run, rigid: Run) -> np.ndarray:
    """Largest difference (R,) of the power over P_0, at the times of the rigid run that both have, linear between the
    times of the other one. R : samples of the rigid run."""
    both = rigid.time <= run.time[-1]
    pairs = zip(run.power.T, rigid.power.T, strict=False)
    return np.array([np.abs(np.interp(rigid.time[both], run.time, p) - q[both]).max() / q[0] for p, q in pairs])


def course_of(run: Run, seeds: Sequence[int], minima: Table) -> Table:
    """The power against time, a row a sample and time."""
    samples, over = run.power.shape[1], {"power_over_initial": run.power / run.power[0]}
    over["power_over_minimum"] = run.power / minima.power[:samples]
    return curves(seeds[:samples], time=run.time, power=run.power, **over)


def without_idle_spin(staggered: np.ndarray) -> np.ndarray:
    """Staggered spins (3, R, nx, ny, nz) less the mean of each free layer about the height.

    That part makes no contact slip and never changes (equations.md, 3).
    """
    rest = staggered.copy()
    free = rest[2, ..., 1:-1]
    free -= free.mean(axis=(1, 2), keepdims=True)
    return rest


def shown_spins(staggered: np.ndarray, sample: int) -> np.ndarray:
    """The same of one sample, (nx, ny, nz, 3)."""
    return np.moveaxis(without_idle_spin(staggered)[:, sample], 0, -1)


def intermediate_spheres(scene: Scene, spin: np.ndarray) -> np.ndarray:
    """Number (R,) of free spheres that turn neither with the bottom nor with the top, to 1e-3 of the jump."""
    axes = scene.minimum_spin_axes
    staggered = scene.staggered_spin(spin, axes)
    apart = [
        np.linalg.norm(staggered - value, axis=0) > 1e-3 * scene.jump
        for value in (0.0, scene.top_spin(axes)[:, None, ..., None])
    ]
    return np.asarray((apart[0] & apart[1] & ~scene.lattice.is_driven).reshape(scene.replicas, -1).sum(axis=1))
