"""Where the numbers of a factorisation by fronts lie: no update is overwritten before it is taken."""

import numpy as np
import pytest

from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.kernels.elimination import BRANCHES, LANES
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky import dissect, tuning
from taichi_bearings.numerics.cholesky.fronts import analyse
from taichi_bearings.numerics.cholesky.layout import Layout, _runs, size_in_panels

pytestmark = pytest.mark.usefixtures("taichi_runtime")


def spans(layout, parent, branches):
    """For each front the span of time in which its update is needed, and the branch (-1: none) within which that span
    is counted, front after front; branches of one batch are worked on at the same time."""
    batch = np.empty(len(parent), dtype=int)
    for number, of in enumerate(layout.batches):
        batch[of.fronts] = number
    found = []
    for n, above in enumerate(parent):
        own = next((k for k, (first, end) in enumerate(branches) if first <= n < end - 1), -1)
        last = len(layout.batches) if above < 0 else batch[above]
        found.append((batch[n], batch[n] if own >= 0 else last, own, n, above))
    return found


def pattern_of(shape, in_planes=False):
    """Pattern of the Newton matrix of a lattice; or of that of springs, which falls apart into planes."""
    lattice = Lattice(shape)
    system = lattice_system(lattice, (0, 1), np.ones(2))
    first, second = (system.by_rows() if in_planes else system).terms()[:2]
    return analyse(dissect(lattice, (0, 1)), first, second, tuning.Price(100, 1, 1))


@pytest.mark.parametrize(("work", "grove"), [(0, 1), (0, 10**9), (3e3, 2_000), (3e4, 20_000), (1e12, 10**9)])
@pytest.mark.parametrize(("shape", "in_planes"), [((7, 6, 8), False), ((4, 4, 20), False), ((7, 6, 8), True)])
def test_updates_that_are_needed_at_one_time_lie_apart(monkeypatch, shape, in_planes, work, grove):
    monkeypatch.setattr(tuning, "BRANCH_OPERATIONS", work)
    monkeypatch.setattr(tuning, "GROVE_NUMBERS", grove)
    pattern = pattern_of(shape, in_planes)
    layout = Layout(pattern, LANES, apart=True)
    assert sorted(np.concatenate([batch.fronts for batch in layout.batches])) == list(range(len(pattern.own)))
    table = layout.tables.tolist()
    branches = [
        tuple(table[table[BRANCHES] + 2 * k : table[BRANCHES] + 2 * k + 2])
        for batch in layout.batches
        if batch.whole
        for k in range(*batch.items)
    ]
    size = size_in_panels(layout.border, layout.update_height, tuning.SHEET_COLUMNS)
    own_size = size_in_panels(layout.own, layout.height, layout.own_panel)
    alive = spans(layout, pattern.parent.tolist(), branches)
    for n, (begin, end, branch, place, above) in enumerate(alive):
        # columns of later batches may come to lie where updates were
        filled = np.concatenate([batch.fronts for batch in layout.batches[: min(end, len(layout.batches) - 1) + 1]])
        columns_end = (layout.columns + own_size)[filled]
        past = (layout.columns[filled] >= layout.update[n] + size[n]) | (columns_end <= layout.update[n])
        assert past.all() or not size[n]
        assert 0 <= layout.update[n] <= layout.update[n] + size[n] <= layout.size
        for m, (begin_other, end_other, branch_other, place_other, _) in enumerate(alive[:n]):
            together = begin <= end_other and begin_other <= end
            if branch == branch_other >= 0:  # one after the other: the earlier one is needed until its parent is there
                together = place_other < place <= pattern.parent[m]
            apart = layout.update[n] + size[n] <= layout.update[m] or layout.update[m] + size[m] <= layout.update[n]
            assert apart or not together or not size[n] or not size[m], (n, m, above)


def test_planes_that_nothing_couples_are_worked_on_at_once_where_their_updates_are_few(monkeypatch):
    pattern = pattern_of((7, 6, 8), in_planes=True)
    planes, levels = np.count_nonzero(pattern.parent < 0), pattern.depth.max() + 1
    assert planes == 7 + 6
    monkeypatch.setattr(tuning, "BRANCH_OPERATIONS", 0)
    assert len(Layout(pattern, LANES, apart=True).batches) == levels
    monkeypatch.setattr(tuning, "BRANCH_OPERATIONS", 1e12)
    (batch,) = Layout(pattern, LANES, apart=True).batches
    assert batch.items == (batch.items[0], batch.items[0] + planes)
    monkeypatch.setattr(tuning, "BRANCH_OPERATIONS", 0)
    monkeypatch.setattr(tuning, "GROVE_NUMBERS", 1)
    assert len(Layout(pattern, LANES, apart=True).batches) >= planes


def test_runs_end_where_rows_of_the_parent_are_left_out_and_at_the_end_of_a_border():
    rows, border = np.array([3, 4, 5, 9, 10, 0, 1, 2, 4]), np.array([5, 0, 2, 2])
    assert _runs(rows, border).tolist() == [3, 2, 1, 2, 1, 2, 1, 1, 1]
    assert _runs(rows[:0], np.array([0])).tolist() == []
