"""The planar cut: stored minima, linear programmes, states, contrasts, drivings, batches."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import PlanarCut
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene, minima, name_of, scene_of

SIX_DECADES = ["lognormal:1,2.3", "bimodal:1e-3,1e3,0.5", "power-law:1e-3,1e3,-1"]


def solved(scene, start="random", tolerance=1e-12):
    solution = solve(scene, PlanarCut().build(), initial_spin(scene, start), StopRule(tolerance))
    assert solution.status is Status.CERTIFIED
    assert solution.iterations == 1
    assert (solution.lower_bound <= solution.power).all()
    return solution


@pytest.mark.parametrize("entry", minima((10, 10), (32, 32)), ids=name_of)
def test_reference_minima(entry):
    assert solved(scene_of(entry)).power[0] == pytest.approx(entry["power_minimum"], rel=1e-12)


@pytest.mark.parametrize("distribution", SIX_DECADES)
@pytest.mark.parametrize("shape", [(60, 50), (2, 100), (11, 12, 13), (2, 2, 3)], ids=str)
def test_six_decades_leave_a_gap_of_round_off(shape, distribution):
    solution = solved(make_scene(shape, distribution=distribution, seeds=(1, 2, 3), direction=(0, 1, 0)))
    assert solution.gap.max() < 1e-12


def test_exactly_the_interface_slips():
    solution = solved(make_scene((9, 8), seeds=(1, 2, 3)))
    assert solution.states_proven.all()
    slipping = solution.state == ContactState.SLIPPING
    assert (slipping == (solution.slip > 0)).all()
    assert solution.force[slipping] == pytest.approx(50.0 * solution.scene.coefficient[slipping], rel=1e-12)
    assert ((solution.state == ContactState.DRIVEN) == solution.scene.lattice.between_driven).all()
    assert not (solution.state == ContactState.UNDECIDED).any()


def test_contacts_along_the_spin_neither_slip_nor_push():
    solution = solved(make_scene((4, 5, 6), direction=(0, 1, 0)))
    along_y = solution.scene.lattice.axis == 1
    assert (solution.slip[:, along_y] == 0).all()
    assert (solution.force[:, along_y] == 0).all()
    assert set(np.unique(solution.state[:, along_y])) == {ContactState.SLIPLESS, ContactState.DRIVEN}
    assert (solution.spin[..., [0, 2]] == 0).all()


def test_without_disorder_other_cuts_are_undecided():
    solution = solved(make_scene((5, 7), distribution="constant:0.3"))
    assert not solution.states_proven[0]
    assert not solution.findings["cut_is_unique"][0]
    assert solution.findings["next_cut_over_minimum"][0] == 1
    assert solution.findings["tied_contacts"][0] == 5 * 6
    sideways, upward = solution.scene.lattice.by_axis(solution.state)
    assert (upward == ContactState.UNDECIDED).all()
    assert not np.isin(sideways, [ContactState.SLIPPING, ContactState.UNDECIDED]).any()


@pytest.mark.parametrize("shape", [(3, 4), (4, 4), (5, 7)], ids=str)
def test_ties_are_known_where_the_start_has_the_least_power_less_a_rounding(shape):
    solution = solved(make_scene(shape, distribution="constant:1"))
    assert solution.findings["tied_contacts"][0] == shape[0] * (shape[1] - 1)
    assert solution.minimum_is_unique == [False]


def test_what_slips_at_every_minimum_is_told_from_what_slips_at_some():
    """Two cuts of weight 4: straight on at the third column, or down by one contact."""
    upward = np.full((1, 3, 3), 9.0)
    upward[0, :, 1] = 1, 1, 2
    upward[0, 2, 0] = 1
    sideways = np.full((1, 2, 4), 9.0)
    sideways[0, 1, 1] = 1
    scene = Scene((sideways, upward))
    solution = solved(scene)
    assert solution.power[0] == 4 * 50 * 0.5
    assert not solution.states_proven[0]
    assert solution.findings["tied_contacts"][0] == 3
    state = scene.lattice.by_axis(solution.state[0])
    slipping, undecided = ([np.argwhere(s == which).tolist() for s in state] for which in (1, 2))
    assert slipping == [[], [[0, 1], [1, 1]]]
    assert undecided == [[[1, 1]], [[2, 0], [2, 1]]]


def test_ties_of_one_plane_leave_the_states_of_the_others_proven():
    scene = make_scene((3, 4, 5), direction=(1, 0, 0), seeds=(1, 2))
    coefficients = [values.copy() for values in scene.coefficients]
    for axis in (1, 2):
        coefficients[axis][1, 1] = 0.3
    scene = replace(scene, coefficients=tuple(coefficients))
    solution = solved(scene)
    assert solution.states_proven.tolist() == [True, False]
    assert solution.findings["tied_contacts"].tolist() == [0, 4 * 4]
    undecided = np.argwhere(scene.lattice.by_axis(solution.state)[2] == ContactState.UNDECIDED)
    assert (undecided[:, :2] == (1, 1)).all()
