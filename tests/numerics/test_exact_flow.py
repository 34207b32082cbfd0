"""Flows of whole numbers of any length, against networkx, which counts with Python's own."""

import networkx as nx
import numpy as np
import pytest

from taichi_bearings.numerics import minimum_cut
from taichi_bearings.numerics.exact_flow import exact_flow
from tests.scenes import some_of


@pytest.mark.parametrize("by_scipy", [False, True])
@pytest.mark.parametrize("seed", some_of(200, 12))
def test_the_flow_is_networkx_largest_to_the_last_digit(seed, by_scipy, monkeypatch):
    """Up to 60 decades of capacities, several parts, several edges between the same two nodes."""
    if by_scipy:
        monkeypatch.setattr(minimum_cut, "largest_flow", minimum_cut.flow_by_scipy)
        monkeypatch.setattr("taichi_bearings.numerics.exact_flow.largest_flow", minimum_cut.flow_by_scipy)
    draw = np.random.default_rng([71, seed])
    nodes, edges, decades = int(draw.integers(2, 12)), int(draw.integers(1, 30)), (3, 12, 30, 60)[seed % 4]
    ends = np.array([draw.choice(nodes, 2, replace=False) for _ in range(edges)]).T
    capacity = _whole(draw, edges, decades)
    source, sink = (_whole(draw, nodes, decades) * draw.integers(0, 2, nodes) for _ in range(2))
    flow, into, out = exact_flow(ends, capacity, source, sink)
    graph = nx.DiGraph()
    graph.add_nodes_from(["from", "to"])
    for (low, high), most in zip(ends.T.tolist(), capacity, strict=True):
        for pair in ((low, high), (high, low)):
            before = graph.edges[pair]["capacity"] if graph.has_edge(*pair) else 0
            graph.add_edge(*pair, capacity=before + most)
    for node in range(nodes):
        graph.add_edge("from", node, capacity=source[node])
        graph.add_edge(node, "to", capacity=sink[node])
    assert int(into.sum()) == nx.maximum_flow_value(graph, "from", "to")
    left = (into - out).astype(object)
    for (low, high), moved in zip(ends.T.tolist(), flow, strict=True):
        left[low] -= int(moved)
        left[high] += int(moved)
    assert not left.any()
    for moved, most in ((np.abs(flow), capacity), (into, source), (out, sink)):
        assert all(0 <= int(m) <= c for m, c in zip(moved, most, strict=True))


def _whole(draw, count, decades):
    """Whole numbers of Python over so many decades, some of them 0."""
    exponents = draw.uniform(0, decades, count)
    found = [int(10 ** (e % 15) * 1000) * 10 ** int(15 * (e // 15)) + int(draw.integers(0, 9)) for e in exponents]
    return np.array([0 if draw.random() < 0.1 else value for value in found], dtype=object)
