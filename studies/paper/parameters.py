"""Stiffness K_t, damping A_t and normal force F_n: what depends on them, and what does not.

The stationary state minimises P = F_n sum mu |v|. Springs and dampers are not in it, and F_n is a factor. Rigid
friction, I d(omega)/dt = -dP/d(omega), knows F_n as a factor of the time alone, so curves are compared at equal F_n t.
What depends on K_t and A_t is the trajectory: contacts that hold stretch by up to mu F_n / K_t and creep at up to
mu F_n / A_t.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import in_our_style, new_figure
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.solvers import CundallStrack, InteriorPoint
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import each, stage

from .claims import Effort
from .samples import TIMES, Found, Run, curves, joined, relax, solved

SHAPE, START = (3, 3, 3), "random"
RUNS = 8
STIFFNESS, DAMPING, FORCE = 1e5, 1e3, 50.0  # the paper's
STEPS = 4_000_000  # limit; ten times the damping takes a million
LATE = 1e-3  # excess of the power over the minimum, relative, at which the times of two courses are compared
PAPER = "K = 1e5, A = 1e3, F_n = 50"
VARIANTS = {  # stiffness, force / length; damping, force * time / length; normal force
    PAPER: (STIFFNESS, DAMPING, FORCE),
    "F_n = 5": (STIFFNESS, DAMPING, 5.0),
    "F_n = 500": (STIFFNESS, DAMPING, 500.0),
    "K = 1e6": (1e6, DAMPING, FORCE),
    "A = 1e4": (STIFFNESS, 1e4, FORCE),
    "K = 1e6, A = 1e4": (1e6, 1e4, FORCE),
    "K = 1e4": (1e4, DAMPING, FORCE),
    "A = 1e2": (STIFFNESS, 1e2, FORCE),
}
COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#D55E00", "#CC79A7", "#8a8a8a", "#0072B2")  # by the variant
GREATER, LOADED = ("K = 1e6", "A = 1e4", "K = 1e6, A = 1e4"), ("F_n = 5", "F_n = 500")


@dataclass(frozen=True)
class Course:
    """Of R samples, at each of T times: time; scaled, F_n t over the paper's F_n; power over the initial one, and its
    excess over the proven least power, relative, (T, R)."""

    time: np.ndarray
    scaled: np.ndarray
    power: np.ndarray
    excess: np.ndarray

    @classmethod
    def of(cls, run: Run, force: float, bound: np.ndarray) -> "Course":
        return cls(run.time, run.time * (force / FORCE), run.power / run.power[0], run.power / bound - 1)

    def distance(self, other: "Course") -> np.ndarray:
        """Largest difference (R,) of the power over P_0 at equal F_n t; what has ended stays as it is."""
        at = np.union1d(self.scaled, other.scaled)
        pairs = zip(self.power.T, other.power.T, strict=True)
        return np.array(
            [np.abs(np.interp(at, self.scaled, p) - np.interp(at, other.scaled, q)).max() for p, q in pairs]
        )

    @property
    def arrival(self) -> np.ndarray:
        """F_n t (R,) from which on the power is within LATE of the minimum; that of the last row if it never is."""
        late = self.excess > LATE
        last = len(late) - 1 - np.argmax(late[::-1], axis=0)
        after = np.where(late.any(axis=0), np.minimum(last + 1, len(late) - 1), 0)
        return np.asarray(self.scaled[after])


def study(folder: Path, effort: Effort) -> Found:
    """The samples under all variants, and their minima under all normal forces."""
    scenes = {
        force: Scene.random(SHAPE, effort.seed, replicas=min(RUNS, effort.samples), normal_force=force)
        for force in dict.fromkeys(force for *_, force in VARIANTS.values())
    }
    runs = {}
    for name in each(tuple(VARIANTS), "variant"):
        stiffness, damping, force = VARIANTS[name]
        method = CundallStrack(stiffness=stiffness, damping=damping)
        runs[name] = relax(scenes[force], START, method, STEPS, TIMES * (FORCE / force))
    with stage("minima"):
        minima = {force: solved(scene, InteriorPoint(), StopRule(1e-10)) for force, scene in scenes.items()}
    courses = {
        name: Course.of(run, force := VARIANTS[name][2], minima[force].lower_bound) for name, run in runs.items()
    }
    rows = {
        name: curves(
            scenes[FORCE].seeds, time=of.time, scaled_time=of.scaled, power_over_initial=of.power,
            excess_over_minimum=of.excess,
        )
        for name, of in courses.items()
    }  # fmt: skip
    named = of_courses(courses) | of_minima(minima) | {"stretch": scenes[FORCE].coefficient * (FORCE / STIFFNESS)}
    return Found({".csv": joined(rows, "variant")}, partial(draw_parameters, courses, effort.seed), named)


def of_courses(courses: Mapping[str, Course]) -> dict[str, Any]:
    """What the claims name of them, by variant, (R,); the last excess, the distance from the paper's course and the
    time until the minimum over that of the paper's."""
    paper, others = courses[PAPER], {name: course for name, course in courses.items() if name != PAPER}
    return {
        "last": {name: course.excess[-1] for name, course in courses.items()},
        "apart": {name: course.distance(paper) for name, course in others.items()},
        "ratio": {name: course.arrival / paper.arrival for name, course in others.items()},
        "greater": GREATER, "loaded": LOADED, "late": LATE,
    }  # fmt: skip


def of_minima(minima: Mapping[float, Solution]) -> dict[str, Any]:
    """By normal force: power over it (R,), states (R, E), samples whose states are proven."""
    return {
        "per_force": {force: found.power / force for force, found in minima.items()},
        "states": [found.state for found in minima.values()],
        "proven": min(int(found.states_proven.sum()) for found in minima.values()),
        "slipless": int((next(iter(minima.values())).state == ContactState.SLIPLESS).sum()),
    }


@in_our_style
def draw_parameters(courses: Mapping[str, Any], seed: int) -> Figure:
    """(a) P / P_0 and (b) its excess over the least power against F_n t, of the first sample; the first course, the
    paper's, is black."""
    figure = new_figure(7.1, 3.2)
    left, right = figure.subplots(1, 2)
    for (name, course), colour in zip(courses.items(), COLOURS, strict=True):
        look: dict[str, Any] = {"color": colour, "lw": 1.8 if name == PAPER else 1.1, "label": name}
        later = course.scaled > 0
        left.plot(course.scaled[later], course.power[later, 0], **look)
        shown = later & (course.excess[:, 0] > 0)
        right.plot(course.scaled[shown], course.excess[shown, 0], **look)
    time = r"time, $\omega_T\, t\, F_n / 50$"
    left.set(xscale="log", xlabel=time, ylabel=r"$P\,/\,P_0$", ylim=(0, 1.04))
    right.set(xscale="log", yscale="log", xlabel=time, ylabel=r"$P\,/\,P_{\min} - 1$", ylim=(1e-8, 10))
    left.set_title(f"(a) seed {seed}, random spins")
    right.set_title("(b) above the minimum")
    figure.legend(handles=left.lines, loc="outside lower center", ncols=4)
    return figure
