"""Elimination (Cholesky factorisation) of a sparse symmetric matrix, and a proven bound on its rounding. It proves the
floors of eigenvalues in theorems 2 and 7.

How. If floating point finds a factor L of A - shift, with positive pivots, then L L^T is positive, and a theorem of
Higham bounds how far L L^T is from A - shift. So no eigenvalue of A is below the shift less this distance.

Example. A = [[2, -1], [-1, 2]] has the eigenvalues 1 and 3. With shift 0.9 the pivots are 1.1 and 1.1 - 1 / 1.1 = 0.19,
both positive, so no eigenvalue is below 0.9 but for rounding of some 1e-16. With shift 1.1 the second pivot is 0.9 - 1
/ 0.9 < 0: nothing is proven.

The unknowns are ordered by nested dissection and eliminated front by front (multifrontal: Liu, SIAM Review 34, 1992). A
*front* is a group of unknowns that are eliminated together in a dense matrix. Its *border* are the later unknowns to
which elimination connects them; the front passes an update to these, which its parent front adds.

Symbols: n unknowns; L the factor, lower triangular; EPS = 2^-52, twice the largest relative error of an operation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.dissection import Part, dissected
from taichi_bearings.numerics.blas import BLAS, LAPACK
from taichi_bearings.proof.enclosure import UP

EPS = np.finfo(np.float64).eps
# numbers of unknowns up to which a region is not divided, and a connected piece of the graph is not: samples of 10^3
# spheres have pieces of some 200, and to divide these takes longer than it spares
REGION_UNKNOWNS, WHOLE_UNKNOWNS = 150, 450
MOST_RUNS = 12  # groups of rows that follow each other, up to which an update is added group by group
ADDED_COLUMNS = 256  # columns of an update that are added at once, from the first one's diagonal down
Columns = tuple[np.ndarray, np.ndarray]
"""Columns of the factor for the own unknowns of a front: their rows (own, own), and those of its border (border,
own)."""


@dataclass(frozen=True)
class Samples:
    """The R samples to which n unknowns belong that are eliminated together.

    of : (n,), the number of the sample of each unknown.
    count : R."""

    of: np.ndarray
    count: int

    @classmethod
    def one(cls, unknowns: int) -> Samples:
        """Return the object for n unknowns that all belong to one sample.

        unknowns : n."""
        return cls(np.zeros(unknowns, dtype=np.intp), 1)

    def largest(self, values: np.ndarray) -> np.ndarray:
        """Return for each of R samples the largest (R,) of the values (n,) that belong to its unknowns; 0 if none is
        above 0."""
        if self.count == 1:
            return np.array([values.max(initial=0.0)])
        found = np.zeros(self.count)
        np.maximum.at(found, self.of, values)
        return found

    def norms(self, values: np.ndarray) -> np.ndarray:
        """Return for each of R samples the Euclidean norm (R,) of the values (n,) that belong to its unknowns."""
        return np.sqrt(np.bincount(self.of, values**2, self.count))

    @property
    def rank(self) -> np.ndarray:
        """(n,), for each unknown how many unknowns of its sample come before it."""
        order, size = np.argsort(self.of, kind="stable"), np.bincount(self.of, minlength=self.count)
        found = np.empty(len(order), dtype=np.intp)
        found[order] = np.arange(len(order)) - np.repeat(np.cumsum(size) - size, size)
        return found


@dataclass(frozen=True)
class Front:
    """A group of unknowns that are eliminated together, in a dense matrix. Here the number of an unknown is its place
    in the order of elimination.

    first, own : the front eliminates the unknowns first ... first + own - 1, `own` of them.
    border : the later unknowns, ascending, that are coupled to these once all earlier ones are eliminated.
    children : indices of the earlier fronts whose update, their effect on the matrix of later unknowns, is added to
        this front."""

    first: int
    own: int
    border: np.ndarray
    children: list[int]

    @cached_property
    def places(self) -> np.ndarray:
        """(own + border,), places in the order of elimination of the rows of the dense matrix of the front: first the
        unknowns that it eliminates, then its border, the later unknowns to which they are coupled."""
        return np.append(np.arange(self.first, self.first + self.own), self.border)


@dataclass(frozen=True)
class Elimination:
    """How to eliminate a symmetric matrix (n, n), or the matrix less any multiple of the identity, group by group. A
    group of unknowns that are eliminated together is a front; what it changes in the matrix of later unknowns is added
    to a later front, its parent.

    order : (n,), the unknown at each place of the order of elimination.
    lower : lower triangle of the matrix in this order.
    fronts : all fronts, children before parents.
    samples : the R samples to which the unknowns belong; the matrix does not couple them."""

    order: np.ndarray
    lower: sparse.csc_array
    fronts: list[Front]
    samples: Samples

    @classmethod
    def of(
        cls,
        matrix: sparse.csc_array,
        place: np.ndarray,
        parts: list[Part] | None = None,
        samples: Samples | None = None,
    ) -> Elimination:
        """Return an order of elimination of the n unknowns of a matrix, in fronts: groups of unknowns that are
        eliminated together. Nothing is eliminated yet.

        matrix : (n, n), symmetric.
        place : (d, n), position of each unknown in d dimensions, by which nested dissection divides them.
        parts : the unknowns in groups that are eliminated one after the other; None to divide the graph of the matrix.
        samples : the sample of each unknown; None for a single sample."""
        samples = Samples.one(len(place[0])) if samples is None else samples
        parts = dissected(matrix, place, REGION_UNKNOWNS, WHOLE_UNKNOWNS) if parts is None else parts
        order = np.concatenate([part.nodes for part in parts])
        lower = _lower_triangle(matrix[order][:, order])
        fronts: list[Front] = []
        touched = np.zeros(len(order), dtype=bool)
        # The border of a front: what its columns of the matrix and the borders of its children touch beyond it.
        for part, end in zip(parts, np.cumsum([len(part.nodes) for part in parts]).tolist(), strict=True):
            first = end - len(part.nodes)
            rows = [lower.indices[lower.indptr[first] : lower.indptr[end]]]
            for found in rows + [fronts[child].border for child in part.children]:
                touched[found] = True
            border = end + np.flatnonzero(touched[end:])
            touched[border] = touched[first:end] = False
            fronts.append(Front(first, end - first, border, part.children))
        _refuse_disorder(order, fronts)
        return cls(order, lower, fronts, samples)

    @property
    def size(self) -> int:
        """The number n of unknowns."""
        return len(self.order)

    def in_units(self, unit: np.ndarray) -> Elimination:
        """Return the elimination of the same matrix in other units of the unknowns: each entry is multiplied by those
        of its row and of its column.

        unit : (n,), powers of two, so that nothing is rounded."""
        own, lower = unit[self.order], self.lower
        data = lower.data * own[lower.indices] * np.repeat(own, np.diff(lower.indptr))
        scaled = sparse.csc_array((data, lower.indices, lower.indptr), shape=lower.shape)
        return Elimination(self.order, scaled, self.fronts, self.samples)

    def columns(
        self, shift: float | np.ndarray, least: float = 0.0, held: np.ndarray | None = None
    ) -> Iterator[tuple[Front, Columns | None]]:
        """Factorise the matrix less `shift` times the identity, and yield each front (group of unknowns that are
        eliminated together) with its columns of the Cholesky factor, or with None if a pivot is not positive. All later
        columns of that sample are then meaningless.

        shift : a number, or one for each sample, (R,).
        least : smallest pivot that is accepted if `held` is given; else not used.
        held : None, or a mask (n,) in the order of elimination, which is written: True for each unknown whose pivot
            would be `least` or less. It is taken out of the matrix, as if its value were 0.
        """
        shifts = np.broadcast_to(shift, self.samples.count)[self.samples.of[self.order]]
        updates: dict[int, np.ndarray] = {}
        local = np.empty(self.size, dtype=np.int64)
        for number, front in enumerate(self.fronts):
            places = front.places
            local[places] = np.arange(len(places))
            pivots, below, rest = self._assembled(front, local, shifts)
            # Add the updates of the children, eliminate the own unknowns, and leave the update for the parent.
            for child in front.children:
                at, update = local[self.fronts[child].border], updates.pop(child)
                own = np.searchsorted(at, front.own)
                _add_at(pivots, at[:own], at[:own], update[:own, :own])
                _add_at(below, at[own:] - front.own, at[:own], update[own:, :own])
                for begin in range(own, len(at), ADDED_COLUMNS):  # the lower triangle is enough
                    columns = slice(begin, begin + ADDED_COLUMNS)
                    _add_at(rest, at[begin:] - front.own, at[columns] - front.own, update[begin:, columns])
            if held is not None:
                _, order, rank, _ = LAPACK.dpstrf(pivots, tol=least, lower=True)
                out = order[rank:] - 1
                pivots[out], pivots[:, out], pivots[out, out], below[:, out] = 0.0, 0.0, 1.0, 0.0
                held[front.first + out] = True
            pivots, fault = LAPACK.dpotrf(pivots, lower=True, overwrite_a=True)
            if below.size and not fault:
                below = BLAS.dtrsm(1.0, pivots, below, side=1, lower=1, trans_a=1, overwrite_b=True)
                rest = BLAS.dsyrk(-1.0, below, 1.0, rest, lower=1, overwrite_c=True)
            updates[number] = rest
            yield front, None if fault else (pivots, below)

    def _assembled(
        self, front: Front, local: np.ndarray, shifts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the lower triangle of the dense matrix in which a front is eliminated, before its children are added,
        as three blocks: own by own unknowns, border by own, and border by border (later unknowns). It has the matrix
        entries of the columns of its own unknowns, less the shift on their diagonal.

        front : the group of unknowns.
        local : (n,), row within the front of each place in the order of elimination; only those of the front count.
        shifts : (n,), what is subtracted from the diagonal at each place."""
        begin = self.lower.indptr[front.first : front.first + front.own + 1]
        at, own, border = slice(begin[0], begin[-1]), np.arange(front.own), len(front.border)
        pivots, below, rest = (
            np.zeros(shape, order="F") for shape in ((front.own, front.own), (border, front.own), (border, border))
        )
        row, column, value = local[self.lower.indices[at]], np.repeat(own, np.diff(begin)), self.lower.data[at]
        inside = row < front.own
        pivots[row[inside], column[inside]] = value[inside]
        below[row[~inside] - front.own, column[~inside]] = value[~inside]
        pivots[own, own] -= shifts[front.first : front.first + front.own]
        return pivots, below, rest

    def distance_from_positive(self, shift: float | np.ndarray) -> np.ndarray:
        """Return for each of R samples a bound (R,) on the rounding of its elimination: on the spectral norm of A -
        shift - L L^T, with the matrix A of the sample and the Cholesky factor L that is computed. It is infinite if a
        pivot is not positive. As L L^T has no negative eigenvalue, no eigenvalue of A is below the shift less this
        bound.

        shift : a number, or one for each sample, (R,).

        Proof. Entry (i, j) of this difference is at most gamma_ij times that of |L| |L|^T, with gamma_ij = t EPS / (1 -
        t EPS) for a sum of t terms in any order (Higham, Accuracy and Stability of Numerical Algorithms, 2002, theorem
        10.3). The sum has a term for each unknown at which both rows i and j of L may differ from 0. That is no more
        than the t_i terms of row i alone, or the t_j of row j: gamma_ij <= (gamma_i gamma_j)^1/2. (Fronts add updates
        that have 0 at some entries; adding 0 rounds nothing.) So the difference is at most W W^T, where row i of W is
        that of |L| times gamma_i^1/2. As W has no negative entries, the norm of W W^T is at most its largest row sum.
        """
        # t_i of each row: the number of its entries in L, and two more.
        terms = np.full(self.size, 2)
        for front in self.fronts:
            terms[front.first : front.first + front.own] += np.arange(1, front.own + 1)
            terms[front.border] += front.own
        gamma = terms * EPS / (1 - terms * EPS) + 8 * EPS  # 8 EPS more than the theorem asks for
        root, total = np.sqrt(gamma), np.zeros(self.size)
        failed = np.zeros(self.samples.count, dtype=bool)
        for front, columns in self.columns(shift):
            if columns is None:
                failed[self._sample_of(front)] = True
                if failed.all():
                    break
                continue
            sizes, own = [np.abs(part) for part in columns], slice(front.first, front.first + front.own)
            carried = root[own] @ sizes[0] + root[front.border] @ sizes[1]
            total[own] += sizes[0] @ carried
            total[front.border] += sizes[1] @ carried
        found = np.empty_like(total)
        found[self.order] = root * total
        return np.where(failed, np.inf, self.samples.largest(found) * UP)

    def _sample_of(self, front: Front) -> int:
        """Return the number of the sample to which all own unknowns of a front belong."""
        return int(self.samples.of[self.order[front.first]])

    def dependent(self, least: float) -> np.ndarray:
        """Return the mask (n,) of unknowns that are held at 0 so that all pivots of the others are above `least`. But
        for rounding, they are as many as there are eigenvalues 0. In samples whose elimination fails the mask is True
        everywhere. Nothing about it is proven.

        least : the elimination puts an unknown into the mask if its pivot would be this number or less."""
        held, failed = np.zeros(self.size, dtype=bool), np.zeros(self.samples.count, dtype=bool)
        for front, columns in self.columns(0.0, least, held):
            if columns is None:
                failed[self._sample_of(front)] = True
        found = np.empty_like(held)
        found[self.order] = held
        result: np.ndarray = found | failed[self.samples.of]
        return result

    def factorised(self, shift: float = 0.0) -> Factor | None:
        """Return the Cholesky factor of the matrix less `shift` times the identity; None if a pivot of any sample is
        not positive."""
        factor = self.factorised_samples(shift)
        return None if factor.failed.any() else factor

    def factorised_samples(self, shift: float = 0.0) -> Factor:
        """Return the Cholesky factor of the matrix less `shift` times the identity. If a pivot of a sample is not
        positive, the mask `failed` of the result is True for this sample, and its part of the factor is meaningless."""
        found, failed = [], np.zeros(self.samples.count, dtype=bool)
        for front, columns in self.columns(shift):
            if columns is None:
                failed[self._sample_of(front)] = True
                if failed.all():
                    break
                columns = np.eye(front.own), np.zeros((len(front.border), front.own))
            found.append((front, columns))
        return Factor(self.order, found, failed)


def _lower_triangle(matrix: sparse.csc_array) -> sparse.csc_array:
    """Return the lower triangle of a matrix (n, n), with its diagonal: as SciPy's `tril`, in a third of the time."""
    kept = matrix.indices >= np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    begins = np.append(0, np.cumsum(kept))[matrix.indptr].astype(matrix.indptr.dtype)
    return sparse.csc_array((matrix.data[kept], matrix.indices[kept], begins), shape=matrix.shape)


def _refuse_disorder(order: np.ndarray, fronts: list[Front]) -> None:
    """Raise RuntimeError if the order of elimination is not valid. It is valid if each unknown is eliminated once, and
    if the update of each front, the change of the matrix of its border (later unknowns), is added to exactly one later
    front, which contains the whole border.

    order : (n,), the unknown at each place of the order of elimination.
    fronts : all fronts, children before parents."""
    parent = np.full(len(fronts), -1)
    for number, front in enumerate(fronts):
        if (parent[front.children] >= 0).any() or any(child >= number for child in front.children):
            raise RuntimeError(
                "internal check failed: the order in which the matrix is eliminated contradicts itself; please report "
                "it with the command"
            )
        parent[front.children] = number
    lost = any(len(f.border) and (p < 0 or f.border[0] < fronts[p].first) for f, p in zip(fronts, parent, strict=True))
    if lost or not (np.bincount(order, minlength=len(order)) == 1).all():
        raise RuntimeError("internal check failed: the elimination leaves out an unknown; please report it")


def _add_at(whole: np.ndarray, rows: np.ndarray, columns: np.ndarray, part: np.ndarray) -> None:
    """Add the matrix `part` (p, q) to the entries of the matrix `whole` in the rows `rows` (p,), ascending, and the
    columns `columns` (q,), in place; both are in Fortran order. Rows that follow each other are added together, as this
    takes a third of the time."""
    if not part.size:
        return
    ends = np.append(np.flatnonzero(np.diff(rows) > 1) + 1, len(rows)).tolist()
    if len(ends) <= MOST_RUNS:
        begin = 0
        for end in ends:
            whole.T[:, rows[begin] : rows[end - 1] + 1][columns] += part.T[:, begin:end]
            begin = end
        return
    wide = np.zeros((len(columns), len(whole)))
    wide[:, rows] = part.T
    whole.T[columns] += wide


@dataclass(frozen=True)
class Factor:
    """The Cholesky factor L of an elimination of n unknowns, by fronts: groups of unknowns that are eliminated
    together.

    order : (n,), the unknown at each place of the order of elimination.
    columns : for each front, itself and its columns of L.
    failed : (R,) mask of the samples that have no factor, since a pivot was not positive. Results for their unknowns
        are meaningless."""

    order: np.ndarray
    columns: list[tuple[Front, Columns]]
    failed: np.ndarray

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution x of L L^T x = right, with the unknowns in their original order.

        right : (n,), or (n, m) for m right-hand sides; the result has its shape."""
        x = right.reshape(len(right), -1)[self.order]
        for front, (pivots, below) in self.columns:  # forward with L
            own = slice(front.first, front.first + front.own)
            x[own] = BLAS.dtrsm(1.0, pivots, x[own], lower=1)
            x[front.border] -= below @ x[own]
        return self._backward(x).reshape(right.shape)

    def drawn(self, normal: np.ndarray) -> np.ndarray:
        """Return the solutions x (n, m) of L^T x = normal. If the entries of `normal` (n, m) are independent and have
        the variance 1, the covariance of the entries of x is the inverse of L L^T.

        normal : (n, m), the right-hand sides.
        """
        return self._backward(normal[self.order])

    def _backward(self, x: np.ndarray) -> np.ndarray:
        """Return the solutions of L^T y = x, with the unknowns in their original order.

        x : (n, m), in the order of elimination; overwritten."""
        for front, (pivots, below) in reversed(self.columns):
            own = slice(front.first, front.first + front.own)
            x[own] -= below.T @ x[front.border]
            x[own] = BLAS.dtrsm(1.0, pivots, x[own], lower=1, trans_a=1)
        found = np.empty_like(x)
        found[self.order] = x
        return found
