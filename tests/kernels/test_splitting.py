"""The contact step and the Poisson solver of operator splitting against sums written out with NumPy."""

import numpy as np
import pytest

from taichi_bearings import runtime
from taichi_bearings.fields import Fields, make_layout
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.numerics.poisson import PlanePoisson
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import OperatorSplitting
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
    if runtime.current().is_gpu:
        pytest.skip("operator splitting works in the memory of the CPU")
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
    fields.view("potential")[...] = potential
    for axis, values in enumerate(trial):
        slot = method.stencil.force_slot[axis]
        layout.from_lower_sphere(fields.view("trial")[slot : slot + len(values)], axis)[...] = values
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
    found = method.stencil.forces_by_axis(fields.view("push"), layout)
    for ours, expected in zip(found, pushes, strict=True):
        assert np.abs(ours - expected).max(initial=0.0) < accuracy
    assert np.abs(fields.view("pull") + torques(tuple(pushes), lattice, axes)).max() < 10 * accuracy


@pytest.mark.parametrize("shape", [(5, 7), (4, 6, 5), (2, 3, 3)])
def test_the_poisson_solution_solves_the_difference_equation(shape):
    """-Laplace u = source, written out as weighted differences across the contacts of the component."""
    lattice, rng = Lattice(shape), np.random.default_rng(5)
    weights = (1.0,) * (len(shape) - 1) + (0.3,)
    for component in lattice.all_spin_axes:
        source = np.zeros((1, 2, *shape))
        source[..., 1:-1] = rng.standard_normal((1, 2, *shape[:-1], shape[-1] - 2))
        if component == lattice.height_axis:  # nothing holds a layer: it has no mean
            source -= source.mean(axis=(2, 3), keepdims=True)
        solution = np.zeros_like(source)
        solver = PlanePoisson(lattice, component, weights, 2, np.float64)
        solver.solve(source[0][..., 1:-1], solution[0][..., 1:-1])
        forces = contact_differences(solution, lattice, (component,))
        pull = torques(tuple(w * f for w, f in zip(weights, forces, strict=True)), lattice, (component,))
        assert np.abs((pull + source)[..., 1:-1]).max() < 1e-12
