"""Loads of links and spheres: by hand, and against networkx on random networks."""

from dataclasses import replace

import networkx
import numpy as np
import pytest

from taichi_bearings.analysis import bottlenecks
from taichi_bearings.analysis.bottlenecks import Bottlenecks, betweenness
from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.scene.packing import Packing
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
from tests.scenes import some_of


def test_every_link_of_a_single_chain_carries_everything():
    found = Bottlenecks(CHAIN)
    assert found.betweenness.pairs == 1
    assert found.betweenness.mean_distance == 4
    np.testing.assert_allclose(found.share, 1)
    assert found.effective_links == pytest.approx(4)
    assert found.parting.all()


def test_two_chains_share_pairs():
    found = Bottlenecks(TWO_CHAINS)
    assert found.betweenness.pairs == 2
    np.testing.assert_allclose(found.betweenness.link, 1)
    assert not found.parting.any()
    assert TWO_CHAINS.disjoint_paths == 2


def test_tied_paths_of_a_ladder_count_half():
    found = Bottlenecks(LADDER)
    assert found.betweenness.pairs == 4
    assert found.betweenness.mean_distance == pytest.approx(3.5)
    for (low, high), value in numbered(LADDER, found.betweenness.link).items():
        assert value == pytest.approx(1 if low[1] == high[1] else 2)


@pytest.mark.parametrize(("network", "ways"), [(SQUARE, 2), (HEXAGONS, 3)], ids=["square", "hexagons"])
def test_equal_paths_share_equally(network, ways):
    found = Bottlenecks(network)
    np.testing.assert_allclose(found.share, np.where(found.parting, 1, 1 / ways))


def test_shortest_paths_through_a_cube():
    corners = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (1, 2)]
    edges = [[a, b] for a in corners for b in corners if sum(b) - sum(a) == 1 and np.abs(np.subtract(a, b)).sum() == 1]
    network = drawn((2, 2, 4), *edges, [(0, 0, 0), (0, 0, 1)], [(1, 1, 2), (1, 1, 3)])
    found = Bottlenecks(network)
    for (low, high), share in numbered(network, found.share).items():
        middle = sum(low) == 2 and low[2] + high[2] not in (1, 5)
        assert share == pytest.approx(1 if {low[2], high[2]} & {0, 3} else 1 / 6 if middle else 1 / 3)


def test_a_dumbbell_is_held_together_by_its_bridge():
    found = Bottlenecks(DUMBBELL)
    bridge, dangling = ((1, 2), (1, 3)), ((0, 2), (0, 3))
    parting = {((0, 0), (0, 1)), bridge, ((2, 4), (2, 5))}
    assert {link for link, yes in numbered(DUMBBELL, found.parting).items() if yes} == parting
    assert {link for link, yes in numbered(DUMBBELL, found.backbone).items() if not yes} == {dangling}
    first = found.most_loaded(4)
    assert [link["parts_the_planes"] for link in first] == [True, True, True, False]
    assert [link["share"] for link in first] == pytest.approx([1, 1, 1, 0.5])
    assert {(*link["contact"], link["axis"]) for link in first[:3]} == {(0, 0, 1), (1, 2, 1), (2, 4, 1)}


@pytest.mark.parametrize("network", [APART, EMPTY], ids=["apart", "empty"])
def test_nothing_is_loaded_where_nothing_spans(network):
    found = Bottlenecks(network)
    for values in (found.share, found.betweenness.sphere, found.backbone, found.parting):
        assert not values.any()
    assert found.betweenness.pairs == found.betweenness.mean_distance == found.effective_links == 0
    assert found.betweenness.is_exact
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


def random_packing(number):
    """Small networks of many kinds, with driven spheres that have several links: planes of bcc, fcc and diamond, a
    shaft, scattered bodies; each contact that has a free end is a link by chance."""
    kind, cells = [("bcc", (2, 2, 3)), ("fcc", (2, 2, 2)), ("cubic", (2, 3, 4)), ("diamond", (1, 2, 2)),
                   ("triangular", (4, 5)), ("honeycomb", (3, 4))][number % 6]  # fmt: skip
    rng, sides = np.random.default_rng([number, 5]), ((), ("x",))[number // 6 % 2] if kind in ("bcc", "cubic") else ()
    packing = Packing.lattice(kind, cells, periodic=sides, seed=number)
    if number % 4 == 3:  # up to four bodies anywhere
        driven = rng.choice([-1, -1, -1, 0, 1, 2, 3], packing.spheres)
        driven[:2] = 0, 1
        packing = replace(packing, driven=driven)
    held = packing.driven[packing.contact] >= 0
    slipless = (rng.random(packing.contacts) < rng.uniform(0.3, 0.9)) & ~held.all(axis=1)
    return SliplessNetwork(packing.network, slipless)


def by_networkx(network):
    """(link, sphere, pairs, mean distance) by networkx, body after body. A node amid each link tells links between the
    same two spheres apart; arcs leave the spheres of one body, enter those of the later ones, and join free spheres."""
    driven, loads = network.whole.body, np.zeros(network.ends.shape[1])
    spheres, pairs, far = np.zeros(len(driven)), 0, 0
    bodies = np.unique(driven[driven >= 0])
    for body in bodies[:-1]:
        graph = networkx.DiGraph()
        graph.add_nodes_from(range(len(driven)))
        for link, ends in enumerate(network.ends.T.tolist()):
            for tail, head in (ends, ends[::-1]):
                if driven[tail] in (-1, body) and (driven[head] == -1 or driven[head] > body):
                    graph.add_edges_from([(tail, (link, tail)), ((link, tail), head)])
        sources, targets = np.flatnonzero(driven == body).tolist(), np.flatnonzero(driven > body).tolist()
        load = networkx.betweenness_centrality_subset(graph, sources, targets)
        loads += [sum(load.get((link, end), 0) for end in ends) for link, ends in enumerate(network.ends.T.tolist())]
        spheres += [load[sphere] for sphere in range(len(driven))]
        for source in sources:
            distance = networkx.single_source_shortest_path_length(graph, source)
            reached = [distance[target] for target in targets if target in distance]
            pairs, far = pairs + len(reached), far + sum(reached) // 2
    return loads, spheres, pairs, far / max(1, pairs)


@pytest.mark.parametrize("number", some_of(60, 2))
def test_betweenness_of_packings_is_that_of_networkx(number):
    network = random_packing(number)
    found, (loads, spheres, pairs, far) = Bottlenecks(network), by_networkx(network)
    assert found.betweenness.pairs == pairs
    assert found.betweenness.mean_distance == pytest.approx(far)
    np.testing.assert_allclose(found.betweenness.link, loads, atol=1e-9)
    np.testing.assert_allclose(found.share, loads / max(1, pairs), atol=1e-9)
    free = network.free
    np.testing.assert_allclose(found.betweenness.sphere[free], spheres[free], atol=1e-9)


@pytest.mark.parametrize("network", RANDOM)
def test_only_the_backbone_is_loaded(network):
    backbone = Bottlenecks(network).backbone
    everything, restricted = betweenness(network), betweenness(network, backbone)
    assert 0 < backbone.sum() < len(backbone)
    np.testing.assert_allclose(everything.link, restricted.link, atol=1e-12)


@pytest.mark.parametrize("network", RANDOM)
def test_links_that_part_the_planes_alone_are_those_without_which_no_path_is_left(network):
    graph = graph_of_bodies(network)
    piece = graph.subgraph(networkx.node_connected_component(graph, "bottom"))

    def parted_without(edge):
        rest = networkx.MultiGraph(piece)
        rest.remove_edge(*edge)
        return not networkx.has_path(rest, "bottom", "top")

    parting = {piece.edges[edge]["link"] for edge in piece.edges if parted_without(edge)}
    assert set(np.flatnonzero(Bottlenecks(network).parting)) == parting


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


def test_too_much_work_is_sampled_without_bias(monkeypatch):
    network = random_network((6, 6, 7), 0.45, 21)
    exact, generator = betweenness(network), np.random.default_rng
    monkeypatch.setattr(bottlenecks, "EXACT_WORK", 9 * len(network.axis))
    samples = []
    for seed in range(300):
        with monkeypatch.context() as patch:
            patch.setattr(np.random, "default_rng", lambda _, seed=seed: generator(seed))
            samples.append(betweenness(network))
    assert exact.is_exact
    assert not any(sample.is_exact for sample in samples)
    for name in ("link", "sphere", "mean_distance"):
        estimate = np.array([getattr(sample, name) for sample in samples])
        error = np.maximum(estimate.std(axis=0) / np.sqrt(len(samples)), 1e-9)
        assert (np.abs(estimate.mean(axis=0) - getattr(exact, name)) < 5 * error).all()


def test_the_effective_number_of_links():
    load = np.array([1, 0.5, 0.5, 0.5, 0.5, 1])  # of a square amid a chain
    found = Bottlenecks(SQUARE)
    np.testing.assert_allclose(np.sort(found.share), np.sort(load))
    assert found.effective_links == pytest.approx(load.sum() ** 2 / (load**2).sum())
