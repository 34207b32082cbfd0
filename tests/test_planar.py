"""Minimum cuts of planar grids against counting all of them, and against scipy's maximum flow."""

from itertools import product

import numpy as np
import pytest
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import maximum_flow

from taichi_bearings import planar
from taichi_bearings.planar import TIE, MinimumCuts, minimum_cuts


def cuts_of(sideways, upward):
    """The cuts of all bundles as one."""
    parts = [cuts for _, cuts in minimum_cuts(sideways, upward)]
    fields = MinimumCuts.__dataclass_fields__
    return MinimumCuts(*(np.concatenate([getattr(cuts, name) for cuts in parts]) for name in fields))


def random_weights(columns, rows, seed, batch=1, decades=1.0):
    rng = np.random.default_rng(seed)
    shapes = (batch, columns - 1, rows), (batch, columns, rows - 1)
    sideways, upward = (10.0 ** rng.uniform(-decades, 0, shape) for shape in shapes)
    sideways[..., 0] = sideways[..., -1] = 0
    return sideways, upward


def weight_of(above, sideways, upward):
    """Weight of the interface of one grid, sides (w, h)."""
    return sideways[np.diff(above, axis=0)].sum() + upward[np.diff(above, axis=1)].sum()


def all_interfaces(sideways, upward):
    """Weight and sides of every choice of sides that leaves both in one piece, lightest first."""
    _, columns, gaps = upward.shape
    found = []
    for choice in product([False, True], repeat=columns * (gaps - 1)):
        above = np.zeros((columns, gaps + 1), dtype=bool)
        above[:, 1:-1] = np.reshape(choice, (columns, gaps - 1))
        above[:, -1] = True
        if label(above)[1] == label(~above)[1] == 1:
            found.append((weight_of(above, sideways[0], upward[0]), above))
    return sorted(found, key=lambda entry: entry[0])


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("columns", "rows"), [(3, 4), (2, 6), (8, 3), (3, 5)])
def test_least_and_next_weight_are_those_of_all_interfaces(columns, rows, seed):
    sideways, upward = random_weights(columns, rows, seed, decades=2.0)
    (least, above), (second, _), *_ = all_interfaces(sideways, upward)
    cuts = cuts_of(sideways, upward)
    assert cuts.weight[0] == pytest.approx(least, rel=1e-14)
    assert cuts.next_weight[0] == pytest.approx(second, rel=1e-14)
    assert cuts.unique[0]
    assert (cuts.above[0] == above).all()


@pytest.mark.parametrize("seed", range(6))
def test_ties_are_seen_in_every_contact(seed):
    """Small integers tie often: the shared contacts are those of all the lightest interfaces together."""
    rng = np.random.default_rng(seed)
    sideways, upward = rng.integers(1, 4, (1, 2, 5)).astype(float), rng.integers(1, 4, (1, 3, 4)).astype(float)
    sideways[..., 0] = sideways[..., -1] = 0
    listed = all_interfaces(sideways, upward)
    lightest = [above for weight, above in listed if weight == listed[0][0]]
    cuts = cuts_of(sideways, upward)
    assert cuts.weight[0] == listed[0][0]
    assert cuts.next_weight[0] == listed[1][0]
    assert cuts.unique[0] == (len(lightest) == 1)
    assert any((cuts.above[0] == above).all() for above in lightest)
    for axis, shared in enumerate((cuts.sideways_shared[0], cuts.upward_shared[0])):
        assert (shared == np.any([np.diff(above, axis=axis) for above in lightest], axis=0)).all()


def test_without_disorder_every_level_cut_ties():
    cuts = cuts_of(0.3 * np.ones((1, 6, 8)), 0.3 * np.ones((1, 7, 7)))
    assert cuts.weight[0] == pytest.approx(7 * 0.3, rel=1e-14)
    assert not cuts.unique[0]
    assert cuts.upward_shared.all()
    assert not cuts.sideways_shared.any()


@pytest.mark.parametrize("seed", range(5))
def test_integer_weights_agree_with_maximum_flow(seed):
    columns, rows = 12, 9
    rng = np.random.default_rng(seed)
    sideways = rng.integers(1, 1000, (1, columns - 1, rows))
    upward = rng.integers(1, 1000, (1, columns, rows - 1))
    node = np.arange(columns * rows).reshape(columns, rows)
    node[:, 0], node[:, -1] = node[0, 0], node[0, -1]
    first = np.concatenate([node[:-1, 1:-1].ravel(), node[:, :-1].ravel()])
    second = np.concatenate([node[1:, 1:-1].ravel(), node[:, 1:].ravel()])
    weight = np.concatenate([sideways[0, :, 1:-1].ravel(), upward[0].ravel()])
    graph = coo_array(
        (np.tile(weight, 2), (np.append(first, second), np.append(second, first))), shape=(node.size, node.size)
    )
    expected = maximum_flow(graph.astype(np.int32).tocsr(), node[0, 0], node[0, -1]).flow_value
    cuts = cuts_of(sideways.astype(float), upward.astype(float))
    assert cuts.weight[0] == expected
    assert cuts.upward_flow[0, :, 0].sum() == expected


@pytest.mark.parametrize("decades", [1.0, 6.0, 15.0, 30.0])
@pytest.mark.parametrize(("columns", "rows"), [(2, 3), (2, 40), (40, 3), (25, 20)])
def test_flows_balance_and_are_admissible_without_any_rounding(columns, rows, decades):
    sideways, upward = random_weights(columns, rows, 3, batch=3, decades=decades)
    cuts = cuts_of(sideways, upward)
    assert (abs(cuts.sideways_flow) <= sideways).all()
    assert (abs(cuts.upward_flow) <= upward).all()
    pull = np.diff(cuts.upward_flow, axis=2)
    pull[:, :-1] += cuts.sideways_flow[..., 1:-1]
    pull[:, 1:] -= cuts.sideways_flow[..., 1:-1]
    assert (pull == 0).all()
    for n in range(3):
        assert cuts.upward_flow[n, :, 0].sum() == cuts.weight[n]
        least = weight_of(cuts.above[n], sideways[n], upward[n])
        assert least == pytest.approx(cuts.weight[n], rel=1e-14)
        assert cuts.weight[n] <= least * (1 + 1e-15)
    assert (cuts.next_weight >= cuts.weight).all()


def test_bundles_change_nothing(monkeypatch):
    sideways, upward = random_weights(6, 7, 8, batch=10, decades=3.0)
    whole = cuts_of(sideways, upward)
    monkeypatch.setattr(planar, "BUNDLE", 80)
    assert len(list(minimum_cuts(sideways, upward))) == 5
    parts = cuts_of(sideways, upward)
    for name in MinimumCuts.__dataclass_fields__:
        assert (getattr(whole, name) == getattr(parts, name)).all()


def test_nearly_equal_cuts_count_as_tied_within_the_tolerance():
    upward = np.ones((1, 2, 2))
    upward[0, 0, 1] += TIE / 4
    sideways = np.ones((1, 1, 3))
    assert not cuts_of(sideways, upward).unique[0]
    upward[0, 0, 1] += 100 * TIE
    assert cuts_of(sideways, upward).unique[0]
