"""The bounds must be true for any candidate, and sharp for a good one."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from taichi_bearings.lattice.incidence import contact_differences
from taichi_bearings.proof import column_sums
from taichi_bearings.proof.certificate import (
    balance,
    dual_value,
    lower_bound,
    precise_torques,
    relative_gap,
    torques,
    work_and_bound,
)
from taichi_bearings.scene.initial_spins import initial_spin
from tests.scenes import SIMPLE_LAWS, make_scene, minima, name_of, scene_of


def random_force(scene, axes, rng, size):
    felt = scene.lattice.tangential_mask(axes)[:, None]
    return np.where(felt, size * rng.standard_normal((len(axes), scene.replicas, scene.lattice.all_contacts)), 0.0)


@pytest.mark.parametrize("entry", minima((10, 10), (3, 3, 3), (5, 5, 5)), ids=name_of)
@pytest.mark.parametrize("size", [1e-3, 1.0, 20.0, 1e4])
def test_random_forces_never_prove_too_much(entry, size):
    scene, rng = scene_of(entry), np.random.default_rng(31)
    axes = scene.minimum_spin_axes
    for _ in range(20):
        assert lower_bound(scene, random_force(scene, axes, rng, size), axes)[0] <= entry["power_minimum"]


@pytest.mark.parametrize("law", SIMPLE_LAWS)
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


def test_the_quick_bound_is_safe_and_loses_nothing_on_balanced_forces():
    scene, rng = make_scene((3, 4, 6), seeds=(1, 2)), np.random.default_rng(13)
    axes = scene.minimum_spin_axes
    wild = random_force(scene, axes, rng, 5.0)
    assert (work_and_bound(scene, wild, axes)[1] <= lower_bound(scene, wild, axes)).all()
    for size in (1.0, 1e3):  # within the friction discs, and far beyond
        spin = scene.impose_driving(np.broadcast_to(np.linspace(0, 1, 6), (2, 2, 3, 4, 6)).copy(), axes)
        even = balance(scene, size * contact_differences(spin, scene.lattice, axes), axes)
        work, bound = work_and_bound(scene, even, axes)
        assert (work > 0).all()
        assert bound == pytest.approx(lower_bound(scene, even, axes), rel=1e-12)


@pytest.mark.parametrize("shape", [(4, 6), (3, 4, 6)])
def test_torques_in_plain_doubles_never_prove_more(shape):
    """Forces of 1e9 that nearly balance: the allowance pays for the rounding of their sums, and for little else."""
    scene, rng = make_scene(shape, normal_force=1e10), np.random.default_rng(31)
    axes = scene.minimum_spin_axes
    for _ in range(20):
        force = balance(scene, random_force(scene, axes, rng, 0.05), axes)
        exact, plain = dual_value(scene, force, axes), dual_value(scene, force, axes, plain=True)
        total = np.abs(force).sum(axis=(0, 2)) * scene.jump
        assert plain < exact
        assert plain > exact - 1e-14 * total


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_forces_that_are_not_finite_prove_nothing(broken):
    scene = make_scene((3, 4, 5), seeds=(1, 2))
    axes = scene.minimum_spin_axes
    force = random_force(scene, axes, np.random.default_rng(2), 5.0)
    force[0, 1, -1] = broken
    bound = lower_bound(scene, force, axes)
    assert np.isfinite(bound).all()
    assert bound[1] == 0


def test_a_wrong_sign_loses_the_certificate():
    scene = make_scene((4, 5))
    spin = scene.impose_driving(np.zeros((1, 1, 4, 5)), (2,))
    difference = contact_differences(spin, scene.lattice, (2,))
    force = -scene.normal_force * scene.coefficient * np.sign(difference)
    assert lower_bound(scene, force, (2,))[0] == 0


def test_without_frustration_the_gap_is_zero():
    scene = make_scene((3, 4, 5), spin_bottom=1.0)
    assert relative_gap(scene, np.array([0.0]), np.array([0.0])) == 0


@pytest.mark.parametrize("shape", [(5, 4), (3, 4, 5)])
def test_torques_in_near_balance_are_summed_without_loss(shape):
    """Huge forces that cancel leave a small torque, known to one rounding: an exact sum says so."""
    scene = make_scene(shape, "viscous")
    axes, lattice = scene.minimum_spin_axes, scene.lattice
    rng = np.random.default_rng(99)
    felt = lattice.tangential_mask(axes)[:, None]
    force = np.where(felt, 1e9 + rng.standard_normal(felt.shape), 0.0)
    pull = precise_torques(scene, force, axes)
    for slot, component in enumerate(axes):
        for site in np.ndindex(*shape):
            terms = []
            for axis, values in enumerate(lattice.by_axis(force)):
                if axis == component:
                    continue
                vector = values[slot, 0]
                below = tuple(n - (a == axis) for a, n in enumerate(site))
                terms += [vector[site]] if site[axis] < shape[axis] - 1 else []
                terms += [-vector[below]] if site[axis] > 0 else []
            assert pull[slot, 0][site] == pytest.approx(math.fsum(terms), rel=1e-15, abs=1e-20)


@pytest.mark.parametrize("size", [1, 40, 10_000])
@pytest.mark.parametrize(
    ("shape", "closed"), [((5, 4), ()), ((6, 4), ("x",)), ((4, 6, 5), ("x", "y")), ((3, 4, 5), ())]
)
def test_torques_summed_plane_by_plane_have_the_bits_of_those_summed_at_once(shape, closed, size, monkeypatch):
    """Of few planes or samples at a time, or of all, on one thread or two."""
    monkeypatch.setattr(column_sums, "CACHED_PULLS", size)
    scene = make_scene(shape, "viscous", seeds=(4, 5, 6), periodic=closed)
    axes, lattice = scene.minimum_spin_axes, scene.lattice
    force = random_force(scene, axes, np.random.default_rng(3), 5.0)
    pull = torques(force, lattice, axes)
    with ThreadPoolExecutor(2) as threads:
        found = column_sums.column_sums(force, lattice, axes, True, threads.map)
        largest = column_sums.largest_torques(force, lattice, axes, threads.map)
    assert (found.top == pull[..., -1]).all()
    assert (found.bottom == pull[..., 0]).all()
    assert (found.left_over == np.abs(pull[..., 1:-1]).sum(axis=-1)).all()
    assert (largest == np.abs(pull[..., 1:-1]).max(axis=(0, *range(2, pull.ndim)))).all()
    np.testing.assert_allclose(precise_torques(scene, force, axes), pull, rtol=1e-12, atol=1e-13)


def test_forces_in_balance_to_round_off_prove_a_gap_of_round_off():
    """The allowance for rounding follows the power, not all forces times the jump, which here is 400 times as much."""
    scene = make_scene((3, 400), "viscous", distribution="constant:1.0")
    staggered = scene.staggered_spin(initial_spin(scene, "linear"), (2,))
    force = 0.5 * contact_differences(staggered, scene.lattice, (2,))
    bound, power = lower_bound(scene, force, (2,)), scene.power(staggered, (2,))
    assert power[0] == pytest.approx(3 * 0.25 / 399, rel=1e-12)
    assert 0 <= 1 - bound[0] / power[0] < 2e-13
