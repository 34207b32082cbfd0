"""Stiffness K_t, damping A_t and normal force F_n: which results depend on them, and which do not.

The stationary state minimises P = F_n sum mu |v|. Springs and dampers are not in it, and F_n is a factor. With rigid
contacts the motion, I d(omega)/dt = -dP/d(omega), depends on F_n only as a factor of the time, so curves are compared
at equal F_n t. What depends on K_t and A_t is the way to the minimum: contacts that do not slip stretch by up to mu F_n
/ K_t and creep at up to mu F_n / A_t.

Letters: R samples, T recorded times, E contacts. A variant is one choice of (K_t, A_t, F_n).
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
from .samples import TIMES, Run, StudyResult, curves, joined, relax, solved

SHAPE, START = (3, 3, 3), "random"
RUNS = 8
STIFFNESS, DAMPING, FORCE = 1e5, 1e3, 50.0  # the paper's
STEPS = 4_000_000  # most time steps; with ten times the damping it takes a million
LATE = 1e-3  # the minimum counts as reached when the power exceeds it by no more than this share
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
GREATER = ("K = 1e6", "A = 1e4", "K = 1e6, A = 1e4")  # variants that are stiffer than the paper's
LOADED = ("F_n = 5", "F_n = 500")  # variants that have another normal force


def arrival(time: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Return the time at which each of R samples arrives at its minimum, (R,): from then on its power exceeds the least
    power by at most a share LATE. It is the last time for a sample that does not arrive.

    time : (times,), rising.
    excess : (times, R samples), power over the proven least one, less 1.
    """
    late = excess > LATE
    last = len(late) - 1 - np.argmax(late[::-1], axis=0)
    return np.asarray(time[np.where(late.any(axis=0), np.minimum(last + 1, len(late) - 1), 0)])


def study(folder: Path, effort: Effort) -> StudyResult:
    """Follow the samples under all variants, and find their minima under all normal forces; return tables, figure and
    values for the claims.

    folder : not used, since no sample takes long enough to be kept.
    effort : first seed and number of samples.
    """
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
    return StudyResult({".csv": joined(rows, "variant")}, draw_parameters, named | more)


def of_courses(runs: Mapping[str, Run], bounds: Mapping[float, np.ndarray]) -> dict[str, Any]:
    """Return by name the values that figure and claims use of the relaxations. The same spins relax under several
    variants (choices of stiffness, damping and normal force F_n); the paper's variant is the reference.

    runs : relaxation under each variant, by its name.
    bounds : for each normal force (R samples,), proven lower bounds on the least power, energy/time.

    With an entry for each variant:

    * `courses`: the relaxation with its times multiplied by F_n over the paper's F_n;
    * `excess`: (T times, R), power over its lower bound, less 1;
    * `last`: (R,), the excess at the end.

    With an entry for each variant but the paper's:

    * `apart`: (R,), largest difference of power / initial power from the paper's variant, at equal scaled times;
    * `ratio`: (R,), time from which on the excess stays below LATE, over that of the paper's variant.

    Constants: `greater`, names of the variants with larger stiffness or damping; `loaded`, names of those with another
    normal force; `late`, the number LATE.
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
    """Return what the claims check of the minima, by name; there are R samples of E contacts.

    * `per_force`: for each normal force, (R,), the least power over this force.
    * `states`: list of arrays (R, E), the states of the contacts, one array for each normal force.
    * `proven`: number of samples all of whose states are proven, at the normal force where these are fewest.
    * `slipless`: number of slipless contacts of all samples together, at the first normal force.

    minima : for each normal force the solution of the R samples.
    """
    return {
        "per_force": {force: found.power / force for force, found in minima.items()},
        "states": [found.state for found in minima.values()],
        "proven": min(int(found.states_proven.sum()) for found in minima.values()),
        "slipless": int((next(iter(minima.values())).state == ContactState.SLIPLESS).sum()),
    }


@in_our_style
def draw_parameters(named: Any) -> Figure:
    """Draw (a) power over its initial value and (b) its excess over the least power, of the first sample, against F_n
    t; a curve for each variant, the paper's in black.

    named : the values that :func:`study` names, as attributes. Used are `courses`: by variant its relaxation (a Run) of
        R samples with T recorded times; `excess`: by variant (T, R samples), power over the least one, less 1; `seed`.
    """
    figure = new_figure(7.1, 3.2)
    left, right = figure.subplots(1, 2)
    for (name, course), colour in zip(named.courses.items(), COLOURS, strict=True):
        look: dict[str, Any] = {"color": colour, "lw": 1.8 if name == PAPER else 1.1, "label": name}
        time, excess = course.time, named.excess[name][:, 0]
        left.plot(time[time > 0], (course.power / course.power[0])[time > 0, 0], **look)
        shown = (time > 0) & (excess > 0)
        right.plot(time[shown], excess[shown], **look)
    label = r"time, $\omega_T\, t\, F_n / 50$"
    left.set(xscale="log", xlabel=label, ylabel=r"$P\,/\,P_0$", ylim=(0, 1.04))
    right.set(xscale="log", yscale="log", xlabel=label, ylabel=r"$P\,/\,P_{\min} - 1$", ylim=(1e-8, 10))
    left.set_title(f"(a) seed {named.seed}, random spins")
    right.set_title("(b) above the minimum")
    figure.legend(handles=left.lines, loc="outside lower center", ncols=4)
    return figure
