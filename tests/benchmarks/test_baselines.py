"""NumPy, C and our kernels make the same sweep, so that their times compare."""

import numpy as np
import pytest
from taichi_bearings_studies.benchmarks.baselines import SHARPNESS, Arrays, CSweep, NumpySweep, find_compiler

from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.gradient_descent import GradientDescentMethod
from taichi_bearings.solvers.table import GradientDescent
from tests.scenes import make_scene

SWEEPS = 6


def inside(arrays):
    return arrays.spin[:, arrays.layout.inside].astype(float)


def ours(scene):
    method = GradientDescentMethod(GradientDescent(momentum=False))
    spin = initial_spin(scene, "random")
    method.begin(scene, spin)
    method._load_spins(scene.staggered_spin(spin, method.spin_axes))
    method._step_and_sharpness = lambda: (1e-3, SHARPNESS)
    method.box = [-np.inf] * 3 + [np.inf] * 3
    method.advance(SWEEPS)
    return method.fields.read("point").reshape(len(method.spin_axes), -1)


@pytest.mark.parametrize(
    "scene", [make_scene((6, 7)), make_scene((4, 5, 6)), make_scene((3, 4, 5), direction=(1, 2, 3))]
)
def test_all_make_the_same_sweeps(scene, tmp_path, needs_f64):
    numpy = Arrays(scene, "f64")
    NumpySweep(numpy).repeat(SWEEPS)
    start = inside(Arrays(scene, "f64"))
    assert np.abs(inside(numpy) - start).max() > 1e-4
    if find_compiler() is not None:
        c = Arrays(scene, "f64")
        CSweep(c, tmp_path).repeat(SWEEPS)
        assert inside(c) == pytest.approx(inside(numpy), abs=1e-12)
    assert ours(scene) == pytest.approx(inside(numpy), abs=1e-12)
