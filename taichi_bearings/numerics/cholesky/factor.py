"""Numeric factorisation and solves: fronts assembled by Taichi, eliminated by LAPACK and BLAS on several threads."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels.assembly import assemble
from taichi_bearings.numerics.cholesky.dense import REAL, DenseFront, DenseSolve
from taichi_bearings.numerics.cholesky.dissection import Part
from taichi_bearings.numerics.cholesky.fronts import Front, Pattern, analyse
from taichi_bearings.numerics.cholesky.storage import Batch, Storage

SERIAL = 500_000  # numbers of a batch below which one worker assembles faster than a team
WORTH_A_SOLVE = 1_000_000  # entries of the factor from which subtrees are solved side by side
WORTH_FORGETTING = 10_000_000  # entries of a factor whose memory is given back
WORTH_A_THREAD = 3e6  # operations of a batch from which several threads share it


class NotPositiveDefinite(ArithmeticError):
    """The matrix is not positive definite to working precision."""


class Cholesky:
    """Cholesky factorisation of a symmetric positive definite matrix with a given elimination tree.

    parts : the tree, at most two children a part. first, second : coupled unknowns, pairwise.
    Values are given for the entries (pattern.row, pattern.column); where they go, `pattern.entry` tells.
    """

    def __init__(self, parts: list[Part], first: np.ndarray, second: np.ndarray) -> None:
        self.pattern = analyse(parts, first, second)
        self._storage = Storage(self.pattern)
        self._elimination: _Elimination | None = None

    @property
    def size(self) -> int:
        return self.pattern.size

    def factorise(self, values: np.ndarray) -> None:
        """Factorise the matrix with these values at the entries of the pattern.

        Raises NotPositiveDefinite if a pivot is not positive.
        """
        if self._elimination is None:
            self._elimination = _Elimination(self.pattern, self._storage)
        self._elimination.eliminate(values)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for one right-hand side, (size,)."""
        assert self._elimination is not None
        look_up()
        solution = np.empty_like(right)
        solution[self.pattern.order] = self._elimination.solve(right[self.pattern.order])
        return solution

    def forget(self) -> None:
        """Give the memory of the factor back, if it is large."""
        if self.pattern.factor_entries > WORTH_FORGETTING:
            self._elimination = None


class _Elimination:
    """The numbers of a factorisation, and the calls that work on them."""

    def __init__(self, pattern: Pattern, storage: Storage) -> None:
        self._tables, self._reals, fronts = storage.tables, storage.new_reals(), pattern.fronts
        self._entries, self._worth_threads = pattern.entries, pattern.factor_entries > WORTH_A_SOLVE
        columns, updates = (
            (self._reals.ctypes.data + REAL * places).tolist() for places in (storage.factor, storage.update)
        )
        dense = [
            DenseFront(front.own, len(front.border), own, update)
            for front, own, update in zip(fronts, columns, updates, strict=True)
        ]
        self._work = [_Work(batch, [dense[n] for n in batch.fronts]) for batch in storage.batches]
        root = len(fronts) - 1  # the branches before the last one, which it ends, can be solved side by side
        ends = [*sorted(child + 1 for child in fronts[root].children), root, root + 1]
        self._branches = [
            _Branch(fronts[begin:end], columns[begin:end], pattern.size)
            for begin, end in zip([0, *ends[:-1]], ends, strict=True)
            if end > begin
        ]

    def eliminate(self, values: np.ndarray) -> None:
        self._reals[: self._entries] = values
        for work in self._work:
            look_up()
            batch = work.batch
            assemble(batch.entries < SERIAL, batch.begin, batch.end, self._tables, self._reals)
            if not work.eliminate():
                raise NotPositiveDefinite

    def solve(self, ordered: np.ndarray) -> np.ndarray:
        """Solution for a right-hand side, both in the order of elimination."""
        *subtrees, root = self._branches
        threads = len(subtrees) > 1 and self._worth_threads and runtime.current().threads > 1
        run = _pool().map if threads else map
        list(run(lambda branch: branch.forward(ordered), subtrees))
        x = root.vector
        x[root.first :] = ordered[root.first :]
        for branch in subtrees:
            x[root.first :] += branch.vector[root.first :]
        root.forward_own()
        root.backward()
        list(run(lambda branch: branch.backward_from(x, root.first), subtrees))
        for branch in subtrees:
            x[branch.first : branch.end] = branch.vector[branch.first : branch.end]
        return x


class _Branch:
    """A part of the elimination tree with a vector of its own, so that branches can be solved side by side."""

    def __init__(self, fronts: Sequence[Front], columns: list[int], size: int) -> None:
        self.first, self.end = fronts[0].first, fronts[-1].first + fronts[-1].own
        self.vector, work = np.zeros(size), np.zeros(max(1, *(len(front.border) for front in fronts)))
        self._solves = [
            DenseSolve(front.own, address, self.vector, front.first, front.border, work)
            for front, address in zip(fronts, columns, strict=True)
            if front.own
        ]

    def forward(self, right: np.ndarray) -> None:
        """Forward substitution from the right-hand side; later unknowns gather what is to be added to theirs."""
        self.vector[self.first : self.end] = right[self.first : self.end]
        self.vector[self.end :] = 0.0
        self.forward_own()

    def forward_own(self) -> None:
        for solve in self._solves:
            solve.forward()

    def backward_from(self, solution: np.ndarray, known: int) -> None:
        """Backward substitution, given the unknowns from place `known` on."""
        self.vector[known:] = solution[known:]
        self.backward()

    def backward(self) -> None:
        for solve in reversed(self._solves):
            solve.backward()


class _Work:
    """The fronts of a batch and the tasks that eliminate them."""

    def __init__(self, batch: Batch, fronts: list[DenseFront]) -> None:
        self.batch, self._fronts = batch, fronts
        self._cost = sum(front.cost for front in fronts)
        tasks = [task for front in fronts for task in front.tasks()]
        self._tasks = [task.work for task in sorted(tasks, key=lambda task: (task.urgency, task.turn))]

    def eliminate(self) -> bool:
        """On several threads if that pays; False if a pivot is not positive."""
        for front in self._fronts:
            front.get_ready()
        threads = min(runtime.current().threads, len(self._tasks))
        if threads == 1 or self._cost < WORTH_A_THREAD:
            return _work_off(self._tasks)
        queue = iter(self._tasks)  # shared
        others = [_pool().submit(_work_off, queue) for _ in range(threads - 1)]
        try:
            succeeded = _work_off(queue)
        except BaseException:
            list(queue)  # nobody works on a front once this is given up
            for front in self._fronts:
                front.stop()
            raise
        finally:
            others_succeeded = [other.result() for other in others]
        return min(succeeded, *others_succeeded)


def _work_off(tasks: Iterable[Callable[[], bool]]) -> bool:
    succeeded = True
    for task in tasks:
        look_up()
        succeeded &= task()
    return succeeded


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(runtime.available_threads(), thread_name_prefix="cholesky")
