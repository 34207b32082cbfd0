"""Which contacts of a network with oblique normals slip at every minimum, from one that is enclosed: theorem 7.

Let S be the contacts that slip in the given spins, T the others, and V all spins at which T rests.

1. Where contacts of T put more conditions on spheres than these have freedom for, they must roll exactly: the spheres
   turn as one of their exact motions does, which also have a floor of the other singular values (exact_motions.py).
   Contacts of T that are left have independent rows in the spins that are left, by a floor of K K^T. So V is not
   empty, and some of its spins are near the given ones, or those that Newton's method has improved.
2. Within V the potential has one minimum near these: along motions x that T allows its curvature is |B x|^2, the sum
   of mu F_n / |y| (K x across y)^2 + eta |K x|^2 over S, and elimination proves a floor tau of it with springs at T.
   Its slope there is r . x for torques r that are left over, and b . B x for what friction turns by from the given
   slips to those in V. The potential rises where |B x| is above (|r| / tau^1/2 + |b|) / 0.72, as long as no slip of a
   contact with friction changes by more than a quarter (curvature.py). Damping resists by eta |K x|^2 anywhere.
3. There the friction of S is known, and what it leaves to T is borne by the friction of T at hand and a correction, the
   size of which the floors of step 1 bound: the potential has no slope in V, so T can bear it. If all of that is inside
   the discs it is one of the whole potential; as T bears less than its friction, it rests at every minimum, so all lie
   in V, and there is only one.

Contacts with damping alone belong to S, whatever they slip.

Newton's method moves the spins as T allows, until S leaves nothing over that T cannot bear, and lets T bear the rest,
in sums of two doubles, of which each step finds more digits. Nothing of that is proven, and nothing has to be: the
proof starts from what comes out, whatever it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.curvature import Form
from taichi_bearings.proof.enclosure import UP, Enclosure, length
from taichi_bearings.proof.exact_motions import ExactMotions, numbered
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.listed import moments
from taichi_bearings.proof.rounded_elimination import EPS, Elimination
from taichi_bearings.proof.springs import floor_of_slips, slip_rows

MOVING = 1e-10  # of the fastest imposed component, above which a contact is taken to slip
MOST_TURN = 0.25  # of a slip, over its size
TINY = 1e-290
FIRM = 1e4  # how much more firmly T is held in guesses of conjugate gradients than S is at the median of its slips
SOFT = -1e-9  # squared slips over spins, above what rounding makes of none, and below those that T forbids
MOST_GRADIENTS, CLOSE = 40, 1e-6  # steps, and the share of the torques at which they end


@np.errstate(all="ignore")  # what is not finite proves nothing
def enclosed_minimum(bounds: Bounds) -> tuple[np.ndarray, np.ndarray] | None:
    """Mask S (E,), where all other contacts that count rest at every minimum, and how far (E,) slips of S are from the
    given ones at most. A contact of S slips at every minimum if it has friction, or slips farther than that. None if
    nothing is known."""
    network, springs = bounds.network, bounds.springs
    longest = np.linalg.norm(network.graph.normal, axis=1).max(initial=0.0)  # steps 2 and 3 take normals for units
    if springs is None or not longest < UP:
        return None
    moves = (network.slip.value > MOVING * network.box.max()) | (network.holding.high == 0)
    slides, number = network.counts & moves, springs.number
    own, still = np.flatnonzero(slides), np.flatnonzero(network.counts & ~slides)
    exact = ExactMotions.of(network, number, network.counts & ~slides)
    others = network.counts & ~slides & ~exact.contacts
    loose = floor_of_slips(network, numbered(~exact.spheres[:, None] & (number >= 0)), others, sharp=True)
    if loose is None:
        return None
    near = Near(network, exact, np.sqrt(loose) / UP, number, own, still, network.spin, bounds.friction)
    if (reach := near.proven_reach()) is None:
        near = near.improved()
        reach = near.proven_reach()
    if reach is None:
        return None
    # slips of the improved spins are not quite the given ones
    found, moved = np.zeros(len(slides)), [a - b for a, b in zip(network.slips(network.spin), near.slips, strict=True)]
    found[own] = (reach + length(moved).most[own]) * UP
    return slides, found


@dataclass(frozen=True)
class Near:
    """Spins of some motion of V, or close to one. own, still : contacts of S and of T. number : (N, 3) of the n
    unknowns, -1 for none. exact : motions of T. loose : least singular value of K^T, of the contacts of T that exact
    motions leave out by the spheres that they leave out; rounded down, infinite of no contacts.

    spin : (N,) by component, exact sums of two doubles. pull : (E,) by component, what T bears, the same; not of S.
    """

    network: JudgedNetwork
    exact: ExactMotions
    loose: float
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
    def strength(self) -> Enclosure:
        """(S,), mu F_n of S."""
        return self.network.holding.at(self.own)

    @cached_property
    def damping(self) -> Enclosure:
        """(S,), eta of S."""
        return self.network.slope.at(self.own)

    @cached_property
    def turns(self) -> np.ndarray:
        """Numbers (k,) among S of the contacts with friction, which turns with the slip."""
        return np.flatnonzero(self.strength.high > 0)

    @cached_property
    def lawful(self) -> list[Enclosure]:
        """(S,) by component, the friction that the law gives these slips."""
        found, some = [], self.turns
        for part in self.slips:
            slip = part.at(self.own)
            found.append(self.damping * slip if self.network.law.flows else Enclosure.exact(np.zeros(len(self.own))))
            found[-1].put(some, found[-1].at(some) + self.strength.at(some) * (slip.at(some) / self.size.at(some)))
        return found

    @cached_property
    def friction(self) -> list[Enclosure]:
        """(E,) by component, exact sums of two doubles, of S nearly what the law says."""
        found = []
        for part, own in zip(self.pull, self.lawful, strict=True):
            found.append(_doubles(part))
            found[-1].put(self.own, _doubles(own))
        return found

    @cached_property
    def torques(self) -> list[Enclosure]:
        """(N,) by component."""
        return self.network.torques(moments(self.friction, self.network.graph.normal))

    @cached_property
    def rows(self) -> sparse.csr_array:
        """K, (3 E, n)."""
        return slip_rows(self.network, self.number)

    def rows_of(self, contacts: np.ndarray) -> np.ndarray:
        """Their numbers, component by component."""
        return np.concatenate([k * len(self.network.graph.normal) + contacts for k in range(3)])

    @property
    def place(self) -> np.ndarray:
        """(3, n)."""
        return np.asarray(self.network.graph.place[np.nonzero(self.number >= 0)[0]].T)

    def form(self, firmness: float = 1.0) -> Form | None:
        """Of S what slips change across them, times the root of friction over slip, and with damping all slips, times
        its root; and of T all slips, times the root of friction over the median slip and the firmness."""
        own, some, still, strength = self.own, self.turns, self.still, self.network.holding.value
        turning, flowing = own[some], own[self.damping.high > 0]
        across = np.cross(
            self.network.graph.normal[turning], np.stack([part.value[turning] for part in self.slips], axis=1)
        )
        across /= np.linalg.norm(across, axis=1)[:, None]
        sizes = self.size.value[some]
        root = np.sqrt(strength[turning] / sizes)
        firm = firmness * np.sqrt(strength[still] / (np.median(sizes) if len(some) else 1.0))
        at = np.concatenate([self.rows_of(turning), self.rows_of(flowing), self.rows_of(still)])
        others = 3 * (len(flowing) + len(still))
        row = np.append(np.tile(np.arange(len(some)), 3), len(some) + np.arange(others))
        shape = (len(some) + others, self.rows.shape[0])
        damped = np.sqrt(self.network.slope.value[flowing])
        size_of = np.concatenate([np.tile(root, 3), np.tile(damped, 3), np.tile(firm, 3)])
        value = size_of * np.append(across.T.ravel(), np.ones(others))
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
        moving = form.rows[: form.rows.shape[0] - 3 * len(self.still)]

        def borne(torque: np.ndarray) -> np.ndarray:
            """By which spins slips of T are that bear it, as far as T can."""
            found = factor.solve(torque)
            return found + factor.solve(torque - fixed.T @ (fixed @ found))

        def allowed(spins: np.ndarray) -> np.ndarray:
            return spins - borne(fixed.T @ (fixed @ spins))

        def bends(spins: np.ndarray) -> np.ndarray:
            """Torques of S, as its slips change."""
            return (moving.T @ (moving @ (spins / form.scale))) / form.scale

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
        moved, less = np.zeros(self.number.shape), np.zeros((3, len(self.network.graph.normal)))
        moved[self.number >= 0], less[:, self.still] = step, -pull
        spin, pull_ = (
            [_doubles(part + Enclosure.exact(by)) for part, by in zip(parts, change, strict=True)]
            for parts, change in ((self.spin, moved.T), (self.pull, less))
        )
        return replace(self, spin=spin, pull=pull_)

    def proven_reach(self) -> np.ndarray | None:
        """(S,), how far slips of the only minimum are from these at most; None if that is not known."""
        reach = self._reach() if (self.size.least[self.turns] > 0).all() else None
        return reach if reach is not None and self._holds(reach) else None

    @property
    def _left(self) -> np.ndarray:
        """(N,) mask of the spheres that exact motions leave out."""
        return np.asarray(self.network.free & ~self.exact.spheres)

    @cached_property
    def _wrong(self) -> np.ndarray:
        """(S,), how far friction is from what the law says."""
        return length([f.at(self.own) - own for f, own in zip(self.friction, self.lawful, strict=True)]).most

    def _over_slip(self, change: np.ndarray) -> np.ndarray:
        """(S,), changes of slips over these; 0 of contacts without friction."""
        found = np.zeros(len(self.own))
        found[self.turns] = (change / self.size.least)[self.turns] * UP
        return found

    def _torques(self, unsure: np.ndarray) -> np.ndarray:
        """(N, 3), sizes at the unknowns, where friction of S is not sure by as much (S,)."""
        found = np.stack([part.most for part in self.torques], axis=1)
        for end in self.network.graph.contact[:, self.own]:
            np.add.at(found, end, unsure[:, None] * UP)
        return np.where(self.number >= 0, found * UP, 0.0)

    def _reach(self) -> np.ndarray | None:
        """Step 2: (S,), how far slips are from these at the minimum in V, at most; or None."""
        size, damping, form = self.size.most, self.damping.most, self.form()
        if form is None or (tau := form.floor(sharp=True)) is None:
            return None
        others, ends = (
            np.setdiff1d(self.still, np.flatnonzero(self.exact.contacts)),
            self.network.graph.contact[:, self.own],
        )
        missed = float(np.sqrt(sum((part.most[others] ** 2).sum() for part in self.slips)))
        off = missed / self.loose * UP if missed else 0.0  # of spins in V from these
        far = np.where(self._left[ends].any(axis=0), 2 * off * UP, 0.0)  # of their slips
        bends, longer, whole = self._off_direction(far)
        scale = np.zeros(self.number.shape)
        scale[self.number >= 0] = form.scale
        slope = np.linalg.norm(scale * self._torques(longer + whole * bends**2 * UP)) / tau
        slope += np.sqrt((whole * size * bends**2 + damping * far**2).sum() / tau)
        largest = scale.max(axis=1)
        found = (far + 12 * largest[ends].max(axis=0) * slope * UP**2 + TINY) * UP
        turn, loss = self._over_slip(found), np.zeros(len(scale))
        for end in ends:
            np.add.at(loss, end, 8 * turn * self._over_slip(turn * self.strength.most))
        known = (turn <= MOST_TURN).all() and (largest**2 * loss * UP < tau / 8).all()
        return found if known else None

    def _off_direction(self, far: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(S,) each, of contacts with friction how far the direction of F is from those of slips that differ by `far`,
        and how far its size is from that which the law gives these slips; of others 0, and how far F is from the law;
        and at most the size of F."""
        some, bends, longer = self.turns, np.zeros(len(self.own)), self._wrong.copy()
        whole = self.strength + self.damping * self.size if self.network.law.flows else self.strength
        bends[some] = ((self._wrong / whole.least + 2 * far / self.size.least) * UP)[some]
        longer[some] = (length([part.at(self.own) for part in self.friction]) - whole).most[some]
        return bends, longer, whole.most

    def _holds(self, reach: np.ndarray) -> bool:
        """Step 3, where slips (S,) are as far from these."""
        network, exact = self.network, self.exact
        torque = self._torques(
            self._wrong + 2 * self._over_slip(reach) * self.strength.most + self.damping.most * reach
        )
        by_left = float(np.linalg.norm(torque[self._left])) / self.loose * UP
        most = np.sqrt(2 * np.bincount(network.graph.contact[:, network.counts].ravel()).max())
        by_exact = (float(np.linalg.norm(torque[exact.spheres])) + most * by_left) / exact.floor * UP**2
        room = (network.holding - length(self.friction)).lower()[self.still]
        return bool((room > np.where(exact.contacts[self.still], by_exact, by_left) * UP).all())


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
