"""Slipless contacts that go around periodic sides, against lattices that are unrolled and searched by NetworkX."""

import networkx
import numpy as np
import pytest

from taichi_bearings.analysis.slipless_network import winding
from tests.analysis.networks import drawn, random_network

CLOSED = [((6, 6), "x"), ((2, 5), "x"), ((4, 12), "x"), ((4, 3, 4), "x"), ((3, 2, 4), "y"), ((4, 4, 5), "xy"),
          ((2, 2, 4), "xy"), ((2, 4, 3), "xy")]  # fmt: skip
HELIX = drawn(
    (4, 4, 5), [(0, 0, 2), (1, 0, 2), (2, 0, 2), (3, 0, 2), (0, 0, 2)], [(1, 1, 1), (1, 1, 0)], periodic=(0, 1)
)


def unrolled(network, axis):
    """Copies of the lattice in a row along an axis, each joined to the next over the side: (sphere, copy)."""
    shape, graph = network.lattice.shape, networkx.Graph()
    crossings = (
        int(np.prod(shape)) // shape[axis]
    )  # a way that uses no contact twice gets no further than so many copies
    for along, slipless in enumerate(network.lattice.by_axis(network.slipless)):
        for low in map(tuple, np.argwhere(slipless).tolist()):
            high = tuple((low[k] + (k == along)) % shape[k] for k in range(len(shape)))
            over = int(along == axis and high[axis] == 0)
            graph.add_edges_from(((low, n), (high, n + over)) for n in range(-crossings, crossings + 1))
    return graph


@pytest.mark.parametrize(("shape", "sides"), CLOSED, ids=str)
def test_a_piece_winds_where_an_unrolled_sphere_reaches_its_own_copy(shape, sides):
    seen = set()
    for number, share in enumerate([0.15, 0.3, 0.4, 0.5, 0.6] * 8):
        network = random_network(shape, share, 100 + number, tuple(map("xyz".index, sides)))
        for axis in (0, 1):
            if axis not in network.lattice.periodic:
                assert network.winds_around(axis) is None
                continue
            expected = np.zeros(shape, dtype=bool)
            for piece in networkx.connected_components(unrolled(network, axis)):
                places = [place for place, _ in piece]
                if len(set(places)) < len(places):
                    expected[tuple(np.transpose(places))] = True
            assert np.array_equal(network.winding(axis), expected)
            spanning = bool((expected & network.spanning).any())
            assert network.winds_around(axis) == expected.any()
            assert network.winds_around(axis, spanning=True) == spanning
            seen.add((bool(expected.any()), spanning))
    assert {(True, True), (False, False)} <= seen


def test_what_winds_by_hand():
    """A way that comes back after two turns winds, and one whose turns cancel does not; nor do two contacts that cross
    the side together, but one beside one that does not."""
    ends = np.array([[0, 1, 2, 3, 4, 6, 7], [1, 0, 3, 2, 5, 7, 6]])
    expected = [True, True, False, False, False, False, True, True, False]
    assert winding(9, ends, np.array([1, 1, 1, -1, 1, 1, 0])).tolist() == expected
    assert winding(2, np.array([[0, 0], [1, 1]]), np.array([1, 1])).tolist() == [False, False]
    assert winding(1, np.array([[0], [0]]), np.array([1])).tolist() == [True]
    assert [HELIX.winds_around(axis) for axis in (0, 1)] == [True, False]
    assert [HELIX.winds_around(axis, spanning=True) for axis in (0, 1)] == [False, False]
