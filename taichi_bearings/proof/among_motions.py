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

The proof is that of centre.py with the unknowns w. Any C is valid: a floor tau of |B P C w|^2 above 0 shows that C is
regular, so that w stands for all v. Two bounds are closer here:
* Only torques along the motions count, P^T r. What exactly rolling contacts exert has no part along them.
* How far a slip turns. |B P C w| at the minimum is at most 9 tau^1/2 reach (centre.py has its factors: 3 x 2 / 0.72 <
  9), and so is each of its rows: the change across a slip is at most that over (mu F_n / |y|)^1/2. A change d
  with a part d_a across turns the slip y by an angle whose sine is at most |d_a| / (|y| - |d|), where |d| is at most a
  quarter of |y|. Unit vectors at an angle below asin 1/4 differ by at most 1.01 times its sine: in all by less than 1.4
  |d_a| / |y|.

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
from taichi_bearings.proof.centre import TINY, Centre, newton_step
from taichi_bearings.proof.curvature import MOST_RELATIVE_CHANGE, Form, largest_eigenvalue
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
class Reduced:
    """The curvature as a quadratic form |B P C w|^2 of the coordinates w, of which there are m.

    form : the form.
    basis : C, (m, m).
    motions : P, (n, m), whole numbers.
    """

    form: Form
    basis: sparse.csr_array
    motions: sparse.csr_array

    def along(self, values: np.ndarray) -> np.ndarray:
        """Return C^T P^T values, (m,), from torques `values` (n,) on the unknown spin components."""
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

    def spins(self, scaled: np.ndarray) -> np.ndarray:
        """Return the changes (n,) of the unknown spin components for scaled coordinates `scaled` (m,)."""
        found: np.ndarray = self.motions @ (self.basis @ (self.form.scale * scaled))
        return found


@dataclass(frozen=True)
class CentreAmongMotions(Centre):
    """Spins near which a minimum is to be proven, with unknowns that stand for motions in which contacts roll exactly.
    It is that of one sample, in which some contacts can roll exactly."""

    @classmethod
    def of(cls, centre: Centre) -> CentreAmongMotions | None:
        """Return the same spins with such unknowns; None if no contact rolls exactly, or motions are none or too many.

        centre : the spins, of one sample.
        """
        found = cls(**{field.name: getattr(centre, field.name) for field in fields(centre)})
        return found if centre.exact.motions is not None and 0 < found.motions.shape[1] <= MOST_MOTIONS else None

    @cached_property
    def motions(self) -> sparse.csr_array:
        """P, (n, m), whole numbers: how the n unknown spin components follow from the coordinates."""
        of, sphere = self.exact.motions, np.nonzero(self.number >= 0)[0]
        assert of is not None
        inside = self.exact.spheres[sphere]
        own, others = np.flatnonzero(inside), np.flatnonzero(~inside)
        rolling = sparse.coo_array(of.motion[:, : len(of.choices.chosen)])
        count, (row, column) = rolling.shape[1], rolling.coords
        at = np.append(own[row], others), np.append(column, count + np.arange(len(others)))
        values = np.append(rolling.data, np.ones(len(others)))
        return sparse.csr_array((values, at), shape=(len(sphere), count + len(others)))

    @cached_property
    def loose_places(self) -> np.ndarray:
        """Positions (l,), among the T resting contacts, of those that need not roll exactly."""
        return np.flatnonzero(~self.exact.contacts[self.resting])

    def reduced(self, stiffness: np.ndarray) -> Reduced | None:
        """Return the curvature in coordinates of which slow contacts have some to themselves; None if some coordinate
        changes no slip.

        stiffness : (l,), of springs at the loose contacts, force over slip speed.
        """
        rows, doubt = times_exact(*self.rows_of_curvature(self.resting[self.loose_places], stiffness), self.motions)
        own = (self.strength.value / self.size.value)[self.with_friction]
        damped = self.damping.value[self.damping.high > 0]
        each = np.concatenate([own, np.tile(damped, 3), np.tile(stiffness, 3)])
        left = np.sqrt(np.asarray(rows.power(2).sum(axis=1)))
        stiff = np.flatnonzero((each > STIFF * np.median(own)) & (left > SOME_ACROSS * np.sqrt(each)))
        basis = basis_for(sparse.csr_array(rows[stiff[np.argsort(-each[stiff], kind="stable")]]))
        rows, doubt = times_exact(rows, doubt, basis)
        count = rows.shape[1]
        whole, samples = [Part(np.arange(count), [])], Samples.one(count)
        form = Form.of(rows, doubt, np.zeros((1, count)), parts=whole, samples=samples)
        return None if form is None else Reduced(form, basis, self.motions)

    def improved(self) -> CentreAmongMotions:
        """Return spins closer to the minimum among those at which the resting contacts rest, and friction of these that
        balances all torques. Nothing about the result is proven. These are steps of Newton's method with one matrix, as
        long as each more than halves the torques along the motions, with springs at loose contacts alone; then springs
        at all resting contacts take the other torques. The same spins are returned if the curvature cannot be
        factorised."""
        stiffest = float((self.strength.value / self.size.value)[self.with_friction].max(initial=1.0))
        stiffness = np.full(len(self.loose_places), FIRMER * stiffest)
        curvature = self.reduced(stiffness)
        factor = None if curvature is None else curvature.form.elimination.factorised()
        if curvature is None or factor is None:
            return self
        form, loose = curvature.form, self.resting[self.loose_places]
        fixed, root = form.rows[form.rows.shape[0] - 3 * len(loose) :], np.tile(np.sqrt(stiffness), 3)
        best, least, found, there = self, np.inf, self, self.number >= 0
        while True:
            torque = form.scale * curvature.along(found.torque_values[there])
            if not (left := float(np.linalg.norm(torque))) < least / 2:
                return best._balanced()
            best, least = found, left
            stretch = root * np.concatenate([part.value[loose] for part in best.slips])
            step = -factor.solve(torque + fixed.T @ stretch)
            less = np.zeros((3, len(self.resting)))
            less[:, self.loose_places] = -(root * (stretch + fixed @ step)).reshape(3, -1)
            found = best.moved(curvature.spins(step), less)

    def _balanced(self) -> CentreAmongMotions:
        """Return the same spins, with the friction of resting contacts corrected so that torques on free spheres
        balance as nearly as rounding allows. Nothing about the result is proven.

        The correction is the force that equally stiff springs at the resting contacts bear under the torques that are
        left. It is repeated as long as it more than halves these, MOST_BALANCING times at most. The friction stays
        unchanged if the matrix of these springs cannot be factorised."""
        rows, there = sparse.csr_array(self.rows[self.rows_of(self.resting)]), self.number >= 0
        squares = np.bincount(rows.indices, rows.data**2, rows.shape[1])
        scale = 1 / np.sqrt(np.where(squares > 0, squares, 1.0))
        rows = sparse.csr_array(rows @ sparse.diags_array(scale))
        factor = Elimination.of((rows.T @ rows).tocsc(), self.place, self.parts, self.samples).factorised(-ADDED)
        best, least, found = self, np.inf, self
        for _ in range(MOST_BALANCING if factor is not None else 0):
            torque = found.torque_values[there]
            if not (left := float(np.linalg.norm(torque))) < least / 2:
                break
            best, least = found, left
            assert factor is not None
            found = best.moved(np.zeros(len(torque)), (rows @ factor.solve(scale * torque)).reshape(3, -1))
        return best

    def _distance_of_minimum(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what :meth:`Centre._distance_of_minimum` does, proven as the head of this file says."""
        size, strength, damping, to_v = self.size.most, self.strength.least, self.damping.most, self.distance_to_v
        unproven = np.full(len(size), np.inf), np.full(len(size), np.inf), np.zeros(1, dtype=bool)
        slips = bool((self.size.least[self.with_friction] > 0).all() and (self.loose.floor > 0).all())
        curvature = self.reduced(self.usual_stiffness(self.resting[self.loose_places])) if slips else None
        floor = None if curvature is None else curvature.form.floor_in_units()
        if curvature is None or floor is None or not floor.tau.all():
            return unproven
        tau, scale = float(floor.tau[0]), curvature.form.scale * floor.unit
        angle, size_error, size_by_law = self._distance_from_slip_direction(to_v)
        # What is left of the slope after a step z of Newton's method: torques, and the doubt about the friction.
        unsure, values = np.zeros(len(self.network.counts)), self.torque_values
        unsure[self.slipping] = size_error + size_by_law * angle**2 * UP
        inexact, there = self._largest_torques(unsure, values), self.number >= 0
        slope = curvature.along(values[there])
        pull, taken, rounded = newton_step(curvature.form, floor, slope)
        left = np.abs(slope - taken) * UP + rounded + curvature.bounded_along(values[there], inexact[there])
        of_law = float((size_by_law * size * angle**2 + damping * to_v**2).sum())
        reach = float(np.linalg.norm(scale * left)) / tau + float(pull[0] + np.sqrt(of_law)) / np.sqrt(tau)
        # Changes of slips: 8.4 is 12 of centre.py without the 2^1/2 that are in the length of the rows.
        changes = self._changes_of_slips(curvature, scale)
        lengths = np.sqrt(np.asarray(changes.power(2).sum(axis=1)).reshape(3, -1).sum(axis=0))
        distance = (to_v + 8.4 * lengths * reach * UP**2 + TINY) * UP
        across = np.where(strength > 0, 9 * np.sqrt(tau * size / np.maximum(strength, TINY)) * reach, np.inf)
        turned = np.minimum(1.4 * self.relative_to_slip(to_v + across), 2 * self.relative_to_slip(distance)) * UP**2
        # Two minima would differ by a motion that changes all slips along their directions alone. Its curvature would
        # be no more than what is lost as slips turn, below tau / 8, but it is tau or more: so there is just one.
        lost = np.tile(turned * np.sqrt(self.strength.most / self.size.least), 3)
        lost = largest_eigenvalue(sparse.csr_array(sparse.diags_array(lost) @ changes), 6, Samples.one(len(scale)))
        changes_little = (self.relative_to_slip(distance) <= MOST_RELATIVE_CHANGE).all()
        return distance, turned, (lost * UP < tau / 8) & changes_little

    def _changes_of_slips(self, curvature: Reduced, scale: np.ndarray) -> sparse.csr_array:
        """Return bounds (3 S, m) on the sizes of the entries of the matrix that gives the changes of the slips of S
        slipping contacts: x components of all, then y, then z.

        curvature : the coordinates.
        scale : (m,), the units in which they are meant.
        """
        rows = sparse.csr_array(self.rows[self.rows_of(self.slipping)])
        rows, doubt = times_exact(rows, 0 * rows, curvature.motions)
        rows, doubt = times_exact(rows, doubt, curvature.basis)
        return sparse.csr_array((abs(rows) + doubt) @ sparse.diags_array(scale * UP))


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
    """Return a matrix C, (m, m), such that most of the given rows, divided by their lengths, have one entry 1 after a
    product with C, and else 0 but for rounding. The others depend on these.

    rows : (r, m), each of its rows not 0; those that come first are preferred.

    Rows that share columns are taken together, in a dense matrix. Elimination with the largest entry of a row as pivot
    finds which are independent, and for each of them a column. These columns are what its row is solved for.
    """
    count, begin = rows.shape[1], rows.indptr[:-1]
    first = np.repeat(rows.indices[begin], np.diff(rows.indptr))
    label, taken = pieces(count, first, rows.indices), np.zeros(count, dtype=bool)
    piece, entries = label[rows.indices[begin]], list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    for part in np.unique(piece):
        own = sparse.csr_array(rows[np.flatnonzero(piece == part)])
        columns = np.unique(own.indices)
        dense = own[:, columns].toarray()
        dense /= np.linalg.norm(dense, axis=1)[:, None]
        kept, pivots = _independent_rows(dense)
        others = np.setdiff1d(np.arange(len(columns)), pivots)
        solved = np.zeros((len(kept), len(columns)))
        solved[:, pivots] = np.linalg.inv(dense[np.ix_(kept, pivots)])
        solved[:, others] = -solved[:, pivots] @ dense[np.ix_(kept, others)]
        row, column = np.nonzero(solved)
        entries.append((columns[pivots][row], columns[column], solved[row, column]))
        taken[columns[pivots]] = True
    same = np.flatnonzero(~taken)
    at, by, values = (
        np.concatenate([*(entry[k] for entry in entries), of]) for k, of in enumerate((same, same, np.ones(len(same))))
    )
    return sparse.csr_array((values, (at, by)), shape=(count, count))


def _independent_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers (k,) of some rows that are independent of each other, and a column (k,) for each of them.

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
