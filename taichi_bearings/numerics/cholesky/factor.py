"""Cholesky factorisations of one matrix or of several of one pattern, by whatever is quickest for their size."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from enum import Enum
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.sparse.linalg import SuperLU, splu

from taichi_bearings import runtime
from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels import elimination, substitution
from taichi_bearings.kernels.elimination import LANES
from taichi_bearings.launch import prepared
from taichi_bearings.memory import aligned_zeros, refuse_beyond
from taichi_bearings.numerics.cholesky import tuning
from taichi_bearings.numerics.cholesky.dense import DOUBLE_BYTES, DenseFront
from taichi_bearings.numerics.cholesky.fronts import BlockPattern, Pattern, SparsePattern, analyse
from taichi_bearings.numerics.cholesky.layout import Batch, Layout


class NotPositiveDefinite(ArithmeticError):
    """The matrix is not positive definite to working precision."""


class Engine(Enum):
    """How a matrix is factorised: as one dense block; front by front in a single launch, several matrices at once if
    need be; by calls of BLAS for all fronts, which threads share; or by SciPy where kernels run on a GPU."""

    BLOCK = "block"
    LAUNCH = "launch"
    CALLS = "calls"
    SCIPY = "scipy"

    @classmethod
    def quickest(cls, unknowns: int) -> "Engine":
        """For a matrix alone."""
        if unknowns <= tuning.BLOCK_UNKNOWNS:
            return cls.BLOCK
        if runtime.current().is_gpu:
            return cls.SCIPY
        return cls.LAUNCH if unknowns < tuning.LAUNCH_UNKNOWNS else cls.CALLS


class Memory:
    """Memory for one factor by calls at a time: who factorises next takes it from who did before.

    The first touch of new memory costs as much as a factorisation, at 32^3. turn : how often it was taken or freed.
    """

    def __init__(self) -> None:
        self._numbers, self.turn = np.zeros(0), 0

    def free(self) -> None:
        self._numbers, self.turn = np.zeros(0), self.turn + 1

    def take(self, size: int, what: str) -> np.ndarray:
        """So many numbers or more, whatever they are. Raises MemoryError if there is no room for them."""
        self.turn += 1
        if len(self._numbers) < size:
            self._numbers = np.zeros(0)
            refuse_beyond(8 * size, what)
            self._numbers = np.zeros(size)
        return self._numbers


class Cholesky:
    """Cholesky factorisation of one or up to LANES symmetric positive definite matrices of one pattern.

    What becomes of a matrix, bit by bit, depends neither on the others, nor on whether there are any, nor on threads.
    Values are given for the entries of the pattern; where they go, `pattern.entry` tells.
    """

    pattern: SparsePattern | BlockPattern

    def __init__(
        self,
        unknowns: int,
        order: Callable[[], np.ndarray],
        couplings: tuple[np.ndarray, np.ndarray],
        memory: Memory | None = None,
        engine: Engine | None = None,
    ) -> None:
        """order : of elimination, (unknowns,). couplings : first and second of the unknowns that are coupled. memory :
        to share with others. engine : LAUNCH for several matrices; the quickest for one if None."""
        self.engine, self._memory = engine or Engine.quickest(unknowns), memory or Memory()
        if self.engine is Engine.BLOCK:
            self.pattern = BlockPattern(unknowns)
        elif self.engine is Engine.SCIPY:
            self.pattern = SparsePattern.of(order(), *couplings)
        else:
            price = tuning.LAUNCH_PRICE if self.engine is Engine.LAUNCH else tuning.CALLS_PRICE
            self.pattern = analyse(order(), *couplings, price)
        self._factors = dict[int, Factor]()

    def factor(self, samples: int = 1) -> "Factor":
        """That of a single matrix, or those of up to LANES."""
        lanes = 1 if samples == 1 else LANES
        if lanes not in self._factors:
            if isinstance(self.pattern, BlockPattern):
                self._factors[lanes] = DenseFactor(self.pattern)
            elif not isinstance(self.pattern, Pattern):
                self._factors[lanes] = SciPyFactor(self.pattern, lanes)
            elif self.engine is Engine.LAUNCH:
                self._factors[lanes] = LaunchedFactor(self.pattern, lanes)
            else:
                self._factors[lanes] = CalledFactor(self.pattern, self._memory)
        return self._factors[lanes]

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solutions of the factorised systems for one right-hand side each, (unknowns, S)."""
        factor, (unknowns, samples) = self.factor(right.shape[1]), right.shape
        np.take(right, self.pattern.order, axis=0, out=factor.solution[:unknowns, :samples], mode="clip")
        factor.substitute()
        return factor.solution[:, :samples].take(self.pattern.place, axis=0)

    def forget(self) -> None:
        """Give the memory of the factor back, if it is large."""
        if self.pattern.factor_entries > tuning.LARGE_FACTOR_NUMBERS:
            for factor in self._factors.values():
                factor.forget()


class Factor:
    """Numbers of one matrix or of LANES.

    entries : (entries or more, samples), of the matrices, at those of the pattern. solution : (unknowns or more,
    samples), right-hand sides and then solutions, in the pattern's order.
    """

    entries: np.ndarray
    solution: np.ndarray

    def factorise(self) -> np.ndarray:
        """Factorise; True (samples,) for matrices that are positive definite to working precision."""
        raise NotImplementedError

    def substitute(self) -> None:
        """Solve the factorised systems in place."""
        raise NotImplementedError

    def forget(self) -> None:
        """Give memory back that others may take."""


class DenseFactor(Factor):
    """A matrix so small that an elimination tree costs more calls than it saves arithmetic, as one dense block."""

    def __init__(self, pattern: BlockPattern) -> None:
        self.entries, self.solution = np.zeros((max(1, pattern.entries), 1)), np.zeros((max(1, pattern.size), 1))
        self._size, self._factor = pattern.size, np.zeros((0, 0))

    def factorise(self) -> np.ndarray:
        look_up()
        if not self._size:
            return np.ones(1, dtype=bool)
        matrix = self.entries.reshape(self._size, self._size, order="F")
        self._factor, fault = dpotrf(matrix, lower=True, clean=False)
        return np.array([fault == 0])

    def substitute(self) -> None:
        if self._size:
            self.solution[:, 0] = dpotrs(self._factor, self.solution[:, 0], lower=True)[0]


class SciPyFactor(Factor):
    """One matrix after the other by SuperLU, which needs no kernel."""

    def __init__(self, pattern: SparsePattern, lanes: int) -> None:
        self.entries, self.solution = np.zeros((pattern.entries, lanes)), np.zeros((pattern.size, lanes))
        self._pattern, self._factors = pattern, list[SuperLU | None]()

    def factorise(self) -> np.ndarray:
        pattern, self._factors = self._pattern, []
        for values in self.entries.T:
            look_up()
            lower = sparse.csc_array((values, (pattern.row, pattern.column)), shape=(pattern.size, pattern.size))
            symmetric = (lower + sparse.tril(lower, -1).T).tocsc()
            with suppress(RuntimeError):  # an exact zero
                factor = splu(symmetric, "NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
                if (factor.U.diagonal() > 0).all():
                    self._factors.append(factor)
                    continue
            self._factors.append(None)
        return np.array([factor is not None for factor in self._factors])

    def substitute(self) -> None:
        for sample, factor in enumerate(self._factors):
            if factor is not None:
                self.solution[:, sample] = factor.solve(self.solution[:, sample])


class LaunchedFactor(Factor):
    """A single launch factorises all fronts, and one solves with them."""

    def __init__(self, pattern: Pattern, lanes: int) -> None:
        layout, samples = Layout(pattern, LANES // lanes), "" if lanes == 1 else f" in {lanes} samples"
        refuse_beyond(8 * lanes * layout.size, f"the factorisation of {pattern.size:,} unknowns{samples}")
        self.entries, self._numbers, vector = (
            _vectors(n, lanes) for n in (pattern.entries, layout.size, layout.vector)
        )
        self.solution, self._pivots = vector[: pattern.size], layout.pivots
        of_all = layout.tables, self.entries, self._numbers, vector
        if lanes > 1:
            tables, entries, numbers, vector = of_all
            self._eliminate = prepared(elimination.eliminate, tables, entries, numbers)
            self._substitute = prepared(substitution.substitute, tables, numbers, vector)
        else:
            tables, entries, numbers, vector = (part.reshape(-1) for part in of_all)
            self._eliminate = prepared(
                elimination.eliminate_alone, tables, entries, numbers, numbers.reshape(-1, LANES)
            )
            self._substitute = prepared(substitution.substitute_alone, tables, numbers, vector)

    def factorise(self) -> np.ndarray:
        look_up()
        self._eliminate()
        return np.isfinite(self._numbers[self._pivots]).all(axis=0)

    def substitute(self) -> None:
        look_up()
        self._substitute()


class CalledFactor(Factor):
    """Fronts are assembled by a kernel and eliminated by LAPACK and BLAS on several threads, and so is the solving."""

    def __init__(self, pattern: Pattern, memory: Memory) -> None:
        self._layout, self._memory, self._size = Layout(pattern, apart=True), memory, pattern.size
        self.entries, self._vector = np.zeros((pattern.entries, 1)), np.zeros((self._layout.vector, 1))
        self.solution = self._vector[: pattern.size]
        self._numbers, self._work, self._halves = np.zeros(0), list[_Work](), list[Callable[[], None]]()
        self._turn = -1  # of the memory, when it was this one's

    def factorise(self) -> np.ndarray:
        self._hold()
        for work in self._work:
            look_up()
            work.assemble()
            if not work.eliminate():
                return np.zeros(1, dtype=bool)
        pivots = self._numbers[self._layout.pivots]
        self._numbers[self._layout.pivots] = 1 / pivots  # as all substitutions want them
        return np.array([np.isfinite(pivots).all()])

    def _hold(self) -> None:
        """Have the memory, and be ready to work in it."""
        if self._turn == self._memory.turn:
            return
        layout = self._layout
        numbers = self._memory.take(layout.size, f"the factorisation of {self._size:,} unknowns")
        self._turn = self._memory.turn
        if numbers is self._numbers:
            return
        self._numbers, arrays = numbers, (layout.tables, self.entries.ravel(), numbers)
        places = (numbers.ctypes.data + DOUBLE_BYTES * of for of in (layout.columns, layout.update))
        of_fronts = layout.own, layout.border, layout.height, layout.update_height, *places
        fronts = [DenseFront(*front) for front in zip(*(of.tolist() for of in of_fronts), strict=True)]
        prepared(elimination.assemble, *arrays, 0, 0)  # compiles it, before large batches want it
        self._work = [_Work(batch, [fronts[n] for n in batch.fronts], arrays) for batch in layout.batches]
        halves = [(1, stage) for stage in layout.stages] + [(0, stage) for stage in reversed(layout.stages)]
        self._halves = [
            prepared(substitution.substitute_branches, layout.tables, numbers, self._vector.ravel(), forth, *stage)
            for forth, stage in halves
        ]

    def forget(self) -> None:
        self._numbers, self._work, self._halves = np.zeros(0), [], []
        self._memory.free()

    def substitute(self) -> None:
        assert self._turn == self._memory.turn
        look_up()
        for start in self._halves:
            start()


def _vectors(count: int, lanes: int) -> np.ndarray:
    """Zeros (count or more, lanes), whole vectors at addresses for SIMD."""
    count = -(-count * lanes // LANES) * LANES // lanes
    return aligned_zeros(count * lanes, LANES).reshape(count, lanes)


class _Work:
    """The fronts of a batch and the tasks that eliminate them."""

    def __init__(self, batch: Batch, fronts: list[DenseFront], arrays: tuple[np.ndarray, ...]) -> None:
        """arrays : tables, entries and numbers."""
        alone = batch.numbers < tuning.SHARED_ASSEMBLY_NUMBERS
        kernel = elimination.assemble_serially if alone else elimination.assemble
        self.assemble = prepared(kernel, *arrays, *batch.items)
        self._fronts, self._cost = fronts, sum(front.cost for front in fronts)
        tasks = [task for front in fronts for task in front.tasks()]
        self._tasks = [task.work for task in sorted(tasks, key=lambda task: (task.urgency, task.turn))]

    def eliminate(self) -> bool:
        """On several threads if that pays; False if a pivot is not positive."""
        for front in self._fronts:
            front.get_ready()
        threads = min(runtime.current().threads, len(self._tasks))
        if threads == 1 or self._cost < tuning.SHARED_BATCH_OPERATIONS:
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
