"""States proven with elimination in several parts and in one."""

import pytest

from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.verifier import dissection
from taichi_bearings.verifier.judgement import Judgement
from tests.scenes import make_scene
from tests.verifier.test_bounds import samples_of


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("leaf", [5, 10_000])
def test_states_are_proven_in_many_parts_and_in_one(monkeypatch, leaf):
    solution = solve(
        scene := make_scene((6, 6, 6), seeds=(3,)),
        InteriorPoint().build(),
        initial_spin(scene, "linear"),
        StopRule(1e-9),
    )
    monkeypatch.setattr(dissection, "LEAF", leaf)
    assert Judgement(samples_of(solution)).states[0].agree([state[0] for state in solution.state])
