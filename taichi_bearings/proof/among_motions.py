"""Step 2 of theorem 7 among the motions in which contacts roll exactly: for packings with very slow contacts.

Why. A contact that slips by y resists a change across it by mu F_n / |y|, 1e15 times as much as others if it slips 1e15
times more slowly. Doubles that sum up both keep nothing of the softer one. So slow contacts get unknowns of their own,
and the springs that hold resting contacts are left out.

Symbols
    n unknown spin components, E contacts, S of them slipping, T resting. K : (3 E, n), slips from these unknowns.
    P : (n, m) whole numbers. P v are motions in which the exactly rolling contacts roll (exact_motions.py); spheres
    that these do not join have their own spins among the coordinates v. So V (oblique.py) is part of all P v.
    B : matrix of the curvature, and of springs at the loose contacts. B P v has no other springs.
    C : (m, m), v = C w. It is 1 on the diagonal but for m' rows, one for each of m' slow contacts: there w is what the
    change of the slip across itself is, and the rows of B P C of these contacts have one entry, but for rounding.

The proof is that of centre.py with the coordinates w. Any C is valid: a floor tau of |B P C w|^2 above 0 shows that C
is regular, so that w stands for all v. Only torques along the motions count, P^T r: what exactly rolling contacts exert
has no part along them.

Example. A sphere is held by three contacts across x, y and z with stiffnesses 1e16, 1 and 1, and the first one is along
(1, 1, 0) / 2^1/2, not along an axis. The matrix of its spins is 1e16 / 2 ((1, 1), (1, 1)) + 1: in doubles the 1 is
lost. With w_1 = (x + y) / 2^1/2 instead of x it is diagonal but for rounding of 1, and its pivots are 1e16 and 1.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.dissection import Part
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.centre import Centre, Coordinates
from taichi_bearings.proof.curvature import Form
from taichi_bearings.proof.enclosure import UP
from taichi_bearings.proof.rounded_elimination import EPS, Elimination, Samples

MOST_MOTIONS = 6_000  # coordinates beyond which a dense matrix takes longer than finding the minimum
# A contact is slow if its stiffness is more than the first number times the median, and if more than the second share
# of it is left in the motions: where other contacts let it change along its slip alone, hardly anything is.
STIFF, SOME_ACROSS = 1e6, 1e-8
DEPENDENT = 1e-6  # share of a row that is left after those before, up to which it is not independent of them
# Springs of loose contacts in Newton's method, over the largest stiffness; what is added to the diagonal where friction
# is balanced, and steps of that at most. Nothing has to be proven of these.
FIRMER, ADDED, MOST_BALANCING = 1e2, 1e-13, 6


@dataclass(frozen=True)
class Reduced(Coordinates):
    """Coordinates w, m numbers that give the changes P C w of the n unknown spin components (head of this file).

    form : the curvature of the potential, a quadratic form |B P C w|^2 of w; that of changes x is |B x|^2.
    basis : C, (m, m), by which slow contacts have coordinates to themselves.
    motions : P, (n, m), whole numbers; the exactly rolling contacts roll in the changes P v, for any v.
    """

    basis: sparse.csr_array
    motions: sparse.csr_array

    def along(self, values: np.ndarray) -> np.ndarray:
        """Return the slope C^T P^T values, (m,), from torques `values` (n,) on the unknown spin components."""
        found: np.ndarray = self.basis.T @ (self.motions.T @ values)
        return found

    def bounded_along(self, values: np.ndarray, inexact: np.ndarray) -> np.ndarray:
        """Return bounds (m,) on how far `along(values)` is from C^T P^T of torques within `inexact` of `values`.

        values, inexact : (n,) each.
        """
        terms = sum(int(np.bincount(part.indices).max(initial=0)) + 4 for part in (self.motions, self.basis))
        whole = inexact + terms * EPS * np.abs(values)
        found: np.ndarray = abs(self.basis).T @ (abs(self.motions).T @ whole) * UP
        return found

    def changes_of_slips(self, rows: sparse.csr_array, scale: np.ndarray) -> tuple[sparse.csr_array, np.ndarray]:
        """Return two things about the matrix (3 S, m) that gives the changes of the slips of S contacts from the
        coordinates, x components of all contacts first, then y, then z:

        1. a matrix of its shape with bounds on the sizes of its entries,
        2. bounds (S,) on the length of the change of each slip, over that of the vector of all coordinates: the root of
           the sum of the squares of its entries.

        rows : (3 S, n), the matrix that gives these changes from the unknown spin components.
        scale : (m,), the units in which the coordinates are meant.
        """
        product, doubt = times_exact(rows, 0 * rows, self.motions)
        product, doubt = times_exact(product, doubt, self.basis)
        sizes = sparse.csr_array((abs(product) + doubt) @ sparse.diags_array(scale * UP))
        squares = np.asarray(sizes.power(2).sum(axis=1)).reshape(3, -1).sum(axis=0)
        return sizes, np.sqrt(squares) * UP

    def spins(self, scaled: np.ndarray) -> np.ndarray:
        """Return the changes P C (scale x), (n,), of the unknown spin components for scaled coordinates x, which is
        `scaled` (m,)."""
        found: np.ndarray = self.motions @ (self.basis @ (self.form.scale * scaled))
        return found


@dataclass(frozen=True)
class CentreAmongMotions(Centre):
    """Spins of one sample near which a minimum is to be proven, with coordinates that stand for motions in which
    contacts roll exactly. At least one contact of the sample can roll exactly."""

    @classmethod
    def of(cls, centre: Centre) -> CentreAmongMotions | None:
        """Return the spins of `centre` with coordinates that stand for motions in which contacts roll exactly. Return
        None if no contact can roll exactly, or if there are no such motions, or more than MOST_MOTIONS.

        centre : the spins, of one sample.
        """
        found = cls(**{field.name: getattr(centre, field.name) for field in fields(centre)})
        return found if centre.exact.motions is not None and 0 < found.motions.shape[1] <= MOST_MOTIONS else None

    @cached_property
    def motions(self) -> sparse.csr_array:
        """The matrix P, (n, m), of whole numbers that gives the n unknown spin components from the coordinates. The
        first coordinates stand for motions in which contacts roll exactly, each other one for an unknown of a sphere
        that these contacts do not touch."""
        exact_motions, sphere = self.exact.motions, np.nonzero(self.number >= 0)[0]
        assert exact_motions is not None
        rolls = self.exact.spheres[sphere]
        rolling, others = np.flatnonzero(rolls), np.flatnonzero(~rolls)
        motion = sparse.coo_array(exact_motions.motion[:, : len(exact_motions.choices.chosen)])
        count, (row, column) = motion.shape[1], motion.coords
        at = np.append(rolling[row], others), np.append(column, count + np.arange(len(others)))
        values = np.append(motion.data, np.ones(len(others)))
        return sparse.csr_array((values, at), shape=(len(sphere), count + len(others)))

    @cached_property
    def loose_places(self) -> np.ndarray:
        """Positions (l,), among the T resting contacts, of those that need not roll exactly."""
        return np.flatnonzero(~self.exact.contacts[self.resting])

    def reduced(self, stiffness: np.ndarray) -> Reduced | None:
        """Return coordinates w with the curvature of the potential in them; None if some coordinate changes no slip.
        Each slow contact has a coordinate to itself, the change of its slip at right angles to the slip. (`STIFF` and
        `SOME_ACROSS` say which contacts are slow.)

        stiffness : (l,), of springs at the l loose contacts (resting ones that need not roll exactly), force over slip
            speed.
        """
        rows, doubt = times_exact(*self.rows_of_curvature(self.resting[self.loose_places], stiffness), self.motions)
        # The stiffness of each row: mu F_n / |y|, eta, or that of the spring.
        of_friction = (self.strength.value / self.size.value)[self.with_friction]
        of_damping = self.damping.value[self.damping.high > 0]
        stiffness_of_row = np.concatenate([of_friction, np.tile(of_damping, 3), np.tile(stiffness, 3)])
        # Slow contacts: stiff ones of which more than the share SOME_ACROSS is left in the motions, the stiffest first.
        length = np.sqrt(np.asarray(rows.power(2).sum(axis=1)))
        is_stiff = stiffness_of_row > STIFF * np.median(of_friction)
        stiff = np.flatnonzero(is_stiff & (length > SOME_ACROSS * np.sqrt(stiffness_of_row)))
        basis = basis_for(sparse.csr_array(rows[stiff[np.argsort(-stiffness_of_row[stiff], kind="stable")]]))
        rows, doubt = times_exact(rows, doubt, basis)
        count = rows.shape[1]
        whole, samples = [Part(np.arange(count), [])], Samples.one(count)
        form = Form.of(rows, doubt, np.zeros((1, count)), parts=whole, samples=samples)
        return None if form is None else Reduced(form, basis, self.motions)

    def coordinates(self) -> Reduced | None:
        """Return the coordinates w, with springs at the loose contacts (resting ones that need not roll exactly) as
        stiff as slipping ones mostly are; None if some coordinate changes no slip."""
        return self.reduced(self.usual_stiffness(self.resting[self.loose_places]))

    def improved(self) -> CentreAmongMotions:
        """Return a copy with spins closer to the minimum among those at which the resting contacts do not slip, and
        with friction of these contacts that balances all torques. Nothing about the result is proven.

        1. Steps of Newton's method, with one matrix, reduce the torques along the motions until a step does not halve
           them. There are springs at the loose contacts alone, resting ones that need not roll exactly.
        2. Springs at all resting contacts find the friction that balances what is left (`_balanced`).

        If the curvature cannot be factorised, nothing is changed."""
        stiffest = float((self.strength.value / self.size.value)[self.with_friction].max(initial=1.0))
        stiffness = np.full(len(self.loose_places), FIRMER * stiffest)
        curvature = self.reduced(stiffness)
        factor = None if curvature is None else curvature.form.elimination.factorised()
        if curvature is None or factor is None:
            return self
        form, loose = curvature.form, self.resting[self.loose_places]
        # The last rows of the curvature are those of the springs: their slips times the root of the stiffness.
        spring_rows, root = form.rows[form.rows.shape[0] - 3 * len(loose) :], np.tile(np.sqrt(stiffness), 3)
        best, least, found, is_unknown = self, np.inf, self, self.number >= 0
        while True:
            torque = form.scale * curvature.along(found.torque_values[is_unknown])
            if not (left := float(np.linalg.norm(torque))) < least / 2:
                return best._balanced()
            best, least = found, left
            # A Newton step; the forces of the springs in it are added to the friction of the loose contacts.
            stretch = root * np.concatenate([part.value[loose] for part in best.slips])
            step = -factor.solve(torque + spring_rows.T @ stretch)
            less_friction = np.zeros((3, len(self.resting)))
            less_friction[:, self.loose_places] = -(root * (stretch + spring_rows @ step)).reshape(3, -1)
            found = best.moved(curvature.spins(step), less_friction)

    def _balanced(self) -> CentreAmongMotions:
        """Return a copy with these spins, and with the friction of resting contacts corrected so that torques on free
        spheres balance but for rounding. Nothing about the result is proven.

        The correction is the force of equally stiff springs at the resting contacts under the leftover torques. It is
        repeated as long as it more than halves these, MOST_BALANCING times at most. The friction stays unchanged if the
        matrix of these springs cannot be factorised."""
        rows, is_unknown = sparse.csr_array(self.rows[self.rows_of(self.resting)]), self.number >= 0
        squares = np.bincount(rows.indices, rows.data**2, rows.shape[1])
        scale = 1 / np.sqrt(np.where(squares > 0, squares, 1.0))
        rows = sparse.csr_array(rows @ sparse.diags_array(scale))
        factor = Elimination.of((rows.T @ rows).tocsc(), self.place, self.parts, self.samples).factorised(-ADDED)
        best, least, found = self, np.inf, self
        for _ in range(MOST_BALANCING if factor is not None else 0):
            torque = found.torque_values[is_unknown]
            if not (left := float(np.linalg.norm(torque))) < least / 2:
                break
            best, least = found, left
            assert factor is not None
            found = best.moved(np.zeros(len(torque)), (rows @ factor.solve(scale * torque)).reshape(3, -1))
        return best


def times_exact(
    rows: sparse.csr_array, doubt: sparse.csr_array, by: sparse.csr_array
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Return the product of two sparse matrices, and a matrix of its shape with bounds on the errors of its entries.

    rows, doubt : (p, n), the first matrix and bounds on the errors of its entries.
    by : (n, m), the second matrix, which is exact.
    """
    terms, sizes = int(np.diff(rows.indptr).max(initial=0)) + 2, abs(by)
    found = sparse.csr_array(rows @ by)
    found.sort_indices()
    return found, sparse.csr_array(doubt @ sizes + (terms * EPS) * (abs(rows) @ sizes))


def basis_for(rows: sparse.csr_array) -> sparse.csr_array:
    """Return a matrix C, (m, m), of other coordinates w, v = C w, of which each of some independent rows has one to
    itself: row . v over the length of the row is a number of w, but for rounding. All other rows depend on these.

    rows : (r, m), each of its rows not 0; those that come first are preferred.

    A row gives its number to w in place of one number of v, its pivot; other numbers of w are those of v. The equations
    are solved for the pivots. Rows that share columns are solved together, in a dense matrix.
    """
    count, begin = rows.shape[1], rows.indptr[:-1]
    first = np.repeat(rows.indices[begin], np.diff(rows.indptr))
    label, is_pivot = pieces(count, first, rows.indices), np.zeros(count, dtype=bool)
    piece_of_row, entries = label[rows.indices[begin]], list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    for piece in np.unique(piece_of_row):
        members = sparse.csr_array(rows[np.flatnonzero(piece_of_row == piece)])
        columns = np.unique(members.indices)
        dense = members[:, columns].toarray()
        dense /= np.linalg.norm(dense, axis=1)[:, None]
        kept, pivots = _independent_rows(dense)
        others = np.setdiff1d(np.arange(len(columns)), pivots)
        # dense_pivots v_pivots + dense_others v_others = w, solved for v_pivots
        solved = np.zeros((len(kept), len(columns)))
        solved[:, pivots] = np.linalg.inv(dense[np.ix_(kept, pivots)])
        solved[:, others] = -solved[:, pivots] @ dense[np.ix_(kept, others)]
        row, column = np.nonzero(solved)
        entries.append((columns[pivots][row], columns[column], solved[row, column]))
        is_pivot[columns[pivots]] = True
    unchanged = np.flatnonzero(~is_pivot)
    entries.append((unchanged, unchanged, np.ones(len(unchanged))))
    row, column, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return sparse.csr_array((values, (row, column)), shape=(count, count))


def _independent_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers (k,) of the rows that do not depend on rows before them, and a column (k,) for each: that of
    its largest entry once those rows are eliminated from it.

    rows : (r, c), of length 1.
    """
    reduced, kept, pivots = np.zeros(rows.shape), list[int](), list[int]()
    for number, row in enumerate(rows):
        left = row.copy()
        for place, pivot in enumerate(pivots):
            left -= left[pivot] * reduced[place]
        left[pivots] = 0.0
        pivot = int(np.argmax(np.abs(left)))
        if abs(left[pivot]) > DEPENDENT:
            reduced[len(kept)] = left / left[pivot]
            kept.append(number)
            pivots.append(pivot)
    return np.array(kept, dtype=np.intp), np.array(pivots, dtype=np.intp)
