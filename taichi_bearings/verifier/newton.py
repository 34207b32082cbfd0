"""Spins and friction of a network with oblique normals that are closer to a minimum than doubles can be.

Contacts of T rest and those of S slip along their friction. Newton's method moves the spins as T allows, until S leaves
nothing over that T cannot bear, and lets T bear the rest; in sums of two doubles, of which each step finds more digits.
Nothing here is proven, and nothing has to be: a proof starts from what comes out, whatever it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.verifier.curvature import Form
from taichi_bearings.verifier.elimination import EPS, Elimination
from taichi_bearings.verifier.enclosure import Enclosure, length
from taichi_bearings.verifier.exact_motions import ExactMotions
from taichi_bearings.verifier.network import Network, moments
from taichi_bearings.verifier.springs import slip_rows

FIRM = 1e4  # how much more firmly T is held in guesses of conjugate gradients than S is at the median of its slips
SOFT = -1e-9  # squared slips over spins, above what rounding makes of none, and below those that T forbids
MOST_GRADIENTS, CLOSE = 40, 1e-6  # steps, and the share of the torques at which they end


@dataclass(frozen=True)
class Near:
    """own, still : contacts of S and of T. number : (N, 3) of the n unknowns, -1 for none. exact : motions of T.

    spin : (N,) by component, exact sums of two doubles. pull : (E,) by component, what T bears, the same; not of S.
    """

    network: Network
    exact: ExactMotions
    number: np.ndarray
    own: np.ndarray
    still: np.ndarray
    spin: list[Enclosure]
    pull: list[Enclosure]

    @cached_property
    def slips(self) -> list[Enclosure]:
        """(E,) by component; contacts of T that can roll exactly do so."""
        return self.network.slips(self.exact.rolling(self.spin))

    @cached_property
    def size(self) -> Enclosure:
        """(S,), of the slips of S."""
        return length([part.at(self.own) for part in self.slips])

    @cached_property
    def friction(self) -> list[Enclosure]:
        """(E,) by component, exact sums of two doubles, of S nearly along its slips."""
        strength, found = self.network.holding.at(self.own), []
        for part, slip in zip(self.pull, self.slips, strict=True):
            found.append(_doubles(part))
            found[-1].put(self.own, _doubles(strength * (slip.at(self.own) / self.size)))
        return found

    @cached_property
    def torques(self) -> list[Enclosure]:
        """(N,) by component."""
        return self.network.torques(moments(self.friction, self.network.normal))

    @cached_property
    def rows(self) -> sparse.csr_array:
        """K, (3 E, n)."""
        return slip_rows(self.network, self.number)

    def rows_of(self, contacts: np.ndarray) -> np.ndarray:
        """Their numbers, component by component."""
        return np.concatenate([k * len(self.network.normal) + contacts for k in range(3)])

    @property
    def place(self) -> np.ndarray:
        """(3, n)."""
        return np.asarray(self.network.place[np.nonzero(self.number >= 0)[0]].T)

    def form(self, firmness: float = 1.0) -> Form | None:
        """Of S what slips change across them, times the root of friction over slip, and of T all slips, times that of
        friction over the median slip and the firmness."""
        own, still, strength = self.own, self.still, self.network.holding.value
        across = np.cross(self.network.normal[own], np.stack([part.value[own] for part in self.slips], axis=1))
        across /= np.linalg.norm(across, axis=1)[:, None]
        root = np.sqrt(strength[own] / self.size.value)
        firm = firmness * np.sqrt(strength[still] / (np.median(self.size.value) if len(own) else 1.0))
        at = np.append(self.rows_of(own), self.rows_of(still))
        row = np.append(np.tile(np.arange(len(own)), 3), len(own) + np.arange(3 * len(still)))
        shape = (len(own) + 3 * len(still), self.rows.shape[0])
        size_of = np.append(np.tile(root, 3), np.tile(firm, 3))
        value = size_of * np.append(across.T.ravel(), np.ones(3 * len(still)))
        rows = sparse.csr_array(sparse.csr_array((value, (row, at)), shape=shape) @ self.rows)
        doubt = sparse.csr_array((32 * EPS * size_of, (row, at)), shape=shape) @ abs(self.rows)
        return Form.of(rows, sparse.csr_array(doubt), self.place)

    def improved(self) -> Near:
        """After as many steps as leave less than half of the torques each."""
        form, there = self.form(FIRM), self.number >= 0
        fixed = sparse.csr_array(self.rows[self.rows_of(self.still)])
        factor = Elimination.of((fixed.T @ fixed).tocsc(), self.place).factorised(SOFT)
        soft = None if form is None else form.elimination.factorised()
        if form is None or factor is None or soft is None:
            return self

        def borne(torque: np.ndarray) -> np.ndarray:
            """By which spins slips of T are that bear it, as far as T can."""
            found = factor.solve(torque)
            return found + factor.solve(torque - fixed.T @ (fixed @ found))

        def allowed(spins: np.ndarray) -> np.ndarray:
            return spins - borne(fixed.T @ (fixed @ spins))

        def bends(spins: np.ndarray) -> np.ndarray:
            """Torques of S, as its slips turn."""
            return (form.rows[: len(self.own)].T @ (form.rows[: len(self.own)] @ (spins / form.scale))) / form.scale

        best, least, found = self, np.inf, self
        while True:
            torque = np.stack([part.value for part in found.torques], axis=1)[there]
            if not (left := float(np.linalg.norm(form.scale * torque))) < least / 2:
                return best
            best, least = found, left
            slip = np.stack([part.value[self.still] for part in best.slips]).ravel()
            step = -borne(fixed.T @ slip)
            step -= _within(lambda x: allowed(bends(x)), allowed(torque + bends(step)),
                            lambda x: allowed(form.scale * soft.solve(form.scale * x)))  # fmt: skip
            found = best.moved(step, (fixed @ borne(torque + bends(step))).reshape(3, -1))

    def moved(self, step: np.ndarray, pull: np.ndarray) -> Near:
        """step : (n,), of the unknowns. pull : (3, T), what T bears less."""
        moved, less = np.zeros(self.number.shape), np.zeros((3, len(self.network.normal)))
        moved[self.number >= 0], less[:, self.still] = step, -pull
        spin, pull_ = (
            [_doubles(part + Enclosure.exact(by)) for part, by in zip(parts, change, strict=True)]
            for parts, change in ((self.spin, moved.T), (self.pull, less))
        )
        return replace(self, spin=spin, pull=pull_)


def _doubles(values: Enclosure) -> Enclosure:
    return Enclosure.exact(values.high, values.low)


def _within(
    operator: Callable[[np.ndarray], np.ndarray], right: np.ndarray, guess: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """x with operator(x) = right, by conjugate gradients. guess : of x, from the right-hand side."""
    x, left, last, along = np.zeros_like(right), right, np.inf, np.zeros_like(right)
    for _ in range(MOST_GRADIENTS):
        if not np.linalg.norm(left) > CLOSE * np.linalg.norm(right):
            break
        guessed = guess(left)
        along, last = guessed + (left @ guessed) / last * along, left @ guessed
        changed = operator(along)
        share = last / (along @ changed)
        x, left = x + share * along, left - share * changed
    return x
