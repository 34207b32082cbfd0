"""Cundall-Strack dynamics nears the rigid limit, which shares no code with it, in proportion to 1/A_t."""

import numpy as np
import pytest

from taichi_bearings.scene import Scene
from tests.benchmarks.rigid_convergence import STIFFENED, Comparison
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("needs_f64")

FACTORS = (10.0, 100.0)


def falls(comparison, limit, error, stiffened):
    """(T,) how much nearer the spins come for ten times the stiffened numbers (the power may cross its limit)."""
    far, near = (comparison.soft(factor, STIFFENED[stiffened], 0.4).distance(limit)[0] for factor in FACTORS)
    assert (near > 3 * error[0]).all(), (near, error)
    return far / near


def test_discs_turn_as_under_rigid_friction_but_for_a_creep_in_proportion_to_one_over_the_damping():
    comparison = Comparison(make_scene((3, 4), seeds=(0,)), "random", (0.3, 1.0))
    limit = comparison.rigid(0, tolerance=2e-5)
    for stiffened in ("K+A", "A"):
        assert falls(comparison, *limit, stiffened) == pytest.approx([10, 10], rel=0.2)
    assert (falls(comparison, *limit, "K") < 5).all()  # the creep stays


def test_spheres_from_the_minimum_cut_near_the_rigid_limit_between_the_root_and_the_first_power():
    comparison = Comparison(make_scene((2, 2, 3), seeds=(1,)), "minimum-cut", (0.3, 1.0))
    found = falls(comparison, *comparison.rigid(8), "K+A")
    assert ((found > 10**0.5) & (found < 13)).all(), found


def test_driven_discs_creep_by_what_the_spring_does_not_bear_over_the_damping():
    """Top 0.7, bottom 0.3 of the friction: the discs speed up until they turn with the top. From then on the upper
    contacts need to bear 0.3 F_n, but their springs still hold the 0.7 F_n of slipping, and give way in a time
    A / K = 10 only: until then the discs turn faster than the top, by 0.4 F_n / A."""
    height = np.empty((1, 2, 2))
    height[..., 0], height[..., 1] = 0.3, 0.7
    scene = Scene((np.full((1, 1, 3), 0.1), height))
    comparison = Comparison(scene, "linear", (4.0,))
    limit, _ = comparison.rigid(0, tolerance=1e-3)
    assert limit.spin == pytest.approx(np.ones_like(limit.spin), abs=1e-8)
    creep = 0.4 * scene.normal_force / 1e6 / scene.lattice.radius
    ahead = comparison.soft(1e3, STIFFENED["A"], 0.4).spin - 1
    assert ahead == pytest.approx(np.full_like(limit.spin, creep), rel=0.01)
