"""The contact step and the torque balance of operator splitting against sums written out with NumPy, on any device."""

import numpy as np
import pytest

from taichi_bearings.fields import Fields, block_size
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import OperatorSplitting
from taichi_bearings.solvers.torque_balance import TorqueBalance
from tests.scenes import make_scene


@pytest.mark.parametrize(
    ("shape", "direction", "periodic"),
    [
        ((4, 5), (1, 1, 0), ""),
        ((3, 4, 5), (1, 1, 0), ""),
        ((3, 4, 5), (1, 2, 3), ""),
        ((4, 3, 4), (0, 1, 0), ""),
        ((2, 3, 20), (0, 1, 1), ""),
        ((4, 5), (1, 1, 0), "x"),
        ((2, 4, 5), (1, 1, 0), "xy"),
    ],
)
def test_a_contact_step_equals_sums_over_contacts(shape, direction, periodic, precision):
    accuracy, rng = 1e-12 if precision == "f64" else 1e-4, np.random.default_rng(77)
    scene = make_scene(shape, direction=direction, seeds=(11, 12), periodic=tuple(periodic))
    method, spin = OperatorSplitting().build(), initial_spin(scene, "random")
    method.begin(scene, spin)
    fields = method.fields
    lattice, axes, layout = scene.lattice, method.spin_axes, method.layout
    potential = 30 * rng.standard_normal((len(axes), 2, *shape))
    difference = contact_differences(potential, lattice, axes)
    acts = (scene.acting_coefficient > 0) & lattice.tangential_mask(axes)[:, None]
    trial = 40 * rng.standard_normal(difference.shape) * acts
    fields.load("potential", potential)
    fields.load("trial", method.stencil.forces_at_lower_sphere(trial, layout))
    method._step_contacts(1.7)

    def limited(force):
        size = np.sqrt((force**2).sum(axis=0))
        return force * np.minimum(1.0, scene.normal_force * scene.acting_coefficient / np.maximum(size, 1e-300))

    friction, weighted = limited(trial), np.array(method.weights)[lattice.axis] * difference
    reached = friction - 0.7 * (trial - friction) + 1.7 * weighted
    springs = weighted - (reached - 2 * limited(reached))
    for name, expected in (("trial", reached), ("spring", springs)):
        assert np.abs(method.stencil.forces_of_contacts(fields.read(name), layout) - expected).max() < accuracy
    pull = torques(springs, lattice, axes)
    assert np.abs((fields.read("pull") - pull)[..., 1:-1]).max() < 10 * accuracy


@pytest.mark.parametrize(
    ("shape", "axes", "periodic"),
    [
        ((5, 7), (2,), ()),
        ((2, 3, 3), (0, 1), ()),
        ((4, 6, 5), (0, 1), ()),
        ((6, 4, 37), (1,), ()),
        ((3, 5, 16), (0,), ()),
        ((2, 3, 48), (0, 1), ()),
        ((3, 2, 65), (0, 1), ()),
        ((2, 20, 4), (0, 1), ()),
        ((6, 7), (2,), (0,)),
        ((2, 3, 3), (0, 1), (0,)),
        ((6, 4, 37), (0, 1), (0, 1)),
        ((2, 20, 4), (0, 1), (1,)),
    ],
    ids=str,
)
@pytest.mark.parametrize("folds", [False, True])
def test_springs_balance_the_pull_of_each_sphere(shape, axes, periodic, folds, precision):
    """-Laplace u = pull, written out as weighted differences across contacts; u is 0 on the driven planes."""
    weights, rng = (1.0,) * (len(shape) - 1) + (0.3,), np.random.default_rng(5)
    lattice = Lattice(shape, periodic=periodic)
    spec = (("potential", len(axes)), ("friction", 1), ("pull", len(axes)))
    fields = Fields(Layout(3, shape, block_size(), periodic), spec)
    balance = TorqueBalance(spec, Stencil(axes, len(shape), fields.layout.block, periodic), weights, fields, folds)
    pull, start = rng.standard_normal((2, len(axes), 3, *shape)).astype(np.float32).astype(np.float64)
    fields.load("potential", start)
    left = pull
    for _ in range(3):  # a CPU multiplies in single precision
        fields.load("pull", left)
        with balance.begin():
            balance.solve()
        added = fields.read("potential") - start
        forces = np.array(weights)[lattice.axis] * contact_differences(added, lattice, axes)
        before, left = np.abs(left).max(), torques(forces, lattice, axes) + pull
        left[..., [0, -1]] = 0.0
        assert np.abs(left).max() < max(1e-3 * before, 1e-12 if precision == "f64" else 1e-4)
    assert np.abs(left).max() < (1e-12 if precision == "f64" else 1e-4)
    assert np.abs(added[..., [0, -1]]).max() == 0.0
