"""Which contacts of a network with oblique normals slip at every minimum, proven from a minimum that is enclosed:
theorem 7.

Letters: N spheres, E contacts, n unknown components of free spins; S the contacts that slip in the given spins, T all
others that count (S and T in shapes are their numbers); V all spins at which T rests; K the matrix (3 E, n) of slips; y
the slip of a contact; F the friction at hand; tau a proven floor of curvature.

1. Where contacts of T put more conditions on spheres than these have freedom for, they must roll exactly: the spheres
   turn as one of their exact motions does, which also have a floor of the other singular values (exact_motions.py). The
   other contacts of T have independent rows of K in the spins of the other spheres, by a floor of K K^T (`loose` is its
   root). So V is not empty, and some of its spins are near the given ones, or near those that Newton's method has
   improved.
2. Within V the potential has one minimum near these spins. Its curvature along a motion x in V is |B x|^2, the sum over
   S of mu F_n / |y| (K x across y)^2 + eta |K x|^2, and elimination proves a floor tau of it, with springs at T. Its
   slope there is r . x + b . B x: r are torques that are left over, b comes from the angles between the given friction
   and the slips in V. The potential rises where |B x| is above (|r| / tau^1/2 + |b|) / 0.72, as long as no slip of a
   contact with friction changes by more than a quarter (curvature.py). Damping resists by eta |K x|^2 anywhere.
3. There the friction of S is known. What it leaves to T is borne by the friction of T at hand and a correction whose
   size the floors of step 1 bound: the potential has no slope in V, so T can bear it. If all of that is inside the
   discs, the minimum in V is one of the whole potential. As T bears less than its friction it rests at every minimum.
   So all minima lie in V, where there is only one.

Contacts with damping alone belong to S, whatever they slip.

Newton's method moves the spins within V until S leaves over only torques that T can bear, and lets T bear them. It
works in sums of two doubles, of which each step finds more digits. Nothing of that is proven, and nothing has to be:
the proof starts from whatever comes out.
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

MOVING = 1e-10  # slip over the fastest imposed component, above which a contact is taken to slip
MOST_TURN = 0.25  # largest change of a slip, over its size, for which 0.72 above holds
TINY = 1e-290  # added to bounds that might underflow
FIRM = 1e4  # factor of the rows of T over those of a contact with the median slip, to precondition conjugate gradients
SOFT = -1e-9  # minus what is added to eigenvalues of the rows of T: above rounding, below those of motions that slip
MOST_GRADIENTS, CLOSE = 40, 1e-6  # most steps of conjugate gradients; they end at this share of the first residual


@np.errstate(all="ignore")  # what is not finite proves nothing
def enclosed_minimum(bounds: Bounds) -> tuple[np.ndarray, np.ndarray] | None:
    """Mask S (E,), such that all other contacts that count rest at every minimum, and a bound (E,) on how far slips of
    S at minima are from the given ones; None if nothing is proven.

    A contact of S slips at every minimum if it has friction, or if its given slip is larger than that bound.
    """
    network, springs = bounds.network, bounds.springs
    longest = np.linalg.norm(network.graph.normal, axis=1).max(initial=0.0)  # steps 2 and 3 take normals for units
    if springs is None or not longest < UP:
        return None
    # Step 1: guess S and T, find the exact motions of T, and prove that rows of its other contacts are independent.
    moves = (network.slip.value > MOVING * network.box.max()) | (network.holding.high == 0)
    slides, number = network.counts & moves, springs.number
    own, still = np.flatnonzero(slides), np.flatnonzero(network.counts & ~slides)
    exact = ExactMotions.of(network, number, network.counts & ~slides)
    others = network.counts & ~slides & ~exact.contacts
    loose = floor_of_slips(network, numbered(~exact.spheres[:, None] & (number >= 0)), others, sharp=True)
    if loose is None:
        return None
    # Steps 2 and 3, from the given spins, and if that fails from spins that Newton's method has improved.
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
    """Spins in V, or close to V, with the friction that T bears at them.

    exact : the motions of spheres at which contacts of T roll exactly.
    loose : proven lower bound of the singular values of K^T for contacts of T and spheres that exact motions leave out;
        infinite if there is no such contact.
    number : (N, 3), number of each of the n unknowns, -1 where there is none.
    own, still : numbers (S,) and (T,) of the contacts of S and of T.
    spin : u by component, (N,) each, exact sums of two doubles.
    pull : by component, (E,), the friction of T, exact sums of two doubles; not used for S.
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
        """Slips by component, (E,) each, of these spins changed such that all contacts of T that can roll exactly do
        so."""
        return self.network.slips(self.exact.rolling(self.spin))

    @cached_property
    def size(self) -> Enclosure:
        """Slip speeds of S, (S,)."""
        return length([part.at(self.own) for part in self.slips])

    @cached_property
    def strength(self) -> Enclosure:
        """Friction mu F_n of the contacts of S, (S,)."""
        return self.network.holding.at(self.own)

    @cached_property
    def damping(self) -> Enclosure:
        """Damping eta of the contacts of S, (S,)."""
        return self.network.slope.at(self.own)

    @cached_property
    def turns(self) -> np.ndarray:
        """Numbers (k,), counted within S, of the contacts with friction: its direction turns with the slip."""
        return np.flatnonzero(self.strength.high > 0)

    @cached_property
    def lawful(self) -> list[Enclosure]:
        """The friction that the law gives the slips of S, by component, (S,) each."""
        found, some = [], self.turns
        for part in self.slips:
            slip = part.at(self.own)
            found.append(self.damping * slip if self.network.law.flows else Enclosure.exact(np.zeros(len(self.own))))
            found[-1].put(some, found[-1].at(some) + self.strength.at(some) * (slip.at(some) / self.size.at(some)))
        return found

    @cached_property
    def friction(self) -> list[Enclosure]:
        """The friction in use, by component, (E,) each, exact sums of two doubles: `pull` for T, `lawful` rounded for
        S."""
        found = []
        for part, own in zip(self.pull, self.lawful, strict=True):
            found.append(_doubles(part))
            found[-1].put(self.own, _doubles(own))
        return found

    @cached_property
    def torques(self) -> list[Enclosure]:
        """Torques over the radius that `friction` leaves over at the spheres, by component, (N,) each."""
        return self.network.torques(moments(self.friction, self.network.graph.normal))

    @cached_property
    def rows(self) -> sparse.csr_array:
        """The matrix K, (3 E, n), of slips by component."""
        return slip_rows(self.network, self.number)

    def rows_of(self, contacts: np.ndarray) -> np.ndarray:
        """Numbers (3 q,) of the rows of K that belong to contacts (q,), component by component."""
        return np.concatenate([k * len(self.network.graph.normal) + contacts for k in range(3)])

    @property
    def place(self) -> np.ndarray:
        """Where the sphere of each unknown is, (3, n)."""
        return np.asarray(self.network.graph.place[np.nonzero(self.number >= 0)[0]].T)

    def form(self, firmness: float = 1.0) -> Form | None:
        """The curvature |B x|^2 with springs at T, as a quadratic form in the n unknowns; None if some unknown changes
        no slip.

        Its rows are, for each contact of S with friction, the change of the slip across it, times the root of friction
        over slip; for each with damping three components of the change, times the root of eta; for each of T three
        components, times the root of friction over the median slip of S and times `firmness`.
        """
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
        doubt = sparse.csr_array((32 * EPS * size_of, (row, at)), shape=shape) @ abs(self.rows)  # 32 roundings, amply
        return Form.of(rows, sparse.csr_array(doubt), self.place)

    def improved(self) -> Near:
        """These spins after some steps of Newton's method within V: as many as leave less than half of the torques
        each."""
        form, there = self.form(FIRM), self.number >= 0
        # Rows of T, and a factor of their squares by which a motion is split into one that T allows and the rest.
        fixed = sparse.csr_array(self.rows[self.rows_of(self.still)])
        factor = Elimination.of((fixed.T @ fixed).tocsc(), self.place).factorised(SOFT)
        soft = None if form is None else form.elimination.factorised()
        if form is None or factor is None or soft is None:
            return self
        moving = form.rows[: form.rows.shape[0] - 3 * len(self.still)]

        def borne(torque: np.ndarray) -> np.ndarray:
            """Spins (n,) whose slips of T, taken as friction, bear a torque (n,) as far as T can; solved twice, for
            rounding."""
            found = factor.solve(torque)
            return found + factor.solve(torque - fixed.T @ (fixed @ found))

        def allowed(spins: np.ndarray) -> np.ndarray:
            """The part of spins (n,), or of torques, that leaves T at rest."""
            return spins - borne(fixed.T @ (fixed @ spins))

        def bends(spins: np.ndarray) -> np.ndarray:
            """Change (n,) of the torques of S when spins change by `spins` (n,): the curvature of step 2 times them."""
            return (moving.T @ (moving @ (spins / form.scale))) / form.scale

        best, least, found = self, np.inf, self
        while True:
            # One step: first take away slips of T, then solve for the motion in V that removes the torques of S, and
            # let T bear what is left. Steps go on while they more than halve the torques.
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
        """These spins and this friction after a step. step : (n,), added to the unknowns. pull : (3, T), subtracted
        from what T bears."""
        moved, less = np.zeros(self.number.shape), np.zeros((3, len(self.network.graph.normal)))
        moved[self.number >= 0], less[:, self.still] = step, -pull
        spin, pull_ = (
            [_doubles(part + Enclosure.exact(by)) for part, by in zip(parts, change, strict=True)]
            for parts, change in ((self.spin, moved.T), (self.pull, less))
        )
        return replace(self, spin=spin, pull=pull_)

    def proven_reach(self) -> np.ndarray | None:
        """Bound (S,) on how far slips of S at the only minimum are from these; None if steps 2 and 3 do not prove
        one."""
        reach = self._reach() if (self.size.least[self.turns] > 0).all() else None
        return reach if reach is not None and self._holds(reach) else None

    @property
    def _left(self) -> np.ndarray:
        """(N,) mask of the free spheres that exact motions leave out."""
        return np.asarray(self.network.free & ~self.exact.spheres)

    @cached_property
    def _wrong(self) -> np.ndarray:
        """(S,), bound on the difference between the friction in use and the one that the law gives."""
        return length([f.at(self.own) - own for f, own in zip(self.friction, self.lawful, strict=True)]).most

    def _over_slip(self, change: np.ndarray) -> np.ndarray:
        """(S,), `change` (S,) over the slip speeds, rounded up; 0 for contacts without friction."""
        found = np.zeros(len(self.own))
        found[self.turns] = (change / self.size.least)[self.turns] * UP
        return found

    def _torques(self, unsure: np.ndarray) -> np.ndarray:
        """(N, 3), bounds on the size of the torques left over at the unknowns, 0 elsewhere. unsure : (S,), how far the
        friction of each contact of S may be from the one in use."""
        found = np.stack([part.most for part in self.torques], axis=1)
        for end in self.network.graph.contact[:, self.own]:
            np.add.at(found, end, unsure[:, None] * UP)
        return np.where(self.number >= 0, found * UP, 0.0)

    def _reach(self) -> np.ndarray | None:
        """Step 2: bound (S,) on how far slips at the minimum in V are from these; None if none is proven."""
        size, damping, form = self.size.most, self.damping.most, self.form()
        if form is None or (tau := form.floor(sharp=True)) is None:
            return None
        others, ends = (
            np.setdiff1d(self.still, np.flatnonzero(self.exact.contacts)),
            self.network.graph.contact[:, self.own],
        )
        # slips that T should not have, and how far from these spins and slips that puts the nearest ones in V
        missed = float(np.sqrt(sum((part.most[others] ** 2).sum() for part in self.slips)))
        off = missed / self.loose * UP if missed else 0.0
        far = np.where(self._left[ends].any(axis=0), 2 * off * UP, 0.0)
        bends, longer, whole = self._off_direction(far)
        scale = np.zeros(self.number.shape)
        scale[self.number >= 0] = form.scale
        # |r| / tau + |b| / tau^1/2 in scaled unknowns; friction at an angle to the slip counts in b, its square in r
        slope = np.linalg.norm(scale * self._torques(longer + whole * bends**2 * UP)) / tau
        slope += np.sqrt((whole * size * bends**2 + damping * far**2).sum() / tau)
        largest = scale.max(axis=1)
        # Two spheres change a slip by sqrt(2) times scale times |x| at most, so sqrt(2) / 0.72 < 2 would do for 12,
        # were B not that of the slips at hand.
        found = (far + 12 * largest[ends].max(axis=0) * slope * UP**2 + TINY) * UP
        turn, loss = self._over_slip(found), np.zeros(len(scale))
        for end in ends:
            # Curvature lost as slips turn: (2 turn)^2 friction / slip, times 2 as |u_i + u_j|^2 <= 2 (|u_i|^2 +
            # |u_j|^2).
            np.add.at(loss, end, 8 * turn * self._over_slip(turn * self.strength.most))
        # At least 7/8 of tau must remain, so that there is just one minimum within reach.
        known = (turn <= MOST_TURN).all() and (largest**2 * loss * UP < tau / 8).all()
        return found if known else None

    def _off_direction(self, far: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Three arrays (S,): by how much the direction of F differs from those of slips that are within `far` (S,) of
        these, as a difference of unit vectors, 0 without friction; how far the size of F, or without friction F itself,
        is from that of the law; and an upper bound on the size of F by the law."""
        some, bends, longer = self.turns, np.zeros(len(self.own)), self._wrong.copy()
        whole = self.strength + self.damping * self.size if self.network.law.flows else self.strength
        bends[some] = ((self._wrong / whole.least + 2 * far / self.size.least) * UP)[some]
        longer[some] = (length([part.at(self.own) for part in self.friction]) - whole).most[some]
        return bends, longer, whole.most

    def _holds(self, reach: np.ndarray) -> bool:
        """Step 3: True if T bears inside its friction discs what S leaves to it where slips of S are up to `reach` (S,)
        from these."""
        network, exact = self.network, self.exact
        torque = self._torques(
            self._wrong + 2 * self._over_slip(reach) * self.strength.most + self.damping.most * reach
        )
        # The correction of the friction of T is at most the torques over the floors of singular values, first on the
        # spheres that exact motions leave out, then on the others, to which it brings torques of its own: K has no
        # singular value above the root of twice the largest number of contacts of a sphere.
        by_left = float(np.linalg.norm(torque[self._left])) / self.loose * UP
        most = np.sqrt(2 * np.bincount(network.graph.contact[:, network.counts].ravel()).max())
        by_exact = (float(np.linalg.norm(torque[exact.spheres])) + most * by_left) / exact.floor * UP**2
        room = (network.holding - length(self.friction)).lower()[self.still]
        return bool((room > np.where(exact.contacts[self.still], by_exact, by_left) * UP).all())


def _doubles(values: Enclosure) -> Enclosure:
    """The values without their error bounds: sums of two doubles, taken as exact."""
    return Enclosure.exact(values.high, values.low)


def _within(
    operator: Callable[[np.ndarray], np.ndarray], right: np.ndarray, guess: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Vector x (n,) that solves operator(x) = right by conjugate gradients. guess : approximate inverse of the
    operator, as preconditioner."""
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
