"""Numeric factorisation and solves: fronts assembled by Taichi, eliminated by LAPACK and BLAS on several threads."""

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels.assembly import assemble
from taichi_bearings.numerics.cholesky.dense import DenseFront, DenseSolve
from taichi_bearings.numerics.cholesky.dissection import Part
from taichi_bearings.numerics.cholesky.fronts import Front, analyse
from taichi_bearings.numerics.cholesky.storage import Storage

SERIAL = 20_000  # columns of a depth below which one worker assembles faster than a team
WORTH_A_SOLVE = 1_000_000  # entries of the factor from which subtrees are solved side by side
WORTH_A_THREAD = 3e6  # operations of a depth from which several threads share it


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
        self._fronts = [
            sorted((DenseFront(*storage.blocks[n]) for n in members), key=lambda front: -front.cost)
            for members in storage.members
        ]
        self._branches = self._make_branches()

    def _make_branches(self) -> list["_Branch"]:
        """The subtrees below the root, then the root: what comes before the last can be solved side by side."""
        fronts, blocks = self.pattern.fronts, self._storage.blocks
        longest = max(len(front.border) for front in fronts)
        root = len(fronts) - 1
        ends = [*sorted(child + 1 for child in fronts[root].children), root, root + 1]
        branches = []
        for begin, end in zip([0, *ends[:-1]], ends, strict=True):
            members = range(begin, end)
            if len(members):
                branches.append(_Branch([fronts[n] for n in members], [blocks[n] for n in members], longest, self.size))
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
        ends = [0, *storage.columns_end]
        for d in reversed(range(len(self._fronts))):
            look_up()
            assemble(ends[d + 1] - ends[d] < SERIAL, ends[d], ends[d + 1], storage.tables, storage.reals)
            if not _eliminate(self._fronts[d]):
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

    def __init__(self, fronts: list[Front], blocks: list, longest_border: int, size: int) -> None:
        self.first, self.end = fronts[0].first, fronts[-1].first + fronts[-1].own
        self.vector, work = np.zeros(size), np.zeros(max(longest_border, 1))
        self._solves = [
            DenseSolve(diagonal, below, self.vector, front.first, front.border, work)
            for front, (diagonal, below, _) in zip(fronts, blocks, strict=True)
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


def _eliminate(fronts: list[DenseFront]) -> bool:
    """Eliminate the fronts of one depth, on several threads if that pays; False if a pivot is not positive."""
    threads = min(runtime.current().threads, len(fronts))
    if threads == 1 or sum(front.cost for front in fronts) < WORTH_A_THREAD:
        return _eliminate_each(fronts)
    queue = iter(fronts)  # shared; heaviest first
    others = [_pool().submit(_eliminate_each, queue) for _ in range(threads - 1)]
    try:
        succeeded = _eliminate_each(queue)
    finally:
        list(queue)  # nobody works on a front once this is given up
        others_succeeded = [other.result() for other in others]
    return min(succeeded, *others_succeeded)


def _eliminate_each(fronts: Iterable[DenseFront]) -> bool:
    succeeded = True
    for front in fronts:
        look_up()
        succeeded &= front.eliminate()
    return succeeded


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(runtime.available_threads(), thread_name_prefix="cholesky")
