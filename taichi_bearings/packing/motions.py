"""How many spins slip nowhere, and which unknowns to hold so that none is left: elimination that meets pivots of 0.

The matrix K^T K of a network is eliminated front by front in an order from the centres (Duff & Reid 1983), pivoting
within a front. Where no pivot is left in a front, its other unknowns can be anything: each is one slipless motion, and
held at 0 it leaves a network that has none. Rattlers, floating clusters, spheres whose contacts all have one direction
and mechanisms are all found so.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpstrf

from taichi_bearings.dissection import dissected
from taichi_bearings.numerics.blas import one_thread

LEAF_SPHERES = 8
NO_PIVOT, SURELY_NONE, SURELY_ONE = 1e-10, 1e-12, 1e-8  # squares of slips over spins; between the last two: undecided
MOST_UNKNOWNS = 150_000  # for which elimination takes no more than minutes


@dataclass(frozen=True)
class _Front:
    """Own unknowns, with a pivot and without, and the factor's rows below: x[kept] = -solve(top^T, rest)."""

    kept: np.ndarray
    free: np.ndarray
    border: np.ndarray
    top: np.ndarray
    below: np.ndarray  # (len(free) + len(border), len(kept))


@dataclass(frozen=True)
class Motions:
    """Slipless motions. held : numbers of the unknowns that, held at 0, leave none; as many as there are motions.

    decided : False where pivots are too close to the rounding to tell. largest_dropped, smallest_kept : pivots.
    """

    held: np.ndarray
    decided: bool
    largest_dropped: float
    smallest_kept: float
    fronts: tuple[_Front, ...]
    unknowns: int

    @property
    def number(self) -> int:
        return len(self.held)

    def basis(self) -> np.ndarray:
        """The motions (unknowns, number), one for each unknown held: 1 there, 0 at the others."""
        found = np.zeros((self.unknowns, self.number))
        found[self.held, np.arange(self.number)] = 1.0
        for front in reversed(self.fronts):
            if len(front.kept):
                rest = found[np.concatenate([front.free, front.border])]
                found[front.kept] = -dtrsm(1.0, front.top, front.below.T @ rest, lower=1, trans_a=1)
        return found


def order_of(graph: sparse.csr_array, place: np.ndarray) -> list[tuple[np.ndarray, list[int]]]:
    """Parts of a graph of spheres (n, n) with places (n, D): numbers of the spheres and of the children of each."""
    return [(part.nodes, part.children) for part in dissected(graph.tocsr(), place.T, LEAF_SPHERES)]


def slipless_motions(slips: sparse.csr_array, sphere: np.ndarray, place: np.ndarray, keep: bool = False) -> Motions:
    """The kernel of the slips (rows, unknowns) that spins make.

    sphere : (unknowns,) that each belongs to. place : (spheres, D). keep : what :meth:`Motions.basis` needs.
    """
    if not slips.shape[1]:
        return Motions(np.zeros(0, dtype=np.int64), True, 0.0, np.inf, (), 0)
    matrix = (slips.T @ slips).tocsr()
    matrix.sort_indices()
    own_of = _unknowns_of(sphere, len(place))
    graph = touching(matrix, sphere, len(place))
    parts, position = order_of(graph, place), np.empty(matrix.shape[0], dtype=np.int64)
    nodes = [np.concatenate([own_of[i] for i in own] or [np.zeros(0, np.int64)]) for own, _ in parts]
    position[np.concatenate(nodes)] = np.arange(matrix.shape[0])
    held, fronts, dropped, least = [], [], 0.0, np.inf
    waiting: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for number, (own, (_, children)) in enumerate(zip(nodes, parts, strict=True)):
        with one_thread():
            front, update, lost = _eliminated(matrix, position, own, [waiting.pop(child) for child in children])
        waiting[number] = (front.border, update)
        held.append(front.free)
        dropped = max(dropped, lost)
        least = min(least, float(np.diagonal(front.top).min(initial=np.inf)) ** 2)
        if keep:
            fronts.append(front)
    decided = dropped < SURELY_NONE and least > SURELY_ONE
    numbers = np.sort(np.concatenate(held)) if held else np.zeros(0, dtype=np.int64)
    return Motions(numbers, decided, dropped, least, tuple(fronts), matrix.shape[0])


def touching(matrix: sparse.csr_array, sphere: np.ndarray, spheres: int) -> sparse.csr_array:
    """Graph of the spheres whose unknowns a matrix couples, (spheres, spheres), without loops."""
    entries = matrix.tocoo()
    row, column = sphere[entries.row], sphere[entries.col]
    apart = row != column
    ones = np.ones(int(apart.sum()), dtype=np.int8)
    graph = sparse.csr_array((ones, (row[apart], column[apart])), shape=(spheres, spheres))
    graph.sum_duplicates()
    graph.sort_indices()
    return graph


def _unknowns_of(sphere: np.ndarray, spheres: int) -> list[np.ndarray]:
    order = np.argsort(sphere, kind="stable")
    return np.split(order, np.cumsum(np.bincount(sphere, minlength=spheres))[:-1])


def _eliminated(
    matrix: sparse.csr_array, position: np.ndarray, own: np.ndarray, updates: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[_Front, np.ndarray, float]:
    """A front, what it leaves on its border, and the largest pivot that counted as 0."""
    begin, end = matrix.indptr[own], matrix.indptr[own + 1]
    rows = [matrix.indices[a:b] for a, b in zip(begin, end, strict=True)]
    start, last = (int(position[own[0]]), int(position[own[-1]])) if len(own) else (0, -1)
    seen = np.unique(np.concatenate([*rows, *(border for border, _ in updates), np.zeros(0, np.int64)]))
    border = seen[position[seen] > last]
    both = np.concatenate([own, border])
    order = np.argsort(both)
    full = np.zeros((len(both), len(both)))
    find = lambda wanted: order[np.searchsorted(both, wanted, sorter=order)]  # noqa: E731
    for local, (columns, a, b) in enumerate(zip(rows, begin, end, strict=True)):
        later = position[columns] >= start
        full[find(columns[later]), local] += matrix.data[a:b][later]
    n = len(own)
    full[:n, n:] = full[n:, :n].T
    for there, update in updates:
        at = find(there)
        full[np.ix_(at, at)] += update
    factor, pivot, rank, _ = (
        dpstrf(full[:n, :n], lower=1, tol=NO_PIVOT) if n else (full[:0, :0], np.zeros(0, int), 0, 0)
    )
    pivot = np.asarray(pivot) - 1
    kept, free = pivot[:rank], pivot[rank:]
    top = np.tril(factor[:rank, :rank])
    rest = np.concatenate([free, np.arange(n, len(both))]).astype(np.int64)
    below = dtrsm(1.0, top, full[np.ix_(kept, rest)], lower=1).T if rank else np.zeros((len(rest), 0))
    lost = full[free, free] - (below[: len(free)] ** 2).sum(axis=1)
    outer = below[len(free) :]
    update = full[n:, n:] - outer @ outer.T
    front = _Front(own[kept], own[free], border, top, below)
    return front, update, float(np.abs(lost).max(initial=0.0))
