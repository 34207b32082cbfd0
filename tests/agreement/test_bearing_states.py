"""Bearing states on both planes against a cone programme in the laboratory frame, with all three components."""

from functools import partial

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.scene import Scene
from tests.agreement.laboratory import SHARPER, draw_scene, falsehoods, laboratory_minimum

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
solve = partial(tb.solve, threads=1)


def test_random_scenes_of_all_laws(thorough):
    """In 2D and 3D, between spins and bearing states, with ties. Where the minimum is flat, slips of the programme are
    off by far more than its power, and a sharper one is asked."""
    compared = 0
    for number in range(500 if thorough else 24):
        scene = draw_scene(1, number)
        best, truth = solve(scene), laboratory_minimum(scene)
        found, states = falsehoods(scene, best, truth) if truth.solved else ([], 0)
        if found:
            sharper = laboratory_minimum(scene, SHARPER)
            assert sharper.solved, (number, found)
            assert falsehoods(scene, best, sharper)[0] == [], number
        compared += states
    assert compared > 200


def sheets(scene, k):
    """Power P_k of component k alone: the cuts of all layers x_k = const, each a lattice of discs."""
    closed = ("x",) if "xy"[1 - k] in scene.periodic else ()
    state_top, state_bottom, other = scene.top or (0.0,) * 4, scene.bottom or (0.0,) * 4, 1 - k
    total = 0.0
    for i in range(scene.lattice.shape[k]):
        sides = tuple(np.take(scene.coefficients[axis], i, axis=k) for axis in (other, 2))
        at = 2 * scene.lattice.radius * i
        jump = state_top[k] - state_bottom[k] + (state_top[3] - state_bottom[3]) * at
        layer = Scene(sides, radius=scene.lattice.radius, normal_force=scene.normal_force, periodic=closed)
        total += abs(jump) * solve(layer, "planar-cut").power
    return total


@pytest.mark.parametrize(("seed", "shape", "periodic"), [
    *((seed, (3, 4, 5), ()) for seed in range(5)), (5, (4, 4, 4), "x,y"), (6, (4, 4, 4), "x,y"),
])  # fmt: skip
def test_sheets_bound_the_minimum_from_both_sides(seed, shape, periodic):
    """sqrt(P_x^2 + P_y^2) <= P_min <= P_x + P_y, and equal where one of them vanishes."""
    rng = np.random.default_rng(seed)
    top, bottom = (tuple(float(part) for part in rng.choice([0.0, 1.0, -0.5, 0.3], 4)) for _ in range(2))
    if seed < 2:
        top, bottom = ((1.0, 0.7, 0.0, 0.0), (0.0, 0.7, 0.0, 0.0))[:: 1 - 2 * seed]
    scene = Scene.random(shape, seed=seed, top=top, bottom=bottom, periodic=periodic)
    of_x, of_y, best = sheets(scene, 0), sheets(scene, 1), solve(scene)
    assert np.hypot(of_x, of_y) <= best.power * (1 + 1e-12)
    assert best.lower_bound <= (of_x + of_y) * (1 + 1e-12)
    if seed < 2:
        assert best.power == pytest.approx(of_x, rel=1e-12)
