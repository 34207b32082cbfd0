"""Factorisations of several matrices of one pattern at once, for which every instruction works on all of them."""

import numpy as np

from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels.elimination import HEADER, LANES, WIDTH, eliminate, substitute
from taichi_bearings.memory import refuse_beyond
from taichi_bearings.numerics.cholesky.dissection import Part
from taichi_bearings.numerics.cholesky.fronts import Pattern, analyse

LEAF = 20  # unknowns of a region that is not divided: calls cost nothing here, arithmetic does


class CholeskySideBySide:
    """Cholesky factorisations of up to LANES symmetric positive definite matrices with a given elimination tree.

    What becomes of one matrix does not depend on the others. See :class:`Cholesky` for parts, first and second.
    """

    def __init__(self, parts: list[Part], first: np.ndarray, second: np.ndarray) -> None:
        self.pattern = pattern = analyse(parts, first, second)
        self._tables, size, self._pivots = _tables(pattern)
        refuse_beyond(8 * LANES * size, f"the factorisation of {LANES} times {len(pattern.order):,} unknowns")
        longest = max(len(front.border) for front in pattern.fronts)
        self._entries, self._numbers = _vectors(len(pattern.row)), _vectors(size)
        self._solution, self._work = _vectors(len(pattern.order)), _vectors(longest + 1)

    def factorise(self, values: np.ndarray) -> np.ndarray:
        """Factorise the matrices with these values (entries, S) at the entries of the pattern; True (S,) for those that
        are positive definite to working precision."""
        look_up()
        samples = values.shape[1]
        self._entries[:, :samples] = values
        eliminate(self._tables, self._entries, self._numbers)
        return np.isfinite(self._numbers[self._pivots, :samples]).all(axis=0)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solutions of the factorised systems for one right-hand side each, (unknowns, S)."""
        look_up()
        samples, order = right.shape[1], self.pattern.order
        self._solution[:, :samples] = right[order]
        substitute(self._tables, self._numbers, self._solution, self._work)
        found = np.empty_like(right)
        found[order] = self._solution[:, :samples]
        return found


def _vectors(count: int) -> np.ndarray:
    """Zeros (count, LANES), at an address for SIMD."""
    memory = np.zeros((count + 1) * LANES)
    first = -(memory.ctypes.data // memory.itemsize) % LANES
    return memory[first : first + count * LANES].reshape(count, LANES)


def _tables(pattern: Pattern) -> tuple[np.ndarray, int, np.ndarray]:
    """Tables of the kernels, how many vectors the fronts take, and where the pivots are among them."""
    fronts = pattern.fronts
    own, border = np.array([f.own for f in fronts]), np.array([len(f.border) for f in fronts])
    columns_end, share_end = np.cumsum(own * (own + border)), np.cumsum(border)
    start = np.concatenate([[0], np.cumsum(np.bincount(pattern.column, minlength=pattern.size))])
    updates, size = _updates(pattern, int(columns_end[-1]))
    table, places, pivots = np.full((len(fronts), WIDTH), -1), [], []
    for number, front in enumerate(fronts):
        end, rows, columns = front.first + front.own, own[number] + border[number], columns_end[number]
        columns -= own[number] * rows
        entries = slice(start[front.first], start[end])
        row, column = pattern.row[entries], pattern.column[entries] - front.first
        inside = np.where(row < end, row - front.first, front.own + np.searchsorted(front.border, row))
        places.append(column * rows + inside)
        pivots.append(columns + np.arange(front.own) * (rows + 1))
        share = share_end[number] - border[number]
        table[number, :6] = front.own, border[number], columns, updates[number], entries.start, entries.stop
        table[number, 6 : 6 + len(front.children)] = front.children
        table[number, 8:] = share, front.first
    none = [np.zeros(0, dtype=np.int64)]
    maps = np.concatenate([*none, *(np.resize(f.place_in_parent, len(f.border)) for f in fronts)])
    parts = [table.ravel(), np.concatenate(places), maps, np.concatenate([*none, *(f.border for f in fronts)])]
    begins = HEADER + np.cumsum([len(part) for part in parts[:-1]])
    packed = np.concatenate([[len(fronts)], begins, *parts]).astype(np.int32)
    return packed, size, np.concatenate(pivots)


def _updates(pattern: Pattern, begin: int) -> tuple[list[int], int]:
    """Where the update of each front is kept from `begin` on until its parent has taken it, and the end of all."""
    free, places, end = [(begin, 2**40)], [], begin
    for front in pattern.fronts:
        needed = len(front.border) ** 2
        at = next(n for n, (_, length) in enumerate(free) if length >= needed)
        place, length = free[at]
        free[at] = (place + needed, length - needed)
        places.append(place)
        end = max(end, place + needed)
        given_back = [(places[child], len(pattern.fronts[child].border) ** 2) for child in front.children]
        joined: list[tuple[int, int]] = []
        for place, length in sorted((part for part in [*free, *given_back] if part[1])):
            if joined and sum(joined[-1]) == place:
                place, length = joined[-1][0], joined.pop()[1] + length
            joined.append((place, length))
        free = joined
    return places, end
