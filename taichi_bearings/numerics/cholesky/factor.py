"""Numeric factorisation and solves: fronts assembled by Taichi, eliminated by LAPACK and BLAS on several threads."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels.assembly import assemble
from taichi_bearings.numerics.cholesky.dense import REAL, DenseFront, DenseSolve
from taichi_bearings.numerics.cholesky.dissection import Part
from taichi_bearings.numerics.cholesky.fronts import Front, analyse
from taichi_bearings.numerics.cholesky.storage import Batch, Storage

SERIAL = 500_000  # numbers of a batch below which one worker assembles faster than a team
WORTH_A_SOLVE = 1_000_000  # entries of the factor from which subtrees are solved side by side
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
        self._storage = storage = Storage(self.pattern)
        address, fronts = storage.reals.ctypes.data, self.pattern.fronts
        dense = [
            DenseFront(front.own, len(front.border), address + REAL * columns, address + REAL * update)
            for front, columns, update in zip(fronts, storage.factor.tolist(), storage.update.tolist(), strict=True)
        ]
        self._work = [_Work(batch, [dense[n] for n in batch.fronts]) for batch in storage.batches]
        self._branches = self._make_branches()

    def _make_branches(self) -> list["_Branch"]:
        """The subtrees below the root, then the root: what comes before the last can be solved side by side."""
        fronts, storage = self.pattern.fronts, self._storage
        columns = (storage.reals.ctypes.data + REAL * storage.factor).tolist()
        longest = max(len(front.border) for front in fronts)
        root = len(fronts) - 1
        ends = [*sorted(child + 1 for child in fronts[root].children), root, root + 1]
        branches = []
        for begin, end in zip([0, *ends[:-1]], ends, strict=True):
            members = range(begin, end)
            if len(members):
                branches.append(_Branch([fronts[n] for n in members], columns[begin:end], longest, self.size))
        return branches

    @property
    def size(self) -> int:
        return self.pattern.size

    def factorise(self, values: np.ndarray) -> None:
        """Factorise the matrix with these values at the entries of the pattern.

        Raises NotPositiveDefinite if a pivot is not positive.
        """
        storage = self._storage
        storage.values[:] = values
        for work in self._work:
            look_up()
            batch = work.batch
            assemble(batch.entries < SERIAL, batch.begin, batch.end, storage.tables, storage.reals)
            if not work.eliminate():
                raise NotPositiveDefinite

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for one right-hand side, (size,)."""
        look_up()
        ordered = right[self.pattern.order]
        *subtrees, root = self._branches
        run = _pool().map if len(subtrees) > 1 and self._worth_threads else map
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
        solution = np.empty_like(x)
        solution[self.pattern.order] = x
        return solution

    @property
    def _worth_threads(self) -> bool:
        return runtime.current().threads > 1 and self.pattern.factor_entries > WORTH_A_SOLVE


class _Branch:
    """A part of the elimination tree with a vector of its own, so that branches can be solved side by side."""

    def __init__(self, fronts: list[Front], columns: list[int], longest_border: int, size: int) -> None:
        self.first, self.end = fronts[0].first, fronts[-1].first + fronts[-1].own
        self.vector, work = np.zeros(size), np.zeros(max(longest_border, 1))
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
