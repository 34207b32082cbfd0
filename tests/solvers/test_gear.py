"""Gear's method: its order, and its stability bound."""

from contextlib import nullcontext
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

from taichi_bearings.errors import InputError
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack
from taichi_bearings.solvers.cundall_strack import stability_bound
from taichi_bearings.solvers.gear import GEAR_COEFFICIENTS, largest_laplacian_eigenvalue, largest_weighted_eigenvalue
from tests.kernels.twins import incidence
from tests.scenes import make_scene


def state_after(scene, start, options, steps):
    method = options.build()
    method.begin(scene, start)
    method.advance(steps)
    return scene.impose_driving(method.fields.read("gear_0"), method.spin_axes), method


def laplacian(scene, component, weighted=True):
    matrix, where = incidence(scene.lattice.shape)
    weight = [(scene.coefficients[a][0][s] if weighted else 1.0) * (a != component) for a, s in where]
    free = ~scene.lattice.is_driven.ravel()
    return (matrix.T.multiply(weight) @ matrix).toarray(), free


def without_vertical(spin):
    """Laboratory spins whose vertical component in 3D is 0: kernels for two components compile sooner."""
    if spin.shape[-1] == 3 and spin.ndim == 5:
        spin[..., 2] = 0.0
    return spin


def exact_spins(scene, start, axes, options, duration):
    """Staggered spins (C, 1, *N) after `duration` while no contact slips: the matrix exponential of the linear system
    in the spins and, for Coulomb, their integrals, which stretch the springs."""
    after = scene.staggered_spin(start, axes)
    for slot, component in enumerate(axes):
        matrix, free = laplacian(scene, component, weighted=scene.law.has_viscosity)
        rate = scene.lattice.radius**2 / options.inertia * matrix * free[:, None]
        nothing = np.zeros_like(rate)
        system = [[-rate, nothing], [nothing, nothing]]
        if scene.law.has_friction:
            system = [[-options.damping * rate, -options.stiffness * rate], [np.eye(len(free)), nothing]]
        state = np.concatenate([after[slot, 0].ravel(), np.zeros(len(free))])
        after[slot, 0] = (expm(duration * np.block(system)) @ state)[: len(free)].reshape(scene.lattice.shape)
    return after


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize(
    ("order", "law", "shape"),
    [(order, *(("viscous", (4, 5)), ("coulomb", (3, 4, 5)))[order % 2]) for order in sorted(GEAR_COEFFICIENTS)],
)
def test_the_error_falls_with_the_number_of_values_kept(law, shape, order):
    """Gear's q + 1 values for a first-order equation are an Adams method of order q + 1, dashpots and springs alike.

    Coulomb with so much friction that nothing slips, and modes about critically damped. The slope of the error against
    the step, over the five finest steps (a factor 2) whose error is clear of the rounding.
    """
    scene = make_scene(shape, law, distribution="uniform:0.1,1.0" if law == "viscous" else "constant:1e9")
    start = without_vertical(initial_spin(scene, "random"))
    options = CundallStrack(gear_order=order, inertia=0.05, damping=50.0)
    duration = 0.05 if law == "viscous" else 2e-3  # some decay times of the stiffest mode
    axes = scene.minimum_spin_axes
    exact = exact_spins(scene, start, axes, options, duration)
    numbers = np.ceil(2 * duration / stability_bound(scene, axes, options) * 2 ** np.arange(0.0, 3.1, 0.25)).astype(int)
    errors = []
    for number in numbers:
        found, _ = state_after(scene, start, replace(options, time_step=duration / number), int(number))
        errors.append(np.abs(found - exact).max())
    clear = np.array(errors) > 1e-12
    assert clear.sum() >= 5
    slope = -np.polyfit(np.log(numbers[clear][-5:]), np.log(np.array(errors)[clear][-5:]), 1)[0]
    assert slope == pytest.approx(order + 1, abs=0.1), errors


def largest_stable_step_found(shape, options):
    """Bisection with the kernels themselves, to 1 %, from a quarter to four times the computed bound.

    Spheres whose contacts never slip are linear, so a small random perturbation tells. It is followed through the first
    two derivatives, which do not see what may stay (a common turn). A step is unstable if they grow a thousandfold,
    or twofold from the first half of 3000 steps to the second.
    """
    scene = make_scene(shape, distribution="constant:1e15", spin_top=0.0)
    spin = without_vertical(1e-3 * np.random.default_rng(3).standard_normal(initial_spin(scene, "zero").shape))
    method = options.build()
    method.begin(scene, spin)
    fields = method.fields

    def is_stable(time_step):
        method.time_step = time_step
        method._load_gear(scene.staggered_spin(spin, method.spin_axes))
        fields.clear("elongation")
        sizes = [size()]
        while len(sizes) <= 30 and sizes[-1] < 1e3 * sizes[0]:
            method.advance(100)
            sizes.append(size())
        return len(sizes) > 30 and max(sizes[16:]) < 2 * max(sizes[:16])

    def size():
        return np.sqrt(sum(np.square(fields.read(f"gear_{n}")).sum() for n in (1, 2)))

    low, high = method.stability_bound / 4, method.stability_bound * 4
    assert is_stable(low)
    assert not is_stable(high)
    while high > 1.01 * low:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if is_stable(middle) else (low, middle)
    return low, method.stability_bound


SHAPES, STIFFNESSES, DAMPINGS = ((4, 5), (3, 4, 5)), (1e4, 1e5, 1e6), (1e2, 1e3, 1e4)
PAIRS = tuple(zip(STIFFNESSES, DAMPINGS[::-1], strict=True))  # with both kinds of limit: the last is the spring's
MATERIALS = [(order, *pair) for order in (2, 3, 4, 5) for pair in PAIRS] + [(5, 1e5, 0.0)]
# without damping, orders 2 to 4 grow too slowly just beyond their bounds, by less than 1e-3 a step, to be seen
OTHERS = [(2, *pair) for pair in product(STIFFNESSES, DAMPINGS) if pair not in PAIRS]
BOUNDS = [  # each in two dimensions or in three; in both, and more materials, with --thorough
    pytest.param(shape, *material, marks=() if number % 2 == at and material in MATERIALS else pytest.mark.thorough)
    for number, material in enumerate(MATERIALS + OTHERS)
    for at, shape in enumerate(SHAPES)
]


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize(("shape", "order", "stiffness", "damping"), BOUNDS)
def test_the_stability_bound_is_the_largest_stable_step(shape, order, stiffness, damping):
    found, bound = largest_stable_step_found(
        shape, CundallStrack(gear_order=order, stiffness=stiffness, damping=damping)
    )
    assert found == pytest.approx(bound, rel=0.1)


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
    assert exact <= largest_weighted_eigenvalue(scene, axes, scene.viscosities) <= 1.01 * exact


def test_a_larger_step_than_the_bound_is_refused():
    scene = make_scene((4, 5))
    bound = stability_bound(scene, scene.minimum_spin_axes, CundallStrack())
    for share, refused in ((0.9, False), (1.1, True)):
        method = CundallStrack(time_step=share * bound).build()
        with (
            pytest.raises(InputError, match=f"stable only for time steps up to {bound:.6g}")
            if refused
            else nullcontext()
        ):
            method.begin(scene, initial_spin(scene, "zero"))
            assert method.time_step == share * bound


@pytest.mark.parametrize(
    "wrong", [{"stiffness": 0}, {"damping": -1}, {"mass": float("nan")}, {"static_ratio": 0.5}, {"gear_order": 7}]
)
def test_unphysical_options_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        CundallStrack(**wrong)
