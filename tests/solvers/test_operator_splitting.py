"""Operator splitting against stored exact minima; its forces and its bits; which of its forces and bounds are kept."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_bearings.lattice.incidence import torques
from taichi_bearings.proof.certificate import dual_value
from taichi_bearings.scene import Status
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.solvers import OperatorSplitting
from taichi_bearings.solvers.drive import _Best, solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene, minima, scene_of


def split(scene, tolerance, start="linear", iterations=30_000):
    return solve(scene, OperatorSplitting().build(), initial_spin(scene, start), StopRule(tolerance, iterations))


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("number", range(7))
def test_exact_minima_are_enclosed_to_1e_5(number):
    """From one start or another; a sample of 5x5x5 and one of 10x10x10 from random spins."""
    entry, start = minima((3, 3, 3), (5, 5, 5), (10, 10, 10))[number], [*STARTS][number % len(STARTS)]
    solution, exact = split(scene_of(entry), 1e-5, start), entry["power_minimum"]
    assert solution.status is Status.CERTIFIED
    assert solution.lower_bound[0] <= exact * (1 + 1e-12)
    assert exact * (1 - 1e-12) <= solution.power[0] <= exact * (1 + 1e-5)
    assert (solution.history["lower_bound"] <= exact * (1 + 1e-12)).all()


@pytest.mark.usefixtures("needs_f64")
def test_spring_forces_are_balanced_and_friction_is_admissible():
    scene = make_scene((4, 6, 5), direction=(1, 2, 3), seeds=(8, 9))
    method = OperatorSplitting().build()
    spin = initial_spin(scene, "random")
    method.begin(scene, spin)
    for _ in range(3):  # the stiffness changes in between
        method.advance(40)
        progress = method.progress()
        force = progress.proof
        work = dual_value(scene, force, method.spin_axes)  # subtracts any torque that is left over
        assert np.abs(torques(force, scene.lattice, method.spin_axes)[..., 1:-1]).max() < 1e-10
        friction = np.sqrt((progress.force**2).sum(axis=0))
        assert (friction <= scene.normal_force * scene.coefficient * (1 + 1e-14)).all()
        assert (progress.lower_bound <= np.minimum(work, progress.objective)).all()


@pytest.mark.usefixtures("needs_f64")
def test_contacts_that_exceed_the_resolution_slip_in_the_exact_solution_too():
    """At the reference accuracy 585 contacts of this scene slip; a gap of 1e-7 leaves few in doubt."""
    entry = minima((10, 10, 10))[0]
    solution = split(scene_of(entry), 1e-7)
    state = solution.state[solution.scene.acting_coefficient > 0]
    assert abs((state == 1).sum() - entry["slipping"]) <= 0.03 * entry["slipping"]
    assert (state == 2).sum() <= 0.03 * entry["contacts"]


@pytest.mark.parametrize("start", ["zero", "random"])
def test_a_start_far_outside_a_small_jump(start):
    scene = make_scene((6, 6, 6), spin_bottom=0.99)
    assert split(scene, 1e-3, start, 3_000).status is Status.CERTIFIED


@pytest.mark.usefixtures("needs_f64")
def test_the_bound_that_is_kept_is_what_the_kept_forces_prove():
    """Also where forces that prove contact states are kept although they prove a little less."""
    scene = make_scene((4, 5, 6), seeds=(3, 4))
    method = OperatorSplitting().build()
    method.begin(scene, initial_spin(scene, "linear"))
    method.advance(300)
    first, best = method.progress(), _Best(method)
    weaker = first.proof * (1 - 5e-12 * np.random.default_rng(7).random(first.proof.shape))
    proven = method.proven_by(weaker)
    assert first.lower_bound[0] * (1 - 1e-11) < proven[0] < first.lower_bound[0]
    best.take(first)
    best.take(replace(first, force=weaker, proof=None, lower_bound=proven, states_believed=np.array([True, False])))
    np.testing.assert_array_equal(best.bound, [proven[0], max(proven[1], first.lower_bound[1])])
    np.testing.assert_allclose(method.proven_by(best.proof), best.bound, rtol=1e-14)
