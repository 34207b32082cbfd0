"""In which order fronts are worked on, and where their updates lie until they are used.

A subtree with few numbers in its updates is worked on depth by depth, all its fronts of a depth at once: threads share
those best. Above such groves come the fronts one by one, children before parents: so few updates wait at a time.
"""

from bisect import insort

import numpy as np

from taichi_bearings.numerics.cholesky.fronts import Pattern, panelled_size

GROVE = 40_000_000  # numbers in all updates of a grove, at most: at 32^3 the whole lattice
ENDLESS = 2**62


class Schedule:
    """batches : numbers of the fronts of each, children first. update : (fronts,) places of the updates.

    peak : numbers that all updates need at a time, at most.
    """

    def __init__(self, pattern: Pattern) -> None:
        fronts = pattern.fronts
        size = panelled_size(np.array([len(f.border) for f in fronts], dtype=np.int64))
        depth, grove = np.array([f.depth for f in fronts]), _groves(pattern, size)
        order = np.lexsort((-depth, grove))
        self.batches = np.split(order, np.flatnonzero(np.diff(grove[order]) | np.diff(depth[order])) + 1)
        self.update = np.empty(len(fronts), dtype=np.int64)
        room, stretch = _Room(), {}
        for members in self.batches:
            ends = np.cumsum(size[members])
            stretch[int(members[0])] = room.take(int(ends[-1])), int(ends[-1])
            self.update[members] = stretch[int(members[0])][0] + ends - size[members]
            used = {child for n in members for child in fronts[n].children}
            for first in used & stretch.keys():  # all of a batch is used by one other
                room.give_back(*stretch.pop(first))
        self.peak = room.peak


def _groves(pattern: Pattern, size: np.ndarray) -> np.ndarray:
    """The front at the root of each one's grove, (fronts,); of a front that belongs to none, itself."""
    within, grove = size.copy(), np.arange(len(size))
    for n, front in enumerate(pattern.fronts):
        within[n] += within[list(front.children)].sum()
    for n in reversed(range(len(size))):
        if within[n] <= GROVE:
            grove[list(pattern.fronts[n].children)] = grove[n]
    return grove


class _Room:
    """Places in a memory without end, the first that fits; peak : what has been needed of it."""

    def __init__(self) -> None:
        self._free = [(0, ENDLESS)]  # starts and lengths, neither touching nor empty
        self.peak = 0

    def take(self, length: int) -> int:
        which = next(i for i, (_, room) in enumerate(self._free) if room >= length)
        start, room = self._free[which]
        self._free[which : which + 1] = [(start + length, room - length)] if room > length else []
        self.peak = max(self.peak, start + length)
        return start

    def give_back(self, start: int, length: int) -> None:
        if length:
            insort(self._free, (start, length))
            joined: list[tuple[int, int]] = []
            for begin, room in self._free:
                if joined and sum(joined[-1]) == begin:
                    begin, room = joined[-1][0], joined.pop()[1] + room
                joined.append((begin, room))
            self._free = joined
