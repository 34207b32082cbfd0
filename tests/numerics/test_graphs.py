"""Connected pieces of graphs, beside those that SciPy finds."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.numerics.graphs import odd_pieces, pieces


def of_scipy(nodes, first, second):
    graph = sparse.coo_array((np.ones(len(first)), (first, second)), shape=(nodes, nodes))
    return connected_components(graph, directed=False)[1]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.45, 0.6, 1.5])
def test_pieces_are_those_of_scipy_in_the_same_order(share):
    rng = np.random.default_rng(int(10 * share))
    for nodes in (1, 7, 400):
        first, second = rng.integers(0, nodes, (2, int(share * nodes)))
        assert (pieces(nodes, first, second) == of_scipy(nodes, first, second)).all()


def test_a_shuffled_chain_is_one_piece():
    order = np.random.default_rng(3).permutation(3000)
    label = pieces(3001, order[:-1], order[1:])
    assert not label[:3000].any()
    assert label[3000] == 1


def test_a_star_round_its_last_node_is_one_piece():
    assert not pieces(50, np.arange(49), np.full(49, 49)).any()


def test_loops_of_odd_length():
    # a triangle, and a square whose neighbours have opposite signs
    odd, sign = odd_pieces(7, np.array([0, 1, 2, 3, 4, 5, 6]), np.array([1, 2, 0, 4, 5, 6, 3]))
    assert odd.tolist() == [True] * 3 + [False] * 4
    assert (sign[3:] * sign[[4, 5, 6, 3]] == -1).all()
