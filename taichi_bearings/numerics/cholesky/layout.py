"""Decides where the numbers of a factorisation are stored and in which order fronts are eliminated; makes the tables of
integers by which kernels find both.

A *grove* is a subtree with few numbers in its updates. It is eliminated depth by depth: all its fronts of one depth are
a *batch*, which threads share. Above the groves fronts are eliminated one by one, children before parents, so that few
updates have to be stored at a time. A *branch* is a subtree with so little work that its numbers stay in the cache of a
processor. The branches of a grove are its first batch: a kernel eliminates each front after front, and threads share
the branches.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np

from taichi_bearings.kernels.elimination import HEADER
from taichi_bearings.numerics.cholesky import tuning
from taichi_bearings.numerics.cholesky.fronts import Pattern
from taichi_bearings.numerics.cholesky.places import branch_of, places_of_updates

ENDLESS_PANEL = 2**30  # more columns than any front has
Integers = TypeVar("Integers", int, np.ndarray)


@dataclass(frozen=True)
class Batch:
    """Fronts that are worked on at once. A front is a dense block of the factorisation: the unknowns that are
    eliminated together, with the later unknowns that they are coupled to.

    fronts : (fronts of the batch,), the index of each among all fronts.
    doubles : how many doubles of memory the fronts need.
    items : (begin, end) of the work items that assemble these fronts, in the list of all. A work item is some columns
        of one front, which one thread fills with matrix entries and with what earlier fronts leave. If `whole` is True,
        (begin, end) of the branches of the batch, in the table of branches.
    whole : True if the batch consists of branches: subtrees of fronts, each of which one kernel call does completely.
    """

    fronts: np.ndarray
    doubles: int
    items: tuple[int, int]
    whole: bool = False


class Layout:
    """The places of all numbers among the `size` doubles of a sparse Cholesky factorisation by fronts.

    A front is a set of unknowns that are eliminated together, its own ones, with its border, the later unknowns that
    they are coupled to. It has a column for each own unknown and, after their elimination, an update: a matrix (border,
    border) that the front above it in the elimination tree takes. All arrays hold int64.

    own : (fronts,) number of own unknowns of each front.
    border : (fronts,) number of unknowns in the border of each front.
    columns : (fronts,) where the own columns of a front begin. They are stored in panels of `own_panel` columns from
        the diagonal down, of `height` rows and less.
    own_panel : (fronts,) SHEET_COLUMNS where calls eliminate a front; elsewhere one panel has all own columns.
    update : (fronts,) where the update of its border begins. It is stored in panels of SHEET_COLUMNS columns from the
        diagonal down, of update_height rows and less; the first one begins at row `skip` of the front. Only lower
        triangles are used.
    diagonal : (fronts,) where the first diagonal entry of the update is.
    pivots : (unknowns,) where the diagonal entries of the factor are; none if threads share the work.
    called_pivots : where the diagonal entries are of fronts that calls of LAPACK eliminate; these are in no branch.
    last_pivots : where the diagonal entries are of fronts without a parent.
    tables : int32, flat, for kernels: a header with where each table begins; the five tables of `_tables_of_fronts`;
        the work items; and the table of branches, first those of each stage, then those of the batches.
    batches : fronts that are worked on at once, children first; none without threads.
    stages : (begin, end) in the table of branches, of branches that can be solved at once; children come first.
    vector : length of the right-hand side together with what fronts leave for their borders.
    """

    def __init__(self, pattern: Pattern, unit: int = 1, apart: bool = False) -> None:
        """Place all numbers, and make the tables; raise MemoryError if there are more than 32 bits can count.

        pattern : the fronts (sets of unknowns that are eliminated together), their borders (the later unknowns that
            they are coupled to), and the stored entries of the matrix.
        unit : rows that make a SIMD vector; columns begin at multiples of it.
        apart : True if threads share the work; else fronts are worked on one by one.
        """
        # how the numbers of each front are stored
        branches = _branches(pattern) if apart else np.zeros((0, 2), dtype=np.int64)
        is_called = (branch_of(len(pattern.own), branches) < 0) & apart
        self.own, self.border = pattern.own, pattern.width
        self.height, self.skip = whole(self.own + self.border, unit), self.own // unit * unit
        self.update_height = self.height - self.skip
        self.own_panel = np.where(is_called, tuning.SHEET_COLUMNS, ENDLESS_PANEL)
        columns = size_in_panels(self.own, self.height, self.own_panel)
        updates = size_in_panels(self.border, self.update_height, tuning.SHEET_COLUMNS)
        batches = _batches(pattern, updates, tuning.GROVE_NUMBERS if apart else -1, branches)
        places, extents = places_of_updates(pattern.parent, updates, batches, branches)
        # Columns are stored from the start of the memory on, updates from its end backwards. So an update may be where
        # later fronts put their columns: for each batch the columns up to then and the updates in use have to fit.
        ends = np.cumsum(columns)
        used = np.maximum.accumulate(_largest(ends, batches))
        end = int((used + whole(extents, unit)).max())
        self.columns, self.update = ends - columns, end - places - updates
        self.size = end + unit  # kernels read up to a vector more
        _refuse_uncountable(self.size)
        self.diagonal = self.update + self.own - self.skip
        # places in columns and right-hand sides; work that threads share; then all tables one after the other
        begins = self._place_pivots(pattern, is_called, apart)
        rest = self._place_right_hand_side(whole(np.array(pattern.size), unit), apart)
        items, stages, self.batches = np.zeros((0, 3), dtype=np.int64), list[np.ndarray](), list[Batch]()
        if apart:
            stages = _stages(pattern, columns)
            doubles, before = columns + updates, sum(map(len, stages))
            items, branches, self.batches = self._shared_work(batches, doubles, branches, before)
        self.stages = list(pairwise(np.cumsum([0, *map(len, stages)]).tolist()))
        parts = [*self._tables_of_fronts(pattern, begins, rest, apart), items, *stages, branches]
        begins_at = HEADER + np.cumsum([part.size for part in parts[:6]])
        header = [len(self.own), *begins_at, tuning.SHEET_COLUMNS, 1]
        self.tables = np.concatenate([header, *(part.ravel() for part in parts)]).astype(np.int32)

    def _place_pivots(self, pattern: Pattern, is_called: np.ndarray, apart: bool) -> np.ndarray:
        """Find the diagonal entries of the unknowns, and return where row 0 of each unknown's column begins,
        (unknowns,), in its front.

        pattern : the fronts, which are sets of unknowns that are eliminated together.
        is_called : (fronts,) True for fronts that calls of LAPACK eliminate.
        apart : True if threads share the work.
        """
        front = pattern.front
        column = np.arange(pattern.size) - pattern.first[front]
        begins: np.ndarray = begin_of_column(column, self.height[front], self.own_panel[front])
        pivots = self.columns[front] + begins + column
        self.called_pivots, self.last_pivots = pivots[is_called[front]], pivots[pattern.parent[front] < 0]
        self.pivots = pivots[: 0 if apart else None].copy()
        return begins

    def _place_right_hand_side(self, begin: np.ndarray, apart: bool) -> np.ndarray:
        """Return where the numbers of each front begin in a right-hand side, (fronts,), and set its length. They come
        after those of the unknowns: one for each row of the border or, if threads share the work, for all rows.

        begin : where the first of them is, a whole number.
        apart : True if threads share the work.
        """
        kept = self.height if apart else self.border
        rest = np.asarray(begin + np.cumsum(kept) - kept)
        self.vector = int(rest[-1] + kept[-1])
        return rest

    def _tables_of_fronts(
        self, pattern: Pattern, begins: np.ndarray, rest: np.ndarray, apart: bool
    ) -> tuple[np.ndarray, ...]:
        """Return five tables by which kernels find the numbers of fronts.

        pattern : the fronts, with their borders and the stored entries of the matrix.
        begins : (unknowns,) where row 0 of each unknown's column begins in its front.
        rest : (fronts,) where the numbers of each front begin in a right-hand side, after those of the unknowns.
        apart : True if threads share the work.
        returns : (fronts, 15), integers of each front; (entries,), place of each matrix entry in its front; and three
            numbers of each row of all borders, one border after the other: its row in the front above; the length of
            the run that begins there (:func:`_runs`); and where a solution has the number that this row needs.
        """
        start = np.searchsorted(pattern.column, np.append(pattern.first, pattern.size))
        integers = (
            *(self.own, self.border, self.columns, self.update, start[:-1], start[1:], *_relatives(pattern.parent)),
            *(pattern.share[:-1], pattern.first, self.height, self.update_height, self.skip, rest, self.own_panel),
        )
        place = begins[pattern.column] + pattern.within(pattern.front[pattern.column], pattern.row)
        parents = np.repeat(pattern.parent, self.border)
        rows, of_parent = pattern.within(parents, pattern.border), self.own[parents]
        is_own = (rows < of_parent) & (not apart)
        slots = np.where(is_own, pattern.border, rest[parents] + rows - (0 if apart else of_parent))
        return np.stack(integers, axis=1), place, rows, _runs(rows, self.border), slots

    def _shared_work(
        self, batches: list[np.ndarray], doubles: np.ndarray, branches: np.ndarray, begin_branches: int
    ) -> tuple[np.ndarray, np.ndarray, list[Batch]]:
        """Return how threads share the fronts of each batch: branch by branch if the batch consists of branches, else
        by work items. An item is some columns of one front with up to ASSEMBLY_NUMBERS doubles, or a single column,
        which one thread fills with matrix entries and with what the fronts below leave.

        batches : for each batch the indices of its fronts, which are worked on at once.
        doubles : (fronts,) doubles of each front, own columns and update.
        branches : (n, 2), first front and end of each branch, a subtree that a kernel works on as a whole.
        begin_branches : number of rows that come before these in the table of branches.
        returns : (n, 3), items: index of a front, first column, end of the columns; (n, 2), the branches in the order
            of the batches; and the batches, each with its range of items or of branches.
        """
        columns = self.own + self.border
        width = np.maximum(1, tuning.ASSEMBLY_NUMBERS // np.maximum(columns, 1))  # columns of an item
        items, in_order, found, begin = [np.zeros((0, 3), dtype=np.int64)], [branches[:0]], [], 0
        of_branch = branch_of(len(columns), branches)
        for fronts in batches:
            numbers = int(doubles[fronts].sum())
            if of_branch[fronts[0]] >= 0:
                own = np.unique(of_branch[fronts])  # the largest come first
                place = begin_branches + sum(map(len, in_order))
                in_order.append(branches[own])
                found.append(Batch(fronts, numbers, (place, place + len(own)), True))
                continue
            for n in fronts.tolist():
                first = np.arange(0, columns[n], width[n])
                items.append(np.stack([np.full_like(first, n), first, np.minimum(first + width[n], columns[n])], 1))
            end = begin + sum(len(of) for of in items[-len(fronts) :])
            found.append(Batch(fronts, numbers, (begin, end)))
            begin = end
        return np.concatenate(items), np.concatenate(in_order), found


def _refuse_uncountable(size: int) -> None:
    """Raise MemoryError if kernels cannot count the `size` numbers of a factorisation, in 32 bits."""
    if size > tuning.MOST_FACTOR_NUMBERS:
        raise MemoryError(
            f"the sample is too large: its matrix factorisation needs {size} numbers, "
            f"of which at most {tuning.MOST_FACTOR_NUMBERS} can be indexed"
        )


def whole(count: np.ndarray, unit: int) -> np.ndarray:
    """Return whole numbers `count`, of any shape, each rounded up to a multiple of `unit`."""
    return -(-count // unit) * unit


def size_in_panels(columns: Integers, height: Integers, width: Integers | int) -> Integers:
    """Return how many doubles the first columns of a matrix take in memory, if columns are stored in panels, and each
    panel from its diagonal down.

    columns : number of columns.
    height : number of rows of the first panel.
    width : columns of a panel.
    """
    before = columns // width * width
    found: Integers = before * height - before * (before - width) // 2 + (columns - before) * (height - before)
    return found


def begin_of_column(column: Integers, height: Integers, width: Integers | int) -> Integers:
    """Return the index, counted from the first number of a matrix, of row 0 of one of its columns, in the storage of
    :func:`size_in_panels`. After the first panel that row itself is not stored.

    column : number of the column.
    height : number of rows of the first panel.
    width : columns of a panel.
    """
    found: Integers = size_in_panels(column, height, width) - column // width * width
    return found


def _largest(values: np.ndarray, parts: list[np.ndarray]) -> np.ndarray:
    """Return the largest value (parts,) of each part.

    values : (n,), any numbers.
    parts : for each part the indices of its values, one or more.
    """
    lengths = np.array([len(part) for part in parts])
    found: np.ndarray = np.maximum.reduceat(values[np.concatenate(parts)], np.cumsum(lengths) - lengths)
    return found


def _relatives(parent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays (fronts,): the first child of each front in the elimination tree, and the next child of the
    same parent; -1 for none.

    parent : (fronts,) index of the front above each front, -1 for none; children come before parents. A front is a
        dense block of the factorisation.
    """
    child, sibling = np.full((2, len(parent)), -1)
    for n, above in reversed(list(enumerate(parent.tolist()))):
        if above >= 0:
            sibling[n], child[above] = child[above], n
    return child, sibling


def _runs(rows: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Return for each row of a border, (rows,), the length of the run that begins there: how many rows of the border,
    this one included, go to successive rows of the front above, so that they can be added together.

    A front is a dense block of the factorisation; its border are the rows that are added to the front above.

    rows : (rows,), for the rows of all borders, one border after the other, the row in the front above.
    border : (fronts,) number of rows of each border.
    """
    front, number = np.repeat(np.arange(len(border)), border), np.arange(len(rows))
    ends = np.flatnonzero(np.append((np.diff(rows) != 1) | (np.diff(front) != 0), True)[: len(rows)]) + 1
    return ends[np.searchsorted(ends, number, side="right")] - number


def _sums_of_branches(parent: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return for each front the sum, (fronts,), of its value and those of all fronts below it in the elimination tree.

    parent : (fronts,) index of the front above each one in the tree, -1 for none; children come before parents.
    values : (fronts,) any numbers. A front is a set of unknowns that are eliminated together.
    """
    total = values.tolist()
    for n, above in enumerate(parent.tolist()):
        if above >= 0:
            total[above] += total[n]
    return np.array(total)


def _branches(pattern: Pattern) -> np.ndarray:
    """Return the branches of the elimination tree, the one with most work first: (n, 2), the first front of each and
    the front after its last. They are the largest subtrees that take at most BRANCH_OPERATIONS.

    pattern : the fronts, sets of unknowns that are eliminated together.
    """
    work = _sums_of_branches(pattern.parent, pattern.operations_of_fronts)
    small = work <= tuning.BRANCH_OPERATIONS
    roots = np.flatnonzero(small & ~((pattern.parent >= 0) & small[pattern.parent]))
    roots = roots[np.argsort(-work[roots], kind="stable")]
    size = _sums_of_branches(pattern.parent, np.ones(len(work), dtype=np.int64))
    return np.stack([roots + 1 - size[roots], roots + 1], axis=1)


def _batches(pattern: Pattern, size: np.ndarray, most: int, branches: np.ndarray) -> list[np.ndarray]:
    """Return the batches in which fronts are eliminated, as a list of arrays of front numbers, children before parents.
    Fronts of one batch are eliminated at once: they do not depend on each other, unless they lie in the same branch.

    A front is a set of unknowns that are eliminated together. It leaves an update, which is stored until the front
    above reads it. A subtree with small updates is a grove.

    * The branches within a grove are its first batch; then each depth of it is a batch, the deepest first.
    * Every other front or branch is a batch of its own.
    * If the matrix falls apart into several trees whose updates are small all together, these are one grove.

    pattern : the fronts.
    size : (fronts,) doubles of the update of each front.
    most : largest number of doubles in all updates of a grove; updates inside branches do not count.
    branches : (n, 2), first front of each branch and the front after its last: subtrees that one call eliminates whole.
    """
    of_branch, lasting = branch_of(len(size), branches), size.copy()
    for first, end in branches.tolist():
        lasting[first : end - 1] = 0
    waiting = _sums_of_branches(pattern.parent, lasting)
    small, grove = (waiting <= most).tolist(), list(range(len(size)))
    together = waiting[pattern.parent < 0].sum() <= most
    for n, above in reversed(list(enumerate(pattern.parent.tolist()))):
        if above >= 0 and (small[above] or of_branch[above] >= 0):
            grove[n] = grove[above]
        elif above < 0 and together:
            grove[n] = len(grove) - 1
    of_front, level = np.array(grove), np.where(of_branch >= 0, -len(size), -pattern.depth)
    order = np.lexsort((level, of_front))
    ends = np.diff(of_front[order]) | np.diff(level[order])
    return np.split(order, np.flatnonzero(ends) + 1)


def _stages(pattern: Pattern, entries: np.ndarray) -> list[np.ndarray]:
    """Return the order in which a system is solved, as a list of stages: arrays (n, 2) of branches of the elimination
    tree that can be worked on at once, each given by its first front and the front after its last. Children come first:
    the first stage has whole subtrees, each with at most BRANCH_SHARE of the factor; then follow the fronts above,
    depth by depth.

    pattern : the fronts, which are sets of unknowns that are eliminated together.
    entries : (fronts,) doubles of the own columns of each.
    """
    small = _sums_of_branches(pattern.parent, entries) <= tuning.BRANCH_SHARE * entries.sum()
    roots = np.flatnonzero(small & ~((pattern.parent >= 0) & small[pattern.parent]))
    size, depth = _sums_of_branches(pattern.parent, np.ones_like(entries)), pattern.depth
    above = [np.flatnonzero(~small & (depth == level)) for level in range(int(depth[~small].max(initial=-1)), -1, -1)]
    stages = [np.stack([roots + 1 - size[roots], roots + 1], axis=1), *(np.stack([n, n + 1], axis=1) for n in above)]
    return [stage for stage in stages if len(stage)]
