"""Where the numbers of a factorisation lie, in which order fronts are worked on, and the tables that tell kernels.

A subtree with few numbers in its updates is worked on depth by depth, all its fronts of a depth at once: threads share
those best. Above such groves come the fronts one by one, children before parents: so few updates wait at a time.
"""

from bisect import insort
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from taichi_bearings.kernels.elimination import HEADER
from taichi_bearings.numerics.cholesky import tuning
from taichi_bearings.numerics.cholesky.fronts import Pattern

ENDLESS = 2**62
Integers = TypeVar("Integers", int, np.ndarray)


@dataclass(frozen=True)
class Batch:
    """Fronts that are worked on at once, the numbers that they have, and the items of the work to assemble them."""

    fronts: np.ndarray
    numbers: int
    items: tuple[int, int]


class Layout:
    """Where everything is among the `size` numbers of a factorisation.

    columns : (fronts,) the own columns of a front, (height, own) in Fortran order. update : (fronts,) that of its
    border, in panels of SHEET columns from the diagonal down, of update_height rows and less; the first one begins at
    row `skip` of the front. Only lower triangles count. pivots : (unknowns,).
    tables : for the kernels. batches : of fronts, children first. stages : begin and end among the branches that can be
    solved at once, children first. vector : length of right-hand sides and what fronts leave for their borders.
    """

    def __init__(self, pattern: Pattern, unit: int = 1, apart: bool = False) -> None:
        """unit : rows that make a vector; columns begin at multiples of it. apart : threads share what there is to do;
        else fronts are worked on one by one."""
        fronts = pattern.fronts
        self.own = np.array([front.own for front in fronts], dtype=np.int64)
        self.border = np.array([len(front.border) for front in fronts], dtype=np.int64)
        self.height, self.skip = whole(self.own + self.border, unit), self.own // unit * unit
        self.update_height = self.height - self.skip
        ends, share = np.cumsum(self.own * self.height), np.cumsum(self.border) - self.border
        self.columns = ends - self.own * self.height
        updates = update_size(self.border, self.update_height)
        batches = _batches(pattern, updates, tuning.GROVE_NUMBERS if apart else -1)
        places, peak = places_of(pattern, updates, batches)
        self.update, self.size = ends[-1] + places, int(ends[-1]) + peak
        if self.size > tuning.MOST_NUMBERS:
            raise MemoryError(
                f"the factorisation needs {self.size} numbers; at most {tuning.MOST_NUMBERS} can be indexed"
            )
        self.vector = pattern.size + int(self.border.sum())
        first = np.array([front.first for front in fronts])
        front, within = np.repeat(np.arange(len(fronts)), self.own), np.arange(pattern.size)
        within = within - first[front]
        self.pivots = self.columns[front] + within * (self.height[front] + 1)
        start = np.searchsorted(pattern.column, np.append(first, pattern.size))
        table = np.stack(
            [
                *(self.own, self.border, self.columns, self.update, start[:-1], start[1:], *pattern.kin.T),
                *(share, first, self.height, self.update_height, self.skip, pattern.size + share),
            ],
            axis=1,
        )
        items, self.batches = self._work(batches, updates) if apart else (np.zeros((0, 3), dtype=np.int64), [])
        stages = _stages(pattern, self.own * self.height) if apart else []
        ends_at = np.cumsum([len(stage) for stage in stages]).tolist()
        self.stages = list(zip([0, *ends_at[:-1]], ends_at, strict=True)) if apart else []
        parts = [table, self._entries(pattern, start), *_maps(pattern, first, share, self.own), items, *stages]
        ends_at = np.cumsum([part.size for part in parts[:5]])
        header = np.array([len(fronts), *(HEADER + ends_at), tuning.SHEET_COLUMNS, 1])
        self.tables = np.concatenate([header, *(part.ravel() for part in parts)]).astype(np.int32)

    def _entries(self, pattern: Pattern, start: np.ndarray) -> np.ndarray:
        """The place of each entry within the own columns of its front, (entries,)."""
        place = np.empty(pattern.entries, dtype=np.int64)
        for number, front in enumerate(pattern.fronts):
            inside, end = slice(start[number], start[number + 1]), front.first + front.own
            rows, column = pattern.row[inside], pattern.column[inside] - front.first
            row = np.where(rows < end, rows - front.first, front.own + np.searchsorted(front.border, rows))
            place[inside] = column * self.height[number] + row
        return place

    def _work(self, batches: list[np.ndarray], updates: np.ndarray) -> tuple[np.ndarray, list[Batch]]:
        """Items (n, 3), a front and its first and last column each, and the batches that they belong to."""
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
    """The next multiples of the unit."""
    return -(-count // unit) * unit


def update_size(border: Integers, height: Integers) -> Integers:
    """Numbers of the panels of updates with so many columns, and so many rows in the first one."""
    width = tuning.SHEET_COLUMNS
    before = border // width * width
    return before * height - before * (before - width) // 2 + (border - before) * (height - before)


def _batches(pattern: Pattern, size: np.ndarray, most: int) -> list[np.ndarray]:
    """Numbers of fronts that are worked on at once, children first. size : (fronts,), of updates; most : of a grove."""
    within, grove, depth = size.copy(), np.arange(len(size)), np.array([front.depth for front in pattern.fronts])
    for n, front in enumerate(pattern.fronts):
        within[n] += within[list(front.children)].sum()
    for n in np.flatnonzero(within <= most)[::-1].tolist():  # the root of a grove lends its number to all below
        grove[list(pattern.fronts[n].children)] = grove[n]
    order = np.lexsort((-depth, grove))
    return np.split(order, np.flatnonzero(np.diff(grove[order]) | np.diff(depth[order])) + 1)


def places_of(pattern: Pattern, size: np.ndarray, batches: list[np.ndarray]) -> tuple[np.ndarray, int]:
    """Where updates of this size (fronts,) lie until their parents have taken them, (fronts,), the first place that
    fits; and how much room all need at a time."""
    places, free, peak = np.empty(len(size), dtype=np.int64), [(0, ENDLESS)], 0  # starts and lengths, never touching
    stretch = dict[int, tuple[int, int]]()  # of the updates of a batch, by the number of its first front
    for members in batches:
        ends = np.cumsum(size[members])
        length = int(ends[-1])
        which = next(i for i, (_, room) in enumerate(free) if room >= length)
        start, room = free[which]
        free[which : which + 1] = [(start + length, room - length)] if room > length else []
        peak, places[members] = max(peak, start + length), start + ends - size[members]
        stretch[int(members[0])] = start, length
        used = {child for n in members.tolist() for child in pattern.fronts[n].children}
        for first in used & stretch.keys():  # all of a batch is used by one other
            free = _given_back(free, stretch.pop(first))
    return places, peak


def _given_back(free: list[tuple[int, int]], stretch: tuple[int, int]) -> list[tuple[int, int]]:
    joined: list[tuple[int, int]] = []
    if stretch[1]:
        insort(free, stretch)
    for start, length in free:
        if joined and sum(joined[-1]) == start:
            start, length = joined[-1][0], joined.pop()[1] + length
        joined.append((start, length))
    return joined


def _maps(pattern: Pattern, first: np.ndarray, share: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the border of each front in the front of the parent, front by front, and where they are in vectors."""
    none, parent = np.zeros(0, dtype=np.int64), np.zeros(len(own), dtype=np.int64)
    for number, front in enumerate(pattern.fronts):
        parent[list(front.children)] = number
    rows = np.concatenate([none, *(front.place_in_parent for front in pattern.fronts)])
    above = np.repeat(parent, [len(front.place_in_parent) for front in pattern.fronts])
    slots = np.where(rows < own[above], first[above] + rows, pattern.size + share[above] + rows - own[above])
    return rows, slots


def _stages(pattern: Pattern, entries: np.ndarray) -> list[np.ndarray]:
    """Branches (n, 2), first front and end of each, that can be solved at once; stage by stage, children first."""
    fronts = pattern.fronts
    within, begin = entries.copy(), np.arange(len(fronts))
    for number, front in enumerate(fronts):  # children come first, right before their parent
        for child in front.children:
            within[number] += within[child]
            begin[number] = min(begin[number], begin[child])
    small = within <= tuning.BRANCH_SHARE * entries.sum()
    parent = {child: number for number, front in enumerate(fronts) for child in front.children}
    roots = [n for n in range(len(fronts)) if small[n] and not (n in parent and small[parent[n]])]
    depth = np.array([front.depth for front in fronts])
    above = [np.flatnonzero(~small & (depth == level)) for level in range(int(depth[~small].max(initial=-1)), -1, -1)]
    stages = [np.array([[begin[n], n + 1] for n in roots]), *(np.stack([n, n + 1], axis=1) for n in above)]
    return [stage for stage in stages if len(stage)]
