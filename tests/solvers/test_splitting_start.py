"""Central paths that begin where a short operator splitting ends: near the minimum, and inside all cones."""

import numpy as np
import pytest

from taichi_bearings.conic.cones import length
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint, lattice_paths
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.lattice_paths import LatticePaths
from taichi_bearings.solvers.splitting_start import MOST_TORQUE, START_GAP, splitting
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
SHAPE = (18, 18, 18)  # the least cube whose samples are followed one by one


def minimum_of(scene):
    return solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-10))


def started(monkeypatch, scene):
    """The paths of a scene at their starts by splitting, and those without."""
    spin = initial_spin(scene, "linear")
    plain = LatticePaths(scene, (0, 1), spin, settle=True)
    assert plain._split is None
    monkeypatch.setattr(lattice_paths, "SPLIT_UNKNOWNS", 0)
    paths = LatticePaths(scene, (0, 1), spin, settle=True)
    if paths._split is not None:
        paths._begin_at(paths._split())
    return paths, plain


def test_splitting_ends_at_the_gap_from_which_paths_begin():
    scene = make_scene(SHAPE, seeds=(1, 2))
    reached = splitting(scene, initial_spin(scene, "linear"))()
    assert (reached.lower_bound >= (1 - START_GAP) * reached.objective).all()


def test_starts_are_inside_all_cones_and_near_the_minimum(monkeypatch):
    paths, plain = started(monkeypatch, make_scene(SHAPE, seeds=(1, 2)))
    for sample, other in zip(paths.samples, plain.samples, strict=True):
        point = sample.iterate
        assert (point.bound > length(point.difference)).all()
        assert (point.friction > length(point.dual)).all()
        assert point.difference == pytest.approx(point.system.differences(point.spins))
        assert point.unbalanced < MOST_TORQUE
        assert point.gap < 0.02
        assert other.iterate.gap > 10 * point.gap


@pytest.mark.parametrize("distribution", ["uniform:0.1,1.0", "bimodal:0.1,1.0,0.5"])
def test_the_minimum_is_that_of_the_plain_start_after_fewer_steps(monkeypatch, distribution):
    scene = make_scene(SHAPE, seeds=(3,), distribution=distribution)
    plain = minimum_of(scene)
    monkeypatch.setattr(lattice_paths, "SPLIT_UNKNOWNS", 0)
    split_first = minimum_of(scene)
    assert split_first.states_proven[0] == plain.states_proven[0]
    assert split_first.power == pytest.approx(plain.power, rel=1e-14)
    assert (split_first.state == plain.state).all()
    assert split_first.iterations <= plain.iterations - 3


def test_frictions_too_far_apart_and_viscosity_keep_the_plain_start(monkeypatch):
    for scene in (make_scene(SHAPE, distribution="power-law:1e-8,1.0,-1.0"), make_scene(SHAPE, "coulomb-viscous")):
        paths, plain = started(monkeypatch, scene)
        assert np.array_equal(paths.samples[0].iterate.bound, plain.samples[0].iterate.bound)
