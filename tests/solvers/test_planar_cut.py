"""The planar cut: stored minima, linear programmes, states, contrasts, drivings, batches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.sparse import coo_array, hstack, identity, vstack

from taichi_bearings.analysis.structure import find_interface
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint, PlanarCut
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.exact_interfaces import slipping_in_some_and_every
from tests.kernels.twins import is_driven, neighbours
from tests.scenes import axis_of, make_scene, minima, name_of, scene_of, some_of

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


def linear_programme(scene, component):
    """Least power of the spins about `component` alone, as a linear programme over spins and slips."""
    shape = scene.lattice.shape
    contacts = [
        (low, high, scene.coefficients[axis][0][low])
        for low, high, axis in neighbours(shape)
        if axis != component and not (is_driven(low, shape) and is_driven(high, shape))
    ]
    rows, spheres = np.arange(len(contacts)), np.prod(shape)
    ends = [np.ravel_multi_index(list(zip(*(c[end] for c in contacts), strict=True)), shape) for end in (0, 1)]
    sign = np.repeat([-1.0, 1.0], len(rows))
    difference = coo_array((sign, (np.tile(rows, 2), np.concatenate(ends))), shape=(len(rows), spheres))
    above = vstack([hstack([s * difference, -identity(len(rows))]) for s in (1, -1)])
    unit = axis_of(scene)[component]
    limits = []
    for site in np.ndindex(*shape):
        value = {0: scene.spin_bottom * unit, shape[-1] - 1: scene.spin_top * unit}.get(site[-1])
        limits.append((value, value))
    cost = np.concatenate([np.zeros(spheres), [c[2] for c in contacts]])
    found = linprog(cost, A_ub=above.tocsr(), b_ub=np.zeros(above.shape[0]), bounds=limits + [(0, None)] * len(rows))
    assert found.success
    return scene.normal_force * scene.lattice.radius * found.fun


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -2, 0), (1, 0, 1)], ids=str)
@pytest.mark.parametrize("driving", [(1.0, 0.0), (-0.3, 0.8)])
def test_layers_of_a_cubic_lattice_equal_a_linear_programme(direction, driving):
    top, bottom = driving
    scene = make_scene((4, 5, 6), direction=direction, spin_top=top, spin_bottom=bottom)
    (component,) = scene.minimum_spin_axes
    assert solved(scene).power[0] == pytest.approx(linear_programme(scene, component), rel=1e-9)


@pytest.mark.parametrize("shape", [(2, 3), (2, 9), (9, 3), (6, 5)], ids=str)
@pytest.mark.parametrize("driving", [(1.0, 0.0), (0.4, 1.3), (-1.0, -3.0)])
def test_discs_equal_a_linear_programme_for_any_driving(shape, driving):
    top, bottom = driving
    scene = make_scene(shape, distribution="lognormal:1,1", spin_top=top, spin_bottom=bottom, normal_force=7.0)
    solution = solved(scene)
    assert solution.power[0] == pytest.approx(linear_programme(scene, 2), rel=1e-9)
    assert set(np.unique(solution.spin[0] * scene.lattice.parity)) == {top, bottom}


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


def test_without_disorder_all_upward_contacts_are_tied_and_that_is_proven():
    solution = solved(make_scene((5, 7), distribution="constant:0.3"))
    assert solution.states_proven[0]
    assert not solution.findings["cut_is_unique"][0]
    assert solution.findings["next_cut_over_minimum"][0] == 1
    sideways, upward = solution.scene.lattice.by_axis(solution.state)
    assert (upward == ContactState.TIED).all()
    assert np.isin(sideways, [ContactState.SLIPLESS, ContactState.DRIVEN]).all()


@pytest.mark.parametrize("shape", [(3, 4), (4, 4), (5, 7)], ids=str)
def test_ties_are_known_where_the_start_has_the_least_power_less_a_rounding(shape):
    solution = solved(make_scene(shape, distribution="constant:1"))
    assert (solution.state == ContactState.TIED).sum() == shape[0] * (shape[1] - 1)
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
    assert solution.states_proven[0]
    assert solution.minimum_is_unique == [False]
    state = scene.lattice.by_axis(solution.state[0])
    slipping, tied = ([np.argwhere(s == which).tolist() for s in state] for which in (1, 4))
    assert slipping == [[], [[0, 1], [1, 1]]]
    assert tied == [[[1, 1]], [[2, 0], [2, 1]]]


def test_ties_of_one_plane_leave_the_states_of_the_others_proven():
    scene = make_scene((3, 4, 5), direction=(1, 0, 0), seeds=(1, 2))
    coefficients = [values.copy() for values in scene.coefficients]
    for axis in (1, 2):
        coefficients[axis][1, 1] = 0.3
    scene = replace(scene, coefficients=tuple(coefficients))
    solution = solved(scene)
    assert solution.states_proven.tolist() == [True, True]
    assert solution.minimum_is_unique == [True, False]
    tied = np.argwhere(scene.lattice.by_axis(solution.state)[2] == ContactState.TIED)
    assert len(tied) == 4 * 4
    assert (tied[:, :2] == (1, 1)).all()


def test_the_second_lightest_cut_of_a_cubic_lattice_differs_in_one_plane():
    """Planes x = const slip by themselves, so the cheapest other cut is another one of a single plane."""
    scene = make_scene((3, 6, 7), direction=(1, 0, 0))
    planes = [solved(_plane(scene, x)) for x in range(3)]
    powers = np.array([plane.power[0] for plane in planes])
    more = powers * [plane.findings["next_cut_over_minimum"][0] - 1 for plane in planes]
    found = solved(scene).findings["next_cut_over_minimum"][0]
    assert found == pytest.approx(1 + more.min() / powers.sum(), rel=1e-12)
    assert found == pytest.approx(find_interface(scene).next_over, rel=1e-12)


def test_a_tie_of_one_plane_is_a_tie_of_a_periodic_lattice():
    """Of the other planes it is not known how much heavier their second cuts are, which then does not matter."""
    scene = make_scene((3, 4, 5), direction=(1, 0, 0), periodic=("y",))
    coefficients = [values.copy() for values in scene.coefficients]
    for axis in (1, 2):
        coefficients[axis][:, 1] = 0.3
    solution = solved(replace(scene, coefficients=tuple(coefficients)))
    assert not solution.findings["cut_is_unique"][0]
    assert solution.findings["next_cut_over_minimum"][0] == 1


def test_beside_a_plane_that_absent_contacts_cut_the_second_lightest_cut_is_not_known():
    """Another cut of the first plane adds 0.1 * 2, the lightest other one of the second plane more."""
    x, y, z = np.full((1, 2, 4), 0.5), np.full((2, 1, 4), 0.8), np.full((2, 2, 3), 0.9)
    z[0, :, 1], z[0, :, 2], z[1, :, 1] = 0.0, 0.1, 0.3
    solution = solved(Scene((x, y, z), direction=(1, 0, 0)))
    assert solution.power[0] == pytest.approx(2 * 0.3 * 50 * 0.5)
    assert np.isnan(solution.findings["next_cut_over_minimum"][0])


def _plane(scene, x):
    """The layer x = const of a cubic lattice as a square one."""
    return type(scene)((scene.coefficients[1][:, x], scene.coefficients[2][:, x]))


def test_findings_are_in_the_summary():
    summary = Result(RunSettings(tolerance=1e-9), solved(make_scene((5, 6), seeds=(1, 2)))).numbers
    assert summary["cut_is_unique"] == [True, True]
    assert summary["tied"] == [0, 0]
    assert min(summary["next_cut_over_minimum"]) > 1


@pytest.mark.parametrize("number", some_of(60, 4))
def test_ties_beside_absent_contacts_are_all_found_and_nothing_else(number):
    """Discs and cubic lattices driven about x; contacts in some and in every lightest cut by networkx."""
    rng = np.random.default_rng([number, 3])
    shape = [(5, 6), (9, 8), (3, 4, 5), (12, 5)][number % 4]
    values = [
        rng.integers(1, 4, tuple(n - (a == axis) for a, n in enumerate(shape))) * 0.25 for axis in range(len(shape))
    ]
    for of in values:
        of[rng.random(of.shape) < rng.choice([0.05, 0.2])] = 0.0
    scene = Scene(tuple(values), **({"direction": (1, 0, 0)} if len(shape) == 3 else {}))
    solution = solve(scene, PlanarCut().build(), initial_spin(scene, "zero"), StopRule(1e-12))
    tied = 0
    planes = range(shape[0]) if len(shape) == 3 else [slice(None)]
    for plane in planes:
        own = [of[plane] for of in values[-2:]]
        weights = {(a, place): int(4 * v) for a, of in enumerate(own) for place, v in np.ndenumerate(of)}
        states = [of[0][plane] for of in scene.lattice.by_axis(solution.state)[-2:]]
        for (axis, place), (some, every) in slipping_in_some_and_every(shape[-2:], weights).items():
            tied += some and not every
            expected = ContactState.SLIPPING if every else ContactState.TIED if some else ContactState.SLIPLESS
            assert states[axis][place] == expected
    assert (solution.state == ContactState.TIED).sum() == tied
    assert solution.states_proven[0]
    assert solution.minimum_is_unique[0] == (not tied)


@pytest.mark.parametrize("number", some_of(24, 4))
def test_other_methods_call_no_tied_contact_slipping_beside_absent_ones(number):
    """Of a method that cuts nothing: what is proven of its contacts is right, and what ties slips at none of them."""
    rng, shape = np.random.default_rng([number, 51]), [(5, 6), (6, 5), (4, 7)][number % 3]
    values = [rng.integers(1, 4, tuple(n - (a == axis) for a, n in enumerate(shape))) * 0.25 for axis in range(2)]
    for of in values:
        of[rng.random(of.shape) < 0.15] = 0.0
    scene = Scene(tuple(values))
    solution = solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-10))
    states, proven = ([of[0] for of in scene.lattice.by_axis(v)] for v in (solution.state, solution.proven))
    weights = {(a, place): int(4 * v) for a, of in enumerate(values) for place, v in np.ndenumerate(of)}
    for (axis, place), (some, every) in slipping_in_some_and_every(shape, weights).items():
        right = ContactState.SLIPPING if every else ContactState.TIED if some else ContactState.SLIPLESS
        assert states[axis][place] in (right, ContactState.UNDECIDED)
        assert states[axis][place] == right or not proven[axis][place]
