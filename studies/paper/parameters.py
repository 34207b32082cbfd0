"""Stiffness K_t, damping A_t and normal force F_n: what depends on them, and what does not.

The stationary state minimises P = F_n sum mu |v|. Springs and dampers are not in it, and F_n is a factor. Rigid
friction, I d(omega)/dt = -dP/d(omega), knows F_n as a factor of the time alone, so curves are compared at equal F_n t.
What depends on K_t and A_t is the trajectory: contacts that hold stretch by up to mu F_n / K_t and creep at up to
mu F_n / A_t.
"""

from collections.abc import Mapping
from dataclasses import replace
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
STEPS = 4_000_000  # most time steps; with ten times the damping it takes a million
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
COLOURS = (
    "#000000",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#8a8a8a",
    "#0072B2",
)  # one for each variant
GREATER, LOADED = ("K = 1e6", "A = 1e4", "K = 1e6, A = 1e4"), ("F_n = 5", "F_n = 500")


def arrival(time: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Return the time (R,) from which on the power is within LATE of the minimum; the last time if it never is.

    time : (T,). excess : relative excess of the power over the proven least one, (T, R).
    """
    late = excess > LATE
    last = len(late) - 1 - np.argmax(late[::-1], axis=0)
    return np.asarray(time[np.where(late.any(axis=0), np.minimum(last + 1, len(late) - 1), 0)])


def study(folder: Path, effort: Effort) -> Found:
    """Follow the samples under all variants, and find their minima under all normal forces."""
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
    named = of_courses(runs, {force: found.lower_bound for force, found in minima.items()}) | of_minima(minima)
    rows = {
        name: curves(
            scenes[FORCE].seeds, time=run.time, scaled_time=named["courses"][name].time,
            power_over_initial=run.power / run.power[0], excess_over_minimum=named["excess"][name],
        )
        for name, run in runs.items()
    }  # fmt: skip
    more = {"stretch": scenes[FORCE].coefficient * (FORCE / STIFFNESS), "seed": effort.seed}
    return Found({".csv": joined(rows, "variant")}, draw_parameters, named | more)


def of_courses(runs: Mapping[str, Run], bounds: Mapping[float, np.ndarray]) -> dict[str, Any]:
    """Return what figure and claims use of runs, by variant.

    runs : relaxations by variant. bounds : (R,) on the least power, by normal force.
    returns : `courses`, the runs with their times F_n t over the paper's F_n; `excess`, relative, of the power over the
        proven least one, (T, R), and its `last` value; `apart`, the distance from the paper's course, and `ratio`, the
        time until the minimum over that of the paper's course, (R,).
    """
    forces = {name: VARIANTS[name][2] for name in runs}
    courses = {name: replace(run, time=run.time * (forces[name] / FORCE)) for name, run in runs.items()}
    excess = {name: run.power / bounds[forces[name]] - 1 for name, run in runs.items()}
    paper, others = courses[PAPER], {name: course for name, course in courses.items() if name != PAPER}
    arrivals = {name: arrival(course.time, excess[name]) for name, course in courses.items()}
    return {
        "courses": courses, "excess": excess, "last": {name: of[-1] for name, of in excess.items()},
        "apart": {name: one.distance(paper, np.union1d(one.time, paper.time)) for name, one in others.items()},
        "ratio": {name: arrivals[name] / arrivals[PAPER] for name in others},
        "greater": GREATER, "loaded": LOADED, "late": LATE,
    }  # fmt: skip


def of_minima(minima: Mapping[float, Solution]) -> dict[str, Any]:
    """Return what claims use of the minima, by normal force: power over it (R,), states (R, E), samples proven."""
    return {
        "per_force": {force: found.power / force for force, found in minima.items()},
        "states": [found.state for found in minima.values()],
        "proven": min(int(found.states_proven.sum()) for found in minima.values()),
        "slipless": int((next(iter(minima.values())).state == ContactState.SLIPLESS).sum()),
    }


@in_our_style
def draw_parameters(of: Any) -> Figure:
    """Draw (a) P / P_0 and (b) its excess over the least power against F_n t, of the first sample; the paper's is
    black.
    """
    figure = new_figure(7.1, 3.2)
    left, right = figure.subplots(1, 2)
    for (name, course), colour in zip(of.courses.items(), COLOURS, strict=True):
        look: dict[str, Any] = {"color": colour, "lw": 1.8 if name == PAPER else 1.1, "label": name}
        time, excess = course.time, of.excess[name][:, 0]
        left.plot(time[time > 0], (course.power / course.power[0])[time > 0, 0], **look)
        shown = (time > 0) & (excess > 0)
        right.plot(time[shown], excess[shown], **look)
    label = r"time, $\omega_T\, t\, F_n / 50$"
    left.set(xscale="log", xlabel=label, ylabel=r"$P\,/\,P_0$", ylim=(0, 1.04))
    right.set(xscale="log", yscale="log", xlabel=label, ylabel=r"$P\,/\,P_{\min} - 1$", ylim=(1e-8, 10))
    left.set_title(f"(a) seed {of.seed}, random spins")
    right.set_title("(b) above the minimum")
    figure.legend(handles=left.lines, loc="outside lower center", ncols=4)
    return figure
