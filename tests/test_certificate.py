"""The bounds must be true for any candidate, and sharp for a good one."""

import numpy as np
import pytest

from taichi_bearings.certificate import balance, lower_bound, relative_gap, torques
from taichi_bearings.lattice.grid import contact_differences
from tests.scenes import make_scene, minima, name_of, scene_of


def random_force(scene, axes, rng, size):
    spin = np.zeros((len(axes), scene.replicas, *scene.lattice.shape))
    return tuple(size * rng.standard_normal(d.shape) for d in contact_differences(spin, scene.lattice, axes))


@pytest.mark.parametrize("entry", minima((10, 10), (3, 3, 3), (5, 5, 5)), ids=name_of)
@pytest.mark.parametrize("size", [1e-3, 1.0, 20.0, 1e4])
def test_random_forces_never_prove_too_much(entry, size):
    scene, rng = scene_of(entry), np.random.default_rng(31)
    axes = scene.minimum_spin_axes
    for _ in range(20):
        assert lower_bound(scene, random_force(scene, axes, rng, size), axes)[0] <= entry["power_minimum"]


@pytest.mark.parametrize("law", ["coulomb", "viscous"])
@pytest.mark.parametrize("driving", [{}, {"spin_bottom": -0.4}, {"direction": (1, 2, -3)}, {"direction": (0, 0, 1)}])
def test_lower_bounds_stay_below_the_power_of_any_spins(law, driving):
    scene, rng = make_scene((3, 4, 5), law, **driving), np.random.default_rng(9)
    axes = scene.lattice.all_spin_axes
    for _ in range(20):
        spin = scene.impose_driving(rng.uniform(-1, 1, (3, 1, 3, 4, 5)), axes)
        force = random_force(scene, axes, rng, rng.choice([0.1, 10.0]))
        assert lower_bound(scene, force, axes)[0] <= scene.power(spin, axes)[0]


@pytest.mark.parametrize("driving", [{}, {"direction": (0, 0, 1)}, {"direction": (1, 2, 3)}])
@pytest.mark.parametrize("shape", [(4, 6), (3, 4, 6), (2, 2, 3)])
def test_balanced_forces_leave_no_torque_on_any_free_sphere(shape, driving):
    scene = make_scene(shape, **driving)
    axes = scene.lattice.all_spin_axes
    force = balance(scene, random_force(scene, axes, np.random.default_rng(2), 5.0), axes)
    assert np.abs(torques(force, scene.lattice, axes)[..., 1:-1]).max() < 1e-12


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_forces_that_are_not_finite_prove_nothing(broken):
    scene = make_scene((3, 4, 5), seeds=(1, 2))
    axes = scene.minimum_spin_axes
    force = random_force(scene, axes, np.random.default_rng(2), 5.0)
    force[2][0, 1, 0, 0, 0] = broken
    bound = lower_bound(scene, force, axes)
    assert np.isfinite(bound).all()
    assert bound[1] == 0


def test_a_wrong_sign_loses_the_certificate():
    scene = make_scene((4, 5))
    spin = scene.impose_driving(np.zeros((1, 1, 4, 5)), (2,))
    difference = contact_differences(spin, scene.lattice, (2,))
    force = tuple(-scene.normal_force * c * np.sign(d) for c, d in zip(scene.coefficient, difference, strict=True))
    assert lower_bound(scene, force, (2,))[0] == 0


def test_without_frustration_the_gap_is_zero():
    scene = make_scene((3, 4, 5), spin_bottom=1.0)
    assert relative_gap(scene, np.array([0.0]), np.array([0.0])) == 0
