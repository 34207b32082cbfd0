"""Minimum cuts of lattices against all sides of tiny ones, planar grids, linear programmes and the power of scenes."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.sparse import coo_array, hstack, identity, vstack

from taichi_bearings import minimum_cut as module
from taichi_bearings.minimum_cut import jump_weights, minimum_cut
from tests.kernels.twins import neighbours
from tests.scenes import make_scene


def random_weights(shape, seed, replicas=2, decades=1.0):
    rng = np.random.default_rng(seed)
    return tuple(
        10.0 ** rng.uniform(-decades, 0, (replicas, *(n - (a == axis) for a, n in enumerate(shape))))
        for axis in range(len(shape))
    )


def contacts_of(weight, replica=0):
    """(lower site, upper site, weight) one by one, as the twins of the kernels list them."""
    shape = (*weight[-1].shape[1:-1], weight[-1].shape[-1] + 1)
    return [(low, high, float(weight[axis][replica][low])) for low, high, axis in neighbours(shape)]


def least_of_all_sides(weight, replica):
    """Weight of the lightest of all choices of sides, by counting."""
    *sides, gaps = weight[-1].shape[1:]
    contacts, least = contacts_of(weight, replica), np.inf
    above = np.zeros((*sides, gaps + 1), dtype=bool)
    above[..., -1] = True
    for choice in product([False, True], repeat=int(np.prod(sides)) * (gaps - 1)):
        above[..., 1:-1] = np.reshape(choice, (*sides, gaps - 1))
        least = min(least, sum(w for low, high, w in contacts if above[low] != above[high]))
    return least


def without(weight, axis):
    return tuple(np.zeros_like(values) if a == axis else values for a, values in enumerate(weight))


@pytest.mark.parametrize("decades", [1.0, 5.0])
@pytest.mark.parametrize("idle", [None, 0, 1, 2])
@pytest.mark.parametrize("shape", [(2, 2, 4), (3, 2, 3)], ids=str)
def test_no_choice_of_sides_is_lighter(shape, idle, decades):
    weight = without(random_weights(shape, 17, decades=decades), idle)
    cut = minimum_cut(weight)
    for replica in range(2):
        expected = least_of_all_sides(weight, replica)
        assert cut.weight[replica] == pytest.approx(expected, rel=1e-13, abs=1e-300)
        assert expected * (1 - 1e-13) <= cut.lower_bound[replica] <= expected * (1 + 1e-15)
    assert not cut.above[..., 0].any()
    assert cut.above[..., -1].all()


def test_small_whole_numbers_tie_and_leave_no_gap():
    rng = np.random.default_rng(3)
    weight = tuple(rng.integers(0, 3, values.shape).astype(float) for values in random_weights((2, 2, 4), 0, 8))
    cut = minimum_cut(weight)
    assert (cut.weight == [least_of_all_sides(weight, replica) for replica in range(8)]).all()
    assert (cut.lower_bound == cut.weight).all()


@pytest.mark.parametrize("shape", [(9, 8), (2, 3), (4, 30)], ids=str)
def test_a_flow_and_a_path_of_the_dual_graph_find_the_same_planar_cut(shape):
    weight = random_weights(shape, 5, decades=3.0)
    cut = minimum_cut(weight)
    for replica in range(2):
        above, bound = module._cut_lattice(tuple(values[replica] for values in weight))
        assert (above == cut.above[replica]).all()
        assert bound == pytest.approx(cut.lower_bound[replica], rel=1e-13)


@pytest.mark.parametrize("decades", [1.0, 6.0])
def test_the_weight_is_that_of_a_linear_programme(decades):
    """Potentials between 0 and 1 with the least weighted sum of |differences|: shares no code and no algorithm."""
    shape = (5, 4, 6)
    weight = random_weights(shape, 8, replicas=1, decades=decades)
    contacts = contacts_of(weight)
    rows = np.arange(len(contacts))
    ends = [np.ravel_multi_index(list(zip(*(c[end] for c in contacts), strict=True)), shape) for end in (0, 1)]
    sign, places = np.repeat([-1.0, 1.0], len(rows)), (np.tile(rows, 2), np.concatenate(ends))
    difference = coo_array((sign, places), shape=(len(rows), int(np.prod(shape))))
    above = vstack([hstack([s * difference, -identity(len(rows))]) for s in (1, -1)]).tocsr()
    fixed = {0: (0, 0), shape[-1] - 1: (1, 1)}
    limits = [fixed.get(site[-1], (0, 1)) for site in np.ndindex(*shape)] + [(0, None)] * len(rows)
    cost = np.concatenate([np.zeros(int(np.prod(shape))), [c[2] for c in contacts]])
    found = linprog(cost, A_ub=above, b_ub=np.zeros(above.shape[0]), bounds=limits)
    assert minimum_cut(weight).weight[0] == pytest.approx(found.fun, rel=1e-7)


@pytest.mark.parametrize("bits", [12, 20])
def test_rounds_of_few_bits_end_at_the_same_cut(bits, monkeypatch):
    weight = random_weights((5, 6, 7), 4, decades=2.0)
    whole = minimum_cut(weight)
    monkeypatch.setattr(module, "BITS", bits)
    parts = minimum_cut(weight)
    assert (parts.above == whole.above).all()
    assert (parts.lower_bound == whole.lower_bound).all()


def test_the_bound_leaves_no_more_than_a_unit_a_contact():
    cut = minimum_cut(random_weights((12, 11, 10), 6))
    assert (cut.lower_bound <= cut.weight).all()
    assert (cut.weight - cut.lower_bound <= 1e-13 * cut.weight).all()


def test_weights_of_a_jump():
    scene = make_scene((2, 3, 4))
    for exponent in (1, 2):
        weights = jump_weights(scene.coefficient, scene.axis_vector, exponent)
        for axis, across in enumerate((0.5**0.5, 0.5**0.5, 1.0)):
            assert weights[axis] == pytest.approx(scene.coefficient[axis] * across**exponent, rel=1e-15)
    about_x = jump_weights(scene.coefficient, np.array([1.0, 0.0, 0.0]))
    assert not about_x[0].any()
    assert (about_x[1] == scene.coefficient[1]).all()
    flat = make_scene((3, 4))
    for ours, theirs in zip(jump_weights(flat.coefficient, flat.axis_vector), flat.coefficient, strict=True):
        assert (ours == theirs).all()
