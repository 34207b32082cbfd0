"""Bearing states on both planes, A + C x: against minima in 140 digits, chains, sheets and the spins about an axis."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from taichi_bearings_studies.stress import truth

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.run import run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import linear_spin, staggered_linear_spin
from tests.scenes import SIMPLE_LAWS, make_scene
from tests.stress.minima import least_of_all

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
solve = partial(tb.solve, threads=1)
STATES = [
    {"top": (1.0, 1.0, 0.0, 0.2)},
    {"top": (0.5, -0.3, 2.0, -0.7), "bottom": (1.0, 0.5, -0.3, 0.4)},
    {"top": (0.0, 0.0, 0.0, 1.0), "bottom": (1.0, 0.0, 0.0, 0.0)},  # about x no jump in the layer i = 1
    {"top": (1.0, 0.0, 0.0), "bottom": (0.0, 1.0, 0.0)},
    {"top": (1.0, 1.0, 0.0, 1e-9), "bottom": (1.0, 1.0, 0.0, 0.0)},
]


DISTRIBUTIONS = ["uniform:0.1,1.0", "bimodal:1,2,0.5"]
DRAWN = [  # each state under one of them; under both with --thorough
    pytest.param(states, distribution, marks=() if number % 2 == at else pytest.mark.thorough)
    for number, states in enumerate(STATES)
    for at, distribution in enumerate(DISTRIBUTIONS)
]


@pytest.mark.parametrize(("states", "distribution"), DRAWN, ids=str)
def test_bounds_and_states_are_those_of_140_digits(states, distribution):
    scene = Scene.random((3, 3, 4), seed=23, distribution=distribution, **states)
    best, exact = solve(scene, tolerance=1e-12), least_of_all(scene)
    assert best.lower_bound <= float(exact.lower) * (1 + 1e-15)
    assert best.power >= float(exact.upper) * (1 - 1e-15)
    assert best.gap < 1e-12
    assert best.states_proven or distribution != "uniform:0.1,1.0"
    state, called = (scene.lattice.flat(of) for of in (exact.state, best.state))
    assert (state[called == ContactState.SLIPPING] == truth.SLIPPING).all()
    assert (state[called == ContactState.SLIPLESS] == truth.SLIPLESS).all()


@pytest.mark.parametrize("law", SIMPLE_LAWS)
def test_columns_that_are_alike_move_alone(law):
    """With friction that varies along the height alone no contact sideways slips, and each column is a chain."""
    height = np.random.default_rng(6).uniform(0.1, 1.0, 5)
    arrays = [np.full(scene_shape, 0.5) for scene_shape in ((4, 4, 6), (5, 3, 6))]
    upright = np.broadcast_to(height, (5, 4, 5))
    scene = Scene((*arrays, upright), law, radius=0.3, top=(1.0, -0.5, 2.0, 0.7), bottom=(0.2, 0.0, 0.0, -0.4))
    best = solve(scene, tolerance=1e-11)
    assert best.power == pytest.approx(float(truth.layered(scene).lower), rel=1e-11)


def test_the_spin_of_the_top_is_not_lost_beside_a_far_faster_bottom():
    scene = Scene.random((4, 4, 4), seed=1, top=(1.0, 1.0, 0.0, 0.2), bottom=(1.0, 1.0, 1.0, 1e12))
    corner = np.array([1.0 + 0.2 * 3, 1.0 + 0.2 * 3, 0.2 * 3])
    assert scene.imposed[0] == pytest.approx(np.linalg.norm(corner), rel=1e-15)


@pytest.mark.parametrize("shape", [(5, 6), (4, 3, 5)], ids=str)
@pytest.mark.parametrize("law", SIMPLE_LAWS)
def test_spins_about_an_axis_are_one_case_of_it(shape, law):
    old = make_scene(shape, law, spin_top=1.5, spin_bottom=-0.5, direction=(0, 3, 4))
    states = ((1.5,), (-0.5,)) if len(shape) == 2 else ((0.0, 0.9, 1.2), (0.0, -0.3, -0.4))
    new = replace(old, spin_top=1.0, spin_bottom=0.0, direction=(1, 1, 0), top=states[0], bottom=states[1])
    found = [solve(scene) for scene in (old, new)]
    assert found[1].power == pytest.approx(found[0].power, rel=1e-13)
    assert new.minimum_spin_axes == old.minimum_spin_axes
    assert np.abs(found[1].spin - found[0].spin).max() < 1e-12


RUNS = [
    {}, {"law": "viscous"}, {"method": "operator-splitting", "tolerance": 1e-4},
    {"method": "gradient-descent", "iterations": 300}, {"method": "cundall-strack", "duration": 0.05},
    {"method": "cundall-strack", "tolerance": 1e-3}, {"method": "rigid-limit", "law": "coulomb-viscous"},
    {"replicas": 3, "distribution": "bimodal:1,2,0.5"},
]  # fmt: skip


@pytest.mark.parametrize(("given", "states"), list(zip(RUNS, (STATES * 2)[1:], strict=False)), ids=str)
def test_runs_are_verified_and_read_back(states, given, tmp_path):
    done = run(RunSettings(shape=(3, 3, 4), threads=1, figures="none", **states, **given), tmp_path / "run")
    assert verify(tmp_path / "run")["contradictions"] == []
    again = tb.load(tmp_path / "run").scene
    assert (again.top, again.bottom) == (done.solution.scene.top, done.solution.scene.bottom)


def test_spins_of_the_planes_that_are_not_imposed_are_found(tmp_path):
    import h5py

    run(RunSettings(shape=(3, 3, 4), threads=1, figures="none", **STATES[1]), tmp_path / "run")
    with h5py.File(tmp_path / "run" / "run.h5", "r+") as file:
        del file.attrs["sha256"]
        file["spin"][1, 2, -1, 0] += 1e-6
    assert any("spins of driven spheres" in text for text in verify(tmp_path / "run")["contradictions"])


def test_a_layer_without_a_jump_does_not_slip():
    scene = Scene.random((4, 3, 5), seed=2, **STATES[2])
    best = solve(scene)
    assert best.states_proven
    assert not scene.top_spin((0,))[0, 1].any()
    spin = best.spin[1, ..., 0] * scene.lattice.parity[1]
    assert (spin == 1.0).all()  # it turns about x as top and bottom do there


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ({"top": (1.0, 0.0, 0.0), "spin_top": 2.0}, "spin_top is 2.0, but the states top or bottom replace it"),
        ({"top": (1.0,)}, r"top is \(1.0,\); the motion of a driven plane must be given by A_x, A_y, A_z"),
        ({"bottom": (1.0, np.nan, 0.0)}, "bottom is"),
        ({"top": "spin"}, "top is 'spin'"),
    ],
)
def test_states_that_cannot_be_are_refused(words, sentence):
    with pytest.raises(InputError, match=sentence):
        Scene.random((3, 3, 4), **words)


def test_domains_turn_between_the_planes_of_their_layers():
    best = solve(Scene.random((5, 4, 6), seed=3, top=(1.0, 0.0, 0.0, 0.2), bottom=(0.0, 0.0, 0.0, -0.1)))
    domains = tb.analyse(best).structure.rigid_domains
    assert domains.spread < 1e-12
    assert all(len(np.unique(labels)) == labels.max() + 1 for labels in domains.component_domain)
    assert domains.turn.min() > -1e-12
    assert domains.turn.max() < 1 + 1e-12
    assert (domains.turn[domains.domain[1, 1, -1]] == 1).all()
    assert ((domains.turn > 0.01) & (domains.turn < 0.99)).any()


@pytest.mark.parametrize(
    "of",
    [
        {"shape": (4, 5)},
        {"shape": (4, 6, 5), "spin_bottom": 0.3, "spin_top": -0.7},
        {"shape": (4, 5), "top": 1.3, "bottom": 0.1},
        {"shape": (3, 4, 5), "top": (1, 1, 0.3, 0.2), "bottom": (0.1, 0, 0.7, -0.3)},
        {"shape": (4, 4, 5), "periodic": "x"},
    ],
    ids=str,
)
def test_linear_spins_as_solvers_store_them_have_the_bits_of_those_of_the_laboratory(of):
    scene = Scene.random(seed=1, **of)
    for axes in {scene.minimum_spin_axes, scene.lattice.all_spin_axes}:
        expected = scene.staggered_spin(linear_spin(scene), axes)
        assert np.array_equal(staggered_linear_spin(scene, axes), expected)
        assert np.ptp(expected) > 0
