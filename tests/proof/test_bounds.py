"""What of a solution the judges take; and spins that miss the jump, which prove no upper bound."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.proof.samples import samples_of
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")


def solved(shape, options, method):
    from taichi_bearings.scene.initial_spins import initial_spin

    scene = make_scene(shape, **options)
    return solve(scene, METHODS[method]().build(), initial_spin(scene, "linear"), StopRule(1e-10))


def test_spins_without_the_jump_prove_no_upper_bound(sample_at_rest):
    judgement = sample_at_rest.judgement
    assert judgement.power[0] == np.inf
    assert judgement.upper_bound[0] == np.inf
    assert judgement.lower_bound[0] > 0
    assert judgement.states[0].unique is None


@pytest.fixture
def sample_at_rest():
    """All stored spins are those of the bottom."""
    whole = samples_of(solved((3, 2, 4), {}, "interior-point"))
    return replace(whole, spin=np.zeros_like(whole.spin), spin_rounding=np.zeros_like(whole.spin))
