"""Which contacts with oblique normals rest at every minimum, although loops beside them cannot roll as they are stored.

Contacts of loops.py rest where they bear less than their friction whatever happens. Of X, the contacts that can roll
exactly, each part rests by resting.py if it can bear what is left to it. R solves K^T R = -L for each load L that f and
c of loops.py bring to the spheres of X, K the rows of X, and G = F + sum R f stays inside all discs where |F| and all
sizes of R f together are below mu F_n. K^T (G - F*) would be 0 without rounding. The exact residual lies in the range
of K^T, so it is orthogonal to all motions Z of X. The computed one may have a part Z a: that is rounding alone, and is
subtracted before its size is taken. Then G can be corrected by no more than that size over the least singular value of
K but for the motions, of which exact_motions.py has a floor.

R is found by springs that are the weaker the less room a contact has, in several trials; any R would do.
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

FORCES_AT_ONCE = 64
MOST_TRIALS, SPARED = 10, 0.7  # of R, and the power of what a contact bears over its room by which it is weakened
LEAST_ROOM, LEAST_BORNE = 1e-4, 1e-2  # of the largest, that are told from none
YIELDING, CARRYING_STEPS = -1e-13, 3  # what holds motions, over squares of their slips, and steps that take it away


@np.errstate(all="ignore")  # what is not finite proves nothing
def at_rest_beside_loops(bounds: Bounds, far: np.ndarray) -> np.ndarray:
    """Mask (E,) of contacts that are proven to rest at every minimum, of a network whose components mix.

    far : (E,), how far slips of minima are from the given ones at most; infinite where that is not known."""
    network, springs = bounds.network, bounds.springs
    found = np.zeros(len(network.acts), dtype=bool)
    longest = np.linalg.norm(network.graph.normal, axis=1).max(initial=0.0)  # normals are taken for units
    if springs is None or not longest < UP:
        return found
    known, off = known_friction(bounds, far)
    rests = network.counts & ~known & ((network.holding - length(bounds.friction)).lower() > 0)
    exact = ExactMotions.of(network, springs.number, rests)
    limit = network.holding.most + np.where(network.slope.high > 0, network.slope.most * (network.slip.most + far), 0.0)
    doubts = Doubts(network, springs.number, exact, bounds.friction, known, off * UP, limit * UP)
    left_out = doubts.split()
    for piece in left_out:
        found[piece.contacts] = piece.largest < network.holding.least[piece.contacts]
    found &= rests
    if exact.contacts.any():
        found[exact.contacts] = Borne(doubts, left_out).rests()
    return found


@dataclass(frozen=True)
class Borne:
    """The spheres of X with n unknowns, and its q contacts. left_out : pieces of what X leaves out."""

    doubts: Doubts
    left_out: list[Piece]

    @cached_property
    def columns(self) -> np.ndarray:
        """Numbers (n,) of the unknowns among all."""
        return np.flatnonzero(self.doubts.exact.spheres[self.doubts.sphere])

    @cached_property
    def contacts(self) -> np.ndarray:
        """Numbers (q,)."""
        return np.flatnonzero(self.doubts.exact.contacts)

    @cached_property
    def rows(self) -> sparse.csr_array:
        """K (3 q, n), exactly, contact by contact."""
        whole = slip_rows(self.doubts.network, self.doubts.number)
        at = self.contacts[:, None] + np.arange(3) * len(self.doubts.off)
        return sparse.csr_array(whole[at.ravel()][:, self.columns])

    @cached_property
    def motions(self) -> sparse.csr_array:
        """Z (n, k), all motions of X, which have no slips."""
        of = self.doubts.exact.motions
        if of is None:
            return sparse.csr_array((len(self.columns), 0))
        return sparse.csr_array(of.motion[:, : len(of.choices.chosen)])

    @cached_property
    def part(self) -> np.ndarray:
        """(n,), number of the part of X that each unknown belongs to."""
        network = self.doubts.network
        first, second = network.graph.contact[:, self.contacts]
        inner = network.free[first] & network.free[second]
        return pieces(len(network.free), first[inner], second[inner])[self.doubts.sphere[self.columns]]

    @cached_property
    def others(self) -> np.ndarray:
        """Numbers (k,) of the contacts whose f is what it may be: all that count but for X and those of pieces."""
        found = self.doubts.network.counts & ~self.doubts.exact.contacts
        for piece in self.left_out:
            found[piece.contacts] = False
        return np.flatnonzero(found)

    @cached_property
    def loads(self) -> tuple[sparse.csc_array, sparse.csc_array]:
        """L of f of the others, (n, 2 k), and of c of all pieces, (n, m)."""
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
        """Share by which sums of the longest kind here may be off, over the sum of their sizes."""
        return float(4 * (2 * len(self.others) + len(self.columns) + 64) * EPS)

    @cached_property
    def unsure(self) -> np.ndarray:
        """(n,), torques that no f of the others and no c makes."""
        more = self.rounding * self.doubts.off
        for piece in self.left_out:
            more[piece.contacts] += piece.rounded + self.rounding * piece.near
        return (self.doubts.left_over + self.doubts.around(more))[self.doubts.sphere[self.columns]] * UP

    @cached_property
    def room(self) -> np.ndarray:
        """(q,)."""
        holding, force = self.doubts.network.holding.least[self.contacts], self.doubts.friction[self.contacts]
        return np.asarray(holding - np.linalg.norm(force, axis=1))

    def rests(self) -> np.ndarray:
        """(q,) mask of the contacts that rest."""
        room = np.maximum(self.room, LEAST_ROOM * self.room.max())
        carrying, off = Carrying.of(self, room**2), self.doubts.off[self.others]
        found = np.zeros(len(room), dtype=bool)
        if carrying is None:
            return found
        borne, missed = np.zeros(len(room)), self.unsure.copy()
        for begin in range(0, len(off), FORCES_AT_ONCE):
            own, some = off[begin : begin + FORCES_AT_ONCE], slice(2 * begin, 2 * (begin + FORCES_AT_ONCE))
            force, left = carrying.carried(self.loads[0][:, some].toarray(), np.repeat(own, 2))
            borne += blocks(force, 3) @ own
            missed += left
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
            share = (np.linalg.norm(moved, axis=1) + sizes(force, half, 3)) / np.maximum(
                room - borne, LEAST_ROOM * room
            )
            eased = carrying.weight * np.maximum(share / share.max(), LEAST_BORNE) ** -SPARED
            carrying = Carrying.of(self, eased)
            if carrying is None:
                break
        return found

    def _bears(self, largest: np.ndarray, missed: np.ndarray) -> np.ndarray:
        """(q,) mask of the contacts of parts of which none bears too much. largest : (q,), sizes of G before it is
        corrected. missed : (n,), what is left to correct."""
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
    """Springs of these stiffnesses (q,) at the contacts of X. scale : (n,), of the unknowns."""

    borne: Borne
    weight: np.ndarray
    scale: np.ndarray
    factor: Factor

    @classmethod
    def of(cls, borne: Borne, weight: np.ndarray) -> Carrying | None:
        rows = sparse.csr_array(sparse.diags_array(np.sqrt(np.repeat(weight, 3))) @ borne.rows)
        squares = np.bincount(rows.indices, rows.data**2, rows.shape[1])
        scale = 1 / np.sqrt(np.where(squares > 0, squares, 1.0))
        rows = sparse.csr_array(rows @ sparse.diags_array(scale))
        place = borne.doubts.network.graph.place[borne.doubts.sphere[borne.columns]].T
        factor = Elimination.of((rows.T @ rows).tocsc(), place).factorised(YIELDING)
        return None if factor is None else cls(borne, weight, scale, factor)

    def carried(self, load: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R (3 q, m) of loads (n, m), and what it does not take (n,), apart from motions, of as much (m,) of each."""
        rows, weight, scale = self.borne.rows, np.repeat(self.weight, 3)[:, None], self.scale[:, None]
        force, (left, moves) = np.zeros((rows.shape[0], load.shape[1])), self._across(load)
        for _ in range(CARRYING_STEPS):
            force -= weight * (rows @ (scale * self.factor.solve(scale * left)))
            left, moves = self._across(load + rows.T @ force)
        motions = self.borne.motions
        summed = abs(rows).T @ (np.abs(force) @ most) + np.abs(load) @ most + abs(motions) @ (np.abs(moves) @ most)
        return force, np.abs(left) @ most + (self.borne.rounding + 2 * motions.shape[1] * EPS) * summed

    def _across(self, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is left of loads (n, m) without motions, and how much (k, m) of each motion was in them."""
        motions = self.borne.motions
        if not motions.shape[1]:
            return load, np.zeros((0, load.shape[1]))
        moves = np.linalg.solve((motions.T @ motions).toarray(), motions.T @ load)
        return load - motions @ moves, moves
