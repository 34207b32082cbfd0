"""Bounds on the friction of contacts in loops that cannot roll as their normals are stored: part of theorem 8.

What is proven. Loops of contacts that would roll with ideal normals cannot roll with rounded ones: at the minimum some
of their contacts slip by 1e-16, and rounding decides which. No proof about slips can help there, but friction is in
balance. This file bounds the optimal friction of each contact near such loops. A contact whose friction is proven to be
below mu F_n rests at every minimum (theorem 4).

Symbols
    N : number of spheres. E : of contacts. n : of unknowns, the components of the spins of free spheres.
    F : friction at hand. F* : optimal friction. f = F* - F. K : matrix of slips, so K^T F are the torques of F.
    X : the contacts that can roll exactly (exact_motions.py).
    Q : the contacts that this file is about. They can dissipate, touch a free sphere that no contact of X touches, and
        their friction at minima is not known (that of contacts that slip or have damping alone is known).
    q : number of contacts of a piece of Q; pieces share no such sphere. Friction has two components, along tangents.
    M : (2 q, n), rows of K for the contacts of a piece and the unknowns of its spheres, along the tangents.
    L : (2 q, m), friction along *loops*, one in each column: L exerts no torque, M^T L = 0 but for rounding. A *group*
        of contacts that this friction connects may have several loops.
    c = L^T f : (m,), how much friction circulates along each loop.
    D : (2 q, 2 q), the error of the splitting of step 1.

The proof
1. Choose any L and any Y (n, 2 q); here they come from a singular value decomposition of M. Define D = I - L L^T - M Y.
   It is of the size of rounding if no singular value of M lies between 0 and NEARLY_SINGULAR, and in any case it is
   bounded. Then, as an identity,
       f = L c + Y^T (M^T f) + D^T f.
2. On every free sphere F* leaves over no torque, so K^T f = -K^T F. Hence M^T f is minus the torques of f on the other
   contacts of these spheres and those that F leaves over. If the friction of a contact is known its f is small; of all
   others both F and F* are inside a disc. That bounds all of f but L c.
3. |F + f| <= mu F_n + eta |y| for every contact. So each contact of a loop confines its c to an interval, the solution
   of a quadratic inequality, and all contacts of the loop to the common part of these intervals. If a contact belongs
   to several loops, |c| is only bounded by the sum over the contacts of |L| (largest |F*| + |F|).
4. Then |F*| is at most |F + L c| at the middle of the intervals, plus |L| times their half lengths, plus the bound of
   step 2.

Example (of the arithmetic of step 3 alone, as discs can roll). Four discs in a ring, limits (2, 2, 2, 5), F = (1, 0, 0,
0), and no other contact may change. Friction that alternates is in balance on each disc: L = (1, -1, 1, -1) / 2. The
first contact gives |1 + c / 2| <= 2, so -6 <= c <= 2; the next two |c| <= 4; the last one |c| <= 10. Together -4 <= c
<= 2, with the middle -1 and the half length 3. The last contact bears at most |1 / 2| + 3 / 2 = 2, less than 5: it
rests. The others may bear all their friction, so nothing is proven of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.enclosure import UP, Enclosure
from taichi_bearings.proof.exact_motions import ExactMotions
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.listed import moments
from taichi_bearings.proof.rounded_elimination import EPS
from taichi_bearings.proof.springs import slip_rows

MOST_SPLIT = 1500  # unknowns of a piece, beyond which its singular values take too long
# Any thresholds are valid, as step 1 is an identity for all L and Y; these separate rounding from what is no loop.
NEARLY_SINGULAR = 1e-8  # singular value over the largest, up to which forces along its vector are taken for a loop
IN_A_LOOP = 1e-7  # force of a contact over that of a loop, above which it belongs to the loop


@dataclass(frozen=True)
class FrictionBounds:
    """Bounds on the friction of each contact of a packing at every minimum, before loops are looked at.

    *Optimal* friction is that at a minimum of the power; *given* friction is the one stored with the solution, after
    fictitious springs have balanced its torques.

    network : the packing, with N spheres and E contacts.
    number : (N, 3), the index of each spin component among the n unknowns; -1 for those that are none, such as those of
        driven spheres.
    exact : the contacts that can all roll exactly at once, and their motions.
    given : the given friction by component, 3 enclosures (E,), in units of force.
    known : (E,) mask of the contacts whose optimal friction is nearly known: they slip at every minimum, or have
        damping alone.
    most_change : (E,), bound on |optimal friction - given friction|, force.
    most_friction : (E,), bound on |optimal friction|, force.
    """

    network: JudgedNetwork
    number: np.ndarray
    exact: ExactMotions
    given: list[Enclosure]
    known: np.ndarray
    most_change: np.ndarray
    most_friction: np.ndarray

    @cached_property
    def friction(self) -> np.ndarray:
        """The field `given`, friction of each of E contacts, as one array (E, 3), rounded to doubles."""
        return np.stack([part.value for part in self.given], axis=1)

    @cached_property
    def tangents(self) -> np.ndarray:
        """(E, 2, 3), two unit vectors for each of E contacts, at right angles to its normal and to each other."""
        n = self.network.graph.normal
        first = np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=1)])
        first /= np.linalg.norm(first, axis=1)[:, None]
        second = np.cross(n, first)
        return np.stack([first, second / np.linalg.norm(second, axis=1)[:, None]], axis=1)

    @cached_property
    def rows(self) -> sparse.csr_array:
        """Matrix (2 E, n) that gives slips of E contacts from n unknown spin components. Rows 2 i and 2 i + 1 are for
        the components of the slip of contact i along its two `tangents`."""
        count = len(self.most_change)
        row = np.repeat(np.arange(2 * count), 3)
        column = (np.arange(3) * count + np.arange(count)[:, None]).repeat(2, axis=0)
        along_tangents = sparse.csr_array((self.tangents.ravel(), (row, column.ravel())), shape=(2 * count, 3 * count))
        return sparse.csr_array(along_tangents @ slip_rows(self.network, self.number))

    @cached_property
    def sphere(self) -> np.ndarray:
        """(n,), for each of n unknown spin components the index of the sphere to which it belongs."""
        return np.nonzero(self.number >= 0)[0]

    @cached_property
    def other_spheres(self) -> np.ndarray:
        """(N,) mask of the free spheres that contacts connect to driven ones and that no exactly rolling contact
        touches."""
        return np.asarray(self.network.reached & ~self.exact.spheres)

    @cached_property
    def near_loops(self) -> np.ndarray:
        """(E,) mask of the contacts that may form loops which cannot roll exactly: they can dissipate, their friction
        at minima is not known, and they touch one of `other_spheres`, free spheres that no exactly rolling contact
        touches."""
        touches = self.other_spheres[self.network.graph.contact].any(axis=0)
        return np.asarray(self.network.counts & ~self.known & touches)

    @cached_property
    def left_over(self) -> np.ndarray:
        """(N,), for each of N spheres a bound on the error of any component of the torque over radius, a force, if the
        given friction is taken to be in balance.

        It is the sum of two bounds: on the torque that this friction leaves over; and on the rounding of torques of
        changes of friction up to `most_change` by the matrix `rows`. An entry of `rows` has fewer than 64 roundings."""
        torques = self.network.torques(moments(self.given, self.network.graph.normal))
        return np.asarray(
            (np.max([part.most for part in torques], axis=0) + 64 * EPS * self.sum_at_spheres(self.most_change)) * UP
        )

    def sum_at_spheres(self, values: np.ndarray) -> np.ndarray:
        """Return for each of N spheres the sum (N,) of `values`, (E,) for E contacts, over those of its contacts that
        can dissipate."""
        ends = self.network.graph.contact[:, self.network.counts].ravel()
        return np.bincount(ends, np.tile(values[self.network.counts], 2), len(self.network.free))

    def split_into_pieces(self) -> list[Piece]:
        """Return the contacts of the mask `near_loops` in pieces, each with bounds on its friction. Two contacts are in
        one piece if such contacts and the spheres of the mask `other_spheres` connect them. Pieces with more than
        MOST_SPLIT unknown spin components are left out."""
        first, second = self.network.graph.contact
        joins = self.near_loops & self.other_spheres[first] & self.other_spheres[second]
        label = pieces(len(self.other_spheres), first[joins], second[joins])
        of_contact = label[np.where(self.other_spheres[first], first, second)]
        of_unknown, found = np.where(self.other_spheres[self.sphere], label[self.sphere], -1), []
        for piece in np.unique(of_contact[self.near_loops]):
            unknowns = np.flatnonzero(of_unknown == piece)
            if len(unknowns) <= MOST_SPLIT:
                found.append(Piece.of(self, np.flatnonzero(self.near_loops & (of_contact == piece)), unknowns))
        return found


@dataclass(frozen=True)
class Piece:
    """Bounds on the friction of q connected contacts at any minimum.

    Let f be the change of their friction, from the given one to that at a minimum: two tangential components for each
    contact. It is L c plus a rest, where c is the friction that circulates along each of m loops.

    contacts : (q,), indices of these contacts.
    others : (k,), indices of the other contacts of their spheres.
    loops : L, (2 q, m), friction on the contacts if 1 circulates along a loop.
    middle, half_length : (m,), of the interval in which the c of each loop lies.
    by_others : (2 q, 2 k), the matrix that gives f - L c from the changes of friction on the other contacts.
    most_off_loops : (q,), bound on the size of f - L c at each contact.
    by_rounding : (q,), the part of `most_off_loops` that is due to rounding and leftover torques, not to the others.
    largest : (q,), bound on the size of the friction at a minimum.
    """

    contacts: np.ndarray
    others: np.ndarray
    loops: np.ndarray
    middle: np.ndarray
    half_length: np.ndarray
    by_others: np.ndarray
    most_off_loops: np.ndarray
    by_rounding: np.ndarray
    largest: np.ndarray

    @classmethod
    def of(cls, bounds: FrictionBounds, contacts: np.ndarray, unknowns: np.ndarray) -> Piece:
        """Return bounds on the friction of q connected contacts at every minimum.

        The change f of their friction, from the given one to that at a minimum, is the sum of friction L c along m
        loops, which exerts no torque, and a rest that follows from the torques of f. These torques cancel those of the
        changes at the other contacts of the spheres, which have bounds; so the rest has bounds. The friction limits
        then confine the number c of each loop to an interval.

        bounds : what is known so far of the friction of all contacts.
        contacts : (q,), indices of these contacts.
        unknowns : (n,), indices, among all unknowns, of the spin components of their spheres."""
        rows, most_change = bounds.rows[tangent_rows(contacts)][:, unknowns].toarray(), bounds.most_change
        in_piece = np.zeros(len(bounds.network.free), dtype=bool)
        in_piece[bounds.sphere[unknowns]] = True
        is_other = bounds.network.counts & in_piece[bounds.network.graph.contact].any(axis=0)
        is_other[contacts] = False
        others = np.flatnonzero(is_other)
        # Friction L along loops, and the inverse Y by which the rest of f follows from torques (step 1 of the proof).
        loops, inverse = _loops_and_inverse(rows)
        # Rounding of torques: 4 EPS for each of the `terms` terms of the longest sum. Rounding of f: the error of the
        # splitting, and 16 EPS, as the tangents are orthonormal up to rounding only.
        terms = 2 * (len(contacts) + len(others)) + len(unknowns) + 64
        torque = (bounds.left_over + 4 * terms * EPS * bounds.sum_at_spheres(most_change))[bounds.sphere[unknowns]]
        by_rounding = np.abs(inverse).T @ torque + _splitting_error(rows, loops, inverse).T @ np.repeat(
            most_change[contacts], 2
        )
        by_rounding = weighted_lengths(by_rounding[:, None]) + 16 * EPS * most_change[contacts]
        # The torques of f are minus those of the changes on the other contacts of these spheres (step 2).
        by_others = -inverse.T @ bounds.rows[tangent_rows(others)][:, unknowns].toarray().T
        most_off_loops = (block_norms(by_others) @ most_change[others] + by_rounding) * UP
        # Intervals of the friction c along loops (step 3), and the bound on the size of optimal friction (step 4).
        tangents, force = bounds.tangents[contacts], bounds.friction[contacts]
        middle, half_length = _loop_intervals(
            loops, np.einsum("cak,ck->ca", tangents, force), bounds.most_friction[contacts] + most_off_loops
        )
        moved = np.einsum("ca,cak->ck", (loops @ middle).reshape(-1, 2), tangents)
        largest = np.linalg.norm(force + moved, axis=1) + weighted_lengths(loops, half_length) + most_off_loops
        return cls(
            contacts, others, loops, middle, half_length, by_others, most_off_loops, by_rounding * UP, largest * UP
        )


def tangent_rows(contacts: np.ndarray) -> np.ndarray:
    """Return the indices (2 q,) of the rows 2 i and 2 i + 1, which belong to both tangents of contact i, for the q
    contacts i in `contacts`."""
    return (2 * contacts[:, None] + np.arange(2)).ravel()


def weighted_lengths(vectors: np.ndarray, weight: np.ndarray | float = 1.0, numbers: int = 2) -> np.ndarray:
    """Return for each of q contacts the sum (q,), over m columns, of the length of its vector in a column times the
    weight of the column.

    vectors : (p q, m), in each column p successive entries are the vector of one contact.
    weight : (m,), or one number for all columns.
    numbers : p."""
    lengths = np.linalg.norm(vectors.reshape(len(vectors) // numbers, numbers, vectors.shape[1]), axis=1)
    return np.asarray((lengths * weight).sum(axis=1))


def block_norms(matrix: np.ndarray, numbers: int = 2) -> np.ndarray:
    """Return the Frobenius norm of each block (p, 2) of a matrix (p q, 2 k): an array (q, k). If the matrix gives the
    forces on q contacts from those on k others, a norm bounds the force on one of the q by a unit force on one of the
    others.

    numbers : p, the number of rows of the matrix for a contact.
    """
    return np.asarray(
        np.linalg.norm(matrix.reshape(len(matrix) // numbers, numbers, matrix.shape[1] // 2, 2), axis=(1, 3))
    )


def _splitting_error(rows: np.ndarray, loops: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Return a bound (2 q, 2 q) on the size of each entry of D = I - L L^T - M Y. It would be 0 without rounding:
    friction on q contacts is the sum of its part along loops, L L^T, and of a rest that follows from its torques, M Y.

    The bound is the size of D as doubles give it, plus the rounding of the sums: EPS for each term, and 64 EPS more.

    rows : M, (2 q, n), the matrix that gives slips of q contacts from n unknown spin components.
    loops : L, (2 q, m), friction along m loops.
    inverse : Y, (n, 2 q), nearly the pseudo-inverse of M."""
    found, terms = np.abs(np.eye(len(rows)) - loops @ loops.T - rows @ inverse), sum(rows.shape) + 64
    sizes = np.abs(loops)
    result: np.ndarray = found + terms * EPS * (np.eye(len(rows)) + sizes @ sizes.T + np.abs(rows) @ np.abs(inverse))
    return result


def _loops_and_inverse(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two matrices: L, (2 q, m), whose columns are friction on q contacts along m loops, which exerts no torque;
    and the pseudo-inverse (n, 2 q) of M. As torques are M^T times friction, M^T L = 0 but for rounding.

    rows : M, (2 q, n), gives both tangential components of each slip from n unknown spin components."""
    u, size, v = np.linalg.svd(rows, full_matrices=True)
    rank = int((size > NEARLY_SINGULAR * size.max(initial=0.0)).sum())
    inverse = (v[:rank].T / size[:rank]) @ u[:, :rank].T
    # The projection on all friction without torque. Contacts that it connects form a group. In each group the columns
    # of L are its eigenvectors with the eigenvalue 1; the others have 0.
    projection = u[:, rank:] @ u[:, rank:].T
    share = block_norms(projection)
    first, second = np.nonzero(share > IN_A_LOOP)
    label, loops = pieces(len(share), first, second), [np.zeros((len(rows), 0))]
    for group in np.unique(label[share.diagonal() > IN_A_LOOP]):
        at = tangent_rows(np.flatnonzero(label == group))
        value, vector = np.linalg.eigh(projection[np.ix_(at, at)])
        loops.append(np.zeros((len(rows), int((value > 0.5).sum()))))
        loops[-1][at] = vector[:, value > 0.5]
    return np.concatenate(loops, axis=1), inverse


def _loop_intervals(loops: np.ndarray, force: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return intervals, as (middle, half_length), (m,) each, of the friction c that circulates along each of m loops:
    |c - middle| <= half_length at any minimum of the power, where the friction is F + L c.

    The interval is close to the possible values of c for a loop that shares no contact with another loop; else it is
    crude.

    loops : L, (2 q, m), orthonormal columns; rows 2 i and 2 i + 1 are the tangential components at contact i.
    force : F, (q, 2), the stored friction along the tangents.
    limit : (q,), force: a bound on |F + L c| at each contact.
    """
    size = np.linalg.norm(loops.reshape(len(force), 2, -1), axis=1)
    # L has orthonormal columns, so c = L^T (F* - F) for the friction F* = F + L c at a minimum, and |F*| <= limit at
    # each contact: |c| is at most the sum of |L| (limit + |F|) over the contacts.
    most_c = (size * (limit + np.linalg.norm(force, axis=1))[:, None]).sum(axis=0) * UP
    middle, half_length, in_loop = np.zeros(len(most_c)), most_c.copy(), (size > IN_A_LOOP).astype(float)
    shares_none = ((in_loop.T @ in_loop) > 0).sum(axis=0) == 1
    for loop in np.flatnonzero(shares_none):
        # For each contact of the loop solve |F + L c| = most, a quadratic equation c^2 + 2 linear c + constant = 0.
        # Tiny entries of L for other loops are covered by `most`, the rounding under the root by 1e-12.
        at = np.flatnonzero(in_loop[:, loop])
        square, most = size[at, loop] ** 2, limit[at] + (size[at] @ most_c - size[at, loop] * most_c[loop])
        linear = (loops[:, loop].reshape(-1, 2)[at] * force[at]).sum(axis=1) / square
        constant = ((force[at] ** 2).sum(axis=1) - most**2) / square
        root = np.sqrt(np.maximum(linear**2 - constant, 0.0) + 1e-12 * (linear**2 + np.abs(constant)))
        low, high = (-linear - root).max(), (root - linear).min()
        if 0 <= high - low < 2 * most_c[loop]:
            middle[loop] = (low + high) / 2
            half_length[loop] = (high - low) / 2 * UP + 8 * EPS * (abs(low) + abs(high))
    return middle, half_length
