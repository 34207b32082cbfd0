"""The truths that judge a stress report, and what all minima have in common, against all cuts and answers by hand."""

from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from taichi_bearings_studies.stress.truth import DIGITS, SLIPLESS, SLIPPING, layered, least

import taichi_bearings as tb
from tests.agreement.laboratory import laboratory_minimum
from tests.agreement.test_periodic_sides import shortest_ring
from tests.cuts import all_cuts
from tests.scenes import KNOWN_LAWS, minima, name_of, scene_of
from tests.stress.minima import DRIVEN, EITHER, least_of_all


def draw(shape, seed, decades=0.0, absent=0.0, values=None):
    rng, arrays = np.random.default_rng(seed), []
    for axis in range(len(shape)):
        sides = tuple(n - (a == axis) for a, n in enumerate(shape))
        drawn = 10.0 ** (decades * rng.uniform(-0.5, 0.5, sides)) * rng.uniform(0.1, 1.0, sides)
        drawn = drawn if values is None else rng.choice(values, sides)
        arrays.append(np.where(rng.uniform(size=sides) < absent, 0.0, drawn))
    return tuple(arrays)


def encloses(truth, value, width=1e-20):
    value = Fraction(value)
    near = (abs(Fraction(bound) - value) <= value * Fraction(width) for bound in (truth.lower, truth.upper))
    return truth.lower <= truth.upper and all(near)


@pytest.mark.parametrize(("decades", "absent"), [(0, 0), (18, 0), (0, 0.25), (12, 0.25)])
def test_the_least_power_of_discs_is_that_of_the_lightest_cut(decades, absent):
    for seed in range(3):
        scene = tb.Scene(draw((3, 4), seed, decades, absent), normal_force=2.0, radius=0.25, spin_top=3.0)
        weight, crossed = all_cuts(scene.coefficients)
        truth = least(scene)
        assert encloses(truth, weight * Fraction(3, 2)) if weight else truth.lower == 0 and truth.upper < 1e-30
        if not absent:  # where spheres are cut off, cuts tie
            state, some = scene.lattice.flat(truth.state), scene.lattice.flat([some for some, _ in crossed])
            known = ~scene.idle[0]
            np.testing.assert_array_equal(state[known], np.where(some, SLIPPING, SLIPLESS)[known])


@pytest.mark.parametrize("law", KNOWN_LAWS)
@pytest.mark.parametrize("shape", [(3, 5), (2, 3, 5)], ids=str)
def test_columns_that_are_alike_do_what_one_does(shape, law):
    def alike(seed, scale):
        *sideways, upward = draw(shape, seed)
        return (*sideways, np.broadcast_to(scale * upward[(0,) * len(sideways)], upward.shape).copy())

    viscosity = alike(2, 100.0) if law == "coulomb-viscous" else ()
    scene = tb.Scene(alike(1, 1.0), law, viscosity=viscosity, spin_bottom=0.25, normal_force=3.0)
    assert encloses(least(scene), Fraction(layered(scene).upper))


def test_a_sphere_between_two_lubricated_contacts_by_hand():
    """Friction 1 and 3, viscosity 2 and 1: forces 1 + 2 u = 3 + v with u + v = R jump = 4, so u = 2, v = 2."""
    contacts = (np.zeros((1, 3)), np.array([[1.0, 3.0], [1.0, 3.0]]))
    slopes = (np.zeros((1, 3)), np.array([[2.0, 1.0], [2.0, 1.0]]))
    scene = tb.Scene(contacts, "coulomb-viscous", viscosity=slopes, normal_force=1.0, radius=2.0, spin_top=2.0)
    potential = 2 * (1 * 2 + 2 * 4 / 2 + 3 * 2 + 1 * 4 / 2)
    assert encloses(least(scene), potential)
    assert layered(scene).upper == potential


@pytest.mark.parametrize("seed", range(3))
def test_on_periodic_sides_it_is_that_of_the_shortest_ring_and_of_clarabel(seed):
    for shape in ((4, 6), (2, 5)):
        scene = tb.Scene.random(shape, seed=seed, periodic="x", normal_force=2.0)  # times 2 R omega_T = 1
        assert encloses(least(scene), shortest_ring(*scene.coefficients), 1e-14)
    for shape in ((4, 2, 4), (2, 2, 4)):
        scene = tb.Scene.random(shape, seed=seed, periodic="x,y", top=(1.0, 0.3, 0.0, 0.25 * seed))
        assert float(least(scene).upper) == pytest.approx(laboratory_minimum(scene).objective, rel=1e-8)


def test_nothing_is_lost_where_top_and_bottom_turn_alike():
    scene = tb.Scene(draw((3, 4), 1), spin_bottom=1.0)
    assert (least(scene).lower, least(scene).upper) == (0, 0)
    assert least(scene).unit > 0


EXACTLY = 1e-50  # relative, of what has no other error than that of 140 digits


def solve(coefficient, perturbed=None, **options):
    scene = tb.Scene(tuple(coefficient), **({"normal_force": 1.0, "radius": 1.0} | options))
    return least_of_all(scene, perturbed)


@pytest.mark.parametrize("shape", [(2, 5), (2, 2, 5)])
def test_columns_slip_at_their_weakest_contacts(shape):
    coefficient = draw(shape, 1)
    coefficient[-1][...] = np.array([0.3, 0.7, 0.2, 0.9])
    direction = {"direction": (1, 2, 0)} if len(shape) == 3 else {}
    truth = solve(coefficient, normal_force=40.0, radius=0.3, spin_top=2.0, spin_bottom=0.5, **direction)
    columns = int(np.prod(shape[:-1]))
    assert encloses(truth, columns * 40 * Fraction(0.3) * Fraction(3, 2) * Fraction(0.2), EXACTLY)
    assert (truth.state[-1] == [SLIPLESS, SLIPLESS, SLIPPING, SLIPLESS]).all()
    assert truth.slip[-1][..., 2] == pytest.approx(0.45, rel=1e-15)
    assert truth.freedom == 0


def test_a_sphere_held_in_one_direction_slides_in_the_other():
    """A column that turns with the top holds Omega_y of its neighbour, which leans on its bottom, friction 5/4, and on
    its top, friction 3/4. With Omega_y = J_y its Omega_x minimises 5/4 sqrt(x^2 + J_y^2) + 3/4 (J_x - x), so that
    x = J_y 3/4 / sqrt(25/16 - 9/16) and the power is 3/4 J_x + J_y beside the 1 of the first column."""
    sideways, columns = np.zeros((1, 2, 3)), np.zeros((2, 2, 2))  # what is behind the two is cut off
    sideways[:, 0], columns[:, 0] = 2.0, [[1.0, 8.0], [1.25, 0.75]]
    truth = solve([sideways, np.zeros((2, 1, 3)), columns])
    with localcontext() as context:
        context.prec = DIGITS
        power = 1 + Decimal(7) / 4 / Decimal(2).sqrt()
    assert encloses(truth, power, EXACTLY)
    assert truth.state[0][0, 0].tolist() == [DRIVEN, SLIPLESS, DRIVEN]
    assert truth.state[2][:, 0].ravel().tolist() == [SLIPPING, SLIPLESS, SLIPPING, SLIPPING]
    assert truth.slip[2][1, 0, 0] == pytest.approx(0.5**0.5 * 1.25, rel=1e-15)
    assert truth.slip[2][1, 0, 1] == pytest.approx(0.5**0.5 * 0.25, rel=1e-15)


@pytest.mark.parametrize("values", [None, (1.0, 2.0), (0.5, 1.0, 1.5), (1.0, 1e12)], ids=str)
@pytest.mark.parametrize("shape", [(3, 3), (3, 4), (2, 6)])
def test_discs_slip_at_the_lightest_cuts(shape, values):
    for seed in range(4):
        coefficient = draw(shape, seed, values=values)
        truth = solve(coefficient)
        weight, crossed = all_cuts(coefficient)
        assert encloses(truth, weight, EXACTLY)
        for state, (some, every) in zip(truth.state, crossed, strict=True):
            expected = np.where(every, SLIPPING, np.where(some, EITHER, SLIPLESS))
            np.testing.assert_array_equal(state, np.where(state == DRIVEN, DRIVEN, expected))


EQUAL = [np.ones((2, 3, 3)), np.ones((3, 2, 3)), np.ones((3, 3, 2))]


def test_equal_columns_may_slip_above_or_below_their_free_layer():
    truth = solve(EQUAL, normal_force=50.0, radius=0.5)
    assert encloses(truth, 225, EXACTLY)
    assert truth.freedom == 1
    assert (truth.state[2] == EITHER).all()
    assert set(np.unique(truth.state[0])) == {SLIPLESS, DRIVEN}


def test_a_perturbation_chooses_between_minima():
    for seed in range(3):
        other = solve(EQUAL, (seed, Decimal("1e-40")))
        slipping = (other.state[2] == SLIPPING).sum(axis=(0, 1))
        assert sorted(slipping.tolist()) == [0, 9]


@pytest.mark.parametrize(
    "driving", [{"direction": (1, 1e-8, 0)}, {"spin_bottom": 0.999999999999}, {"direction": (1, 1, 1)}], ids=str
)
@pytest.mark.parametrize("decades", [0, 9])
def test_a_single_minimum_hardly_feels_a_perturbation(driving, decades):
    coefficient = [10.0 ** (decades * (2 * c - 1)) if decades else c for c in draw((2, 3, 4), 5)]
    truth = solve(coefficient, **driving)
    assert truth.freedom == 0
    other = solve(coefficient, (0, Decimal("1e-40")), **driving)
    assert encloses(other, truth.upper, 1e-39)
    for a, b in zip(truth.state, other.state, strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(truth.slip, other.slip, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-30)


@pytest.mark.parametrize("entry", minima((3, 3, 3)), ids=name_of)
def test_stored_minima_of_another_solver_are_met(entry):
    scene = scene_of(entry)
    truth = least_of_all(scene)
    assert float(truth.upper) == pytest.approx(entry["power_minimum"], rel=1e-14)
    slipping = np.concatenate([slip[state == SLIPPING] for slip, state in zip(truth.slip, truth.state, strict=True)])
    assert len(slipping) == entry["slipping"]
    smallest = entry["smallest_slip_over_spin_top"] * scene.lattice.radius * entry["spin_top"]
    assert slipping.min() == pytest.approx(smallest, rel=1e-9)


@pytest.mark.parametrize("driving", [{"direction": (0, 0, 1)}, {"spin_bottom": 1.0}], ids=str)
def test_nothing_slips_if_nothing_is_imposed(driving):
    assert solve(draw((2, 3, 4), 3), **driving).upper == 0


def test_viscous_contacts_of_a_column_are_in_series():
    damping = np.array([0.3, 0.7, 0.2, 0.9])
    columns = (np.ones((1, 2, 5)), np.ones((2, 1, 5)), np.broadcast_to(damping, (2, 2, 4)).copy())
    truth = least(tb.Scene(columns, "viscous", radius=0.3, spin_top=2.0, spin_bottom=0.5))
    series = sum(1 / Fraction(eta) for eta in damping)
    assert encloses(truth, 4 * (Fraction(0.3) * Fraction(3, 2)) ** 2 / series, EXACTLY)
