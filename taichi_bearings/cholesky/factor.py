"""Numeric factorisation and solves: fronts assembled by Taichi, eliminated by LAPACK and BLAS on several threads."""

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np
from scipy.linalg import blas

from taichi_bearings import runtime
from taichi_bearings.cholesky.dense import DenseFront
from taichi_bearings.cholesky.dissection import Part
from taichi_bearings.cholesky.fronts import analyse
from taichi_bearings.cholesky.storage import Storage
from taichi_bearings.kernels.assembly import assemble

SERIAL = 20_000  # columns of a depth below which one worker assembles faster than a team
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
        self._steps = [  # in the order of elimination: diagonal, below, own unknowns, border
            (diagonal, below, slice(front.first, front.first + front.own), front.border)
            for front, (diagonal, below, _) in zip(self.pattern.fronts, storage.blocks, strict=True)
            if front.own
        ]

    def factorise(self, values: np.ndarray) -> None:
        """Factorise the matrix with these values at the entries of the pattern.

        Raises NotPositiveDefinite if a pivot is not positive.
        """
        storage = self._storage
        storage.values[:] = values
        ends = [0, *storage.columns_end]
        for d in reversed(range(len(self._fronts))):
            assemble(ends[d + 1] - ends[d] < SERIAL, ends[d], ends[d + 1], storage.tables, storage.reals)
            if not _eliminate(self._fronts[d]):
                raise NotPositiveDefinite

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for one right-hand side, (size,)."""
        x = right[self.pattern.order]
        for diagonal, below, own, border in self._steps:
            x[own] = part = blas.dtrsv(diagonal, x[own], lower=1, overwrite_x=1)
            if len(border):
                x[border] -= below @ part
        for diagonal, below, own, border in reversed(self._steps):
            part = x[own] - x[border] @ below if len(border) else x[own]
            x[own] = blas.dtrsv(diagonal, part, lower=1, trans=1, overwrite_x=1)
        solution = np.empty_like(x)
        solution[self.pattern.order] = x
        return solution


def _eliminate(fronts: list[DenseFront]) -> bool:
    """Eliminate the fronts of one depth, on several threads if that pays; False if a pivot is not positive."""
    threads = min(runtime.current().threads, len(fronts))
    if threads == 1 or sum(front.cost for front in fronts) < WORTH_A_THREAD:
        return _eliminate_each(fronts)
    queue = iter(fronts)  # shared; heaviest first
    others = [_pool().submit(_eliminate_each, queue) for _ in range(threads - 1)]
    succeeded = _eliminate_each(queue)
    return min([succeeded, *(other.result() for other in others)])


def _eliminate_each(fronts: Iterable[DenseFront]) -> bool:
    succeeded = True
    for front in fronts:
        succeeded &= front.eliminate()
    return succeeded


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, runtime.available_threads() - 1), thread_name_prefix="cholesky")
