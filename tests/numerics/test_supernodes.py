"""The elimination tree against elimination entry by entry, and what its supernodes spare."""

import numpy as np
import pytest
from scipy import sparse

from taichi_bearings.kernels import elimination_tree
from taichi_bearings.numerics.cholesky import tuning
from taichi_bearings.numerics.cholesky.fronts import supernodes

pytestmark = pytest.mark.usefixtures("taichi_runtime")


def random_pattern(size, share, seed):
    """Symmetric, with its diagonal; in several pieces where the share is small."""
    coupled = np.random.default_rng(seed).random((size, size)) < share
    return coupled | coupled.T | np.eye(size, dtype=bool)


def filled(coupled):
    """Lower triangle of the factor, eliminated column by column."""
    full = coupled.copy()
    for k in range(len(full)):
        below = np.flatnonzero(full[k + 1 :, k]) + k + 1
        full[np.ix_(below, below)] = True
    return np.tril(full)


PATTERNS = [(1, 0.0), (12, 0.0), (40, 0.02), (40, 0.05), (60, 0.1), (25, 1.0)]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("size", "share"), PATTERNS)
def test_the_tree_is_that_of_the_factor(size, share, seed):
    coupled = random_pattern(size, share, seed=size + seed)
    matrix, full = sparse.csr_matrix(coupled), filled(coupled)
    parent, count, *others = np.zeros((8, size), dtype=np.int32)
    starts, rows = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)  # as columns and as rows
    elimination_tree.divide(0.0, 0.0, 0.0, starts, rows, starts, rows, parent, count, *others, 1)
    assert count.tolist() == full.sum(axis=0).tolist()
    for k in range(size):
        below = np.flatnonzero(full[k + 1 :, k])
        assert parent[k] == (below[0] + k + 1 if len(below) else -1)


@pytest.mark.parametrize("price", [(0, 0, 0), (10, 1, 1), (1e3, 10, 10), (1e9, 0, 0)])
@pytest.mark.parametrize(("size", "share"), PATTERNS)
def test_parts_hold_the_factor_and_come_after_their_children(size, share, price):
    coupled = random_pattern(size, share, seed=3 + size)
    parts = supernodes(sparse.csr_matrix(coupled), tuning.Price(*price))
    assert sorted(parts.order.tolist()) == list(range(size))
    assert sum(parts.own) == size
    full = filled(coupled[np.ix_(parts.order, parts.order)])
    assert full.sum() == filled(coupled).sum()  # another order of the same tree
    ends = np.cumsum(parts.own)
    assert all(number < above for number, above in enumerate(parts.parent) if above >= 0)
    for number, end in enumerate(ends):
        below = np.flatnonzero(full[end:, end - parts.own[number] : end].any(axis=1)) + end
        above = parts.parent[number]
        assert (above >= 0) == bool(len(below))
        if len(below):
            assert below[0] < ends[above]
            assert below[0] >= ends[above] - parts.own[above]
    if price == (1e9, 0, 0):  # nothing else counts: one part for each piece of the graph
        assert len(parts.own) == sparse.csgraph.connected_components(sparse.csr_matrix(coupled))[0]
