"""Where the numbers of a factorisation lie in memory, and the tables by which the assembly kernel finds them."""

import numpy as np

from taichi_bearings.cholesky.fronts import Pattern
from taichi_bearings.kernels.assembly import BELOW, BORDER, CHILD_A, DIAGONAL, ENTRIES, MAP, OWN, UPDATE


class Storage:
    """Memory of a factorisation.

    factor : all diagonal blocks and the blocks below them.
    updates : update blocks of even and of odd depths, which take turns: fronts read those of the next depth only.
    members : numbers of the fronts of each depth. columns_end : end of each depth in the list of columns.
    tables : arguments of the assembly kernel that never change.
    blocks : per front, views (diagonal (m, m), below (b, m), update (b, b)) in Fortran order.
    """

    def __init__(self, pattern: Pattern) -> None:
        fronts = pattern.fronts
        own = np.array([f.own for f in fronts], dtype=np.int64)
        border = np.array([len(f.border) for f in fronts], dtype=np.int64)
        depth = np.array([f.depth for f in fronts])
        self.members = [np.flatnonzero(depth == d) for d in range(depth.max() + 1)]

        ends = np.cumsum(np.stack([own * own, own * border], axis=1))
        offset = np.zeros((len(fronts), 3), dtype=np.int64)
        offset[:, DIAGONAL], offset[:, BELOW] = ends[::2] - own * own, ends[1::2] - own * border
        self.factor = np.zeros(int(ends[-1]))
        capacity = [1, 1]
        for d, members in enumerate(self.members):
            end = np.cumsum(border[members] ** 2)
            offset[members, UPDATE] = end - border[members] ** 2
            capacity[d % 2] = max(capacity[d % 2], int(end[-1]))
        self.updates = [np.zeros(numbers) for numbers in capacity]
        self.blocks = [self._views(offset[n], f.own, len(f.border), f.depth) for n, f in enumerate(fronts)]

        table = np.zeros((len(fronts), 6), dtype=np.int32)
        table[:, OWN], table[:, BORDER], table[:, ENTRIES] = own, border, [f.first for f in fronts]
        table[:, MAP] = np.cumsum(border) - border
        columns = []
        for number in np.concatenate(self.members):
            front = fronts[number]
            table[number, CHILD_A : CHILD_A + len(front.children)] = front.children
            columns.append(_columns(pattern, number))
        widths = [int((own + border)[members].sum()) for members in self.members]
        self.columns_end = np.cumsum(widths)
        entry_start, entry_place = _entries(pattern)
        maps = np.concatenate([f.place_in_parent for f in fronts])
        self.tables = (np.concatenate(columns), table, offset, entry_start, entry_place, _not_empty(maps))

    def _views(self, offset: np.ndarray, m: int, b: int, depth: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        diagonal, below, update = (int(o) for o in offset)
        return (
            self.factor[diagonal : diagonal + m * m].reshape(m, m, order="F"),
            self.factor[below : below + m * b].reshape(b, m, order="F"),
            self.updates[depth % 2][update : update + b * b].reshape(b, b, order="F"),
        )


def _columns(pattern: Pattern, number: int) -> np.ndarray:
    """(width, 4) for a front: its number, column, and the columns of its two children that belong there, or -1."""
    front = pattern.fronts[number]
    columns = np.full((front.own + len(front.border), 4), -1, dtype=np.int32)
    columns[:, 0], columns[:, 1] = number, np.arange(len(columns))
    for which, child in enumerate(front.children):
        places = pattern.fronts[child].place_in_parent
        columns[places, 2 + which] = np.arange(len(places))
    return columns


def _entries(pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
    """Start of each column among the stored entries, and the row of each entry within its front."""
    start = np.concatenate([[0], np.cumsum(np.bincount(pattern.column, minlength=pattern.size))]).astype(np.int32)
    place = np.empty(len(pattern.row), dtype=np.int32)
    for front in pattern.fronts:
        end = front.first + front.own
        inside = slice(start[front.first], start[end])
        rows = pattern.row[inside]
        place[inside] = np.where(rows < end, rows - front.first, front.own + np.searchsorted(front.border, rows))
    return start, place


def _not_empty(values: np.ndarray) -> np.ndarray:
    """A kernel takes no array of length zero."""
    return (values if len(values) else np.zeros(1)).astype(np.int32)
