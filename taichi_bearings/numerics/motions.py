"""How many spins slip nowhere, and which unknowns to hold so that none is left: elimination that meets pivots of 0.

The matrix K^T K of a network is eliminated front by front in an order from the centres (Duff & Reid 1983), pivoting
within a front. Where no pivot is left in a front, its other unknowns can be anything: each is one slipless motion, and
held at 0 it leaves a network that has none. Rattlers, floating clusters, spheres whose contacts all have one direction
and mechanisms are all found so.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpstrf

from taichi_bearings.numerics.blas import one_thread

NO_PIVOT, SURELY_ONE = 1e-10, 1e-9  # squares of slips over spins: what is eliminated, and what is surely not rounding
SLIPLESS_SLIP, SOME_SLIP = 1e-13, 1e-11  # slips of a motion over its spins: up to which there is none, and surely one
PROBES, MOST_PROBED = 4, 4000  # sums of motions that are looked at first; motions that are looked at one by one
CHUNK_MOTIONS = 100  # at once
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

    decided : False where their slips are too close to the rounding to tell; counted : and where pivots are.
    largest_slip : of a motion, over its spins. smallest_kept : pivot.
    """

    held: np.ndarray
    decided: bool
    largest_slip: float
    smallest_kept: float
    fronts: tuple[_Front, ...]
    unknowns: int
    whole: bool = True  # False where some that elimination found slip

    @property
    def counted(self) -> bool:
        return self.decided and self.smallest_kept > SURELY_ONE

    @property
    def number(self) -> int:
        return len(self.held)

    def basis(self, shares: np.ndarray | None = None) -> np.ndarray:
        """The motions (unknowns, number), one for each unknown held: 1 there, 0 at the others; or sums with these
        shares (number, k) of them, (unknowns, k)."""
        shares = np.eye(len(self.held)) if shares is None else shares
        found = np.zeros((self.unknowns, shares.shape[1]))
        found[self.held] = shares
        for front in reversed(self.fronts):
            if len(front.kept):
                rest = found[np.concatenate([front.free, front.border])]
                found[front.kept] = -dtrsm(1.0, front.top, front.below.T @ rest, lower=1, trans_a=1)
        return found


Parts = list[tuple[np.ndarray, list[int]]]
"""Of a graph of spheres: numbers of the spheres and of the children of each."""


def slipless_motions(slips: sparse.csr_array, sphere: np.ndarray, parts: Parts) -> Motions:
    """The kernel of the slips (rows, unknowns) that spins make.

    sphere : (unknowns,) that each belongs to. parts : an order of the spheres, in which those of a contact are above
    each other.
    """
    if not slips.shape[1]:
        return Motions(np.zeros(0, dtype=np.int64), True, 0.0, np.inf, (), 0)
    matrix = (slips.T @ slips).tocsr()
    matrix.sort_indices()
    nodes, position = unknowns_of(sphere, parts), np.empty(matrix.shape[0], dtype=np.int64)
    position[np.concatenate(nodes)] = np.arange(matrix.shape[0])
    held, fronts, least = [], [], np.inf
    waiting: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for number, (own, (_, children)) in enumerate(zip(nodes, parts, strict=True)):
        with one_thread():
            front, update = _eliminated(matrix, position, own, [waiting.pop(child) for child in children])
        waiting[number] = (front.border, update)
        held.append(front.free)
        least = min(least, float(np.diagonal(front.top).min(initial=np.inf)) ** 2)
        fronts.append(front)
    numbers = np.sort(np.concatenate(held))
    return _looked_at(Motions(numbers, True, 0.0, least, tuple(fronts), matrix.shape[0]), slips)


def _looked_at(motions: Motions, slips: sparse.csr_array) -> Motions:
    """Without the motions that slip more than rounding makes them: pivots are squares and hide slips of 1e-8."""
    if not motions.number:
        return motions
    largest = _slips(motions, slips, np.random.default_rng(1).standard_normal((motions.number, PROBES))).max()
    if largest <= SLIPLESS_SLIP or motions.number > MOST_PROBED:
        return replace(motions, decided=motions.decided and largest <= SLIPLESS_SLIP, largest_slip=float(largest))
    parts = np.split(np.arange(motions.number), np.arange(CHUNK_MOTIONS, motions.number, CHUNK_MOTIONS))
    each = np.concatenate([_slips(motions, slips, np.eye(motions.number)[:, part]) for part in parts])
    clear = bool(((each <= SLIPLESS_SLIP) | (each > SOME_SLIP)).all())
    none = each <= SLIPLESS_SLIP
    return replace(
        motions, held=motions.held[none], decided=clear, largest_slip=float(each[none].max(initial=0.0)), whole=False
    )


def _slips(motions: Motions, slips: sparse.csr_array, shares: np.ndarray) -> np.ndarray:
    """Slips of sums of motions, (k,), over their spins."""
    spins = motions.basis(shares)
    return np.asarray(np.abs(slips @ spins).max(axis=0, initial=0.0) / np.abs(spins).max(axis=0))


def unknowns_of(sphere: np.ndarray, parts: Parts) -> list[np.ndarray]:
    """Numbers of the unknowns of each part."""
    order, own = np.concatenate([spheres for spheres, _ in parts]), [len(spheres) for spheres, _ in parts]
    place, part = np.empty(len(order), dtype=np.int64), np.repeat(np.arange(len(own)), own)
    place[order] = np.arange(len(order))
    by_place = np.argsort(place[sphere], kind="stable")
    return np.split(by_place, np.cumsum(np.bincount(part[place[sphere]], minlength=len(own)))[:-1])


def _eliminated(
    matrix: sparse.csr_array, position: np.ndarray, own: np.ndarray, updates: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[_Front, np.ndarray]:
    """A front, and what it leaves on its border."""
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
    outer = below[len(free) :]
    update = full[n:, n:] - outer @ outer.T
    return _Front(own[kept], own[free], border, top, below), update
