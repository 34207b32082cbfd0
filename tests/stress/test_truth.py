"""The truths that judge a stress report, against all cuts and answers by hand."""

from fractions import Fraction

import numpy as np
import pytest
from taichi_bearings_studies.stress.truth import SLIPLESS, SLIPPING, layered, least

import taichi_bearings as tb
from tests.agreement.laboratory import laboratory_minimum
from tests.agreement.winding import shortest_ring
from tests.cuts import all_cuts


def draw(shape, seed, decades=0.0, absent=0.0):
    rng, arrays = np.random.default_rng(seed), []
    for axis in range(len(shape)):
        sides = tuple(n - (a == axis) for a, n in enumerate(shape))
        values = 10.0 ** (decades * rng.uniform(-0.5, 0.5, sides)) * rng.uniform(0.1, 1.0, sides)
        arrays.append(np.where(rng.uniform(size=sides) < absent, 0.0, values))
    return tuple(arrays)


def encloses(truth, value, width=1e-20):
    value = Fraction(value)
    return truth.lower <= truth.upper and abs(Fraction(truth.upper) - value) <= value * Fraction(width)


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


@pytest.mark.parametrize("law", ["coulomb", "viscous", "coulomb-viscous"])
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
