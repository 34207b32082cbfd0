"""Pieces, spans and paths of slipless networks: by hand, against networkx, and at true minima."""

import itertools

import networkx
import numpy as np
import pytest
from taichi_bearings_studies.paper.network import spans_within_planes

from taichi_bearings.lattice import Lattice
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.analysis.networks import (
    APART,
    CHAIN,
    DUMBBELL,
    EMPTY,
    LADDER,
    RANDOM,
    TWO_CHAINS,
    drawn,
    graph_of_bodies,
    network_of,
    random_network,
)
from tests.scenes import make_scene

ANY = [*RANDOM, APART, EMPTY, DUMBBELL, random_network((4, 5, 6), 0.2, 13)]
STAIRS = drawn((3, 3, 4), [(0, 2, 0), (0, 2, 1), (1, 2, 1), (1, 1, 1), (1, 1, 2), (2, 1, 2), (2, 1, 3)])


def test_links_are_listed_axis_by_axis():
    network = drawn((2, 3, 4), [(1, 1, 1), (1, 1, 2)], [(0, 2, 2), (1, 2, 2), (1, 1, 2)], [(0, 0, 0), (0, 0, 1)])
    assert network.axis.tolist() == [0, 1, 2, 2]
    assert network.contact.tolist() == [[0, 2, 2], [1, 1, 2], [0, 0, 0], [1, 1, 1]]
    assert network.ends.tolist() == [[10, 18, 0, 17], [22, 22, 1, 18]]
    spread = network.lattice.by_axis(network.on_contacts(np.array([1.0, 2.0, 3.0, 4.0])))
    assert [values.shape for values in spread] == [(1, 3, 4), (2, 2, 4), (2, 3, 3)]
    assert (spread[0][0, 2, 2], spread[1][1, 1, 2], spread[2][0, 0, 0], spread[2][1, 1, 1]) == (1, 2, 3, 4)
    assert sum(np.count_nonzero(values) for values in spread) == 4


def test_only_slipless_contacts_are_links():
    lattice = Lattice((2, 3))
    state = lattice.flat([np.array([[3, 1, 3]], dtype=np.uint8), np.array([[0, 2], [0, 0]], dtype=np.uint8)])
    assert ContactState.SLIPLESS == 0
    assert network_of(lattice, state).contact.tolist() == [[0, 0], [1, 0], [1, 1]]


def test_pieces_drawn_by_hand():
    assert (APART.components, APART.spans, APART.spanning.any()) == (2, False, False)
    assert APART.reached_fraction == 4 / 9
    assert APART.spanning_fraction == 0
    assert [APART.touched_of(body).tolist() for body in (0, APART.bodies - 1)] == [[0], [9]]
    expected = np.zeros((3, 5), dtype=bool)  # each driven plane is one body
    expected[:, 0] = expected[[0, 1], 1] = True
    np.testing.assert_array_equal(APART.component == 0, expected)
    assert (TWO_CHAINS.components, TWO_CHAINS.spans) == (1, True)
    assert TWO_CHAINS.spanning_fraction == TWO_CHAINS.reached_fraction == 4 / 6
    assert (EMPTY.components, EMPTY.spans, EMPTY.reached_fraction) == (0, False, 0)


def test_a_piece_apart_from_both_planes_is_reached_but_does_not_span():
    network = drawn((3, 5), [(1, height) for height in range(5)], [(2, 2), (2, 3)])
    assert network.components == 2
    assert network.reached_fraction == 5 / 9
    assert network.spanning_fraction == 3 / 9
    assert network.spanning[2].tolist() == [True, False, False, False, True]


@pytest.mark.parametrize("network", ANY)
def test_pieces_agree_with_networkx(network):
    graph = graph_of_bodies(network)
    pieces = [piece for piece in networkx.connected_components(graph) if len(piece) > 1]
    assert network.components == len(pieces)
    assert network.spans == networkx.has_path(graph, "bottom", "top")
    free = {node for node in graph if isinstance(node, tuple)}
    assert network.reached_fraction == len(set().union(*pieces) & free) / len(free)
    spanning = networkx.node_connected_component(graph, "bottom") if network.spans else set()
    assert network.spanning_fraction == len(spanning & free) / len(free)
    of_free = {node: network.component[node] for node in free}
    for label in set(of_free.values()) - {0, network.component.flat[-1]}:
        together = {node for node in free if of_free[node] == label}
        assert networkx.node_connected_component(graph, min(together)) == together


@pytest.mark.parametrize("network", ANY)
def test_a_shortest_path_is_one(network):
    path, graph = network.shortest_path, graph_of_bodies(network)
    if not network.spans:
        assert path.shape == (0, network.lattice.dimension)
        return
    assert len(path) - 1 == networkx.shortest_path_length(graph, "bottom", "top")
    assert (path[0, -1], path[-1, -1]) == (0, network.lattice.shape[-1] - 1)
    links = {frozenset(pair) for pair in network.ends.T.tolist()}
    spheres = np.ravel_multi_index(path.T, network.lattice.shape).tolist()
    steps = [frozenset(pair) for pair in itertools.pairwise(spheres)]
    assert set(steps) <= links
    assert network.slipless[network.on_path].all()
    on_path = [frozenset(pair) for pair in network.lattice.ends[:, network.on_path].T.tolist()]
    assert sorted(map(sorted, on_path)) == sorted(map(sorted, steps))


def test_planes_that_a_path_crosses():
    path = STAIRS.shortest_path
    np.testing.assert_array_equal(path[[0, 1, -1]], [[0, 2, 0], [0, 2, 1], [2, 1, 3]])
    assert [network.path_planes for network in (STAIRS, CHAIN, EMPTY)] == [[3, 2], [1], [0, 0]]
    assert not spans_within_planes(STAIRS, 0).any()
    assert not spans_within_planes(STAIRS, 1).any()
    flat = drawn((2, 3, 4), [(1, 0, 0), (1, 0, 1), (1, 1, 1), (1, 1, 2), (1, 1, 3)])
    assert spans_within_planes(flat, 0).tolist() == [False, True]
    assert spans_within_planes(flat, 1).tolist() == [False] * 3
    assert spans_within_planes(TWO_CHAINS, 0).tolist() == [True, False, True]


def test_disjoint_paths_by_hand():
    middle = drawn(  # only the link half way up limits
        (2, 5), *([(i, 0), (i, 1)] for i in (0, 1)), [(0, 1), (1, 1), (1, 2), (1, 3), (0, 3), (0, 4)], [(1, 3), (1, 4)]
    )
    assert [network.disjoint_paths for network in (CHAIN, LADDER, middle, APART)] == [1, 2, 1, 0]


def largest_flow(graph):
    """From bottom to top, every link carrying 1 at most: as many paths share no link (Menger)."""
    capacity = networkx.Graph()
    capacity.add_nodes_from(graph)
    for low, high in graph.edges():
        capacity.add_edge(low, high, capacity=graph.number_of_edges(low, high))
    return networkx.maximum_flow_value(capacity, "bottom", "top")


@pytest.mark.parametrize("network", ANY)
def test_disjoint_paths_agree_with_networkx(network):
    assert network.disjoint_paths == (largest_flow(graph_of_bodies(network)) if network.spans else 0)


@pytest.mark.usefixtures("needs_f64")
def test_no_path_within_a_plane_joins_the_driven_planes_at_a_minimum():
    """Links within a plane x = const tie x components, and those of bottom and top differ; the same with y."""
    spanning = 0
    for seed in range(6):
        scene = make_scene((5, 5, 5), seeds=(seed,), spin_bottom=0.1)
        solution = solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-10))
        network = network_of(scene.lattice, solution.state[0])
        assert not spans_within_planes(network, 0).any()
        assert not spans_within_planes(network, 1).any()
        if network.spans:
            spanning += 1
            assert min(network.path_planes) >= 2
    assert spanning > 0
