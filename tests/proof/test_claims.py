"""What runs claim where claims used to be false: nearly equal driving, extreme contrasts, numbers that are none.

Truth is a solver in 140 digits that shares nothing with the others.
"""

from dataclasses import replace

import numpy as np
import pytest
from taichi_bearings_studies.stress import truth

from taichi_bearings.runs.lattice_run import solve_job
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run import prepare
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.stress.minima import least_of_all

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
ROUNDING = 4 * np.finfo(float).eps

COULOMB = [
    {"shape": (5, 4), "spin_bottom": 0.999999999999},
    {"shape": (3, 3, 4), "spin_bottom": 0.999999999, "direction": (1, 0, 3)},
    {"shape": (3, 2, 4), "spin_bottom": 0.9999999, "direction": (1, 2, 0)},
    {"shape": (3, 2, 4), "spin_top": 1e9, "spin_bottom": 1e9 * (1 - 1e-12), "direction": (1, 1, 1)},
    {"shape": (3, 3, 3), "distribution": "bimodal:1e-12,1e3,0.1"},
    {"shape": (2, 3, 4), "distribution": "bimodal:1e-9,1e9,0.5", "method": "operator-splitting", "iterations": 2000},
    {"shape": (3, 3, 4), "spin_bottom": 0.9999, "method": "gradient-descent", "tolerance": 1e-3},
    {
        "shape": (3, 3, 8), "seed": 140, "distribution": "bimodal:0.1,1,0.5", "direction": (0, 1, 0),
        "spin_bottom": 0.5, "radius": 2.0, "method": "operator-splitting",
    },
]  # fmt: skip


def answer(settings):
    return solve_job(prepare(RunSettings(threads=1, **settings)))


def assert_true(solution, exact, tolerance):
    """Bounds hold, and the gap is not less than it truly is."""
    low, high = float(exact.lower), float(exact.upper)
    assert solution.lower_bound[0] <= high
    assert solution.power[0] >= low * (1 - ROUNDING)
    missing = (solution.power[0] - low) / solution.power[0]
    assert solution.gap[0] >= missing - ROUNDING
    assert (Result(RunSettings(tolerance=tolerance), solution).numbers["status"] == "certified") <= (
        missing <= tolerance
    )


@pytest.mark.parametrize("settings", COULOMB, ids=str)
def test_friction(settings):
    solution = answer(settings)
    assert_true(solution, truth.least(solution.scene), settings.get("tolerance", 1e-8))


@pytest.mark.parametrize("shape", [(4, 4), (3, 3, 4)], ids=str)
@pytest.mark.parametrize("bottom", [0.9999, 0.99999999])
def test_damping(shape, bottom):
    solution = answer({"shape": shape, "law": "viscous", "spin_bottom": bottom})
    assert_true(solution, truth.least(solution.scene), 1e-8)
    assert solution.status is Status.CERTIFIED


def test_one_coefficient_does_not_set_the_scale_of_the_others():
    """A single contact of 1e15 made the power of all others count as nothing."""
    settings = {"shape": (3, 3, 4), "method": "gradient-descent", "iterations": 100}
    job = prepare(RunSettings(threads=1, **settings))
    coefficients = job.scene.lattice.by_axis(job.scene.coefficient.copy())
    coefficients[0][0, 1, 1, 1] = 1e15
    solution = solve(replace(job.scene, coefficients=coefficients), job.method, job.spin, StopRule(1e-8, 100))
    assert solution.status is not Status.CERTIFIED
    assert solution.gap[0] > 1e-8


def test_a_power_that_is_no_number_is_not_certified():
    settings = {
        "shape": (3, 3, 4), "law": "viscous", "radius": 1e15, "spin_top": 1e15,
        "distribution": "uniform:1e14,1e15", "method": "gradient-descent", "iterations": 10,
    }  # fmt: skip
    job = prepare(RunSettings(threads=1, **settings))
    solution = solve(job.scene, job.method, np.full_like(job.spin, np.nan), StopRule(1e-8, 10))
    assert solution.status is not Status.CERTIFIED
    assert not solution.gap[0] <= 1e-8
    assert Result(RunSettings(), solution).numbers["status"] != "certified"


def test_strong_levels_that_weak_contacts_part_are_not_proven_by_a_mean():
    """Contacts within a level of 2x2 hold almost anything; one of the weak ones between levels is a little stronger."""
    x, y, z = (np.full((1, *n), v) for n, v in (((1, 2, 3), 1e12), ((2, 1, 3), 1e12), ((2, 2, 2), 0.5)))
    z[0, 0, 0, 1] += 1e-3
    scene = Scene((x, y, z))
    solution = solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "linear"), StopRule(1e-8))
    exact = least_of_all(scene)
    assert_true(solution, exact, 1e-8)
    if solution.states_proven[0]:
        np.testing.assert_array_equal(solution.state[0] == 1, scene.lattice.flat(exact.state) == truth.SLIPPING)
