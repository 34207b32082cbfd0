"""What contacts with oblique normals can bear at every minimum, where loops cannot roll as their normals are stored.

Letters: N spheres, E contacts, n unknowns; F the friction at hand, F* optimal friction, f = F* - F; X the contacts that
can roll exactly (exact_motions.py); Q those that touch a sphere which X leaves out, and are not known to slip; M the
rows of slips of Q, two for each contact; N (in formulas) columns along loops, with M^T N = 0 but for rounding; c = N^T
f their coordinates; y slips.

With rounded normals loops cannot roll that would do so with ideal ones: some of their contacts slip by 1e-16, and
rounding decides which. But friction is in balance there as elsewhere: K^T f = -K^T F on all free spheres. f is small
where contacts are known to slip; elsewhere both F and F* lie in a disc. Choose Y such that I = N N^T + M Y + E with
small E, a matrix of rounding errors. Then

    f = N c + Y^T (M^T f) + E^T f

on Q, and M^T f is what all other contacts leave over. This is an identity, wherever N and Y come from (singular
values). A contact with N = 0 is in no loop, and what it bears is known. As |F + f| <= mu F_n + eta |y| for every
contact, each contact of a loop with one c confines this c to an interval. Several c are each confined by the sum of
what the discs allow. A contact of which |F + f| is below mu F_n for all that is possible rests, since one that slips
bears no less.
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
NEARLY_SINGULAR = 1e-8  # singular value over the largest, up to which forces along its vector are taken for a loop
IN_A_LOOP = 1e-7  # force of a contact over that of a loop, above which it belongs to the loop


@dataclass(frozen=True)
class Doubts:
    """What is known of friction at every minimum before loops are looked at.

    number : (N, 3), number of each unknown, -1 where there is none.
    exact : X and its motions.
    given : F by component.
    known : (E,) mask of contacts that are known to slip.
    off, limit : (E,), bounds on the sizes of f and of F*.
    """

    network: JudgedNetwork
    number: np.ndarray
    exact: ExactMotions
    given: list[Enclosure]
    known: np.ndarray
    off: np.ndarray
    limit: np.ndarray

    @cached_property
    def friction(self) -> np.ndarray:
        """F (E, 3), rounded to doubles."""
        return np.stack([part.value for part in self.given], axis=1)

    @cached_property
    def tangents(self) -> np.ndarray:
        """(E, 2, 3), two unit vectors for each contact, across its normal and each other."""
        n = self.network.graph.normal
        first = np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=1)])
        first /= np.linalg.norm(first, axis=1)[:, None]
        second = np.cross(n, first)
        return np.stack([first, second / np.linalg.norm(second, axis=1)[:, None]], axis=1)

    @cached_property
    def rows(self) -> sparse.csr_array:
        """Matrix (2 E, n) of slips along the tangents; the two rows of a contact follow each other."""
        count = len(self.off)
        row = np.repeat(np.arange(2 * count), 3)
        column = (np.arange(3) * count + np.arange(count)[:, None]).repeat(2, axis=0)
        along = sparse.csr_array((self.tangents.ravel(), (row, column.ravel())), shape=(2 * count, 3 * count))
        return sparse.csr_array(along @ slip_rows(self.network, self.number))

    @cached_property
    def sphere(self) -> np.ndarray:
        """(n,), the sphere of each unknown."""
        return np.nonzero(self.number >= 0)[0]

    @cached_property
    def left_out(self) -> np.ndarray:
        """(N,) mask of the spheres that X leaves out."""
        return np.asarray(self.network.reached & ~self.exact.spheres)

    @cached_property
    def outside(self) -> np.ndarray:
        """(E,) mask of Q."""
        touches = self.left_out[self.network.graph.contact].any(axis=0)
        return np.asarray(self.network.counts & ~self.known & touches)

    @cached_property
    def left_over(self) -> np.ndarray:
        """(N,), bound on the torque that F leaves over on each sphere, and on the rounding of `rows` times f (64
        roundings, amply)."""
        torques = self.network.torques(moments(self.given, self.network.graph.normal))
        return np.asarray((np.max([part.most for part in torques], axis=0) + 64 * EPS * self.around(self.off)) * UP)

    def around(self, values: np.ndarray) -> np.ndarray:
        """(N,), sum of `values` (E,) over the contacts of each sphere that count."""
        ends = self.network.graph.contact[:, self.network.counts].ravel()
        return np.bincount(ends, np.tile(values[self.network.counts], 2), len(self.network.free))

    def split(self) -> list[Piece]:
        """A piece for each part that contacts of Q make of the spheres that X leaves out, unless it has more than
        MOST_SPLIT unknowns."""
        first, second = self.network.graph.contact
        joins = self.outside & self.left_out[first] & self.left_out[second]
        label = pieces(len(self.left_out), first[joins], second[joins])
        part = label[np.where(self.left_out[first], first, second)]
        column, found = np.where(self.left_out[self.sphere], label[self.sphere], -1), []
        for own in np.unique(part[self.outside]):
            unknowns = np.flatnonzero(column == own)
            if len(unknowns) <= MOST_SPLIT:
                found.append(Piece.of(self, np.flatnonzero(self.outside & (part == own)), unknowns))
        return found


@dataclass(frozen=True)
class Piece:
    """What one part of Q can bear at a minimum.

    contacts : numbers (q,) of its contacts.
    others : numbers (k,) of the other contacts of its spheres.
    along : N, (2 q, m), columns along its loops.
    middle, half : (m,), of the interval in which each c lies.
    by_others : (2 q, 2 k), the change of f with f of the others.
    near : (q,), bound on the size of f without its part N c.
    rounded : (q,), the share of `near` that is rounding and leftover torques, not f of the others.
    largest : (q,), bound on |F*|.
    """

    contacts: np.ndarray
    others: np.ndarray
    along: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    by_others: np.ndarray
    near: np.ndarray
    rounded: np.ndarray
    largest: np.ndarray

    @classmethod
    def of(cls, doubts: Doubts, contacts: np.ndarray, unknowns: np.ndarray) -> Piece:
        """Split the friction of some contacts of Q by loops. contacts : their numbers (q,). unknowns : numbers (n,) of
        the unknowns of the spheres that they join."""
        own, off = doubts.rows[both(contacts)][:, unknowns].toarray(), doubts.off
        touches = np.zeros(len(doubts.network.free), dtype=bool)
        touches[doubts.sphere[unknowns]] = True
        beside = doubts.network.counts & touches[doubts.network.graph.contact].any(axis=0)
        beside[contacts] = False
        others = np.flatnonzero(beside)
        # N and Y, and bounds on E and on torques that F leaves over; `terms` is the length of the longest sum.
        along, inverse = _split(own)
        terms = 2 * (len(contacts) + len(others)) + len(unknowns) + 64
        left = (doubts.left_over + 4 * terms * EPS * doubts.around(off))[doubts.sphere[unknowns]]
        rounded = np.abs(inverse).T @ left + _missed(own, along, inverse).T @ np.repeat(off[contacts], 2)
        rounded = sizes(rounded[:, None]) + 16 * EPS * off[contacts]
        # M^T f is minus what the other contacts bring to these spheres.
        by_others = -inverse.T @ doubts.rows[both(others)][:, unknowns].toarray().T
        near = (blocks(by_others) @ off[others] + rounded) * UP
        tangents, force = doubts.tangents[contacts], doubts.friction[contacts]
        middle, half = _intervals(along, np.einsum("cak,ck->ca", tangents, force), doubts.limit[contacts] + near)
        moved = np.einsum("ca,cak->ck", (along @ middle).reshape(-1, 2), tangents)
        largest = np.linalg.norm(force + moved, axis=1) + sizes(along, half) + near
        return cls(contacts, others, along, middle, half, by_others, near, rounded * UP, largest * UP)


def both(contacts: np.ndarray) -> np.ndarray:
    """Numbers (2 q,) of the two rows of each contact (q,)."""
    return (2 * contacts[:, None] + np.arange(2)).ravel()


def sizes(of: np.ndarray, weight: np.ndarray | float = 1.0, numbers: int = 2) -> np.ndarray:
    """(q,), for each contact the weighted sum over columns of the lengths of its vectors. of : (p q, m), vectors of p =
    `numbers` entries for each contact. weight : (m,)."""
    lengths = np.linalg.norm(of.reshape(len(of) // numbers, numbers, of.shape[1]), axis=1)
    return np.asarray((lengths * weight).sum(axis=1))


def blocks(of: np.ndarray, numbers: int = 2) -> np.ndarray:
    """(q, k), the Frobenius norm of each block of a matrix (p q, 2 k), of p = `numbers` rows for a contact and two
    columns for another: not below its spectral norm."""
    return np.asarray(np.linalg.norm(of.reshape(len(of) // numbers, numbers, of.shape[1] // 2, 2), axis=(1, 3)))


def _missed(rows: np.ndarray, along: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Bound on the size of each entry of E = I - N N^T - M Y. rows : M. along : N. inverse : Y."""
    found, terms = np.abs(np.eye(len(rows)) - along @ along.T - rows @ inverse), sum(rows.shape) + 64
    of_along = np.abs(along)
    return found + terms * EPS * (np.eye(len(rows)) + of_along @ of_along.T + np.abs(rows) @ np.abs(inverse))


def _split(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """N and Y of rows M: the columns of N span what M^T makes 0, each within one loop."""
    u, size, v = np.linalg.svd(rows, full_matrices=True)
    rank = int((size > NEARLY_SINGULAR * size.max(initial=0.0)).sum())
    inverse = (v[:rank].T / size[:rank]) @ u[:, :rank].T
    balanced = u[:, rank:] @ u[:, rank:].T
    share = blocks(balanced)
    first, second = np.nonzero(share > IN_A_LOOP)
    loop, found = pieces(len(share), first, second), [np.zeros((len(rows), 0))]
    for own in np.unique(loop[share.diagonal() > IN_A_LOOP]):
        at = both(np.flatnonzero(loop == own))
        value, vector = np.linalg.eigh(balanced[np.ix_(at, at)])
        found.append(np.zeros((len(rows), int((value > 0.5).sum()))))
        found[-1][at] = vector[:, value > 0.5]
    return np.concatenate(found, axis=1), inverse


def _intervals(along: np.ndarray, force: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half length (m,) of an interval for each c. along : N, (2 q, m). force : (q, 2), F along the tangents.
    limit : (q,), sizes that F + N c does not exceed."""
    size = np.linalg.norm(along.reshape(len(force), 2, -1), axis=1)
    # As |N c| <= limit + |F| at each contact and c = N^T (N c), c is at most the sum of that over contacts.
    whole = (size * (limit + np.linalg.norm(force, axis=1))[:, None]).sum(axis=0) * UP
    middle, half, there = np.zeros(len(whole)), whole.copy(), (size > IN_A_LOOP).astype(float)
    for c in np.flatnonzero(((there.T @ there) > 0).sum(axis=0) == 1):
        own = np.flatnonzero(there[:, c])
        # For each contact of a loop that shares none with another c: solve |F + N c| = most, a quadratic equation of c.
        square, most = size[own, c] ** 2, limit[own] + (size[own] @ whole - size[own, c] * whole[c])
        part = (along[:, c].reshape(-1, 2)[own] * force[own]).sum(axis=1) / square
        beyond = ((force[own] ** 2).sum(axis=1) - most**2) / square
        reach = np.sqrt(np.maximum(part**2 - beyond, 0.0) + 1e-12 * (part**2 + np.abs(beyond)))
        low, high = (-part - reach).max(), (reach - part).min()
        if 0 <= high - low < 2 * whole[c]:
            middle[c], half[c] = (low + high) / 2, (high - low) / 2 * UP + 8 * EPS * (abs(low) + abs(high))
    return middle, half
