"""Honest runs of every method and law, of scenes that hurt and with any end; none of them may be refuted.

A run is drawn from the seed and its number alone, solved, written and verified in this process.
"""

from pathlib import Path

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.runs.lattice_run import solve_job
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run import prepare, resume, run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.runs.writing import write_state
from taichi_bearings.scene import Scene
from taichi_bearings.solvers import METHODS
from tests.scenes import KNOWN_LAWS

METHODS_OR_AUTO = ("auto", *METHODS)
SHAPES = ((2, 3), (3, 4), (4, 5), (3, 9), (6, 7), (2, 2, 3), (3, 3, 4), (4, 4, 4))
SCENES = (
    {}, {}, {"spin_bottom": 0.1}, {"spin_top": 1e15}, {"spin_top": 1e-12}, {"spin_bottom": 1 - 1e-10},
    {"spin_top": 1e8, "spin_bottom": 1e8 - 1}, {"spin_top": 0.5, "spin_bottom": 0.5}, {"spin_top": 0.0,
    "spin_bottom": 0.5}, {"spin_top": -1.0, "spin_bottom": 0.7}, {"normal_force": 1e-12}, {"normal_force": 1e12},
    {"radius": 1e-12}, {"radius": 1e12}, {"direction": (1, 0, 0)}, {"direction": (1, 1e-9, 0)}, {"direction": (1, 1,
    1)}, {"direction": (0, 0, 1)}, {"slip_threshold": 1e-3}, {"replicas": 3}, {"initial": "random"}, {"initial":
    "zero"}, {"initial": "minimum-cut"},
)  # fmt: skip
STATES = (
    (1, 1, 0, 0.2), (0, 0, 0, 1), (1, 0.5, -0.3, 0), (-1, 0, 0, 1), (1e-9, 1, 0, 1e-9), (1, 1, 1, 1e12), (0, 0, 0, 0),
)  # fmt: skip
DISTRIBUTIONS = (
    "uniform:0.1,1.0", "uniform:0.1,1.0", "lognormal:1,5", "lognormal:1,12", "constant:1", "bimodal:0.1,1,0.5",
    "bimodal:1,2,0.5", "bimodal:1e-12,1,0.5", "bimodal:1e-15,1e15,0.5", "power-law:1e-15,1e15,-1",
    "power-law:1e-8,1e8,-1", "bimodal:1e-4,1e4,0.3",
)  # fmt: skip
VISCOSITIES = (
    "uniform:0.1,1.0", "constant:1e13", "constant:1e-13", "lognormal:1,8", "constant:1e3", "power-law:1e-15,1e15,-1",
)  # fmt: skip
TOLERANCES = (1e-3, 1e-6, 1e-8, 1e-8, 1e-10, 1e-12, 1e-13, 1e-14, 1e-15)
ENDS = (None, None, None, None, 1, 7, 60, 1000)
COURSES = (
    {"duration": 0.01}, {"duration": 0.1, "snapshots": "0.03,0.1"}, {"duration": 0.1, "record": "linear:0.01,0.1,7"},
    {"iterations": 3}, {"iterations": 300}, {"duration": 0.02, "checkpoint_every": 1e-3},
)  # fmt: skip
LIMIT = {"iterations": 3000, "time_limit": 2.0}  # unless a run has others: an end that is cut short is honest, too


def drawn(seed: int, number: int = 0) -> dict:
    """Settings of one run."""
    rng = np.random.default_rng([seed, number])

    def one_of(choices):
        return choices[rng.integers(len(choices))]

    law, method = one_of(KNOWN_LAWS), one_of(METHODS_OR_AUTO)
    given = {"shape": one_of(SHAPES), "seed": int(rng.integers(10**6)), "law": law, "method": method}
    given |= {"distribution": one_of(DISTRIBUTIONS), "tolerance": one_of(TOLERANCES)} | one_of(SCENES)
    if law == "coulomb-viscous":
        given["viscosity"] = one_of(VISCOSITIES)
    if "cundall" in method or method == "rigid-limit":
        given |= one_of(COURSES)
    elif (end := one_of(ENDS)) is not None:
        given["iterations"] = end
    if method == "planar-cut" and len(given["shape"]) == 3:
        given["direction"] = one_of(((1, 0, 0), (0, 1, 0), (1, 0, 3)))
    elif len(given["shape"]) == 3 and rng.random() < 0.25:
        given = {key: value for key, value in given.items() if key not in Scene.BY_SPINS}
        given |= {"top": one_of(STATES), "bottom": one_of(STATES)}
    sides = tuple(name for name, n in zip("xy", given["shape"][:-1], strict=False) if n % 2 == 0)
    if sides and rng.random() < 0.3:
        given["periodic"] = sides
    return given


def contradictions(given: dict, folder: Path) -> list[str] | None:
    """What `verify` holds against a run in `folder`; None for a scene or option that the method does not take."""
    try:
        settings = RunSettings(threads=1, figures="none", **LIMIT | given)
        if "checkpoint_every" in given:
            run(settings, folder)
            if found := verify(folder)["contradictions"]:
                return ["before it was resumed: " + sentence for sentence in found]
            resume(folder, {"duration": 2 * given["duration"]})
            return verify(folder)["contradictions"]
        job = prepare(settings)
        folder.mkdir(exist_ok=True)
        write_state(folder / "run.h5", Result(job.settings, solve_job(job), job.spin), job.settings)
        return verify(folder)["contradictions"]
    except InputError:
        return None
