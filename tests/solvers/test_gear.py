"""Gear's method: its order, and its stability bound."""

import numpy as np
import pytest
from scipy.linalg import expm

from taichi_bearings.errors import InputError
from taichi_bearings.fields import borrow
from taichi_bearings.fields.workspace import make_layout
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.cundall_strack import (
    CundallStrack,
    CundallStrackOptions,
    choose_time_step,
    stability_bound,
)
from taichi_bearings.solvers.gear import CORRECTORS, largest_laplacian_eigenvalue, largest_weighted_eigenvalue
from tests.agreement.test_independent_solvers import incidence
from tests.scenes import make_scene


def state_after(scene, start, options, steps):
    method = CundallStrack(options)
    with borrow(make_layout(scene.replicas, scene.lattice.shape), method.plan(scene, start)) as fields:
        method.begin(scene, start, fields)
        method.advance(steps)
        return scene.impose_driving(fields.read("gear_0"), method.spin_axes), method


def laplacian(scene, component, weighted=True):
    matrix, where = incidence(scene.lattice.shape)
    weight = [(scene.coefficient[a][0][s] if weighted else 1.0) * (a != component) for a, s in where]
    free = ~scene.lattice.is_driven.ravel()
    return (matrix.T.multiply(weight) @ matrix).toarray(), free


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("order", sorted(CORRECTORS))
@pytest.mark.parametrize("shape", [(3, 5), (2, 3, 4)])
def test_viscous_decay_converges_with_the_order_of_the_method(shape, order):
    """Error against step over a factor of 8, compared with the matrix exponential; the slope is the order + 1."""
    scene = make_scene(shape, "viscous")
    start = initial_spin(scene, "linear")
    inertia = 0.05
    component = scene.minimum_spin_axes[0]
    matrix, free = laplacian(scene, component)
    rate = -(scene.lattice.radius**2) / inertia * matrix
    omega = scene.staggered_spin(start, (component,))[0, 0].ravel()
    duration = 0.02
    block, source = rate[free][:, free], rate[free][:, ~free] @ omega[~free]
    rest = np.linalg.solve(block, -source)
    exact = rest + expm(duration * block) @ (omega[free] - rest)
    errors, steps = [], 2 ** np.arange(3, 7)
    for number in steps:
        options = CundallStrackOptions(gear_order=order, inertia=inertia, time_step=duration / number)
        state, method = state_after(scene, start, options, int(number))
        slot = method.spin_axes.index(component)
        errors.append(np.abs(state[slot, 0].ravel()[free] - exact).max())
    errors = np.array(errors)
    usable = errors > 1e-14
    slope = -np.polyfit(np.log(steps[usable]), np.log(errors[usable]), 1)[0]
    assert slope == pytest.approx(order + 1, abs=0.25), errors


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("order", sorted(CORRECTORS))
@pytest.mark.parametrize("damping", [50.0, 1e3])
@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5)])
def test_steps_below_the_bound_are_stable_and_above_it_are_not(shape, damping, order):
    """Linear contacts: friction so high and motion so small that nothing slips. Growth is the eigenvalue's business."""
    scene = make_scene(shape, distribution="constant:1e9", spin_top=0.0)
    rng = np.random.default_rng(3)
    spin = 1e-3 * rng.standard_normal(initial_spin(scene, "zero").shape)
    bound = stability_bound(
        scene, (2,) if len(shape) == 2 else (0, 1, 2), CundallStrackOptions(gear_order=order, damping=damping)
    )
    for factor, stable in ((0.97, True), (1.03, False)):
        options = CundallStrackOptions(gear_order=order, damping=damping)
        method = CundallStrack(options)
        with borrow(make_layout(1, shape), method.plan(scene, spin)) as fields:
            method.begin(scene, spin, fields)
            method.time_step = factor * bound
            method._load_gear(scene.staggered_spin(spin, method.spin_axes))
            before = np.abs(fields.read("gear_1")).max()
            method.advance(4_000)
            after = np.abs(fields.read("gear_1")).max()
        assert after < before if stable else after > 1e3 * before, (factor, before, after)


@pytest.mark.parametrize("shape", [(4, 5), (5, 3), (3, 4, 5), (2, 2, 3)])
def test_the_stiffest_mode_is_that_of_the_lattice(shape):
    scene = make_scene(shape)
    for component in scene.lattice.all_spin_axes:
        matrix, free = laplacian(scene, component, weighted=False)
        exact = np.linalg.eigvalsh(matrix[free][:, free]).max()
        assert largest_laplacian_eigenvalue(scene.lattice, (component,)) == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5), (2, 3)])
def test_the_stiffest_viscous_mode_is_not_underestimated(shape):
    scene = make_scene(shape, "viscous")
    axes = scene.lattice.all_spin_axes
    exact = max(np.linalg.eigvalsh(m[f][:, f]).max() for m, f in (laplacian(scene, k) for k in axes))
    assert exact <= largest_weighted_eigenvalue(scene, axes) <= 1.01 * exact


def test_a_larger_step_than_the_bound_is_refused():
    assert choose_time_step(1e-3, 0.9e-3) == 0.9e-3
    with pytest.raises(InputError, match=r"stable only up to 0\.001"):
        choose_time_step(1e-3, 1.1e-3)


@pytest.mark.parametrize(
    "wrong", [{"stiffness": 0}, {"damping": -1}, {"mass": float("nan")}, {"static_ratio": 0.5}, {"gear_order": 7}]
)
def test_unphysical_options_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        CundallStrackOptions(**wrong)
