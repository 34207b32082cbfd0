"""Numeric factorisation and solves: fronts assembled by Taichi, dense blocks by BLAS and LAPACK."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.linalg import blas

from taichi_bearings import runtime
from taichi_bearings.cholesky.dense import DenseFront
from taichi_bearings.cholesky.dissection import Part
from taichi_bearings.cholesky.fronts import Pattern, analyse
from taichi_bearings.kernels.assembly import assemble

SERIAL = 20_000  # entries of a depth below which one worker assembles faster than a team


WORTH_A_THREAD = 3e6  # operations of a depth from which several threads share it


def _helpers() -> ThreadPoolExecutor:
    """Threads that help eliminating; started on first use, idle otherwise."""
    global _pool
    if _pool is None:
        _pool = ThreadPoolExecutor(max(1, runtime.available_threads() - 1), thread_name_prefix="cholesky")
    return _pool


_pool: ThreadPoolExecutor | None = None


class NotPositiveDefinite(ArithmeticError):
    """The matrix is not positive definite to working precision."""


class Cholesky:
    """Cholesky factorisation of a symmetric positive definite matrix with a given elimination tree.

    parts : the tree, at most two children a part. first, second : coupled unknowns, pairwise.
    Values are given for the entries (pattern.row, pattern.column); where they go, `pattern.entry` tells.
    """

    def __init__(self, parts: list[Part], first: np.ndarray, second: np.ndarray) -> None:
        self._prepare(analyse(parts, first, second))

    def _prepare(self, pattern: Pattern) -> None:
        self.pattern = pattern
        fronts = pattern.fronts
        own = np.array([f.own for f in fronts], dtype=np.int64)
        border = np.array([len(f.border) for f in fronts], dtype=np.int64)
        depth = np.array([f.depth for f in fronts])
        first = np.array([f.first for f in fronts], dtype=np.int64)
        blocks = np.stack([own * own, own * border], axis=1).ravel()
        block_start = np.concatenate([[0], np.cumsum(blocks)])
        offset = np.zeros((len(fronts), 3), dtype=np.int64)
        offset[:, 0], offset[:, 1] = block_start[:-1:2], block_start[1::2]
        self._factor = np.zeros(block_start[-1])
        capacity = [1, 1]  # updates of even and of odd depths take turns in two arenas
        self._depths = [np.flatnonzero(depth == d) for d in range(depth.max() + 1)]
        for d, members in enumerate(self._depths):
            sizes = border[members] ** 2
            offset[members, 2] = np.cumsum(sizes) - sizes
            capacity[d % 2] = max(capacity[d % 2], int(sizes.sum()))
        self._updates = [np.zeros(c) for c in capacity]
        maps = np.concatenate([[0], np.cumsum(border)])
        table = np.zeros((len(fronts), 6), dtype=np.int32)
        table[:, 0], table[:, 1], table[:, 2], table[:, 5] = own, border, first, maps[:-1]
        columns, self._columns_of_depth = [], [0]
        for members in self._depths:
            for number in members:
                front = fronts[number]
                width = front.own + len(front.border)
                of_child = np.full((width, 4), -1, dtype=np.int32)
                of_child[:, 0], of_child[:, 1] = number, np.arange(width)
                for which, child in enumerate(front.children):
                    table[number, 3 + which] = child
                    places = fronts[child].place_in_parent
                    of_child[places, 2 + which] = np.arange(len(places))
                columns.append(of_child)
            self._columns_of_depth.append(self._columns_of_depth[-1] + sum(len(c) for c in columns[-len(members) :]))
        counts = np.bincount(pattern.column, minlength=pattern.size)
        # place of each stored entry along the own unknowns and border of its front
        front_of = np.repeat(np.arange(len(fronts)), own)
        place = np.empty(len(pattern.row), dtype=np.int32)
        entry_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        for number, front in enumerate(fronts):
            inside = slice(entry_start[front.first], entry_start[front.first + front.own])
            rows = pattern.row[inside]
            end = front.first + front.own
            place[inside] = np.where(rows < end, rows - front.first, front.own + np.searchsorted(front.border, rows))
        del front_of
        self._static = (
            np.concatenate(columns),
            table,
            offset,
            entry_start,
            place,
            np.concatenate([f.place_in_parent for f in fronts]).astype(np.int32),
        )
        self._blocks = []
        for number, front in enumerate(fronts):
            m, b = front.own, len(front.border)
            d0, b0, u0 = offset[number]
            self._blocks.append(
                (
                    self._factor[d0 : d0 + m * m].reshape(m, m, order="F"),
                    self._factor[b0 : b0 + m * b].reshape(b, m, order="F"),
                    self._updates[front.depth % 2][u0 : u0 + b * b].reshape(b, b, order="F"),
                    slice(front.first, front.first + m),
                    front.border,
                )
            )

        self._dense = [
            sorted((DenseFront(*self._blocks[n][:3]) for n in members), key=lambda f: -f.cost)
            for members in self._depths
        ]
        self._cost = [sum(front.cost for front in fronts) for fronts in self._dense]

    def factorise(self, values: np.ndarray) -> None:
        """Factorise the matrix with these values at the entries of the pattern.

        Raises NotPositiveDefinite if a pivot is not positive.
        """
        for d in reversed(range(len(self._depths))):
            begin, end = self._columns_of_depth[d : d + 2]
            serial = self._work_of_depth(d) < SERIAL
            updates, below = self._updates[d % 2], self._updates[(d + 1) % 2]
            assemble(serial, begin, end, *self._static, values, self._factor, below, updates)
            if not self._eliminate(d):
                raise NotPositiveDefinite

    def _eliminate(self, d: int) -> bool:
        """Eliminate the fronts of one depth, on several threads if there is enough to do."""
        fronts = self._dense[d]
        threads = min(runtime.current().threads, len(fronts))
        if threads == 1 or self._cost[d] < WORTH_A_THREAD:
            return all([front.eliminate() for front in fronts])
        queue = iter(fronts)  # heaviest first; taking the next one is atomic

        def work() -> bool:
            return all([front.eliminate() for front in queue])

        futures = [_helpers().submit(work) for _ in range(threads - 1)]
        return all([work(), *[future.result() for future in futures]])

    def _work_of_depth(self, d: int) -> int:
        return self._columns_of_depth[d + 1] - self._columns_of_depth[d]

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for one right-hand side, (size,)."""
        x = right[self.pattern.order]
        for diagonal, lower, _, own, border in self._blocks:
            if len(diagonal) == 0:
                continue
            part = blas.dtrsv(diagonal, x[own], lower=1, overwrite_x=1)
            x[own] = part
            if len(border):
                x[border] -= lower @ part
        for diagonal, lower, _, own, border in reversed(self._blocks):
            if len(diagonal) == 0:
                continue
            part = x[own] - x[border] @ lower if len(border) else x[own]
            x[own] = blas.dtrsv(diagonal, part, lower=1, trans=1, overwrite_x=1)
        solution = np.empty_like(x)
        solution[self.pattern.order] = x
        return solution
