"""The start "minimum-cut": two domains, the least power that two domains can have, and no less than the minimum."""

import numpy as np
import pytest

from taichi_bearings.analysis.structure import find_interface
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.interface import cut_of
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.exact_interfaces import BITS, lightest, power_of_sides, whole_weights
from tests.scenes import SIMPLE_LAWS, make_scene, some_of

DIRECTIONS = [(1, 1, 0), (1, 0, 0), (0, -2, 0), (0, 0, 1), (1, 0, -1), (3, 1, 2)]


def start_of(scene):
    axes = scene.minimum_spin_axes
    return scene.staggered_spin(initial_spin(scene, "minimum-cut"), axes), axes


@pytest.mark.parametrize("law", SIMPLE_LAWS)
@pytest.mark.parametrize("shape", [(5, 6), (3, 4, 5)], ids=str)
@pytest.mark.parametrize("direction", DIRECTIONS, ids=str)
def test_the_power_is_that_of_the_cut(shape, direction, law):
    """P = F_n R |jump| * weight for friction; (R |jump|)^2 * weight for viscous contacts."""
    scene = make_scene(shape, law, seeds=(7, 8), direction=direction, spin_top=-0.7, spin_bottom=0.5, normal_force=3.0)
    staggered, axes = start_of(scene)
    unit = 3.0 * 0.5 * 1.2 if law == "coulomb" else (0.5 * 1.2) ** 2
    assert scene.power(staggered, axes) == pytest.approx(unit * cut_of(scene).weight, rel=1e-13, abs=1e-300)
    top = scene.top_spin(axes)[:, None, ..., None]
    rounding = 4 * np.finfo(float).eps  # of the spins in the laboratory
    turns_with_top = (abs(staggered - top) <= rounding).all(axis=0)
    assert (turns_with_top | (abs(staggered) <= rounding).all(axis=0)).all()
    assert turns_with_top[..., -1].all()


def test_two_components_start_at_or_above_their_minimum(needs_f64):
    """In 3D two domains are not the best state of most samples (paper, Fig. 2); no proven bound is above theirs."""
    scene = make_scene((4, 3, 5), seeds=range(6))
    power = scene.power(*start_of(scene))
    least = solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-8))
    assert (least.lower_bound <= power).all()
    assert (least.power < 0.999 * power).sum() >= 4


def test_without_a_jump_everything_turns_alike():
    scene = make_scene((3, 4, 5), spin_bottom=1.0)
    staggered, axes = start_of(scene)
    assert scene.power(staggered, axes)[0] == 0


STATES = [
    ((1.0, 0.5, 0.0, 1.0), (0.25, 0.0, 0.0, 0.1)),  # the component along the height differs most at the top
    ((0.0, 0.0, 3.0, 0.5), (0.0, 0.0, -1.0, -0.25)),  # no jump at x = y = 0, where contacts weigh nothing
    ((0.0, -1.0, 0.5, 0.5), (0.0, 0.0, 0.0, 0.0)),
    ((1.0, 0.0, 7.0), (0.0, 0.0, 0.0)),  # one component and no C
]
SHAPES = [((3, 4, 4), ()), ((4, 3, 5), ("x",)), ((2, 2, 6), ("x", "y")), ((2, 5, 3), ())]
DISORDER = ["uniform:0.1,1.0", "bimodal:0.1,1.0,0.5", "power-law:1e-12,1.0,-1", "constant:0.3"]


@pytest.mark.parametrize("number", some_of(64, 5))
@pytest.mark.parametrize("law", SIMPLE_LAWS)
def test_no_interface_of_two_bearing_states_is_lighter(number, law):
    """Against exact fractions and networkx: power of the start, proven bound, whether there is another."""
    (shape, closed), (top, bottom) = SHAPES[number % 4], STATES[number // 4 % 4]
    scene = make_scene(shape, law, (number,), DISORDER[number // 16], top=top, bottom=bottom, periodic=closed)
    found, (staggered, axes) = find_interface(scene), start_of(scene)
    arrays = [of[0] for of in scene.lattice.by_axis(scene.coefficient)]
    _, weights = whole_weights(arrays, top, bottom, 0.5, law, periodic=scene.lattice.periodic)
    value, unique, _ = lightest(shape, weights, scene.lattice.periodic)
    least = value * (25.0 if law == "coulomb" else 0.25) / 2**BITS
    assert found.power == pytest.approx(least, rel=1e-12)
    assert least * (1 - 1e-12) <= found.lower_bound <= least
    assert scene.power(staggered, axes)[0] == pytest.approx(least, rel=1e-12)
    assert power_of_sides(scene, top, bottom, found.above) == pytest.approx(least, rel=1e-12)
    assert unique or not found.unique
