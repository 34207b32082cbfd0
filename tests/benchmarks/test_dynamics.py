"""The other codes run our scene: they come to rest at the certified minimum. Skipped where they are not installed."""

import numpy as np
import pytest
from taichi_bearings_studies.benchmarks.dynamics import FRICTION, PEER_STEP, Code, codes, request_of

from taichi_bearings.errors import BearingsError
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene


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
