"""Solves with a factor: branches of the elimination tree at once, then what is above them, level by level."""

from collections.abc import Callable

import numpy as np

from taichi_bearings.kernels import substitution as kernels
from taichi_bearings.kernels.elimination import LANES
from taichi_bearings.kernels.substitution import WIDTH
from taichi_bearings.launch import prepared
from taichi_bearings.memory import aligned_zeros
from taichi_bearings.numerics.cholesky.fronts import Pattern

BRANCH = 1 / 16  # of the factor, which a branch has at most; they do not depend on the number of threads


class Substitution:
    """Forward and backward substitution with factors of this pattern."""

    def __init__(self, pattern: Pattern, columns: np.ndarray) -> None:
        """columns : (fronts,) places of the own columns of the fronts among the numbers of a factor."""
        fronts, kin = pattern.fronts, pattern.kin
        own = np.array([front.own for front in fronts])
        border = np.array([len(front.border) for front in fronts])
        room = -(-(own + border) // LANES) * LANES
        table = np.full((len(fronts), WIDTH), -1, dtype=np.int64)
        table[:, kernels.OWN], table[:, kernels.HEIGHT], table[:, kernels.COLUMNS] = own, own + border, columns
        table[:, kernels.VECTOR], table[:, kernels.MAP] = np.cumsum(room) - room, np.cumsum(border) - border
        table[:, kernels.FIRST] = [front.first for front in fronts]
        table[:, [kernels.CHILD, kernels.SIBLING]] = np.where(kin >= 0, kin * WIDTH, -1)
        for number, front in enumerate(fronts):
            table[list(front.children), kernels.PARENT] = number * WIDTH
        stages = _stages(pattern)
        branches = np.concatenate(stages)
        ends = np.cumsum([len(stage) for stage in stages]).tolist()
        self._stages = list(zip([0, *ends[:-1]], ends, strict=True))
        parts = [table.ravel(), branches.ravel(), pattern.order, *(front.place_in_parent for front in fronts)]
        self._tables = np.concatenate(parts).astype(np.int32)
        self._begins = np.cumsum([part.size for part in parts[:3]]).tolist()
        self._room, self._unknowns = int(room.sum()), pattern.size

    def of(self, factor: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Gives solutions (unknowns,) for right-hand sides (unknowns,), with the numbers that then are in `factor`."""
        solution, vector = np.zeros(self._unknowns), aligned_zeros(self._room, LANES)
        numbers = factor, solution, vector, vector.reshape(-1, LANES)
        starts = [
            prepared(kernels.substitute, forth, self._tables, begin, end, *self._begins, *numbers)
            for forth in (1, 0)
            for begin, end in (self._stages if forth else reversed(self._stages))
        ]

        def solve(right: np.ndarray) -> np.ndarray:
            solution[:] = right
            for start in starts:
                start()
            return solution.copy()

        return solve


def _stages(pattern: Pattern) -> list[np.ndarray]:
    """Branches (n, 2), first front and end of each, that can be solved at once; stage by stage, children first."""
    fronts = pattern.fronts
    entries = np.array([front.own * (front.own + len(front.border)) for front in fronts])
    within, begin = entries.copy(), np.arange(len(fronts))
    for number, front in enumerate(fronts):  # children come first, right before their parent
        for child in front.children:
            within[number] += within[child]
            begin[number] = min(begin[number], begin[child])
    small = within <= BRANCH * entries.sum()
    parent = {child: number for number, front in enumerate(fronts) for child in front.children}
    whole = [n for n in range(len(fronts)) if small[n] and not (n in parent and small[parent[n]])]
    depth = np.array([front.depth for front in fronts])
    above = [np.flatnonzero(~small & (depth == level)) for level in range(int(depth[~small].max(initial=-1)), -1, -1)]
    stages = [np.array([[begin[n], n + 1] for n in whole]), *(np.stack([n, n + 1], axis=1) for n in above)]
    return [stage for stage in stages if len(stage)]
