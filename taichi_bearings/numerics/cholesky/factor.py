"""Cholesky factorisation of one matrix, or of several matrices with one pattern of entries, in the way that is quickest
for their size.

S is the number of samples: matrices of one pattern that are factorised together. Kernels work on LANES of them at a
time, one in each lane of a SIMD vector.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from enum import Enum
from functools import lru_cache
from threading import Thread
from typing import Any
from weakref import WeakSet

import numpy as np
from scipy import sparse

from taichi_bearings import runtime
from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels import elimination, substitution
from taichi_bearings.kernels.elimination import LANES
from taichi_bearings.launch import prepared
from taichi_bearings.memory import aligned_zeros, give_back_freed, provide, refuse_beyond
from taichi_bearings.numerics.blas import LAPACK, SPARSE
from taichi_bearings.numerics.cholesky import tuning
from taichi_bearings.numerics.cholesky.dense import DOUBLE_BYTES, DenseFront
from taichi_bearings.numerics.cholesky.fronts import BlockPattern, Pattern, PlacedPattern, SparsePattern, analyse
from taichi_bearings.numerics.cholesky.layout import Batch, Layout


class NotPositiveDefinite(ArithmeticError):
    """The matrix is not positive definite to working precision."""


class Engine(Enum):
    """How a matrix is factorised. A front is a dense block of a sparse matrix (fronts.py).

    BLOCK : as one dense block.
    LAUNCH : front by front in a single kernel launch, several matrices at once if need be.
    CALLS : front by front by calls of LAPACK and BLAS, which threads share.
    SCIPY : by SciPy's SuperLU, where kernels run on a GPU.
    """

    BLOCK = "block"
    LAUNCH = "launch"
    CALLS = "calls"
    SCIPY = "scipy"

    @classmethod
    def quickest(cls, unknowns: int) -> "Engine":
        """Return the engine that is quickest for a single matrix with so many unknowns."""
        if unknowns <= tuning.BLOCK_UNKNOWNS:
            return cls.BLOCK
        if runtime.current().is_gpu:
            return cls.SCIPY
        return cls.LAUNCH if unknowns < tuning.LAUNCH_UNKNOWNS else cls.CALLS


class Memory:
    """Memory that several factorisations of large matrices use one after the other; each takes it from the one before.
    (The first touch of new memory costs as much as a factorisation, at 32^3.)

    changes : how often the memory was taken or freed. If it is still what it was when a factorisation took the memory,
        that factorisation's numbers are still there.
    """

    def __init__(self) -> None:
        """Begin with no memory."""
        # `_users` : the factorisations that have taken the memory; their method `let_go` is called when it is freed
        self._numbers, self._users, self.changes = np.zeros(0), WeakSet[CalledFactor](), 0

    def free(self) -> None:
        """Give the memory back to the operating system."""
        is_large = len(self._numbers) > tuning.LARGE_FACTOR_NUMBERS
        self._numbers, self.changes = np.zeros(0), self.changes + 1
        for user in self._users:
            user.let_go()
        if is_large:
            give_back_freed()

    def take(self, user: "CalledFactor", size: int, what: str) -> np.ndarray:
        """Return an array of `size` doubles or more with arbitrary content. A factorisation that took it before must
        not use it any more.

        user : the factorisation that takes it; its method `let_go` is called when the memory is freed.
        size : doubles that are needed.
        what : what needs the memory, named in the error.

        Raises MemoryError if the machine has too little.
        """
        if len(self._numbers) < size:
            self.free()
            if size > tuning.HUGE_FACTOR_NUMBERS:
                give_back_freed()
            refuse_beyond(8 * size, what)
            self._numbers = aligned_zeros(size, LANES)
        self._users.add(user)
        self.changes += 1
        return self._numbers


class Cholesky:
    """Cholesky factorisation of one symmetric positive definite matrix, or of up to LANES of one pattern of entries.

    The result for a matrix, bit by bit, depends neither on the other matrices nor on the number of threads. Values are
    given for the stored entries of the pattern; :meth:`entry` says which entry couples two unknowns.

    pattern : the stored entries and the order of elimination; of a large matrix, once it has a factor, without lists of
        the entries.
    engine : how matrices are factorised.
    """

    pattern: SparsePattern | BlockPattern | PlacedPattern

    def __init__(
        self,
        unknowns: int,
        order: Callable[[], np.ndarray],
        couplings: tuple[np.ndarray, np.ndarray],
        memory: Memory | None = None,
        engine: Engine | None = None,
    ) -> None:
        """Choose the engine and analyse the pattern.

        unknowns : number of unknowns.
        order : function that returns the order of elimination (unknowns,); called if the engine needs one.
        couplings : first and second unknown of each coupled pair, two arrays (pairs,).
        memory : memory to share with other factorisations, None for its own.
        engine : way to factorise: Engine.LAUNCH, one kernel launch, for several matrices; if None the quickest one for
            a single matrix of this size.
        """
        self.engine, self._memory = engine or Engine.quickest(unknowns), memory or Memory()
        if self.engine is Engine.BLOCK:
            self.pattern = BlockPattern(unknowns)
        elif self.engine is Engine.SCIPY:
            self.pattern = SparsePattern.of(order(), *couplings)
        else:
            price = tuning.LAUNCH_PRICE if self.engine is Engine.LAUNCH else tuning.CALLS_PRICE
            self.pattern = analyse(order(), *couplings, price)
        self._factors = dict[int, Factor]()

    def entry(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return for each pair of unknowns the index (pairs,), in the list of all stored entries, of the entry that
        couples them. It is called before the first call of :meth:`factor`.

        first, second : (pairs,), the two unknowns of each pair, in any order.
        """
        assert not isinstance(self.pattern, PlacedPattern)
        return self.pattern.entry(first, second)

    def factor(self, samples: int = 1) -> "Factor":
        """Return the object that factorises and solves for `samples` matrices of the pattern at a time, the same in
        every call: one for a single matrix, another one for 2 to LANES matrices (the lanes of a SIMD vector)."""
        lanes = 1 if samples == 1 else LANES
        if lanes not in self._factors:
            if isinstance(self.pattern, BlockPattern):
                self._factors[lanes] = DenseFactor(self.pattern)
            elif not isinstance(self.pattern, Pattern):
                assert isinstance(self.pattern, SparsePattern)
                self._factors[lanes] = SciPyFactor(self.pattern, lanes)
            elif self.engine is Engine.LAUNCH:
                self._factors[lanes] = LaunchedFactor(self.pattern, lanes)
            else:
                self._factors[lanes] = CalledFactor(self.pattern, self._memory)
                self.pattern = PlacedPattern.of(self.pattern)
        return self._factors[lanes]

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solutions (unknowns, S) of the S factorised systems for one right-hand side each.

        right : (unknowns, S), these right-hand sides.
        """
        factor, (unknowns, samples) = self.factor(right.shape[1]), right.shape
        np.take(right, self.pattern.order, axis=0, out=factor.solution[:unknowns, :samples], mode="clip")
        factor.substitute()
        return factor.solution[:, :samples].take(self.pattern.place, axis=0)

    def reserve(self) -> None:
        """Take the memory of a large factor before it is needed, and touch it in another thread, so that the system
        provides it. With one thread nothing happens."""
        if self.engine is Engine.CALLS and runtime.current().threads > 1:
            self.factor().reserve()

    def forget(self) -> None:
        """Give the memory of the factor back if it has more than tuning.LARGE_FACTOR_NUMBERS entries. The matrix has to
        be factorised anew before it is solved with again."""
        if self.pattern.factor_entries > tuning.LARGE_FACTOR_NUMBERS:
            for factor in self._factors.values():
                factor.forget()


class Factor(ABC):
    """Cholesky factors of one matrix, or of LANES matrices of one pattern; in shapes `samples` is 1 or LANES. The user
    writes `entries` and calls `factorise`, then writes right-hand sides and calls `substitute`.

    entries : (entries or more, samples) values of the matrices at the stored entries of the pattern.
    solution : (unknowns or more, samples) right-hand sides, and then solutions, in the pattern's order of elimination.
    """

    entries: np.ndarray
    solution: np.ndarray

    @abstractmethod
    def factorise(self) -> np.ndarray:
        """Factorise the matrices whose values are in `entries`; return a mask (samples,), True for matrices that are
        positive definite to working precision."""

    @abstractmethod
    def substitute(self) -> None:
        """Solve the factorised systems: replace the right-hand sides in `solution` by the solutions."""

    def reserve(self) -> None:  # noqa: B027
        """Take memory before it is needed; here all of it is taken already."""

    def forget(self) -> None:  # noqa: B027
        """Give memory back that others may take; here there is none."""


class DenseFactor(Factor):
    """Factor of one dense block, for small matrices: an elimination tree would cost more calls than it saves work."""

    def __init__(self, pattern: BlockPattern) -> None:
        """Reserve memory for one matrix of a dense pattern: its entries (size * size, 1), and right-hand side and
        solution (size, 1)."""
        self.entries, self.solution = np.zeros((max(1, pattern.entries), 1)), np.zeros((max(1, pattern.size), 1))
        self._size, self._factor = pattern.size, np.zeros((0, 0))

    def factorise(self) -> np.ndarray:
        """Factorise the matrix by LAPACK; return a mask (1,), True if it is positive definite."""
        look_up()
        if not self._size:
            return np.ones(1, dtype=bool)
        matrix = self.entries.reshape(self._size, self._size, order="F")
        self._factor, fault = LAPACK.dpotrf(matrix, lower=True, clean=False)
        return np.array([fault == 0])

    def substitute(self) -> None:
        """Replace the right-hand side in `solution` by the solution."""
        if self._size:
            self.solution[:, 0] = LAPACK.dpotrs(self._factor, self.solution[:, 0], lower=True)[0]


class SciPyFactor(Factor):
    """Factors of one matrix after the other by SuperLU, which needs no kernel."""

    def __init__(self, pattern: SparsePattern, lanes: int) -> None:
        """Reserve memory for some matrices of one pattern.

        pattern : the stored entries and the order of elimination.
        lanes : number of matrices.
        """
        # `entries` : values of the stored entries; `solution` : (unknowns, lanes), right-hand sides, then solutions
        self.entries, self.solution = np.zeros((pattern.entries, lanes)), np.zeros((pattern.size, lanes))
        self._pattern, self._factors = pattern, list[Any]()

    def factorise(self) -> np.ndarray:
        """Factorise each matrix; return a mask (lanes,), True for those that are positive definite."""
        pattern, self._factors = self._pattern, []
        for values in self.entries.T:
            look_up()
            lower = sparse.csc_array((values, (pattern.row, pattern.column)), shape=(pattern.size, pattern.size))
            symmetric = (lower + sparse.tril(lower, -1).T).tocsc()
            with suppress(RuntimeError):  # raised where a pivot is exactly zero
                factor = SPARSE.splu(symmetric, "NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
                if (factor.U.diagonal() > 0).all():
                    self._factors.append(factor)
                    continue
            self._factors.append(None)
        return np.array([factor is not None for factor in self._factors])

    def substitute(self) -> None:
        """Replace the right-hand sides in `solution` by the solutions; those of matrices that were not
        factorised stay."""
        for sample, factor in enumerate(self._factors):
            if factor is not None:
                self.solution[:, sample] = factor.solve(self.solution[:, sample])


class LaunchedFactor(Factor):
    """Factors of one matrix, or of LANES matrices, that a single kernel launch computes, front by front (a front is a
    dense block of unknowns that are eliminated together); another launch solves with them."""

    def __init__(self, pattern: Pattern, lanes: int) -> None:
        """Reserve memory and prepare the launches.

        pattern : the fronts (dense blocks of the sparse matrix) and the order of elimination.
        lanes : number of matrices, 1 or LANES, the number of lanes of a SIMD vector.
        """
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
        """Factorise the matrices in one launch; return a mask (lanes,), True for those that are positive definite."""
        look_up()
        self._eliminate()
        # sample by sample: NumPy takes five times as long over columns of an array with so short rows
        found: np.ndarray = np.isfinite(self._numbers.take(self._pivots, axis=0)).T.copy().all(axis=1)
        return found

    def substitute(self) -> None:
        """Replace the right-hand sides in `solution` by the solutions."""
        look_up()
        self._substitute()


class CalledFactor(Factor):
    """Factor of one large matrix, front by front (a front is a dense block of unknowns that are eliminated together): a
    kernel fills the fronts, LAPACK and BLAS eliminate them. Threads share the work."""

    def __init__(self, pattern: Pattern, memory: Memory) -> None:
        """Decide where all numbers lie; their memory is taken at the first factorisation.

        pattern : the fronts (dense blocks of the sparse matrix) and the order of elimination.
        memory : memory that this factor shares with others.
        """
        self._layout, self._memory, self._size = Layout(pattern, LANES, apart=True), memory, pattern.size
        self.entries, self._vector = np.zeros((pattern.entries, 1)), _vectors(self._layout.vector, 1)
        self.solution = self._vector[: pattern.size]
        # numbers of the factor; the batches of the elimination; the calls of a substitution, forward then backward
        self._numbers, self._work, self._halves = np.zeros(0), list[_BatchWork](), list[Callable[[], None]]()
        self._seen = -1  # `changes` of the memory when this factor took it

    def factorise(self) -> np.ndarray:
        """Factorise the matrix: assemble and eliminate its fronts (dense blocks), batch by batch.

        Returns a mask (1,) for the one matrix: True if it is positive definite.
        """
        self._take_memory()
        for work in self._work:
            look_up()
            work.assemble()
            if not work.eliminate():
                return np.zeros(1, dtype=bool)
        # Substitutions read reciprocals of pivots. Kernels store them so, LAPACK (called for large fronts) does not.
        called = self._layout.called_pivots
        inverse = 1 / self._numbers[called]
        self._numbers[called] = inverse
        # a number that is not finite in a branch makes a pivot of each front above it not finite
        return np.array([np.isfinite(inverse).all() and np.isfinite(self._numbers[self._layout.last_pivots]).all()])

    def _take_memory(self) -> None:
        """Take the shared memory, unless this factor still has it, and prepare all calls of elimination and
        substitution with addresses in it."""
        if self._seen == self._memory.changes:
            return
        layout, numbers = self._layout, self._taken_memory()
        self._seen = self._memory.changes
        if numbers is self._numbers:
            return
        self._numbers, arrays = numbers, (layout.tables, self.entries.ravel(), numbers, numbers.reshape(-1, LANES))
        # fronts that LAPACK and BLAS eliminate, by the addresses of their own columns and updates
        places = tuple(numbers.ctypes.data + DOUBLE_BYTES * of for of in (layout.columns, layout.diagonal))
        of_fronts = layout.own, layout.border, layout.height, layout.update_height, *places
        called = np.concatenate([batch.fronts for batch in layout.batches if not batch.whole] or [layout.own[:0]])
        fronts = {
            n: DenseFront(*front)
            for n, *front in zip(called.tolist(), *(of[called].tolist() for of in of_fronts), strict=True)
        }
        prepared(elimination.assemble, *arrays, 0, 0)  # compiles it, before large batches want it
        self._work = [
            _BatchWork(batch, [] if batch.whole else [fronts[n] for n in batch.fronts], arrays)
            for batch in layout.batches
        ]
        # a substitution: forward (1) through all stages of branches, then backward (0)
        memory = numbers, numbers.reshape(-1, LANES), self._vector.ravel(), self._vector.reshape(-1, LANES)
        halves = [(1, stage) for stage in layout.stages] + [(0, stage) for stage in reversed(layout.stages)]
        self._halves = [
            prepared(substitution.substitute_branches, layout.tables, *memory, forth, *stage) for forth, stage in halves
        ]

    def _taken_memory(self) -> np.ndarray:
        """Take the shared memory and return it, as many doubles as this factor needs or more; raise MemoryError if
        there are too few."""
        return self._memory.take(self, self._layout.size, f"the factorisation of {self._size:,} unknowns")

    def reserve(self) -> None:
        """Take the shared memory for the first factorisation, and touch it in a separate thread, so that the system
        provides it; that takes as long as a factorisation. Nothing happens if there is too little memory."""
        with suppress(MemoryError):
            Thread(target=provide, args=(self._taken_memory(),), daemon=True).start()

    def forget(self) -> None:
        """Give the memory back to the system."""
        self._memory.free()

    def let_go(self) -> None:
        """Forget the memory, which is being freed, and all calls that work in it."""
        self._numbers, self._work, self._halves = np.zeros(0), [], []

    def substitute(self) -> None:
        """Replace the right-hand side in `solution` by the solution. No other factor may have taken the shared memory
        since this matrix was factorised."""
        assert self._seen == self._memory.changes
        look_up()
        for start in self._halves:
            start()


def _vectors(count: int, lanes: int) -> np.ndarray:
    """Return zeros (count or more, lanes), rounded up to whole SIMD vectors, at an address that suits these.

    count : number of rows that are needed.
    lanes : numbers of a row, 1 or LANES.
    """
    count = -(-count * lanes // LANES) * LANES // lanes
    return aligned_zeros(count * lanes, LANES).reshape(count, lanes)


class _BatchWork:
    """A batch of independent fronts, and the tasks that eliminate them. A front is a dense block of a sparse matrix:
    unknowns that are eliminated together, and the later ones that they are coupled to.

    assemble : fills the fronts from the entries of the matrix and the updates of the fronts below.
    """

    def __init__(self, batch: Batch, fronts: list[DenseFront], arrays: tuple[np.ndarray, ...]) -> None:
        """Prepare assembly and tasks.

        batch : which fronts, and the work items that fill them (an item is some columns of one front).
        fronts : the eliminations of these fronts.
        arrays : three flat arrays, as kernels take them: tables of the layout (int32), entries of the matrix, and all
            doubles of the factor.
        """
        alone = batch.doubles < tuning.SHARED_ASSEMBLY_NUMBERS
        kernel = elimination.assemble_serially if alone else elimination.assemble
        self.assemble = prepared(elimination.eliminate_branches if batch.whole else kernel, *arrays, *batch.items)
        self._fronts, self._cost = fronts, sum(front.cost for front in fronts)
        tasks = [task for front in fronts for task in front.tasks()]
        self._tasks = [task.work for task in sorted(tasks, key=lambda task: (task.urgency, task.position))]

    def eliminate(self) -> bool:
        """Eliminate all fronts (dense blocks) of the batch, on several threads if that pays. Return False if a pivot is
        not positive."""
        for front in self._fronts:
            front.get_ready()
        threads = min(runtime.current().threads, len(self._tasks))
        if threads <= 1 or self._cost < tuning.SHARED_BATCH_OPERATIONS:
            return _do_tasks(self._tasks)
        queue = iter(self._tasks)  # shared
        others = [_pool().submit(_do_tasks, queue) for _ in range(threads - 1)]
        try:
            succeeded = _do_tasks(queue)
        except BaseException:
            list(queue)  # nobody works on a front once this is given up
            for front in self._fronts:
                front.stop()
            raise
        finally:
            others_succeeded = [other.result() for other in others]
        return min(succeeded, *others_succeeded)


def _do_tasks(tasks: Iterable[Callable[[], bool]]) -> bool:
    """Do the tasks that are left in a shared iterator; return False if any of them failed, as a pivot was not
    positive."""
    succeeded = True
    for task in tasks:
        look_up()
        succeeded &= task()
    return succeeded


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    """Return the threads that share the tasks, made once for the process."""
    return ThreadPoolExecutor(runtime.available_threads(), thread_name_prefix="cholesky")
