"""Which contacts with oblique normals rest at every minimum, although loops beside them cannot roll as they are stored.

Letters: N spheres, E contacts; X the contacts that can roll exactly, q of them, on spheres with n unknowns; K (3 q, n)
the matrix of their slips; F the friction at hand, F* optimal friction, f = F* - F; c the m coordinates of friction
along loops (loops.py); k the number of contacts whose f is only bounded; Z (n, z) the motions of X without any slip; R
here a matrix of forces, not a number of samples.

Contacts of loops.py rest where they bear less than their friction whatever f is. Each part of X rests by theorem 8
(resting.py) if it can bear what is left to it. For each load L that f and c bring to the spheres of X, R solves K^T R =
-L. So G = F + sum R f, a sum over loads, stays inside all discs where |F| and the sizes of all R f together are below
mu F_n. Without rounding K^T (G - F*) would be 0. The exact residual lies in the range of K^T, so it is orthogonal to
all motions Z. The computed residual may have a part Z a: that is rounding alone, and is subtracted before the size of
the residual is taken. Then G can be corrected by forces no larger than that size over the least singular value of K
that is not 0, of which exact_motions.py has a floor.

R is found by springs, which are the weaker the less friction a contact has left, in several trials; any R would do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.enclosure import UP, length
from taichi_bearings.proof.exact_motions import ExactMotions
from taichi_bearings.proof.loops import Doubts, Piece, blocks, both, sizes
from taichi_bearings.proof.resting import known_friction
from taichi_bearings.proof.rounded_elimination import EPS, Elimination, Factor
from taichi_bearings.proof.springs import slip_rows

FORCES_AT_ONCE = 64  # contacts whose loads are carried at once
MOST_TRIALS, SPARED = 10, 0.7  # trials of R; springs are weakened by (load of a contact / friction left) to this power
LEAST_ROOM, LEAST_BORNE = 1e-4, 1e-2  # friction left, and load, over the largest; smaller ones count as this large
YIELDING, CARRYING_STEPS = -1e-13, 3  # minus what is added to the diagonal, to hold motions; steps that correct it


@np.errstate(all="ignore")  # what is not finite proves nothing
def at_rest_beside_loops(bounds: Bounds, far: np.ndarray) -> np.ndarray:
    """Mask (E,) of contacts that are proven to rest at every minimum, of a network whose components mix.

    far : (E,), bound on how far slips of minima are from the given ones; infinite where none is known.
    """
    network, springs = bounds.network, bounds.springs
    found = np.zeros(len(network.acts), dtype=bool)
    longest = np.linalg.norm(network.graph.normal, axis=1).max(initial=0.0)  # normals are taken for units
    if springs is None or not longest < UP:
        return found
    known, off = known_friction(bounds, far)
    rests = network.counts & ~known & ((network.holding - length(bounds.friction)).lower() > 0)
    # X among the contacts that have friction left, and what f and F* are at most.
    exact = ExactMotions.of(network, springs.number, rests)
    limit = network.holding.most + np.where(network.slope.high > 0, network.slope.most * (network.slip.most + far), 0.0)
    doubts = Doubts(network, springs.number, exact, bounds.friction, known, off * UP, limit * UP)
    # Contacts of loops beside X rest where they cannot bear all their friction; parts of X where they can bear the
    # rest.
    left_out = doubts.split()
    for piece in left_out:
        found[piece.contacts] = piece.largest < network.holding.least[piece.contacts]
    found &= rests
    if exact.contacts.any():
        found[exact.contacts] = Borne(doubts, left_out).rests()
    return found


@dataclass(frozen=True)
class Borne:
    """What is left to X to bear. doubts : bounds on f everywhere. left_out : the pieces of contacts beside X."""

    doubts: Doubts
    left_out: list[Piece]

    @cached_property
    def columns(self) -> np.ndarray:
        """Numbers (n,) of the unknowns of the spheres of X, among all unknowns."""
        return np.flatnonzero(self.doubts.exact.spheres[self.doubts.sphere])

    @cached_property
    def contacts(self) -> np.ndarray:
        """Numbers (q,) of the contacts of X."""
        return np.flatnonzero(self.doubts.exact.contacts)

    @cached_property
    def rows(self) -> sparse.csr_array:
        """The matrix K (3 q, n), without rounding; the three rows of a contact follow each other."""
        whole = slip_rows(self.doubts.network, self.doubts.number)
        at = self.contacts[:, None] + np.arange(3) * len(self.doubts.off)
        return sparse.csr_array(whole[at.ravel()][:, self.columns])

    @cached_property
    def motions(self) -> sparse.csr_array:
        """Z (n, z), all motions of the spheres of X in which X does not slip."""
        of = self.doubts.exact.motions
        if of is None:
            return sparse.csr_array((len(self.columns), 0))
        return sparse.csr_array(of.motion[:, : len(of.choices.chosen)])

    @cached_property
    def part(self) -> np.ndarray:
        """(n,), number of the part of X to which each unknown belongs."""
        network = self.doubts.network
        first, second = network.graph.contact[:, self.contacts]
        inner = network.free[first] & network.free[second]
        return pieces(len(network.free), first[inner], second[inner])[self.doubts.sphere[self.columns]]

    @cached_property
    def others(self) -> np.ndarray:
        """Numbers (k,) of the contacts whose f is only bounded: all that count, except X and the contacts of pieces."""
        found = self.doubts.network.counts & ~self.doubts.exact.contacts
        for piece in self.left_out:
            found[piece.contacts] = False
        return np.flatnonzero(found)

    @cached_property
    def loads(self) -> tuple[sparse.csc_array, sparse.csc_array]:
        """Loads L on the unknowns of X: (n, 2 k) of the two tangential components of f of each other contact, including
        what f makes the pieces bear, and (n, m) of the loop coordinates c of all pieces."""
        rows, own = self.doubts.rows[:, self.columns], both(self.others)
        place = np.full(rows.shape[0], -1)
        place[own] = np.arange(len(own))
        found, loops = [rows[own].T], [sparse.csr_array((len(self.columns), 0))]
        for piece in self.left_out:
            to_spheres, at = rows[both(piece.contacts)].T, place[both(piece.others)]
            row, column = np.indices(piece.by_others.shape).reshape(2, -1)
            shape = (len(piece.by_others), len(own))
            by_others = sparse.csr_array((piece.by_others.ravel(), (row, at[column])), shape=shape)
            found.append(to_spheres @ by_others)
            loops.append(sparse.csr_array(to_spheres @ piece.along))
        return sparse.csc_array(sum(found[1:], found[0])), sparse.csc_array(sparse.hstack(loops))

    @cached_property
    def rounding(self) -> float:
        """Bound on the relative rounding error of sums as long as any here, over the sum of the sizes of their terms: 4
        units for each term, and 64 terms more."""
        return float(4 * (2 * len(self.others) + len(self.columns) + 64) * EPS)

    @cached_property
    def unsure(self) -> np.ndarray:
        """(n,), bound on the torques on X that neither f of the others nor c accounts for, as they are rounding."""
        more = self.rounding * self.doubts.off
        for piece in self.left_out:
            more[piece.contacts] += piece.rounded + self.rounding * piece.near
        return (self.doubts.left_over + self.doubts.around(more))[self.doubts.sphere[self.columns]] * UP

    @cached_property
    def room(self) -> np.ndarray:
        """(q,), the friction that each contact of X has left, mu F_n - |F|."""
        holding, force = self.doubts.network.holding.least[self.contacts], self.doubts.friction[self.contacts]
        return np.asarray(holding - np.linalg.norm(force, axis=1))

    def rests(self) -> np.ndarray:
        """(q,) mask of the contacts of X that are proven to rest."""
        room = np.maximum(self.room, LEAST_ROOM * self.room.max())
        carrying, off = Carrying.of(self, room**2), self.doubts.off[self.others]
        found = np.zeros(len(room), dtype=bool)
        if carrying is None:
            return found
        borne, missed = np.zeros(len(room)), self.unsure.copy()
        # Sizes of R f for other contacts, whose f may have any direction: each norm times the bound on f, summed.
        for begin in range(0, len(off), FORCES_AT_ONCE):
            own, some = off[begin : begin + FORCES_AT_ONCE], slice(2 * begin, 2 * (begin + FORCES_AT_ONCE))
            force, left = carrying.carried(self.loads[0][:, some].toarray(), np.repeat(own, 2))
            borne += blocks(force, 3) @ own
            missed += left
        # Loop coordinates c are known within intervals: their middles move G, and half their lengths add to its size.
        middle, half = (
            np.concatenate([np.zeros(0), *of])
            for of in ([p.middle for p in self.left_out], [p.half for p in self.left_out])
        )
        for _ in range(MOST_TRIALS):
            force, left = carrying.carried(self.loads[1].toarray(), np.abs(middle) + half)
            moved = (force @ middle).reshape(-1, 3)
            largest = np.linalg.norm(self.doubts.friction[self.contacts] + moved, axis=1) + sizes(force, half, 3)
            found |= self._bears(largest + borne, missed + left)
            if found.all() or not len(half):
                break
            # Try again with weaker springs where contacts bear much of the friction that they have left.
            share = (np.linalg.norm(moved, axis=1) + sizes(force, half, 3)) / np.maximum(
                room - borne, LEAST_ROOM * room
            )
            eased = carrying.weight * np.maximum(share / share.max(), LEAST_BORNE) ** -SPARED
            carrying = Carrying.of(self, eased)
            if carrying is None:
                break
        return found

    def _bears(self, largest: np.ndarray, missed: np.ndarray) -> np.ndarray:
        """(q,) mask of the contacts in parts none of whose contacts bears too much. largest : (q,), sizes of G before
        it is corrected. missed : (n,), torques that the correction has to take up."""
        network, part = self.doubts.network, self.part
        corrected = np.sqrt(np.bincount(part, missed**2)) / self.doubts.exact.floor * UP
        of_sphere = np.zeros(len(network.free), dtype=np.intp)
        of_sphere[self.doubts.sphere[self.columns]] = part
        first, second = network.graph.contact[:, self.contacts]
        own = of_sphere[np.where(network.free[first], first, second)]
        bears = (largest + corrected[own]) * UP < network.holding.least[self.contacts]
        return np.asarray(np.bincount(own, ~bears)[own] == 0)


@dataclass(frozen=True)
class Carrying:
    """Springs at the contacts of X, which carry loads.

    weight : (q,), stiffnesses.
    scale : (n,), by which unknowns are multiplied in the factorised matrix.
    factor : of the scaled K^T weight K.
    """

    borne: Borne
    weight: np.ndarray
    scale: np.ndarray
    factor: Factor

    @classmethod
    def of(cls, borne: Borne, weight: np.ndarray) -> Carrying | None:
        """Springs with stiffnesses `weight` (q,); None if the factorisation fails."""
        rows = sparse.csr_array(sparse.diags_array(np.sqrt(np.repeat(weight, 3))) @ borne.rows)
        squares = np.bincount(rows.indices, rows.data**2, rows.shape[1])
        scale = 1 / np.sqrt(np.where(squares > 0, squares, 1.0))
        rows = sparse.csr_array(rows @ sparse.diags_array(scale))
        place = borne.doubts.network.graph.place[borne.doubts.sphere[borne.columns]].T
        factor = Elimination.of((rows.T @ rows).tocsc(), place).factorised(YIELDING)
        return None if factor is None else cls(borne, weight, scale, factor)

    def carried(self, load: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R (3 q, m) for loads (n, m), and a bound (n,) on the torque that it does not take up, motions Z apart, when
        each load is multiplied by a number of size up to `most` (m,)."""
        rows, weight, scale = self.borne.rows, np.repeat(self.weight, 3)[:, None], self.scale[:, None]
        force, (left, moves) = np.zeros((rows.shape[0], load.shape[1])), self._across(load)
        for _ in range(CARRYING_STEPS):  # iterative refinement
            force -= weight * (rows @ (scale * self.factor.solve(scale * left)))
            left, moves = self._across(load + rows.T @ force)
        motions = self.borne.motions
        summed = abs(rows).T @ (np.abs(force) @ most) + np.abs(load) @ most + abs(motions) @ (np.abs(moves) @ most)
        return force, np.abs(left) @ most + (self.borne.rounding + 2 * motions.shape[1] * EPS) * summed

    def _across(self, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Loads (n, m) without their part along the motions Z, and the amount (z, m) of each motion that was in
        them."""
        motions = self.borne.motions
        if not motions.shape[1]:
            return load, np.zeros((0, load.shape[1]))
        moves = np.linalg.solve((motions.T @ motions).toarray(), motions.T @ load)
        return load - motions @ moves, moves
