"""NumPy, C and our kernels make the same sweep, so that times compare; other codes that run our scene come to rest
at the certified minimum. What is not installed is skipped."""

import numpy as np
import pytest
from taichi_bearings_studies.benchmarks.baselines import SHARPNESS, Arrays, CSweep, NumpySweep, find_compiler
from taichi_bearings_studies.benchmarks.dynamics import FRICTION, PEER_STEP, Code, codes, request_of

from taichi_bearings.errors import BearingsError
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.gradient_descent import GradientDescentMethod
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import GradientDescent
from tests.scenes import make_scene

SWEEPS = 6


def inside(arrays):
    first = arrays.layout.margin
    return arrays.spin[:, first : first + arrays.layout.sites].astype(float)


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


def power_at_rest(code, scene, spin, duration, folder):
    """Power of a code's spins after `duration`, from these laboratory spins on."""
    everything = scene.lattice.all_spin_axes
    lab = scene.laboratory_spin(scene.staggered_spin(spin, everything), everything)  # the driving imposed
    request = request_of(scene, lab[0], folder, round(duration / PEER_STEP), 0)
    code.measure({**request, "final": str(folder / "final.npy")})
    return scene.power(scene.staggered_spin(np.load(folder / "final.npy")[None], everything), everything)[0]


@pytest.mark.parametrize("code", codes(), ids=lambda code: code.name)
def test_rests_at_the_minimum(code, tmp_path):
    if not code.program:
        pytest.skip(f"{code.name} is not installed here: {code.how_to_install}")
    scene = make_scene((3, 3, 3), seeds=(0,), distribution=f"constant:{FRICTION}")
    spin = initial_spin(scene, "random")
    minimum = solve(scene, InteriorPoint().build(), spin, StopRule(1e-10)).power[0]
    assert power_at_rest(code, scene, spin, 0.3, tmp_path) == pytest.approx(minimum, rel=1e-4)
    assert power_at_rest(code, scene, spin, PEER_STEP, tmp_path) > 1.02 * minimum  # it was not there from the start


def test_a_code_that_fails_is_one_sentence():
    with pytest.raises(BearingsError, match=r"^false x failed"):
        Code("x", "", ("false", "x")).measure({})
