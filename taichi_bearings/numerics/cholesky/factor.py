"""Numeric factorisation and solves: fronts assembled by Taichi, eliminated by LAPACK and BLAS on several threads."""

import weakref
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels.assembly import assemble
from taichi_bearings.numerics.cholesky.dense import REAL, DenseFront
from taichi_bearings.numerics.cholesky.fronts import Pattern, analyse
from taichi_bearings.numerics.cholesky.storage import Batch, Storage
from taichi_bearings.numerics.cholesky.substitution import Substitution
from taichi_bearings.numerics.cholesky.supernodes import Price

SERIAL = 500_000  # numbers of a batch below which one worker assembles faster than a team
WORTH_FORGETTING = 10_000_000  # entries of a factor whose memory is given back
PRICE = Price(part=1e5, column=40, update=80)  # a call costs as much as a thousand numbers that are copied
WORTH_A_THREAD = 3e6  # operations of a batch from which several threads share it


class NotPositiveDefinite(ArithmeticError):
    """The matrix is not positive definite to working precision."""


class Memory:
    """Memory for one factor at a time: who factorises next takes it from who did before.

    The first touch of new memory costs as much as a factorisation, at 32^3.
    """

    _holder: "weakref.ref[Cholesky] | None"

    def __init__(self) -> None:
        self.free()

    def free(self) -> None:
        self._reals, self._holder = np.zeros(0), None

    def is_held_by(self, cholesky: "Cholesky") -> bool:
        return self._holder is not None and self._holder() is cholesky

    def taken_by(self, cholesky: "Cholesky", storage: Storage) -> np.ndarray:
        """Zeros, as many as it needs or more. Raises MemoryError if there is no room for them."""
        if len(self._reals) < storage.size:
            self.free()
            self._reals = storage.new_reals()
        else:
            self._reals[: storage.size] = 0.0
        self._holder = weakref.ref(cholesky)
        return self._reals


class Cholesky:
    """Cholesky factorisation of a symmetric positive definite matrix.

    order : of elimination, (unknowns,). first, second : coupled unknowns, pairwise. memory : to share with others.
    Values are given for the entries (pattern.row, pattern.column); where they go, `pattern.entry` tells.
    """

    def __init__(self, order: np.ndarray, first: np.ndarray, second: np.ndarray, memory: Memory | None = None) -> None:
        self.pattern = analyse(order, first, second, PRICE)
        self._storage, self._memory = Storage(self.pattern), memory or Memory()
        self._substitution = Substitution(self.pattern, self._storage.factor)
        self._elimination: _Elimination | None = None

    @property
    def size(self) -> int:
        return self.pattern.size

    def factorise(self, values: np.ndarray) -> None:
        """Factorise the matrix with these values at the entries of the pattern.

        Raises NotPositiveDefinite if a pivot is not positive.
        """
        if self._elimination is None or not self._memory.is_held_by(self):
            reals = self._memory.taken_by(self, self._storage)
            if self._elimination is None or self._elimination.reals is not reals:
                self._elimination = _Elimination(self.pattern, self._storage, self._substitution, reals)
        self._elimination.eliminate(values)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for one right-hand side, (size,)."""
        assert self._elimination is not None
        assert self._memory.is_held_by(self)
        look_up()
        return self._elimination.solve(right)

    def forget(self) -> None:
        """Give the memory of the factor back, if it is large."""
        if self.pattern.factor_entries > WORTH_FORGETTING:
            self._elimination = None
            self._memory.free()


@lru_cache
def compile_fronts() -> None:
    """Compile the kernels of large factorisations, on a single unknown: they are the same for all."""
    none = np.zeros(0, dtype=np.int64)
    cholesky = Cholesky(np.zeros(1, dtype=np.int64), none, none)
    cholesky.factorise(np.ones(1))
    cholesky.solve(np.ones(1))
    assemble(False, 0, 0, cholesky._storage.tables, np.zeros(1))  # the one above was serial


class _Elimination:
    """The numbers of a factorisation, and the calls that work on them."""

    def __init__(self, pattern: Pattern, storage: Storage, substitution: Substitution, reals: np.ndarray) -> None:
        self._tables, self.reals, self._entries = storage.tables, reals, pattern.entries
        self.solve = substitution.of(self.reals)
        columns, updates = (
            (self.reals.ctypes.data + REAL * places).tolist() for places in (storage.factor, storage.update)
        )
        dense = [
            DenseFront(front.own, len(front.border), own, update)
            for front, own, update in zip(pattern.fronts, columns, updates, strict=True)
        ]
        self._work = [_Work(batch, [dense[n] for n in batch.fronts]) for batch in storage.batches]

    def eliminate(self, values: np.ndarray) -> None:
        self.reals[: self._entries] = values
        for work in self._work:
            look_up()
            batch = work.batch
            assemble(batch.entries < SERIAL, batch.begin, batch.end, self._tables, self.reals)
            if not work.eliminate():
                raise NotPositiveDefinite


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
