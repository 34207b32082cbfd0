"""The contact step and the torque balance of operator splitting against sums written out with NumPy, on any device."""

import numpy as np
import pytest

from taichi_bearings.fields import Fields, make_layout
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import OperatorSplitting
from taichi_bearings.solvers.torque_balance import TorqueBalance
from tests.scenes import make_scene


@pytest.mark.parametrize(
    ("shape", "direction"),
    [
        ((4, 5), (1, 1, 0)),
        ((3, 4, 5), (1, 1, 0)),
        ((3, 4, 5), (1, 2, 3)),
        ((4, 3, 4), (0, 1, 0)),
        ((2, 3, 20), (0, 1, 1)),
    ],
)
def test_a_contact_step_equals_sums_over_contacts(shape, direction, precision):
    accuracy = 1e-12 if precision == "f64" else 1e-4
    scene, rng = make_scene(shape, direction=direction, seeds=(11, 12)), np.random.default_rng(77)
    method, spin = OperatorSplitting().build(), initial_spin(scene, "random")
    fields = Fields(make_layout(scene.replicas, shape), method.plan(scene, spin))
    method.begin(scene, spin, fields)
    lattice, axes, layout = scene.lattice, method.spin_axes, method.layout
    potential = 30 * rng.standard_normal((len(axes), 2, *shape))
    difference = contact_differences(potential, lattice, axes)
    trial = [
        40 * rng.standard_normal(d.shape) * (c > 0) for d, c in zip(difference, scene.acting_coefficient, strict=True)
    ]
    fields.load("potential", potential)
    fields.load("trial", method.stencil.forces_at_lower_sphere(tuple(trial), layout))
    method._step_contacts(1.7)

    pushes = []
    for axis, (old, d, c) in enumerate(zip(trial, difference, scene.acting_coefficient, strict=True)):
        bound = scene.normal_force * c

        def limited(force, bound=bound):
            size = np.sqrt((force**2).sum(axis=0))
            return force * np.minimum(1.0, bound / np.maximum(size, 1e-300))

        friction = limited(old)
        new = (friction - 0.7 * (old - friction) + 1.7 * method.weights[axis] * d) * (c > 0)
        pushes.append(new - 2 * limited(new))
    found = method.stencil.forces_by_axis(fields.read("push"), layout)
    for ours, expected in zip(found, pushes, strict=True):
        assert np.abs(ours - expected).max(initial=0.0) < accuracy
    assert np.abs(fields.read("pull") + torques(tuple(pushes), lattice, axes)).max() < 10 * accuracy


@pytest.mark.parametrize(
    ("shape", "axes"),
    [
        ((5, 7), (2,)),
        ((2, 3, 3), (0, 1)),
        ((4, 6, 5), (0, 1)),
        ((6, 4, 37), (1,)),
        ((3, 5, 16), (0,)),
        ((2, 20, 4), (0, 1)),
    ],
    ids=str,
)
def test_springs_balance_the_pull_of_each_sphere_whatever_the_driven_planes_do(shape, axes, precision):
    """-Laplace u = pull, written out as weighted differences across contacts; 0 at the bottom, any value at the top."""
    lattice, rng, weights = Lattice(shape), np.random.default_rng(5), (1.0,) * (len(shape) - 1) + (0.3,)
    spec = (("potential", len(axes)), ("friction", 1), ("pull", len(axes)))
    fields = Fields(make_layout(3, shape), spec)
    balance = TorqueBalance(spec, Stencil(axes, len(shape), fields.layout.block), weights, fields)
    pull, top = rng.standard_normal((len(axes), 3, *shape)), rng.standard_normal((len(axes), 3, 1))
    start = rng.standard_normal(pull.shape)
    start[..., 0], start[..., -1] = 0.0, top.reshape(-1, 3, *(1,) * (len(shape) - 1))
    for name, values in (("pull", pull), ("potential", start)):
        fields.load(name, values)
    balance.drive(top * np.linspace(0, 1, shape[-1]))
    with balance.begin():
        balance.solve()
    found = fields.read("potential")
    forces = tuple(w * f for w, f in zip(weights, contact_differences(found, lattice, axes), strict=True))
    accuracy = 1e-12 if precision == "f64" else 1e-3
    assert np.abs((torques(forces, lattice, axes) + pull)[..., 1:-1]).max() < accuracy
    assert np.abs((found - start)[..., [0, -1]]).max() < accuracy
