"""Decides where the numbers of a factorisation lie and in which order fronts are worked on; makes the kernels' tables.

A *grove* is a subtree with few numbers in its updates. It is worked on depth by depth, all its fronts of a depth at
once: threads share those best. Above the groves fronts are worked on one by one, children before parents, so that few
updates wait at a time.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from taichi_bearings.kernels.elimination import HEADER
from taichi_bearings.numerics.cholesky import tuning
from taichi_bearings.numerics.cholesky.fronts import Pattern

ENDLESS = 2**62  # length of the free memory behind all updates
Integers = TypeVar("Integers", int, np.ndarray)


@dataclass(frozen=True)
class Batch:
    """Fronts that are worked on at once. A front is a dense block of the factorisation: the unknowns that are
    eliminated together, with the later unknowns that they are coupled to.

    fronts : (fronts of the batch,), the index of each among all fronts.
    numbers : memory that they need, in doubles.
    items : (begin, end) of the work items that assemble these fronts, in the list of all items. An item is some
        columns of one front, which one thread fills with matrix entries and with what earlier fronts leave.
    """

    fronts: np.ndarray
    numbers: int
    items: tuple[int, int]


class Layout:
    """The places of all numbers among the `size` doubles of a sparse Cholesky factorisation by fronts.

    A front is a set of unknowns that are eliminated together, its own ones, with its border, the later unknowns that
    they are coupled to. It has a column for each own unknown and, after their elimination, an update: a matrix (border,
    border) that the front above it in the elimination tree takes. All arrays hold int64.

    own, border : (fronts,) numbers of own unknowns, and of unknowns of the border.
    columns : (fronts,) where the own columns of a front begin; they are (height, own) in Fortran order.
    update : (fronts,) where the update of its border begins. It is stored in panels of SHEET_COLUMNS columns from the
        diagonal down, of update_height rows and less; the first one begins at row `skip` of the front. Only lower
        triangles are used.
    pivots : (unknowns,) where the diagonal entries are.
    tables : int32, flat, for kernels: a header with where each table begins; 14 integers of each front; where each
        entry of the matrix goes; where each row of an update goes in the front above, and each number of a solution;
        work items; and the branches of each stage.
    batches : fronts that are worked on at once, children first; none without threads.
    stages : begin and end among branches of the tree that can be solved at once, children first.
    vector : length of the right-hand side together with what fronts leave for their borders.
    """

    def __init__(self, pattern: Pattern, unit: int = 1, apart: bool = False) -> None:
        """Place all numbers, and make the tables; raise MemoryError if there are more than 32 bits can count.

        pattern : the fronts (sets of unknowns that are eliminated together), their borders (the later unknowns that
            they are coupled to), and the stored entries of the matrix.
        unit : rows that make a SIMD vector; columns begin at multiples of it.
        apart : True if threads share the work; else fronts are worked on one by one.
        """
        self.own, self.border = pattern.own, pattern.width
        self.height, self.skip = whole(self.own + self.border, unit), self.own // unit * unit
        self.update_height = self.height - self.skip
        ends, share = np.cumsum(self.own * self.height), pattern.share[:-1]
        self.columns = ends - self.own * self.height
        updates = update_size(self.border, self.update_height)
        batches = _batches(pattern, updates, tuning.GROVE_NUMBERS if apart else -1)
        places, peak = _places(pattern.parent, updates, batches)
        self.update, self.size = ends[-1] + places, int(ends[-1]) + peak
        if self.size > tuning.MOST_FACTOR_NUMBERS:
            raise MemoryError(
                f"the sample is too large: its matrix factorisation needs {self.size} numbers, "
                f"of which at most {tuning.MOST_FACTOR_NUMBERS} can be indexed"
            )
        self.vector = pattern.size + int(self.border.sum())
        first, front = pattern.first, np.repeat(np.arange(len(self.own)), self.own)  # of each unknown
        self.pivots = self.columns[front] + (np.arange(pattern.size) - first[front]) * (self.height[front] + 1)
        start = np.searchsorted(pattern.column, np.append(first, pattern.size))
        child, sibling = np.full((2, len(self.own)), -1)  # the first child, and the next one of the same parent
        for n, above in reversed(list(enumerate(pattern.parent.tolist()))):
            if above >= 0:
                sibling[n], child[above] = child[above], n
        table = np.stack(
            [
                *(self.own, self.border, self.columns, self.update, start[:-1], start[1:], child, sibling),
                *(share, first, self.height, self.update_height, self.skip, pattern.size + share),
            ],
            axis=1,
        )
        of_entry = front[pattern.column]
        place = (pattern.column - first[of_entry]) * self.height[of_entry] + pattern.within(of_entry, pattern.row)
        parents = np.repeat(pattern.parent, self.border)
        rows, of_parent = pattern.within(parents, pattern.border), self.own[parents]
        slots = np.where(rows < of_parent, pattern.border, pattern.size + share[parents] + rows - of_parent)
        items, self.batches = self._work(batches, updates) if apart else (np.zeros((0, 3), dtype=np.int64), [])
        stages = _stages(pattern, self.own * self.height) if apart else []
        ends_at = np.cumsum([len(stage) for stage in stages]).tolist()
        self.stages = list(zip([0, *ends_at[:-1]], ends_at, strict=True)) if apart else []
        parts = [table, place, rows, slots, items, *stages]
        ends_at = np.cumsum([part.size for part in parts[:5]])
        header = np.array([len(self.own), *(HEADER + ends_at), tuning.SHEET_COLUMNS, 1])
        self.tables = np.concatenate([header, *(part.ravel() for part in parts)]).astype(np.int32)

    def _work(self, batches: list[np.ndarray], updates: np.ndarray) -> tuple[np.ndarray, list[Batch]]:
        """Split the assembly of the fronts into items of at least ASSEMBLY_NUMBERS doubles, which threads share.
        Returns the items, (n, 3): index of a front, first column and end of the columns; and the batches with their
        items.

        A front is a dense symmetric matrix; assembly fills it with matrix entries and what the fronts below it leave.

        batches : for each batch the indices of its fronts, which are worked on at once.
        updates : (fronts,) doubles of the update of each front, the matrix that its elimination leaves for later ones.
        """
        columns = self.own + self.border
        least = np.maximum(1, tuning.ASSEMBLY_NUMBERS // np.maximum(columns, 1))  # columns of an item
        items, found, begin = [], [], 0
        for fronts in batches:
            for n in fronts.tolist():
                first = np.arange(0, columns[n], least[n])
                items.append(np.stack([np.full_like(first, n), first, np.minimum(first + least[n], columns[n])], 1))
            end = begin + sum(len(of) for of in items[-len(fronts) :])
            numbers = int((self.own * self.height + updates)[fronts].sum())
            found.append(Batch(fronts, numbers, (begin, end)))
            begin = end
        return np.concatenate(items), found


def whole(count: np.ndarray, unit: int) -> np.ndarray:
    """Return the counts rounded up to multiples of the unit."""
    return -(-count // unit) * unit


def update_size(border: Integers, height: Integers) -> Integers:
    """Return how many doubles the update of a front takes in memory.

    The update is what the elimination of a front adds to the symmetric matrix of its border, the later unknowns that it
    is coupled to. It is stored in panels of SHEET_COLUMNS columns, each from its diagonal down.

    border : number of its columns. height : number of rows of its first panel.
    """
    width = tuning.SHEET_COLUMNS
    before = border // width * width
    return before * height - before * (before - width) // 2 + (border - before) * (height - before)


def _sums_of_branches(parent: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return (fronts,) the sum of the values of each front and of all fronts below it in the elimination tree.

    parent : (fronts,) index of the front above each one in the tree, -1 for none; children come before parents.
    values : (fronts,) any numbers. A front is a set of unknowns that are eliminated together.
    """
    total = values.tolist()
    for n, above in enumerate(parent.tolist()):
        if above >= 0:
            total[above] += total[n]
    return np.array(total)


def _batches(pattern: Pattern, size: np.ndarray, most: int) -> list[np.ndarray]:
    """Return the fronts that are worked on at once, as arrays of their numbers, children first.

    A front is a set of unknowns that are eliminated together; its update is what that adds to the matrix of later
    unknowns, and waits in memory until the front above takes it.

    pattern : the fronts. size : (fronts,) doubles of the update of each front.
    most : largest number of doubles in all updates of a subtree that is worked on depth by depth; above such subtrees
        fronts are worked on one by one.
    """
    small, grove = (_sums_of_branches(pattern.parent, size) <= most).tolist(), list(range(len(size)))
    for n, above in reversed(list(enumerate(pattern.parent.tolist()))):
        if above >= 0 and small[above]:
            grove[n] = grove[above]
    of_front = np.array(grove)
    order = np.lexsort((-pattern.depth, of_front))
    ends = np.diff(of_front[order]) | np.diff(pattern.depth[order])
    return np.split(order, np.flatnonzero(ends) + 1)


def _places(parent: np.ndarray, size: np.ndarray, batches: list[np.ndarray]) -> tuple[np.ndarray, int]:
    """Return for each front where its update lies, (fronts,), in doubles from the start of the memory for updates; and
    the most doubles of it that are in use at one time.

    The update of a front is the matrix that its elimination adds to that of the later unknowns it is coupled to. It
    lies there until the front above has taken it. Memory is taken at the first free stretch that is long enough.

    parent : (fronts,) index of the front above each, or -1. size : (fronts,) doubles of each update.
    batches : for each batch the indices of its fronts, which are worked on at once; children come first.
    """
    places, free, peak = np.empty(len(size), dtype=np.int64), [(0, ENDLESS)], 0  # starts and lengths, never touching
    batch, waiting = np.empty(len(size), dtype=np.int64), [list[tuple[int, int]]() for _ in batches]
    for number, members in enumerate(batches):
        batch[members] = number
    for number, members in enumerate(batches):
        # take the first free stretch that holds all updates of the batch
        ends = np.cumsum(size[members])
        length = int(ends[-1])
        which = next(i for i, (_, stretch) in enumerate(free) if stretch >= length)
        start, whole_length = free[which]
        free[which : which + 1] = [(start + length, whole_length - length)] if whole_length > length else []
        peak, places[members] = max(peak, start + length), start + ends - size[members]
        if parent[members[0]] >= 0:  # all of a batch is used by one other
            waiting[batch[parent[members[0]]]].append((start, length))
        # give back the updates of the children, and join free stretches that touch
        for stretch in waiting[number]:
            stretches, free = sorted([*free, stretch] if stretch[1] else free), []
            for start, length in stretches:
                if free and sum(free[-1]) == start:
                    start, length = free[-1][0], free.pop()[1] + length
                free.append((start, length))
    return places, peak


def _stages(pattern: Pattern, entries: np.ndarray) -> list[np.ndarray]:
    """Return branches of the elimination tree that can be solved at once, stage by stage, children first: arrays (n, 2)
    of the first front and the end of each branch.

    pattern : the fronts, which are sets of unknowns that are eliminated together. entries : (fronts,) doubles of the
        own columns of each. Small branches go whole, in the first stage; the fronts above follow depth by depth.
    """
    small = _sums_of_branches(pattern.parent, entries) <= tuning.BRANCH_SHARE * entries.sum()
    roots = np.flatnonzero(small & ~((pattern.parent >= 0) & small[pattern.parent]))
    size, depth = _sums_of_branches(pattern.parent, np.ones_like(entries)), pattern.depth
    above = [np.flatnonzero(~small & (depth == level)) for level in range(int(depth[~small].max(initial=-1)), -1, -1)]
    stages = [np.stack([roots + 1 - size[roots], roots + 1], axis=1), *(np.stack([n, n + 1], axis=1) for n in above)]
    return [stage for stage in stages if len(stage)]
