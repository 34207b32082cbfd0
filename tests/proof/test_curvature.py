"""States are proven in less memory than the method has taken."""

import tracemalloc

import pytest

from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.proof.samples import samples_of
from tests.scenes import make_scene


def solved(shape: tuple[int, ...]):
    scene = make_scene(shape, seeds=(3,))
    return solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-9))


@pytest.mark.usefixtures("needs_f64")
def test_the_proof_needs_less_memory_than_is_asked_for_the_method():
    samples = samples_of(solved((10, 10, 10)))
    assert samples.judgement.states[0].unique  # what is loaded and kept for all samples of this shape is not counted
    tracemalloc.start()
    try:
        assert samples.judgement.states[0].unique
        assert tracemalloc.get_traced_memory()[1] < min(3.5e6, 0.6 * InteriorPoint.bytes((10, 10, 10)))
    finally:
        tracemalloc.stop()
