"""Factorisations of several matrices of one pattern at once, for which every instruction works on all of them."""

from functools import cached_property

import numpy as np

from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels import elimination as kernels
from taichi_bearings.kernels.elimination import HEADER, LANES, WIDTH
from taichi_bearings.launch import prepared
from taichi_bearings.memory import aligned_zeros, refuse_beyond
from taichi_bearings.numerics.cholesky.factor import NotPositiveDefinite
from taichi_bearings.numerics.cholesky.fronts import Pattern, analyse
from taichi_bearings.numerics.cholesky.supernodes import Price

PRICE = Price(part=4000, column=20, update=20)  # calls cost nothing here
MANY = 8_000  # unknowns from which libraries and threads are worth their calls


class CholeskySideBySide:
    """Cholesky factorisations of one or up to LANES symmetric positive definite matrices of one pattern.

    What becomes of a matrix, bit by bit, does not depend on the others, nor on whether there are any. See
    :class:`Cholesky` for order, first and second.
    """

    def __init__(self, order: np.ndarray, first: np.ndarray, second: np.ndarray) -> None:
        self.pattern = analyse(order, first, second, PRICE)

    def factorise(self, values: np.ndarray) -> np.ndarray:
        """Factorise the matrices with these values (entries, S) at the entries of the pattern; True (S,) for those that
        are positive definite to working precision."""
        samples = values.shape[1]
        storage = self.storage(samples)
        storage.entries[: len(values), :samples] = values
        return storage.factorise()[:samples]

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solutions of the factorised systems for one right-hand side each, (unknowns, S)."""
        unknowns, samples = right.shape
        storage = self.storage(samples)
        solution = storage.solution[:unknowns, :samples]
        np.take(right, self.pattern.order, axis=0, out=solution, mode="clip")
        storage.substitute()
        return solution.take(self.pattern.place, axis=0)

    def storage(self, samples: int) -> "Storage":
        """For the matrix of a single sample, or for those of up to LANES."""
        return self._alone if samples == 1 else self._together

    @cached_property
    def _alone(self) -> "Storage":
        return Storage(self.pattern, 1)

    @cached_property
    def _together(self) -> "Storage":
        return Storage(self.pattern, LANES)


class CholeskyAlone:
    """Like Cholesky, of one matrix with fewer than MANY unknowns: all in one launch."""

    def __init__(self, order: np.ndarray, first: np.ndarray, second: np.ndarray) -> None:
        self._all = CholeskySideBySide(order, first, second)
        self.pattern = self._all.pattern

    def factorise(self, values: np.ndarray) -> None:
        """As that of Cholesky."""
        if not self._all.factorise(values[:, None]).all():
            raise NotPositiveDefinite

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for one right-hand side, (unknowns,)."""
        return self._all.solve(right[:, None])[:, 0]

    def forget(self) -> None:
        """Nothing: it is small."""


class Storage:
    """Memory and tables for one matrix or for LANES.

    entries : (entries or more, samples), of the matrices, at those of the pattern. solution : (unknowns or more,
    samples), right-hand sides and then solutions, in the pattern's order.
    """

    def __init__(self, pattern: Pattern, lanes: int) -> None:
        tables, size, self._pivots = _tables(pattern, LANES // lanes)
        samples = "" if lanes == 1 else f" in {lanes} samples"
        refuse_beyond(8 * lanes * size, f"the factorisation of {pattern.size:,} unknowns{samples}")
        longest = max(len(front.border) for front in pattern.fronts)
        counts = pattern.entries, size, pattern.size, longest + 1
        self.entries, self._numbers, self.solution, work = (_vectors(count, lanes) for count in counts)
        entries, numbers, solution = self.entries, self._numbers, self.solution
        if lanes == 1:
            entries, numbers, solution, work = (part[:, 0] for part in (entries, numbers, solution, work))
            self._eliminate = prepared(kernels.eliminate_alone, tables, entries, numbers, numbers.reshape(-1, LANES))
            self._substitute = prepared(kernels.substitute_alone, tables, numbers, solution, work)
        else:
            self._eliminate = prepared(kernels.eliminate, tables, entries, numbers)
            self._substitute = prepared(kernels.substitute, tables, numbers, solution, work)

    def factorise(self) -> np.ndarray:
        """Factorise; True (samples,) for matrices that are positive definite to working precision."""
        look_up()
        self._eliminate()
        return np.isfinite(self._numbers[self._pivots]).all(axis=0)

    def substitute(self) -> None:
        """Solve the factorised systems in place."""
        look_up()
        self._substitute()


def _vectors(count: int, lanes: int) -> np.ndarray:
    """Zeros (count, lanes), whole vectors at addresses for SIMD."""
    count = _whole(count, LANES // lanes)
    return aligned_zeros(count * lanes, LANES).reshape(count, lanes)


def _whole(count: int, unit: int) -> int:
    return -(-count // unit) * unit


def _tables(pattern: Pattern, unit: int) -> tuple[np.ndarray, int, np.ndarray]:
    """Tables of the kernels, how many numbers the fronts take, and where the pivots are among them.

    unit : rows that make a vector; columns begin at multiples of it.
    """
    fronts, shapes = pattern.fronts, [_shape(len(f.border), f.own, unit) for f in pattern.fronts]
    start = np.concatenate([[0], np.cumsum(np.bincount(pattern.column, minlength=pattern.size))])
    columns_end = np.cumsum([f.own * height for f, (height, _, _) in zip(fronts, shapes, strict=True)]).tolist()
    share_end = np.cumsum([len(f.border) for f in fronts]).tolist()
    sizes = [len(f.border) * height for f, (_, height, _) in zip(fronts, shapes, strict=True)]
    updates, size = _updates(pattern, sizes, columns_end[-1])
    table, places, pivots = np.zeros((len(fronts), WIDTH), dtype=np.int64), [], []
    table[:, [kernels.CHILD, kernels.SIBLING]] = pattern.kin
    for number, (front, (height, update_height, skip)) in enumerate(zip(fronts, shapes, strict=True)):
        end, columns = front.first + front.own, columns_end[number] - front.own * height
        entries = slice(start[front.first], start[end])
        row, column = pattern.row[entries], pattern.column[entries] - front.first
        inside = np.where(row < end, row - front.first, front.own + np.searchsorted(front.border, row))
        places.append(column * height + inside)
        pivots.append(columns + np.arange(front.own) * (height + 1))
        table[number, :6] = front.own, len(front.border), columns, updates[number], entries.start, entries.stop
        table[number, 8:] = share_end[number] - len(front.border), front.first, height, update_height, skip
    none = [np.zeros(0, dtype=np.int64)]
    maps = np.concatenate([*none, *(np.resize(f.place_in_parent, len(f.border)) for f in fronts)])
    parts = [table.ravel(), np.concatenate(places), maps, np.concatenate([*none, *(f.border for f in fronts)])]
    begins = HEADER + np.cumsum([len(part) for part in parts[:-1]])
    packed = np.concatenate([[len(fronts)], begins, [1], *parts]).astype(np.int32)
    return packed, size, np.concatenate(pivots)


def _shape(border: int, own: int, unit: int) -> tuple[int, int, int]:
    """Numbers from column to column, those of the update, and the row at which these begin."""
    height, skip = _whole(own + border, unit), own // unit * unit
    return height, height - skip, skip


def _updates(pattern: Pattern, sizes: list[int], begin: int) -> tuple[list[int], int]:
    """Where the update of each front is kept from `begin` on until its parent has taken it, and the end of all."""
    free, places, end = [(begin, 2**40)], [], begin
    for number, front in enumerate(pattern.fronts):
        at = next(n for n, (_, length) in enumerate(free) if length >= sizes[number])
        place, length = free[at]
        free[at] = (place + sizes[number], length - sizes[number])
        places.append(place)
        end = max(end, place + sizes[number])
        given_back = [(places[child], sizes[child]) for child in front.children]
        joined: list[tuple[int, int]] = []
        for place, length in sorted(part for part in [*free, *given_back] if part[1]):
            if joined and sum(joined[-1]) == place:
                place, length = joined[-1][0], joined.pop()[1] + length
            joined.append((place, length))
        free = joined
    return places, end
