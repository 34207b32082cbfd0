"""The direct solver of grid Laplacians against a sparse solver that shares no code, on grids of any sides."""

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import spsolve

from taichi_bearings.numerics.nested_dissection import GridFactor, dissect

SHAPES = [(1, 1), (1, 9), (7, 1), (2, 30), (6, 6), (7, 6), (10, 8), (23, 17), (40, 13), (33, 64)]


def random_grids(shape, batch, decades, seed=271828):
    rng = np.random.default_rng(seed)

    def weight(*size):
        return 10.0 ** rng.uniform(-decades / 2, decades / 2, size)

    (m, n), anchor = shape, np.zeros((batch, *shape))
    anchor[:, :, 0], anchor[:, :, -1] = weight(batch, m), weight(batch, m)
    return weight(batch, m - 1, n), weight(batch, m, n - 1), anchor


def sparse_laplacian(first, second, anchor):
    """Matrix of one grid, link by link."""
    (m, n), entries = anchor.shape, {}
    for i, j in np.ndindex(m, n):
        entries[i * n + j, i * n + j] = anchor[i, j]
    for weights, step in ((first, (1, 0)), (second, (0, 1))):
        for (i, j), w in np.ndenumerate(weights):
            a, b = i * n + j, (i + step[0]) * n + j + step[1]
            for row, column, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
                entries[row, column] = entries.get((row, column), 0.0) + sign * w
    rows, columns = zip(*entries, strict=True)
    return csc_matrix((list(entries.values()), (rows, columns)), (m * n, m * n))


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("decades", [1, 6])
def test_grids_in_a_batch_equal_a_sparse_solver_one_by_one(shape, decades):
    grids = random_grids(shape, 3, decades)
    right = np.random.default_rng(31).standard_normal((3, *shape))
    values = GridFactor(*grids).solve(right)
    for n in range(3):
        expected = spsolve(sparse_laplacian(*(part[n] for part in grids)), right[n].ravel()).reshape(shape)
        assert values[n] == pytest.approx(expected, rel=1e-8 if decades == 6 else 1e-11, abs=1e-9 * abs(expected).max())


@pytest.mark.parametrize("shape", [*SHAPES, (101, 67)], ids=str)
def test_each_node_is_eliminated_once_and_each_link_belongs_to_one_cell(shape):
    eliminated, owned = np.zeros(shape, int), np.zeros(shape, int)
    for front in dissect(shape):
        np.add.at(eliminated, front.at(front.nodes[: front.inside])[1:], 1)
        if not front.halves:
            np.add.at(owned, front.at(front.nodes[front.owned])[1:], 1)
    assert (eliminated == 1).all()
    assert (owned == 1).all()


def test_cells_of_a_kind_are_treated_together():
    """The number of fronts, and so of calls, grows with the logarithm of the sides only."""
    assert len(dissect((1000, 998))) < 150 < sum(len(front.origins) for front in dissect((1000, 998))) / 100


def test_a_grid_that_hangs_on_nothing_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        GridFactor(np.ones((1, 1, 1)), np.ones((1, 2, 0)), np.zeros((1, 2, 1)))
