"""Stiffness K_t, damping A_t and normal force F_n: what depends on them, and what does not.

The stationary state minimises P = F_n sum mu |v|. Springs and dampers are not in it, and F_n is a factor. Rigid
friction, I d(omega)/dt = -dP/d(omega), knows F_n as a factor of the time alone, so curves are compared at equal F_n t.
What depends on K_t and A_t is the trajectory: contacts that hold stretch by up to mu F_n / K_t and creep at up to
mu F_n / A_t.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.solvers import CundallStrack, InteriorPoint
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import each, stage
from taichi_bearings.words import counted
from taichi_bearings.words import share as in_percent

from ..plots.parameters import Course, draw_parameters
from .claims import FEWEST, Claim, Effort, interval_of_mean
from .relaxation import SAME, TIMES, Run, relax
from .samples import save_both, solved

SHAPE, START = (3, 3, 3), "random"
RUNS = 8
STIFFNESS, DAMPING, FORCE = 1e5, 1e3, 50.0  # the paper's
STEPS = 4_000_000  # limit; ten times the damping takes a million
ROUND_OFF = 1e-9  # relative difference of least powers over F_n that are the same
SIGNIFICANT = 0.05  # of P_0: a difference between two courses that counts
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

    @cached_property
    def forces(self) -> list[float]:
        return list(self.minima)


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
    changed = sum(int((state != states[0]).sum()) for state in states[1:])
    proven = min(int(s.states_proven.sum()) for s in (first, *others))
    slipless = int((states[0] == ContactState.SLIPLESS).sum())
    return Claim(
        "The state of least dissipation does not depend on F_n; its power is proportional to it.",
        f"P_min / F_n is the same to {spread:.1e} for F_n = {', '.join(f'{force:g}' for force in courses.forces)} "
        f"(limit {ROUND_OFF:g}), and {changed} contacts have another state (limit: none). {slipless} contacts are "
        f"slipless in {counted(len(per_force), 'sample')}; all are proven in {proven}. K_t and A_t are not in it.",
        bool(spread <= ROUND_OFF and changed == 0),
        {"forces": courses.forces, "spread": spread, "contacts_that_differ": changed, "proven": proven},
        samples=len(per_force),
        kind="theorem",
        paper="no significant differences",
        ours=f"P_min / F_n equal to {spread:.0e}",
        uncertainty="none but rounding: a theorem",
    )


def _same_end(courses: Courses) -> Claim:
    excess = {name: courses.excess(name)[-1] for name in courses.runs}
    worst = max(float(values.max()) for values in excess.values())
    samples = len(next(iter(excess.values())))
    return Claim(
        "The dynamics ends in the same stationary state for other F_n, K_t and A_t.",
        f"In {counted(samples, 'sample')} and for {', '.join(courses.runs)} (else the paper's) P ends at most "
        f"{worst:.1e} above the proven lower bound (limit {SAME:g}).",
        worst <= SAME,
        {name: values.tolist() for name, values in excess.items()},
        samples=samples,
        needed=FEWEST,
        paper="no significant differences",
        ours=f"within {worst:.0e} of the minimum",
        uncertainty="the excess is proven, sample by sample",
    )


def _same_way(courses: Courses) -> Claim:
    apart = {name: courses.distance(name) for name in courses.runs if name != PAPER}
    stiffer = max(float(apart[name].max()) for name in ("K = 1e6", "A = 1e4", "K = 1e6, A = 1e4"))
    loaded = max(float(apart[name].max()) for name in ("F_n = 5", "F_n = 500"))
    words = "; ".join(f"{name} {values.mean():.2g}, at most {values.max():.2g}" for name, values in apart.items())
    return Claim(
        "For other F_n and greater K_t and A_t no significant differences are observed: on the trajectory, too.",
        f"Largest difference of P / P_0 from the course with the paper's values, at equal F_n t; mean over the samples "
        f"and largest: {words} (limit: {SIGNIFICANT:g} in every sample for greater K_t and A_t; where other F_n alone "
        "exceed it the claim is refined). The stretch mu F_n / K_t of a contact that holds must be small: more normal "
        "force takes more stiffness. Which F_n the paper tried it does not say.",
        stiffer <= SIGNIFICANT,
        {name: values.tolist() for name, values in apart.items()},
        refined=loaded > SIGNIFICANT,
        samples=len(next(iter(apart.values()))),
        needed=FEWEST,
        paper="no significant differences",
        ours=f"P / P_0 differs by up to {stiffer:.2g}, for other F_n by {loaded:.2g}",
        uncertainty="mean for " + "; ".join(f"{name}: {interval_of_mean(values)}" for name, values in apart.items()),
    )


def _slower(courses: Courses) -> Claim:
    ratio = {name: courses.arrival(name) / courses.arrival(PAPER) for name in courses.runs if name != PAPER}
    words = "; ".join(f"{name} {values.mean():.2g} ({interval_of_mean(values)})" for name, values in ratio.items())
    faster = ratio["K = 1e6"]
    return Claim(
        "Beyond the paper: how long it takes depends on K_t.",
        f"Time F_n t until P stays within {LATE:g} of the least power, over that with the paper's values: {words} "
        "(limit: with K = 1e6 less than 1 in every sample).",
        bool((faster < 1).all()),
        {name: values.tolist() for name, values in ratio.items()},
        samples=len(faster),
        needed=FEWEST,
        paper="not given",
        ours=f"{faster.mean():.2g} of the time with ten times K_t",
        uncertainty=interval_of_mean(faster),
    )


def _threshold(scene: Scene) -> Claim:
    stretch = scene.coefficient.ravel() * (FORCE / STIFFNESS)
    least, most = float(stretch.min()), float(stretch.max())
    reached = float((stretch <= PAPER_STRETCH).mean())
    return Claim(
        "K = 10^5, A = 10^3 and F_n = 50 ensure that the threshold of friction is reached at delta = 10^-4.",
        f"A contact yields at a stretch of mu F_n / K_t. In {counted(scene.replicas, 'sample')} that is {least:.1e} to "
        f"{most:.1e}, and {PAPER_STRETCH:g} is enough for {in_percent(reached, 0)} of the contacts (limit: enough for "
        f"all; refined where ten times as much is).",
        most <= 10 * PAPER_STRETCH,
        {"least": least, "most": most, "reached": reached},
        refined=most > PAPER_STRETCH,
        samples=scene.replicas,
        needed=FEWEST,
        paper="10^-4",
        ours=f"{least:.0e} to {most:.0e}",
        uncertainty="the range that uniform friction from 0.1 to 1 allows is 5e-05 to 5e-04",
    )
