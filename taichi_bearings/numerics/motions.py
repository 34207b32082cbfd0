"""Counts motions of spheres at which nothing slips, and says which unknowns to hold so that none is left.

Let K be the matrix that gives the slips of all contacts from the spins (the unknowns). Its kernel is the space of
slipless motions. K^T K is eliminated front by front, in an order that follows from the centres of the spheres
(multifrontal method, Duff & Reid 1983), with pivoting within a front. Unknowns of a front for which no pivot is left
can have any value: each gives one slipless motion, and with all of them held at 0 the network has none. This finds
rattlers, floating clusters, spheres whose contacts all have one direction, and mechanisms.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from taichi_bearings.numerics.blas import BLAS, LAPACK, one_thread

# Pivots are squares of slips over spins. Up to NO_PIVOT they count as 0; above SURELY_ONE they surely are not 0.
NO_PIVOT, SURELY_ONE = 1e-10, 1e-9
# Largest slip of a motion over its largest spin: up to SLIPLESS_SLIP it is rounding, above SOME_SLIP surely not.
SLIPLESS_SLIP, SOME_SLIP = 1e-13, 1e-11
PROBES = 4  # random sums of motions whose slips are computed first
MOST_PROBED = 4000  # if some of these slip, the slips of up to so many single motions are computed
CHUNK_MOTIONS = 100  # motions whose slips are computed together
MOST_UNKNOWNS = 150_000  # with more unknowns elimination takes more than minutes


@dataclass(frozen=True)
class _Front:
    """The result of eliminating one front, a set of unknowns that are eliminated together. In a motion x without slip
    the unknowns `kept` follow from the others: x[kept] = -solve(top^T, below^T x[free and border]).

    kept, free : numbers of the unknowns of the front that have a pivot, and of those that have none and can have any
        value.
    border : numbers of the later unknowns that those of the front are coupled to.
    top : Cholesky factor (kept, kept), lower triangle, of the block of the unknowns with a pivot.
    below : (free + border, kept), the rows of the factor below it.
    """

    kept: np.ndarray
    free: np.ndarray
    border: np.ndarray
    top: np.ndarray
    below: np.ndarray


@dataclass(frozen=True)
class Motions:
    """Slipless motions of the spheres of a network: changes of the spins (unknowns) at which no contact slips.

    held : numbers of some unknowns, as many as there are independent motions; with these held at 0 there is none.
    decided : True if the slips of each motion that the elimination found are clearly rounding, or clearly not.
    largest_slip : largest slip of a motion over its largest spin; it is rounding alone if `decided` is True.
    smallest_kept : smallest pivot that was not taken as 0: the square of a slip over a spin.
    fronts : the results of the elimination, from which `basis` computes the motions.
    unknowns : number of unknowns.
    whole : False if some motions that the elimination found do slip, and were left out.
    """

    held: np.ndarray
    decided: bool
    largest_slip: float
    smallest_kept: float
    fronts: tuple[_Front, ...]
    unknowns: int
    whole: bool = True

    @property
    def number_is_certain(self) -> bool:
        """True if the number of motions is certain: their slips and all pivots are clear of rounding."""
        return self.decided and self.smallest_kept > SURELY_ONE

    @property
    def number(self) -> int:
        """Number of independent slipless motions."""
        return len(self.held)

    def basis(self, shares: np.ndarray | None = None) -> np.ndarray:
        """Return the slipless motions, one in each column, (unknowns, number): each is 1 at one of the unknowns `held`,
        and 0 at the others of them.

        shares : (number, sums), or None. If given, sums of the motions with these coefficients are returned instead,
            (unknowns, sums).
        """
        shares = np.eye(len(self.held)) if shares is None else shares
        found = np.zeros((self.unknowns, shares.shape[1]))
        found[self.held] = shares
        for front in reversed(self.fronts):
            if len(front.kept):
                rest = found[np.concatenate([front.free, front.border])]
                found[front.kept] = -BLAS.dtrsm(1.0, front.top, front.below.T @ rest, lower=1, trans_a=1)
        return found


Parts = list[tuple[np.ndarray, list[int]]]
"""Parts of an elimination order: the numbers of the spheres in each part, and the parts that are its children."""


def slipless_motions(slips: sparse.csr_array, sphere: np.ndarray, parts: Parts) -> Motions:
    """Return all motions of the spheres of a network at which no contact slips: the kernel of the matrix that gives
    slips from spins.

    slips : (rows, unknowns) that matrix; an unknown is a component of the spin of a free sphere.
    sphere : (unknowns,) sphere that each unknown belongs to.
    parts : order of elimination of the spheres, a tree with children first: for each part the numbers of its spheres
        and of its child parts. Two spheres in contact are in one part, or one is in a part above that of the other.
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
    return _without_slipping_motions(Motions(numbers, True, 0.0, least, tuple(fronts), matrix.shape[0]), slips)


def _without_slipping_motions(motions: Motions, slips: sparse.csr_array) -> Motions:
    """Return the motions without those that really slip. Elimination finds motions by pivots below NO_PIVOT. As pivots
    are squares of slips over spins, slips of these motions may be up to about 1e-5 times their spins.

    To save time the slips of PROBES random sums of all motions are computed first. If all are rounding, nothing is left
    out. Else the slips of each motion are computed, and motions with slips above SLIPLESS_SLIP times their largest spin
    are left out; the result has `decided` False if some slip lies between SLIPLESS_SLIP and SOME_SLIP. With more than
    MOST_PROBED motions nothing is left out, and `decided` is False.

    motions : as the elimination has found them.
    slips : (rows, unknowns), the matrix from spins to slips.
    """
    if not motions.number:
        return motions
    largest = _relative_slips(motions, slips, np.random.default_rng(1).standard_normal((motions.number, PROBES))).max()
    if largest <= SLIPLESS_SLIP or motions.number > MOST_PROBED:
        return replace(motions, decided=motions.decided and largest <= SLIPLESS_SLIP, largest_slip=float(largest))
    parts = np.split(np.arange(motions.number), np.arange(CHUNK_MOTIONS, motions.number, CHUNK_MOTIONS))
    each = np.concatenate([_relative_slips(motions, slips, np.eye(motions.number)[:, part]) for part in parts])
    clear = bool(((each <= SLIPLESS_SLIP) | (each > SOME_SLIP)).all())
    none = each <= SLIPLESS_SLIP
    return replace(
        motions, held=motions.held[none], decided=clear, largest_slip=float(each[none].max(initial=0.0)), whole=False
    )


def _relative_slips(motions: Motions, slips: sparse.csr_array, shares: np.ndarray) -> np.ndarray:
    """Return (sums,) the largest slip of each of some sums of motions, over its largest spin.

    motions : motions at which contacts do not slip, or hardly.
    slips : (rows, unknowns), the matrix from spins to slips.
    shares : (motions, sums), the coefficients with which the motions are added.
    """
    spins = motions.basis(shares)
    return np.asarray(np.abs(slips @ spins).max(axis=0, initial=0.0) / np.abs(spins).max(axis=0))


def unknowns_of(sphere: np.ndarray, parts: Parts) -> list[np.ndarray]:
    """Return the numbers of the unknowns of each part of an elimination order, one array for each part.

    sphere : (unknowns,) number of the sphere that each unknown belongs to.
    parts : for each part, children first, the numbers of its spheres and of its child parts.
    """
    order, own = np.concatenate([spheres for spheres, _ in parts]), [len(spheres) for spheres, _ in parts]
    place, part = np.empty(len(order), dtype=np.int64), np.repeat(np.arange(len(own)), own)
    place[order] = np.arange(len(order))
    by_place = np.argsort(place[sphere], kind="stable")
    return np.split(by_place, np.cumsum(np.bincount(part[place[sphere]], minlength=len(own)))[:-1])


def _eliminated(
    matrix: sparse.csr_array, position: np.ndarray, own: np.ndarray, updates: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[_Front, np.ndarray]:
    """Eliminate the own unknowns of one front, by pivoted Cholesky factorisation. A front is a dense symmetric matrix
    of its own unknowns and its border, the later unknowns that they are coupled to.

    matrix : (unknowns, unknowns), K^T K, where the matrix K gives slips from spins.
    position : (unknowns,) place of each in the order of elimination.
    own : (own unknowns,), their numbers.
    updates : for each front below this one its border, and the matrix (border, border) that it adds there.
    returns : the front, and the matrix that its elimination adds to that of its border (the Schur complement).
    """
    # border: later unknowns that own ones, or those of the children, are coupled to
    begin, end = matrix.indptr[own], matrix.indptr[own + 1]
    rows = [matrix.indices[a:b] for a, b in zip(begin, end, strict=True)]
    start, last = (int(position[own[0]]), int(position[own[-1]])) if len(own) else (0, -1)
    seen = np.unique(np.concatenate([*rows, *(border for border, _ in updates), np.zeros(0, np.int64)]))
    border = seen[position[seen] > last]
    both = np.concatenate([own, border])
    order = np.argsort(both)
    # dense matrix of own and border: entries of K^T K, then what the children left
    full = np.zeros((len(both), len(both)))

    def find(wanted: np.ndarray) -> np.ndarray:
        """Return (n,), the row in the dense matrix `full` of each of the n unknowns whose numbers are `wanted`."""
        return order[np.searchsorted(both, wanted, sorter=order)]

    for local, (columns, a, b) in enumerate(zip(rows, begin, end, strict=True)):
        later = position[columns] >= start
        full[find(columns[later]), local] += matrix.data[a:b][later]
    n = len(own)
    full[:n, n:] = full[n:, :n].T
    for there, update in updates:
        at = find(there)
        full[np.ix_(at, at)] += update
    # pivoted Cholesky of the own block, up to its rank; then the Schur complement of the border
    factor, pivot, rank, _ = (
        LAPACK.dpstrf(full[:n, :n], lower=1, tol=NO_PIVOT) if n else (full[:0, :0], np.zeros(0, int), 0, 0)
    )
    pivot = np.asarray(pivot) - 1
    kept, free = pivot[:rank], pivot[rank:]
    top = np.tril(factor[:rank, :rank])
    rest = np.concatenate([free, np.arange(n, len(both))]).astype(np.int64)
    below = BLAS.dtrsm(1.0, top, full[np.ix_(kept, rest)], lower=1).T if rank else np.zeros((len(rest), 0))
    outer = below[len(free) :]
    update = full[n:, n:] - outer @ outer.T
    return _Front(own[kept], own[free], border, top, below), update
