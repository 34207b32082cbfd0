"""Descent reaches the exact minima, which were computed by another program in extended precision."""

import pytest

from taichi_bearings.scene import Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import GradientDescent, OperatorSplitting
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import minima, name_of, scene_of


def check(entry, solution, accuracy):
    """Power within `accuracy` of the minimum, from above, and the lower bound below it: both proven, both true."""
    exact = entry["power_minimum"]
    assert solution.power[0] >= exact * (1 - 1e-12)
    assert solution.power[0] <= exact * (1 + accuracy)
    assert solution.lower_bound[0] <= exact
    assert solution.lower_bound[0] >= solution.power[0] * (1 - solution.gap[0]) * (1 - 1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("entry", minima((10, 10))[:1] + minima((3, 3, 3))[:1], ids=name_of)
def test_plain_subgradient_descent(entry):
    """The paper's method without momentum: within 1e-3, after up to a few million steps as in the paper."""
    scene = scene_of(entry)
    method = GradientDescent(momentum=False).build()
    solution = solve(scene, method, initial_spin(scene, "random"), StopRule(1e-3, 6_000_000))
    check(entry, solution, 1e-3)


@pytest.mark.parametrize("options", [GradientDescent(), OperatorSplitting()], ids=lambda options: options.name)
@pytest.mark.parametrize("entry", minima((10, 10), (5, 5, 5)), ids=name_of)
def test_single_precision_proves_a_gap_it_can_reach(entry, options, precision):
    """The bounds are evaluated in f64 whatever the fields are, so they are true for f32 runs too."""
    if precision == "f64":
        pytest.skip("a statement about single precision")
    scene = scene_of(entry)
    solution = solve(scene, options.build(), initial_spin(scene, "linear"), StopRule(1e-3, 100_000))
    assert solution.status is Status.CERTIFIED
    check(entry, solution, 1e-3)
