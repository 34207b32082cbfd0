"""Bearing states on both planes against a cone programme in the laboratory frame, with all three components."""

from functools import partial

import pytest

import taichi_bearings as tb
from taichi_bearings.scene import Scene
from tests.agreement.laboratory import draw_scene, falsehoods, laboratory_minimum
from tests.scene.test_driving import STATES

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
solve = partial(tb.solve, threads=1)


@pytest.mark.parametrize("states", STATES[:4], ids=str)
def test_two_components_are_enough(states):
    """The third one, free in the cone programme, changes nothing."""
    scene = Scene.random((3, 4, 4), seed=8, **states)
    best = solve(scene)
    assert len(scene.minimum_spin_axes) == 2
    assert best.states_proven
    assert best.power == pytest.approx(laboratory_minimum(scene).objective, rel=1e-8)


def test_random_scenes_of_all_laws():
    """In 2D and 3D, between spins and bearing states, with ties; `python -m tests.agreement.laboratory` runs more."""
    compared = 0
    for number in range(24):
        scene = draw_scene(1, number)
        found, states = falsehoods(scene, solve(scene), laboratory_minimum(scene))
        assert found == [], number
        compared += states
    assert compared > 200
