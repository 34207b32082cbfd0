"""Where the numbers of a factorisation lie in memory, and the tables by which the assembly kernel finds them."""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.kernels.assembly import (
    ADDRESS,
    BEGIN,
    CHILD,
    COLUMN_WIDTH,
    FIRST,
    FRONT,
    FRONT_WIDTH,
    HEADER,
    HEIGHT,
    MAP,
    OWN,
    SIBLING,
)
from taichi_bearings.kernels.elimination import LANES
from taichi_bearings.memory import refuse_beyond
from taichi_bearings.numerics.cholesky.fronts import PANEL, Pattern, panelled_size
from taichi_bearings.numerics.cholesky.schedule import Schedule

MOST_REALS = 2**31 - 1  # the kernel counts in 32 bits


@dataclass(frozen=True)
class Batch:
    """Fronts that are assembled at once: their numbers, and their columns begin ... end-1 in the table of columns."""

    fronts: np.ndarray
    begin: int
    end: int
    entries: int


class Storage:
    """Where the numbers of a factorisation lie.

    tables : argument of the assembly kernel. The other one are the reals, the original entries first.
    batches : of fronts, children first.
    factor, update : (fronts,) places among the reals of the own columns, (own + border, own) in Fortran order, and of
    the update of the border, panels of PANEL columns from the diagonal down; lower triangles count.
    size : how many reals.
    """

    def __init__(self, pattern: Pattern) -> None:
        fronts, schedule = pattern.fronts, Schedule(pattern)
        own = np.array([f.own for f in fronts], dtype=np.int64)
        border = np.array([len(f.border) for f in fronts], dtype=np.int64)
        height = own + border
        ends = pattern.entries + np.cumsum(own * height)
        self.factor = ends - own * height
        self.update = ends[-1] + schedule.update
        self.size, self._unknowns = int(ends[-1]) + schedule.peak + LANES - 1, pattern.size  # solves read whole vectors
        if self.size > MOST_REALS:
            raise MemoryError(f"the factorisation needs {self.size} numbers; at most {MOST_REALS} can be indexed")
        order = np.concatenate(schedule.batches)
        table = np.zeros((len(fronts), FRONT_WIDTH), dtype=np.int64)
        table[:, OWN], table[:, HEIGHT], table[:, FIRST] = own, height, [f.first for f in fronts]
        table[order, BEGIN] = np.cumsum(height[order]) - height[order]
        table[:, MAP] = np.cumsum(border) - border
        maps = np.concatenate([f.place_in_parent for f in fronts])
        columns = self._columns(order, table)
        _join_children(pattern, table, columns, maps)
        self.tables = _packed(columns, table, *_entries(pattern), maps)
        self.batches = [self._batch(members, table) for members in schedule.batches]

    def new_reals(self) -> np.ndarray:
        """Raises MemoryError if there is no room for them."""
        refuse_beyond(8 * self.size, f"the factorisation of {self._unknowns:,} unknowns")
        return np.zeros(self.size)

    def _batch(self, members: np.ndarray, table: np.ndarray) -> Batch:
        own, height = table[members, OWN], table[members, HEIGHT]
        begin = int(table[members[0], BEGIN])
        entries = int((own * height + panelled_size(height - own)).sum())
        return Batch(members, begin, begin + int(height.sum()), entries)

    def _columns(self, order: np.ndarray, table: np.ndarray) -> np.ndarray:
        """The table of columns, front by front in this order; without children."""
        front = np.repeat(order, table[order, HEIGHT])
        column = np.arange(len(front)) - table[front, BEGIN]
        own, height = table[front, OWN], table[front, HEIGHT]
        panel = np.maximum(column - own, 0) // PANEL * PANEL  # its first column, counted along the border
        before, rows = panelled_size(height - own) - panelled_size(height - own - panel), height - own - panel
        in_update = self.update[front] + before + (column - own - panel) * rows - own - panel
        columns = np.full((len(front), COLUMN_WIDTH), -1)
        columns[:, FRONT] = front
        columns[:, ADDRESS] = np.where(column < own, self.factor[front] + column * height, in_update)
        return columns


def _join_children(pattern: Pattern, table: np.ndarray, columns: np.ndarray, maps: np.ndarray) -> None:
    """Write into the table of columns which columns of the children belong there."""
    for which in reversed(range(max(len(front.children) for front in pattern.fronts))):
        pairs = [(front.children[which], n) for n, front in enumerate(pattern.fronts) if len(front.children) > which]
        child, parent = np.array(pairs).T
        border = table[child, HEIGHT] - table[child, OWN]
        column = np.arange(border.sum()) - np.repeat(np.cumsum(border) - border, border)
        place = maps[np.repeat(table[child, MAP], border) + column]
        own = np.repeat(table[child, BEGIN] + table[child, OWN], border) + column
        above = np.repeat(table[parent, BEGIN], border) + place
        columns[own, SIBLING], columns[above, CHILD] = columns[above, CHILD], own


def _entries(pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
    """Start of each column among the stored entries, and the row of each entry within its front."""
    start = np.concatenate([[0], np.cumsum(np.bincount(pattern.column, minlength=pattern.size))])
    place = np.empty(pattern.entries, dtype=np.int64)
    for front in pattern.fronts:
        end = front.first + front.own
        inside = slice(start[front.first], start[end])
        rows = pattern.row[inside]
        place[inside] = np.where(rows < end, rows - front.first, front.own + np.searchsorted(front.border, rows))
    return start, place


def _packed(*tables: np.ndarray) -> np.ndarray:
    """All tables in one array of 32-bit integers, where they begin at its start."""
    begins = HEADER + np.cumsum([0, *(table.size for table in tables)])
    return np.concatenate([begins[:HEADER], *(table.ravel() for table in tables)]).astype(np.int32)
