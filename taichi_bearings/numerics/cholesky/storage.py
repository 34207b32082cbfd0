"""Where the numbers of a factorisation lie in memory, and the tables by which the assembly kernel finds them."""

import numpy as np

from taichi_bearings.kernels.assembly import (
    BELOW,
    BORDER,
    CHILD_A,
    COLUMN_WIDTH,
    DIAGONAL,
    FIRST,
    FRONT_WIDTH,
    HEADER,
    MAP,
    OWN,
    UPDATE,
)
from taichi_bearings.memory import refuse_beyond
from taichi_bearings.numerics.cholesky.fronts import Pattern

MOST_REALS = 2**31 - 1  # the kernel counts in 32 bits


class Storage:
    """Memory of a factorisation.

    tables, reals : arguments of the assembly kernel.
    values : view of `reals`, the original entries.
    members : numbers of the fronts of each depth. columns_end : end of each depth in the table of columns.
    blocks : per front, views (diagonal (m, m), below (b, m), update (b, b)) of `reals` in Fortran order.

    The update blocks of even and of odd depths take turns: fronts read those of the next depth only.
    """

    def __init__(self, pattern: Pattern) -> None:
        fronts = pattern.fronts
        own = np.array([f.own for f in fronts], dtype=np.int64)
        border = np.array([len(f.border) for f in fronts], dtype=np.int64)
        depth = np.array([f.depth for f in fronts])
        self.members = [np.flatnonzero(depth == d) for d in range(depth.max() + 1)]

        table = np.zeros((len(fronts), FRONT_WIDTH), dtype=np.int64)
        table[:, OWN], table[:, BORDER], table[:, FIRST] = own, border, [f.first for f in fronts]
        table[:, MAP] = np.cumsum(border) - border
        ends = len(pattern.row) + np.cumsum(np.stack([own * own, own * border], axis=1))
        table[:, DIAGONAL], table[:, BELOW] = ends[::2] - own * own, ends[1::2] - own * border
        size = int(ends[-1])
        for turn in (0, 1):
            start, longest = size, 0
            for members in self.members[turn::2]:
                end = np.cumsum(border[members] ** 2)
                table[members, UPDATE] = start + end - border[members] ** 2
                longest = max(longest, int(end[-1]))
            size += longest
        if size > MOST_REALS:
            raise MemoryError(f"the factorisation needs {size} numbers; at most {MOST_REALS} can be indexed")
        refuse_beyond(8 * size, f"the factorisation of {len(pattern.order):,} unknowns")
        columns = []
        for number in np.concatenate(self.members):
            children = fronts[number].children
            table[number, CHILD_A : CHILD_A + len(children)] = children
            columns.append(_columns(pattern, number))
        self.columns_end = np.cumsum([(own + border)[members].sum() for members in self.members]).tolist()
        maps = np.concatenate([f.place_in_parent for f in fronts])
        self.tables = _packed(np.concatenate(columns), table, *_entries(pattern), maps)
        self.reals = np.zeros(size)
        self.values = self.reals[: len(pattern.row)]
        self.blocks = [self._views(row) for row in table]

    def _views(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        m, b = int(row[OWN]), int(row[BORDER])

        def view(start: int, height: int, width: int) -> np.ndarray:
            return self.reals[start : start + height * width].reshape(height, width, order="F")

        return view(int(row[DIAGONAL]), m, m), view(int(row[BELOW]), b, m), view(int(row[UPDATE]), b, b)


def _columns(pattern: Pattern, number: int) -> np.ndarray:
    """(width, 4) for a front: its number, column, and the columns of its two children that belong there, or -1."""
    front = pattern.fronts[number]
    columns = np.full((front.own + len(front.border), COLUMN_WIDTH), -1)
    columns[:, 0], columns[:, 1] = number, np.arange(len(columns))
    for which, child in enumerate(front.children):
        places = pattern.fronts[child].place_in_parent
        columns[places, 2 + which] = np.arange(len(places))
    return columns


def _entries(pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
    """Start of each column among the stored entries, and the row of each entry within its front."""
    start = np.concatenate([[0], np.cumsum(np.bincount(pattern.column, minlength=pattern.size))])
    place = np.empty(len(pattern.row), dtype=np.int64)
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
