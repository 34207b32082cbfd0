"""Loops, loose parts and slipless motions: the whole table, by singular values and by elimination."""

import networkx
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.analysis.topology import DENSE_UNKNOWNS, slipless_number, topology_of

EVERY = ("x", "y", "z")
TABLE = [
    ("square", (4, 5), (), 1),
    ("honeycomb", (2, 2), (), 1),
    ("triangular", (3, 3), (), 0),
    ("square", (3, 4), ("x",), 0),
    ("cubic", (4, 5, 1), (), 4 + 5 + 1),
    ("cubic", (3, 4, 5), (), 3 + 4 + 5),
    ("cubic", (4, 4, 6), EVERY, 4 + 4 + 6),
    ("cubic", (3, 4, 4), EVERY, 3),
    ("cubic", (3, 5, 4), EVERY, 0),
    ("bcc", (3, 3, 3), (), 4 + 2),
    ("bcc", (2, 3, 2), EVERY, 3),
    ("diamond", (2, 2, 2), EVERY, 4 * 2 - 1),
    ("diamond", (3, 3, 3), EVERY, 4 * 3 - 1),
    ("fcc", (2, 2, 2), (), 0),
    ("hcp", (3, 3, 3), EVERY, 0),
]


@pytest.mark.parametrize(("kind", "cells", "periodic", "number"), TABLE)
@pytest.mark.parametrize("dense", [10**6, 0])
def test_the_number_of_slipless_motions_is_that_of_the_table(kind, cells, periodic, number, dense, monkeypatch):
    monkeypatch.setattr("taichi_bearings.analysis.topology.DENSE_UNKNOWNS", dense)
    packing = tb.Packing.lattice(kind, cells, periodic)
    assert slipless_number(packing.network, np.ones(packing.spheres, dtype=bool))[0] == number
    assert DENSE_UNKNOWNS > 0


def test_free_diamonds_have_at_least_as_many_as_their_layers():
    packing = tb.Packing.lattice("diamond", (2, 2, 2))
    layers = sum(len(np.unique(np.round(packing.center[:, axis], 6))) for axis in range(3))
    assert topology_of(packing).all_motions >= layers - 1


def test_a_tetrahedron_of_spheres_is_stuck():
    center = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]]) / np.sqrt(2)
    contact = np.stack(np.triu_indices(4, 1), axis=1)
    found = topology_of(tb.Packing(center, contact, np.full(4, -1), np.zeros((4, 3))))
    assert (found.all_motions, found.smallest_odd_loop, found.bipartite) == (0, 3, False)


@pytest.mark.parametrize("length", [5, 7, 9])
def test_the_smallest_odd_loop_is_found(length):
    """In a ring of that many discs beside an even one."""
    angle = 2 * np.pi * np.arange(length) / length
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) / (2 * np.sin(np.pi / length))
    center = np.concatenate([ring, [[50, 0], [51, 0], [51, 1], [50, 1]]])
    pairs = [(i, (i + 1) % length) for i in range(length)]
    pairs += [(length + i, length + (i + 1) % 4) for i in range(4)]
    found = topology_of(tb.Packing(center, pairs, np.full(length + 4, -1), np.zeros(length + 4)))
    assert (found.smallest_odd_loop, found.parts, found.floating, found.all_motions) == (length, 2, 2, 1)


def test_loose_parts_are_counted():
    center = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [5, 0, 0], [5, 0, 1], [9, 9, 9]]
    packing = tb.Packing(center, [(0, 1), (1, 2), (3, 4)], [0, -1, -1, -1, -1, -1], np.zeros((6, 3)))
    found = topology_of(packing)
    assert (found.parts, found.floating, found.rattlers, found.free_dangling) == (3, 1, 1, 3)
    assert found.free_motions == 2 + 4 + 3  # each turns about its axis; a pair slips in 2 of 6 ways; a rattler never


def test_large_networks_are_decided_by_elimination():
    packing = tb.Packing.lattice("cubic", (8, 9, 10))
    assert slipless_number(packing.network, np.ones(packing.spheres, dtype=bool)) == (27, "elimination")
    assert slipless_number(packing.network, packing.driven < 0) == (8, "elimination")


def test_paths_of_a_packing_that_share_no_contact_are_the_largest_flow():
    """Several contacts of a free sphere with one body are several ways; all against networkx."""
    place = [[0, 0], [-0.6, -0.8], [0.6, -0.8], [-0.6, 0.8], [0.6, 0.8]]
    cross = tb.Packing(place, [[0, 1], [0, 2], [0, 3], [0, 4]], [-1, 0, 0, 1, 1], np.zeros(5))
    assert SliplessNetwork(cross.network, np.array([True] * 4)).disjoint_paths == 2
    assert SliplessNetwork(cross.network, np.array([True, True, True, False])).disjoint_paths == 1
    packing = tb.Packing.lattice("bcc", (3, 3, 3), seed=1)
    free = (packing.driven[packing.contact] < 0).any(axis=1)
    for seed in range(4):
        slipless = free & (np.random.default_rng(seed).random(packing.contacts) < 0.6)
        network, graph = SliplessNetwork(packing.network, slipless), networkx.DiGraph()
        for one, other in network.body[network.ends].T:
            for ends in ((one, other), (other, one)):
                graph.add_edge(*ends, capacity=graph.get_edge_data(*ends, {"capacity": 0})["capacity"] + 1)
        assert network.disjoint_paths == networkx.maximum_flow_value(graph, 0, network.bodies - 1) > 1
        assert network.spans
