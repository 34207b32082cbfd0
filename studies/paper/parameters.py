"""Stiffness K_t, damping A_t and normal force F_n: what depends on them, and what does not.

The stationary state minimises P = F_n sum mu |v|. Springs and dampers are not in it, and F_n is a factor. Rigid
friction, I d(omega)/dt = -dP/d(omega), knows F_n as a factor of the time alone, so curves are compared at equal F_n t.
What depends on K_t and A_t is the trajectory: contacts that hold stretch by up to mu F_n / K_t and creep at up to
mu F_n / A_t.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.solvers import CundallStrack, InteriorPoint
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import each, stage

from ..plots.parameters import Course, draw_parameters
from .claims import Claim, Effort, judge
from .samples import TIMES, Run, relax, save_both, solved

SHAPE, START = (3, 3, 3), "random"
RUNS = 8
STIFFNESS, DAMPING, FORCE = 1e5, 1e3, 50.0  # the paper's
STEPS = 4_000_000  # limit; ten times the damping takes a million
PAPER_STRETCH = 1e-4  # at which contacts yield, by the paper
LATE = 1e-3  # excess of the power over the minimum, relative, at which the times of two courses are compared


@dataclass(frozen=True)
class Springs:
    """K_t, force / length, A_t, force * time / length, and F_n."""

    stiffness: float = STIFFNESS
    damping: float = DAMPING
    force: float = FORCE


VARIANTS = {  # the first one is that of the paper
    "K = 1e5, A = 1e3, F_n = 50": Springs(),
    "F_n = 5": Springs(force=5.0),
    "F_n = 500": Springs(force=500.0),
    "K = 1e6": Springs(stiffness=1e6),
    "A = 1e4": Springs(damping=1e4),
    "K = 1e6, A = 1e4": Springs(stiffness=1e6, damping=1e4),
    "K = 1e4": Springs(stiffness=1e4),
    "A = 1e2": Springs(damping=1e2),
}
PAPER = next(iter(VARIANTS))


@dataclass(frozen=True)
class Courses:
    """Relaxations of R samples by variant, and their certified minima, by normal force."""

    runs: Mapping[str, Run]
    minima: Mapping[float, Solution]

    def scaled_time(self, name: str) -> np.ndarray:
        """F_n t over the paper's F_n, (T,)."""
        return self.runs[name].time * (VARIANTS[name].force / FORCE)

    def excess(self, name: str) -> np.ndarray:
        """P over the proven lower bound, less 1, (T, R)."""
        return np.asarray(self.runs[name].power / self.minima[VARIANTS[name].force].lower_bound - 1)

    def distance(self, name: str) -> np.ndarray:
        """Largest difference (R,) from the paper's course at equal F_n t, over P_0; what has ended stays as it is."""
        time, other = self.scaled_time(PAPER), self.scaled_time(name)
        longest = np.union1d(time, other)
        own, paper = self.runs[name].power, self.runs[PAPER].power
        return np.array([
            np.abs(np.interp(longest, other, p / p[0]) - np.interp(longest, time, q / q[0])).max()
            for p, q in zip(own.T, paper.T, strict=True)
        ])  # fmt: skip

    def arrival(self, name: str) -> np.ndarray:
        """F_n t (R,) from which on the power is within LATE of the minimum; that of the last row if it never is."""
        late = self.excess(name) > LATE
        last = len(late) - 1 - np.argmax(late[::-1], axis=0)
        after = np.where(late.any(axis=0), np.minimum(last + 1, len(late) - 1), 0)
        return np.asarray(self.scaled_time(name)[after])


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write parameters.png, .pdf and .csv into `folder`; returns the claims with their verdicts."""
    runtime.start("cpu", "f64")
    courses = followed(effort)
    write_courses(folder / "parameters.csv", courses, effort.seed)
    with stage("drawing"):
        drawn = {
            name: Course(courses.scaled_time(name), run.power[:, 0] / run.power[0, 0], courses.excess(name)[:, 0])
            for name, run in courses.runs.items()
        }
        save_both(draw_parameters(drawn, effort.seed), folder, "parameters")
    return [
        _same_minimum(courses),
        _same_end(courses),
        _same_way(courses),
        _slower(courses),
        _threshold(courses.minima[FORCE].scene),
    ]


def followed(effort: Effort) -> Courses:
    """The samples under all variants, and their minima under all normal forces."""
    samples = min(RUNS, effort.samples)
    scenes = {
        force: Scene.random(SHAPE, effort.seed, replicas=samples, normal_force=force)
        for force in dict.fromkeys(springs.force for springs in VARIANTS.values())
    }
    runs = {}
    for name in each(tuple(VARIANTS), "variant"):
        springs = VARIANTS[name]
        method = CundallStrack(stiffness=springs.stiffness, damping=springs.damping)
        runs[name] = relax(scenes[springs.force], START, method, STEPS, TIMES * (FORCE / springs.force))
    with stage("minima"):
        minima = {force: solved(scene, InteriorPoint(), StopRule(1e-10)) for force, scene in scenes.items()}
    return Courses(runs, minima)


def write_courses(path: Path, courses: Courses, seed: int) -> None:
    """variant, seed, time, F_n t over the paper's F_n, power over the initial one, power over the least less 1."""
    rows = []
    for name, run in courses.runs.items():
        scaled, excess = courses.scaled_time(name), courses.excess(name)
        for r in range(run.power.shape[1]):
            for n in range(len(run.time)):
                numbers = (run.time[n], scaled[n], run.power[n, r] / run.power[0, r], excess[n, r])
                rows.append([name, seed + r, *map(float, numbers)])
    names = ["variant", "seed", "time", "scaled_time", "power_over_initial", "excess_over_minimum"]
    write_csv(path, names, rows)


def _same_minimum(courses: Courses) -> Claim:
    first, *others = courses.minima.values()
    per_force = first.power / first.scene.normal_force
    spread = max(float(np.abs(s.power / s.scene.normal_force / per_force - 1).max()) for s in others)
    states = [s.state for s in (first, *others)]
    numbers = {
        "forces": list(courses.minima),
        "spread": spread,
        "contacts_that_differ": sum(int((state != states[0]).sum()) for state in states[1:]),
        "proven": min(int(s.states_proven.sum()) for s in (first, *others)),
    }
    slipless = int((states[0] == ContactState.SLIPLESS).sum())
    return judge("parameters.same_minimum", numbers, slipless=slipless, samples=len(per_force))


def _same_end(courses: Courses) -> Claim:
    excess = {name: courses.excess(name)[-1].tolist() for name in courses.runs}
    samples = len(next(iter(excess.values())))
    return judge("parameters.same_end", excess, excess=excess, worst=max(map(max, excess.values())), samples=samples)


def _same_way(courses: Courses) -> Claim:
    apart = {name: courses.distance(name) for name in courses.runs if name != PAPER}
    return judge(
        "parameters.same_way",
        {name: values.tolist() for name, values in apart.items()},
        apart={name: {"values": values} for name, values in apart.items()},
        distances=apart,
        stiffer=max(float(apart[name].max()) for name in ("K = 1e6", "A = 1e4", "K = 1e6, A = 1e4")),
        loaded=max(float(apart[name].max()) for name in ("F_n = 5", "F_n = 500")),
        samples=len(next(iter(apart.values()))),
    )


def _slower(courses: Courses) -> Claim:
    ratio = {name: courses.arrival(name) / courses.arrival(PAPER) for name in courses.runs if name != PAPER}
    told = {name: {"values": values} for name, values in ratio.items()}
    numbers = {name: values.tolist() for name, values in ratio.items()}
    return judge("parameters.slower", numbers, ratio=told, faster=ratio["K = 1e6"], late=LATE)


def _threshold(scene: Scene) -> Claim:
    stretch = scene.coefficient.ravel() * (FORCE / STIFFNESS)
    reached = float((stretch <= PAPER_STRETCH).mean())
    numbers = {"least": float(stretch.min()), "most": float(stretch.max()), "reached": reached}
    return judge("parameters.threshold", numbers, samples=scene.replicas, enough=PAPER_STRETCH)
