"""Cundall–Strack steps against plain loops in the laboratory frame."""

from unittest.mock import patch

import numpy as np
import pytest

from taichi_bearings import runtime
from taichi_bearings.kernels.team import Team
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers import CundallStrack, on_strides
from taichi_bearings.solvers.gear import GEAR_COEFFICIENTS
from tests.kernels.test_descent import three_components
from tests.kernels.twins import cundall_strack_step, neighbours
from tests.scenes import make_scene

LATTICES = [((4, 5), ()), ((3, 2, 5), ()), ((4, 5), "x"), ((3, 2, 5), "y"), ((2, 4, 3), "xy")]
CASES = [  # every lattice, start, law and order, and half of their pairs
    (*lattice, ("random", "linear")[(i // 2 + n) % 2], tuple(LAWS)[(i + n) % 3], order)
    for i, lattice in enumerate(LATTICES)
    for n, order in enumerate(sorted(GEAR_COEFFICIENTS))
    if (i + n) % 2 == 0
]


@pytest.mark.parametrize(("shape", "periodic", "start", "law", "order"), CASES)
def test_steps_equal_plain_loops(shape, periodic, start, law, order, precision):
    scene = make_scene(shape, law, spin_bottom=0.3, viscosity="uniform:20,100", periodic=tuple(periodic))
    spring = "reset" if start == "random" else "relax"
    options = CundallStrack(gear_order=order, static_ratio=1.25, mass=2.0, slipping_spring=spring)
    method = options.build()
    spin = initial_spin(scene, start)
    method.begin(scene, spin)
    fields = method.fields

    def read(name):
        staggered = fields.read(name)
        full = scene.laboratory_spin(staggered, method.spin_axes) if name == "gear_0" else derivative(staggered)
        return three_components(scene, full)

    def derivative(staggered):
        zero = np.zeros((3, 1, *shape))
        zero[list(method.spin_axes)] = staggered
        lab = np.moveaxis(zero, 0, -1) * scene.lattice.parity[..., None]
        return lab if scene.lattice.dimension == 3 else lab[..., 2]

    gear = [read(f"gear_{n}") for n in range(order + 1)]
    last_error = np.zeros_like(gear[0])
    constants = (
        options.stiffness, options.damping, scene.normal_force, options.static_ratio, method.inertia,
        method.time_step, spring == "relax",
    )  # fmt: skip
    by_axis = scene.lattice.by_axis
    coefficient = by_axis(scene.coefficient[0])
    elongation = {(lower, axis): np.zeros(3) for lower, _, axis in neighbours(shape, coefficient)}
    viscosity = by_axis(scene.viscosities[0]) if law == "coulomb-viscous" else None
    slipped = 0
    for _ in range(60):
        forces = cundall_strack_step(
            gear, elongation, last_error, coefficient, law, constants, GEAR_COEFFICIENTS[order], viscosity
        )
        slipped += sum(
            np.linalg.norm(f) >= (1 - 1e-9) * scene.normal_force * coefficient[axis][site]
            for (site, axis), f in forces.items()
        )
    method.advance(60)
    progress = method.progress()
    found = read("gear_0")
    accuracy = 1e-13 if precision == "f64" else 1e-5
    assert np.abs(found - gear[0]).max() <= 10 * accuracy  # 60 steps add up their rounding
    if law != "viscous":
        assert slipped > 0  # or the test would not see the friction limit
    largest = max(np.linalg.norm(f) for f in forces.values())
    sizes = by_axis(np.linalg.norm(progress.force[:, 0], axis=0))
    for (site, axis), force in forces.items():
        assert sizes[axis][site] == pytest.approx(np.linalg.norm(force), abs=1e4 * accuracy * largest)


@pytest.mark.parametrize(
    ("shape", "seeds", "law"),
    [((9, 7, 12), (1,), "coulomb"), ((5, 4, 6), (1, 2), "coulomb-viscous"), ((23, 9), (3,), "viscous")],
)
@pytest.mark.parametrize("energy", [False, True])
def test_both_parts_of_a_step_at_once_give_the_same_bits(shape, seeds, law, energy, precision):
    """As on lattices that no cache holds: without the field of predicted spins, by any number of threads."""
    scene = make_scene(shape, law, seeds=seeds, viscosity="uniform:20,100", spin_bottom=0.3)
    found = []
    for most, threads in ((10**9, 1), *((0, n + 1) for n in range(runtime.current().threads))):
        with patch.object(on_strides, "UNCACHED_SPHERES", most):
            method = CundallStrack(energy=energy).build()
            method.begin(scene, initial_spin(scene, "random"))
        assert ("predicted" in method.fields.names) is (most > 0)
        method.team = Team(threads) if method.team.size else method.team
        method.advance(40)
        state = method.state()
        found.append({name: values for name, values in state.items() if name != "predicted"})
    if precision == "f32":  # the first prediction is rounded once where it is stored, else each of its parts is
        assert np.abs(found[1]["gear_0"] - found[0]["gear_0"]).max() < 1e-4
        del found[0]
    for other in found[1:]:
        assert other.keys() == found[0].keys()
        for name, values in other.items():
            assert (values == found[0][name]).all(), name
