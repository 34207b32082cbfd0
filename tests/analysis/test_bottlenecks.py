"""Loads of links and spheres: by hand, and against networkx and dense linear algebra on random networks."""

import networkx
import numpy as np
import pytest

from taichi_bearings.analysis import betweenness as betweenness_module
from taichi_bearings.analysis.betweenness import betweenness
from taichi_bearings.analysis.bottlenecks import Bottlenecks, concentration, current_flow
from taichi_bearings.errors import InputError
from tests.analysis.networks import (
    APART,
    CHAIN,
    DUMBBELL,
    EMPTY,
    HEXAGONS,
    LADDER,
    RANDOM,
    SQUARE,
    TWO_CHAINS,
    drawn,
    graph_of_bodies,
    graph_of_spheres,
    numbered,
    random_network,
)


def all_links(network):
    return np.ones(len(network.axis), dtype=bool)


def positions(network, spheres):
    return {tuple(place.tolist()) for place in np.argwhere(spheres.reshape(network.lattice.shape))}


def test_every_link_of_a_single_chain_carries_everything():
    found = Bottlenecks(CHAIN)
    assert found.betweenness.pairs == 1
    assert found.betweenness.mean_distance == 4
    assert found.flow.resistance == pytest.approx(4)
    np.testing.assert_allclose(found.share, 1)
    np.testing.assert_allclose(found.flow.current, 1)
    assert found.parting.links.all()
    assert positions(CHAIN, found.parting.spheres) == {(1, 1), (1, 2), (1, 3)}


def test_two_chains_share_pairs_and_current():
    found = Bottlenecks(TWO_CHAINS)
    assert found.betweenness.pairs == 2
    np.testing.assert_allclose(found.betweenness.link, 1)
    np.testing.assert_allclose(found.flow.current, 0.5)
    assert found.flow.resistance == pytest.approx(1.5)
    assert not found.weak.links.any()
    assert TWO_CHAINS.disjoint_paths == 2


def test_tied_paths_of_a_ladder_count_half():
    found = Bottlenecks(LADDER)
    assert found.betweenness.pairs == 4
    assert found.betweenness.mean_distance == pytest.approx(3.5)
    load, current = numbered(LADDER, found.betweenness.link), numbered(LADDER, found.flow.current)
    for (low, high), value in load.items():
        is_rung = low[1] == high[1]
        assert value == pytest.approx(1 if is_rung else 2)
        assert current[low, high] == pytest.approx(0 if is_rung else 0.5, abs=1e-12)


@pytest.mark.parametrize(("network", "ways"), [(SQUARE, 2), (HEXAGONS, 3)], ids=["square", "hexagons"])
def test_equal_paths_share_equally(network, ways):
    found = Bottlenecks(network)
    split = ~found.parting.links
    np.testing.assert_allclose(found.share, np.where(split, 1 / ways, 1))
    np.testing.assert_allclose(found.flow.current, np.where(split, 1 / ways, 1))
    assert positions(network, found.parting.spheres) == positions(network, found.weak.spheres)


def test_shortest_paths_and_current_through_a_cube():
    corners = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (1, 2)]
    edges = [[a, b] for a in corners for b in corners if sum(b) - sum(a) == 1 and np.abs(np.subtract(a, b)).sum() == 1]
    network = drawn((2, 2, 4), *edges, [(0, 0, 0), (0, 0, 1)], [(1, 1, 2), (1, 1, 3)])
    found = Bottlenecks(network)
    assert found.flow.resistance == pytest.approx(2 + 5 / 6)
    for (low, high), share in numbered(network, found.share).items():
        middle = sum(low) == 2 and low[2] + high[2] not in (1, 5)
        assert share == pytest.approx(1 if {low[2], high[2]} & {0, 3} else 1 / 6 if middle else 1 / 3)


def test_a_dumbbell_is_held_together_by_its_bridge():
    found = Bottlenecks(DUMBBELL)
    bridge, dangling = ((1, 2), (1, 3)), ((0, 2), (0, 3))
    parting = {((0, 0), (0, 1)), bridge, ((2, 4), (2, 5))}
    assert {link for link, yes in numbered(DUMBBELL, found.weak.links).items() if yes} == parting | {dangling}
    assert {link for link, yes in numbered(DUMBBELL, found.parting.links).items() if yes} == parting
    assert {link for link, yes in numbered(DUMBBELL, found.backbone).items() if not yes} == {dangling}
    ends = {(0, 1), (1, 2), (1, 3), (2, 4)}
    assert positions(DUMBBELL, found.parting.spheres) == ends
    assert positions(DUMBBELL, found.weak.spheres) == ends | {(0, 2)}
    first = found.most_loaded(4)
    assert [link["parts_the_planes"] for link in first] == [True, True, True, False]
    assert [link["share"] for link in first] == pytest.approx([1, 1, 1, 0.5])
    assert {(*link["contact"], link["axis"]) for link in first[:3]} == {(0, 0, 1), (1, 2, 1), (2, 4, 1)}


@pytest.mark.parametrize("network", [APART, EMPTY], ids=["apart", "empty"])
def test_nothing_is_loaded_where_nothing_spans(network):
    found = Bottlenecks(network)
    for values in (found.share, found.flow.current, found.betweenness.sphere):
        assert not values.any()
    for chosen in (found.backbone, *found.weak, *found.parting):
        assert not chosen.any()
    assert found.betweenness.pairs == found.betweenness.sources == found.betweenness.mean_distance == 0
    assert np.isinf(found.flow.resistance)
    assert found.concentration == concentration(np.zeros(3))
    assert found.most_loaded(5) == []


@pytest.mark.parametrize("network", RANDOM)
def test_betweenness_agrees_with_networkx(network):
    graph, bottom, top = graph_of_spheres(network), *(network.touched_of(n).tolist() for n in (0, network.bodies - 1))
    found = betweenness(network)
    assert found.pairs == sum(networkx.has_path(graph, s, t) for s in bottom for t in top) > 0
    halved = networkx.Graph()  # a node amid each link: networkx splits loads of edges evenly, whatever the path counts
    for link, (low, high) in enumerate(network.ends.T.tolist()):
        halved.add_edges_from([(low, ("link", link)), (("link", link), high)])
    load = networkx.betweenness_centrality_subset(halved, bottom, top)  # counts each pair half on undirected graphs
    expected = [2 * load["link", link] for link in range(len(network.axis))]
    np.testing.assert_allclose(found.link, expected, atol=1e-9)
    free = np.flatnonzero(network.touched.ravel() & ~network.lattice.is_driven.ravel())
    np.testing.assert_allclose(found.sphere[free], [2 * load[sphere] for sphere in free], atol=1e-9)
    assert found.sphere[network.touched_of(0)].sum() == pytest.approx(found.pairs)
    assert found.link.sum() == pytest.approx(found.pairs * found.mean_distance)


@pytest.mark.parametrize("network", RANDOM)
def test_only_the_backbone_is_loaded(network):
    backbone = Bottlenecks(network).backbone
    everything, restricted = betweenness(network), betweenness(network, backbone)
    assert 0 < backbone.sum() < len(backbone)
    np.testing.assert_allclose(everything.link, restricted.link, atol=1e-12)
    currents = current_flow(network, network.spanning.ravel()[network.ends[0]]).current
    np.testing.assert_allclose(currents, current_flow(network, backbone).current, atol=1e-12)


@pytest.mark.parametrize("network", RANDOM)
def test_bridges_and_articulation_points_agree_with_networkx(network):
    graph = graph_of_bodies(network)
    piece = graph.subgraph(networkx.node_connected_component(graph, "bottom"))
    found = Bottlenecks(network)
    bridges = {piece.edges[(*pair, 0)]["link"] for pair in networkx.bridges(piece)}
    assert set(np.flatnonzero(found.weak.links)) == bridges
    cut_points = set(networkx.articulation_points(piece)) - {"bottom", "top"}
    assert positions(network, found.weak.spheres) == cut_points

    def parted_without(remove, what):
        rest = networkx.MultiGraph(piece)
        getattr(rest, remove)(*what)
        return not networkx.has_path(rest, "bottom", "top")

    parting = {piece.edges[pair]["link"] for pair in piece.edges if parted_without("remove_edge", pair)}
    assert set(np.flatnonzero(found.parting.links)) == parting
    spheres = {node for node in cut_points if parted_without("remove_node", [node])}
    assert positions(network, found.parting.spheres) == spheres


@pytest.mark.parametrize("network", [*RANDOM, random_network((4, 5, 6), 0.95, 16)])
def test_current_agrees_with_a_dense_solution(network):
    graph = graph_of_bodies(network)
    nodes = sorted(networkx.node_connected_component(graph, "bottom"), key=str)
    source = np.array([{"bottom": 1.0, "top": -1.0}.get(node, 0.0) for node in nodes])
    laplacian = networkx.laplacian_matrix(graph, nodes).toarray()
    voltage = dict(zip(nodes, np.linalg.pinv(laplacian, rcond=1e-12) @ source, strict=True))
    expected = np.zeros(len(network.axis))
    for one, other, link in graph.edges(nodes, data="link"):
        expected[link] = abs(voltage[one] - voltage[other])
    found = Bottlenecks(network).flow
    np.testing.assert_allclose(found.current, expected, atol=1e-10)
    assert found.resistance == pytest.approx(voltage["bottom"] - voltage["top"])


def test_current_through_a_lattice_without_slip_goes_straight_up():
    network = random_network((5, 4, 7), 1.0, 0)
    found = current_flow(network, all_links(network))
    assert found.resistance == pytest.approx(6 / 20)
    np.testing.assert_allclose(found.current, np.where(network.axis == 2, 1 / 20, 0), atol=1e-11)


def test_more_paths_than_a_float_can_count():
    squares, path, detours, x, height = 1100, [(0, 0)], [], 0, 1
    for _ in range(squares):
        path += [(x, height), (1 - x, height), (1 - x, height + 1)]
        detours.append([(x, height), (x, height + 1), (1 - x, height + 1)])
        x, height = 1 - x, height + 2
    network = drawn((2, height + 1), [*path, (x, height)], *detours)
    found = betweenness(network)
    assert found.mean_distance == pytest.approx(3 * squares + 1)
    assert set(np.unique(found.link.round(12))) == {0.5, 1.0}
    assert (found.link > 0.9).sum() == squares + 1


def test_batches_change_nothing(monkeypatch):
    network = RANDOM[3]
    whole = betweenness(network)
    monkeypatch.setattr(betweenness_module, "BATCH_WORK", 1)
    np.testing.assert_allclose(betweenness(network).link, whole.link, rtol=1e-12, atol=1e-12)


def test_a_sample_of_sources_is_unbiased_and_knows_its_error():
    network = random_network((6, 6, 7), 0.45, 21)
    exact = betweenness(network)
    samples = [betweenness(network, sources=9, seed=seed) for seed in range(300)]
    assert samples[0].sources == 9 < samples[0].all_sources == exact.sources
    for name in ("link", "sphere"):
        truth = getattr(exact, name)
        estimate = np.array([getattr(sample, name) for sample in samples])
        scatter = estimate.std(axis=0)
        off = np.abs(estimate.mean(axis=0) - truth) / np.maximum(scatter / np.sqrt(len(samples)), 1e-9)
        assert off.max() < 5
    claimed = np.mean([sample.link_error**2 for sample in samples], axis=0).sum()
    assert claimed == pytest.approx(np.var([sample.link for sample in samples], axis=0).sum(), rel=0.1)
    distance = np.array([sample.mean_distance for sample in samples])
    assert distance.mean() == pytest.approx(exact.mean_distance, abs=5 * distance.std() / np.sqrt(300))
    repeated = betweenness(network, sources=9, seed=3)
    np.testing.assert_array_equal(repeated.link, samples[3].link)


def test_too_much_work_is_sampled(monkeypatch):
    network = RANDOM[3]
    monkeypatch.setattr(betweenness_module, "EXACT_WORK", 3 * len(network.axis))
    found = betweenness(network)
    assert found.sources == 3 < found.all_sources
    assert found.link_error.any()
    with pytest.raises(InputError, match="sources is 1"):
        betweenness(network, sources=1)


def test_measures_of_concentration():
    found = concentration(np.array([0.0, 0.5, 0.25, 0.25, 1.0]))
    effective = pytest.approx(4 / (0.25 + 0.125 + 1))
    assert found == {"largest": 1.0, "loaded": 4, "effective": effective, "half": 1, "nearly_all": 1}
    even = concentration(np.full(8, 0.125))
    assert (even["effective"], even["half"]) == (pytest.approx(8), 4)
