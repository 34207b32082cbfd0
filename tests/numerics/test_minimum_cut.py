"""Minimum cuts of lattices against all sides of tiny ones, planar grids and linear programmes; ties; the next cut."""

import sys
from dataclasses import replace
from itertools import product

import networkx as nx
import numpy as np
import pytest
from scipy.ndimage import label

from taichi_bearings.numerics import minimum_cut as module
from taichi_bearings.numerics.minimum_cut import flow_cut, largest_flow, minimum_cut, next_cut, weight_of_cut
from taichi_bearings.scene.interface import cut_weights
from tests.kernels.twins import neighbours
from tests.scenes import make_scene


@pytest.fixture(params=["ortools", "scipy"])
def flows(request, monkeypatch):
    """Either way to find a largest flow."""
    if request.param == "ortools":
        pytest.importorskip("ortools")
    else:
        hide_ortools(monkeypatch)


def hide_ortools(monkeypatch):
    monkeypatch.setitem(sys.modules, "ortools.graph.python.max_flow", None)


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


def all_sides(weight, replica):
    """(sides, weight) of every choice of sides."""
    *sides, gaps = weight[-1].shape[1:]
    contacts = contacts_of(weight, replica)
    for choice in product([False, True], repeat=int(np.prod(sides)) * (gaps - 1)):
        above = np.zeros((*sides, gaps + 1), dtype=bool)
        above[..., -1] = True
        above[..., 1:-1] = np.reshape(choice, (*sides, gaps - 1))
        yield above, sum(w for low, high, w in contacts if above[low] != above[high])


def least_of_all_sides(weight, replica):
    """Weight of the lightest of all choices of sides, by counting."""
    return min(found for _, found in all_sides(weight, replica))


def in_one_piece(side):
    """True if the spheres of this side hang together; the driven plane is in it."""
    return label(side)[1] == 1


def without(weight, axis):
    return tuple(np.zeros_like(values) if a == axis else values for a, values in enumerate(weight))


@pytest.mark.parametrize("decades", [1.0, 5.0])
@pytest.mark.parametrize("idle", [None, 0, 1, 2])
@pytest.mark.parametrize("shape", [(2, 2, 4), (3, 2, 3)], ids=str)
def test_no_choice_of_sides_is_lighter(shape, idle, decades, flows):
    weight = without(random_weights(shape, 17, decades=decades), idle)
    cut = minimum_cut(weight)
    for replica in range(2):
        expected = least_of_all_sides(weight, replica)
        assert cut.weight[replica] == pytest.approx(expected, rel=1e-13, abs=1e-300)
        assert expected * (1 - 1e-13) <= cut.lower_bound[replica] <= expected * (1 + 1e-15)
    assert not cut.above[..., 0].any()
    assert cut.above[..., -1].all()


def test_small_whole_numbers_tie_and_leave_no_gap(flows):
    rng = np.random.default_rng(3)
    weight = tuple(rng.integers(0, 3, values.shape).astype(float) for values in random_weights((2, 2, 4), 0, 8))
    cut = minimum_cut(weight)
    assert (cut.weight == [least_of_all_sides(weight, replica) for replica in range(8)]).all()
    assert (cut.lower_bound == cut.weight).all()


@pytest.mark.parametrize("shape", [(9, 8), (2, 3), (4, 30)], ids=str)
def test_a_flow_and_a_path_of_the_dual_graph_find_the_same_planar_cut(shape, flows):
    weight = random_weights(shape, 5, decades=3.0)
    path, flow = minimum_cut(weight), flow_cut(weight)
    assert (path.above == flow.above).all()
    assert path.unique.all()
    assert flow.unique.all()
    assert flow.lower_bound == pytest.approx(path.lower_bound, rel=1e-13)


def test_flows_balance_within_the_capacities_and_fill_the_cut(flows):
    rng = np.random.default_rng(12)
    ends = np.array([(low, high) for low in range(40) for high in range(low + 1, 40) if rng.random() < 0.2]).T
    capacity = rng.integers(0, 2**50, ends.shape[1])
    at_most = int(capacity[(ends == 0).any(axis=0)].sum())
    flow = largest_flow(ends, capacity, at_most)
    assert (np.abs(flow) <= capacity).all()
    out = np.zeros(40, dtype=np.int64)
    np.add.at(out, ends[0], flow)
    np.add.at(out, ends[1], -flow)
    assert not out[1:-1].any()
    below = module.within_reach(ends, np.stack([capacity - flow, capacity + flow]), 0)
    assert capacity[below[ends[0]] != below[ends[1]]].sum() == out[0] == -out[-1]


def test_one_light_layer_between_heavy_ones(flows):
    """The capacities around a driven plane add up to 2^64 here."""
    heavy = tuple(np.full(values.shape, 1e6) for values in random_weights((46, 46, 4), 0, 1))
    heavy[2][..., 1] = 1.0
    cut = minimum_cut(heavy)
    assert cut.weight == cut.lower_bound == 46 * 46
    assert cut.unique


@pytest.mark.parametrize("idle", [None, 0])
def test_layers_that_weigh_the_same_tie(idle, flows):
    """Equal weights: the cuts are the levels, so all that is free lies between the lowest and the highest one."""
    weight = without(tuple(np.full(values.shape, 0.7) for values in random_weights((3, 4, 5), 0)), idle)
    cut = minimum_cut(weight)
    assert cut.weight == pytest.approx(0.7 * 12, rel=1e-15)
    assert not cut.unique.any()
    assert cut.between[..., 1:-1].all()
    assert not cut.between[..., [0, -1]].any()
    assert next_cut(weight, cut)[1] == pytest.approx(cut.weight, rel=1e-15)


@pytest.mark.parametrize("shape", [(2, 2, 4), (3, 2, 3), (3, 4)], ids=str)
def test_what_lies_between_ties_is_what_their_sides_differ_in(shape):
    """Small whole numbers tie often; none is 0, so that no contact is in a cut for nothing."""
    rng, ties = np.random.default_rng(6), 0
    weight = tuple(rng.integers(1, 3, values.shape).astype(float) for values in random_weights(shape, 0, 12))
    cut = minimum_cut(weight)
    for replica in range(12):
        lightest = [above for above, found in all_sides(weight, replica) if found == cut.weight[replica]]
        differ = np.any(lightest, axis=0) & ~np.all(lightest, axis=0)
        assert (cut.between[replica] == differ).all()
        assert cut.unique[replica] == (len(lightest) == 1)
        ties += len(lightest) > 1
    assert 0 < ties < 12


@pytest.mark.parametrize(("shape", "idle"), [((3, 4), None), *product([(2, 2, 4), (3, 2, 3)], [None, 0, 1])], ids=str)
def test_the_next_cut_is_the_second_of_all_choices_in_one_piece(shape, idle):
    weight = without(random_weights(shape, 9), idle)
    above, following = next_cut(weight, minimum_cut(weight))
    assert (weight_of_cut(above, weight) == following).all()
    for replica in range(2):
        if idle is None:  # else planes are apart, and a side is a piece in each
            sides = [w for a, w in all_sides(weight, replica) if in_one_piece(a) and in_one_piece(~a)]
        else:
            sides = [w for a, w in all_sides(weight, replica) if _stacked_in_one_piece(a, idle)]
        assert following[replica] == pytest.approx(sorted(sides)[1], rel=1e-13)


def _stacked_in_one_piece(above, idle):
    planes = np.moveaxis(above, idle, 0)
    return all(in_one_piece(plane) and in_one_piece(~plane) for plane in planes)


def test_weights_of_a_jump():
    scene = make_scene((2, 3, 4))
    for law, exponent in (("coulomb", 1), ("viscous", 2)):
        across = np.array([0.5**0.5, 0.5**0.5, 1.0])[scene.lattice.axis]
        weights = cut_weights(replace(scene, law=law))
        assert weights == pytest.approx(scene.coefficient * across**exponent, rel=1e-15)
    about_x, along_x = cut_weights(replace(scene, direction=(1.0, 0.0, 0.0))), scene.lattice.axis == 0
    assert not about_x[:, along_x].any()
    assert (about_x[:, ~along_x] == scene.coefficient[:, ~along_x]).all()
    flat = make_scene((3, 4))
    assert (cut_weights(flat) == flat.coefficient).all()


@pytest.mark.parametrize("shape", [(4, 5), (3, 3, 4)], ids=str)
def test_with_absent_contacts_the_cut_is_that_of_networkx(shape, flows):
    """Weights are powers of two over forty binary decades, which Python's whole numbers hold exactly."""
    rng, replicas = np.random.default_rng(77), 60
    absent = rng.uniform(0.05, 0.9, replicas).reshape(-1, *(1,) * len(shape))
    weight = tuple(
        np.where(rng.random(values.shape) < absent, 0.0, 2.0 ** rng.integers(-40, 1, values.shape))
        for values in random_weights(shape, 1, replicas)
    )
    weight[-1][::4, ..., 1] = 0.0  # an empty level
    cut = minimum_cut(weight)
    for replica in range(replicas):
        graph = nx.Graph()
        for low, high, size in contacts_of(weight, replica):
            ends = ["bottom" if s[-1] == 0 else "top" if s[-1] == shape[-1] - 1 else s for s in (low, high)]
            if ends[0] != ends[1]:
                graph.add_edge(*ends, capacity=int(size * 2**40))
        least = nx.maximum_flow_value(graph, "bottom", "top") / 2**40
        assert cut.weight[replica] == pytest.approx(least, rel=1e-13, abs=0.0)
        assert least * (1 - 1e-13) <= cut.lower_bound[replica] <= least
        assert least > 0 or not cut.lower_bound[replica]
    assert 10 < np.count_nonzero(cut.weight) < replicas - 10
