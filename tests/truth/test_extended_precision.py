"""The oracle itself, against answers worked by hand and by trying all cuts."""

import numpy as np
import pytest

pytest.importorskip("flint")

from flint import arb, ctx

from tests.scenes import minima, name_of, scene_of
from tests.truth.cuts import all_cuts
from tests.truth.extended_precision import DRIVEN, EITHER, SLIPLESS, SLIPPING, exact, least_viscous_power, solve


def draw(shape, seed, values=None):
    rng = np.random.default_rng(seed)
    shapes = [tuple(n - (a == axis) for a, n in enumerate(shape)) for axis in range(len(shape))]
    return [rng.uniform(0.1, 1.0, s) if values is None else rng.choice(values, s) for s in shapes]


def agrees(value, expected, digits=80):
    return abs(value - expected) < abs(expected) * arb(10) ** -digits


@pytest.fixture(autouse=True)
def many_bits():
    before, ctx.prec = ctx.prec, 700
    yield
    ctx.prec = before


@pytest.mark.parametrize("shape", [(1, 5), (1, 1, 5)])
def test_a_column_slips_at_its_weakest_contact(shape):
    friction = np.array([0.3, 0.7, 0.2, 0.9])
    coefficient = draw(shape, 1)
    coefficient[-1][...] = friction
    truth = solve(coefficient, 40.0, 0.3, 2.0, 0.5, (1, 2, 0))
    assert agrees(truth.power, exact(40.0) * exact(0.3) * exact(1.5) * exact(0.2))
    assert truth.state[-1].ravel().tolist() == [SLIPLESS, SLIPLESS, SLIPPING, SLIPLESS]
    assert truth.slip[-1].ravel()[2] == pytest.approx(0.45, rel=1e-15)
    assert truth.freedom == 0
    assert truth.gap < 1e-60


def test_a_sphere_held_in_one_direction_slides_in_the_other():
    """A column that turns with the top holds Omega_y of its neighbour, which leans on its bottom, friction 5/4, and on
    its top, friction 3/4. With Omega_y = J_y its Omega_x minimises 5/4 sqrt(x^2 + J_y^2) + 3/4 (J_x - x), so that
    x = J_y 3/4 / sqrt(25/16 - 9/16) and the power is 3/4 J_x + J_y beside the 1 of the first column."""
    columns = np.array([[[1.0, 8.0]], [[1.25, 0.75]]])
    truth = solve([np.full((1, 1, 3), 2.0), np.zeros((2, 0, 3)), columns], 1.0, 1.0, 1.0, 0.0)
    assert agrees(truth.power, 1 + arb(7) / 4 / arb(2).sqrt())
    assert truth.state[0].ravel().tolist() == [DRIVEN, SLIPLESS, DRIVEN]
    assert truth.state[2].ravel().tolist() == [SLIPPING, SLIPLESS, SLIPPING, SLIPPING]
    assert truth.slip[2].ravel()[2] == pytest.approx(0.5**0.5 * 1.25, rel=1e-15)
    assert truth.slip[2].ravel()[3] == pytest.approx(0.5**0.5 * 0.25, rel=1e-15)


@pytest.mark.parametrize("values", [None, (1.0, 2.0), (0.5, 1.0, 1.5), (1.0, 1e12)], ids=str)
@pytest.mark.parametrize("shape", [(3, 3), (3, 4), (2, 6)])
def test_discs_slip_at_the_lightest_cuts(shape, values):
    for seed in range(4):
        coefficient = draw(shape, seed, values)
        truth = solve(coefficient, 1.0, 1.0, 1.0, 0.0)
        least, crossed = all_cuts(coefficient)
        assert agrees(truth.power, arb(least.numerator) / least.denominator)
        for state, (some, every) in zip(truth.state, crossed, strict=True):
            expected = np.where(every, SLIPPING, np.where(some, EITHER, SLIPLESS))
            np.testing.assert_array_equal(state, np.where(state == DRIVEN, DRIVEN, expected))


def test_equal_columns_may_slip_above_or_below_their_free_layer():
    truth = solve([np.ones((2, 3, 3)), np.ones((3, 2, 3)), np.ones((3, 3, 2))], 50.0, 0.5, 1.0, 0.0)
    assert agrees(truth.power, arb(225))
    assert truth.freedom == 1
    assert (truth.state[2] == EITHER).all()
    assert set(np.unique(truth.state[0])) == {SLIPLESS, DRIVEN}


@pytest.mark.parametrize(
    "driving", [{}, {"direction": (1, 1e-8, 0)}, {"spin_bottom": 0.999999999999}, {"direction": (1, 1, 1)}], ids=str
)
@pytest.mark.parametrize("decades", [0, 9])
def test_a_single_minimum_hardly_feels_a_perturbation(driving, decades):
    coefficient = [10.0 ** (decades * (2 * c - 1)) if decades else c for c in draw((2, 3, 4), 5)]
    options = {"normal_force": 50.0, "radius": 0.5, "spin_top": 1.0, "spin_bottom": 0.0} | driving
    truth = solve(coefficient, **options)
    assert truth.freedom == 0
    assert truth.gap < 1e-60
    for seed in range(2):
        other = solve(coefficient, **options, perturbation=(seed, 1e-40))
        assert agrees(other.power, truth.power, 39)
        for a, b in zip(truth.state, other.state, strict=True):
            np.testing.assert_array_equal(a, b)
        for a, b in zip(truth.slip, other.slip, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-30)


def test_a_perturbation_chooses_between_minima():
    coefficient = [np.ones((2, 3, 3)), np.ones((3, 2, 3)), np.ones((3, 3, 2))]
    for seed in range(3):
        other = solve(coefficient, 50.0, 0.5, 1.0, 0.0, perturbation=(seed, 1e-40))
        slipping = (other.state[2] == SLIPPING).sum(axis=(0, 1))
        assert sorted(slipping.tolist()) == [0, 9]


@pytest.mark.parametrize("entry", minima((3, 3, 3)), ids=name_of)
def test_stored_minima_of_another_solver_are_met(entry):
    scene = scene_of(entry)
    coefficient = scene.lattice.by_axis(scene.coefficient[0])
    truth = solve(coefficient, scene.normal_force, scene.lattice.radius, scene.spin_top, scene.spin_bottom)
    assert float(truth.power) == pytest.approx(entry["power_minimum"], rel=1e-14)
    slipping = np.concatenate([slip[state == SLIPPING] for slip, state in zip(truth.slip, truth.state, strict=True)])
    assert len(slipping) == entry["slipping"]
    smallest = entry["smallest_slip_over_spin_top"] * scene.lattice.radius * entry["spin_top"]
    assert slipping.min() == pytest.approx(smallest, rel=1e-9)


@pytest.mark.parametrize("driving", [{"direction": (0, 0, 1)}, {"spin_bottom": 1.0}], ids=str)
def test_nothing_slips_if_nothing_is_imposed(driving):
    truth = solve(draw((2, 3, 4), 3), **({"normal_force": 1, "radius": 1, "spin_top": 1, "spin_bottom": 0} | driving))
    assert truth.power == 0
    assert not any(np.isin(s, (SLIPPING, EITHER)).any() for s in truth.state)


def test_viscous_contacts_of_a_column_are_in_series():
    damping = np.array([0.3, 0.7, 0.2, 0.9])
    series = sum(1 / exact(eta) for eta in damping)
    power = least_viscous_power([np.zeros((0, 1, 5)), np.zeros((1, 0, 5)), damping.reshape(1, 1, 4)], 0.3, 2.0, 0.5)
    assert agrees(power, (exact(0.3) * exact(1.5)) ** 2 / series)
