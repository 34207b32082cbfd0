"""The truth about all minima of a sample, against answers worked by hand and by trying all cuts."""

from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from taichi_bearings_studies.stress.truth import DIGITS, SLIPLESS, SLIPPING, least

import taichi_bearings as tb
from tests.cuts import all_cuts
from tests.scenes import minima, name_of, scene_of
from tests.stress.minima import DRIVEN, EITHER, least_of_all


def draw(shape, seed, values=None):
    rng = np.random.default_rng(seed)
    shapes = [tuple(n - (a == axis) for a, n in enumerate(shape)) for axis in range(len(shape))]
    return [rng.uniform(0.1, 1.0, s) if values is None else rng.choice(values, s) for s in shapes]


def solve(coefficient, perturbed=None, **options):
    scene = tb.Scene(tuple(coefficient), **({"normal_force": 1.0, "radius": 1.0} | options))
    return least_of_all(scene, perturbed)


def agrees(truth, expected, digits=50):
    with localcontext() as context:
        context.prec = DIGITS
        width = abs(expected) * Decimal(10) ** -digits
        return max(abs(bound - expected) for bound in (truth.lower, truth.upper)) < width


def decimal(fraction):
    with localcontext() as context:
        context.prec = DIGITS
        return Decimal(fraction.numerator) / Decimal(fraction.denominator)


@pytest.mark.parametrize("shape", [(2, 5), (2, 2, 5)])
def test_columns_slip_at_their_weakest_contacts(shape):
    coefficient = draw(shape, 1)
    coefficient[-1][...] = np.array([0.3, 0.7, 0.2, 0.9])
    direction = {"direction": (1, 2, 0)} if len(shape) == 3 else {}
    truth = solve(coefficient, normal_force=40.0, radius=0.3, spin_top=2.0, spin_bottom=0.5, **direction)
    columns = int(np.prod(shape[:-1]))
    assert agrees(truth, decimal(columns * 40 * Fraction(0.3) * Fraction(3, 2) * Fraction(0.2)))
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
    assert agrees(truth, power)
    assert truth.state[0][0, 0].tolist() == [DRIVEN, SLIPLESS, DRIVEN]
    assert truth.state[2][:, 0].ravel().tolist() == [SLIPPING, SLIPLESS, SLIPPING, SLIPPING]
    assert truth.slip[2][1, 0, 0] == pytest.approx(0.5**0.5 * 1.25, rel=1e-15)
    assert truth.slip[2][1, 0, 1] == pytest.approx(0.5**0.5 * 0.25, rel=1e-15)


@pytest.mark.parametrize("values", [None, (1.0, 2.0), (0.5, 1.0, 1.5), (1.0, 1e12)], ids=str)
@pytest.mark.parametrize("shape", [(3, 3), (3, 4), (2, 6)])
def test_discs_slip_at_the_lightest_cuts(shape, values):
    for seed in range(4):
        coefficient = draw(shape, seed, values)
        truth = solve(coefficient)
        weight, crossed = all_cuts(coefficient)
        assert agrees(truth, decimal(weight))
        for state, (some, every) in zip(truth.state, crossed, strict=True):
            expected = np.where(every, SLIPPING, np.where(some, EITHER, SLIPLESS))
            np.testing.assert_array_equal(state, np.where(state == DRIVEN, DRIVEN, expected))


EQUAL = [np.ones((2, 3, 3)), np.ones((3, 2, 3)), np.ones((3, 3, 2))]


def test_equal_columns_may_slip_above_or_below_their_free_layer():
    truth = solve(EQUAL, normal_force=50.0, radius=0.5)
    assert agrees(truth, Decimal(225))
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
    assert agrees(other, truth.upper, 39)
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
    assert agrees(truth, decimal(4 * (Fraction(0.3) * Fraction(3, 2)) ** 2 / series))
