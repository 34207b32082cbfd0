"""Which contacts of a Coulomb network with oblique normals slip at every minimum, from one that is enclosed.

Let S be the contacts that slip in the given spins, and T the others.

1. Free spheres that do not turn, or turn as a driven one does, up to rounding, are taken to do so exactly, as far as
   contacts of T among them then rest bit by bit and, by a floor of K^T K of these contacts, let them do nothing else.
   Contacts of T that are left have independent rows in the spins that are left, by a floor of K K^T. So the spins V at
   which all of T rest are not empty, and some of them are near the given ones.
2. Within V the power has one minimum near these: along motions x that T allows its curvature is that of the sum of
   mu F_n / |y| (K x across y)^2 over S and of any springs at T, for which elimination proves a floor tau. Where that
   loses no more than a part within a distance of 8 |slope| / tau, the minimum is not further away.
3. There the friction of S is known, and what it leaves to T is borne by the given friction of T and a correction, the
   size of which the floors of step 1 bound. If all of that is inside the discs it is one of the whole power; as T bears
   less than its friction, it rests at every minimum, so all lie in V, and there is only one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from taichi_bearings.verifier.bounds import Bounds
from taichi_bearings.verifier.curvature import Form
from taichi_bearings.verifier.elimination import EPS
from taichi_bearings.verifier.enclosure import UP, Enclosure, length
from taichi_bearings.verifier.exact_motions import ExactMotions, numbered
from taichi_bearings.verifier.network import Network, moments
from taichi_bearings.verifier.springs import floor_of_slips, slip_rows

MOVING = 1e-10  # of the fastest imposed component, above which a contact is taken to slip
FIRM = 1e3  # root of how much stiffer T is taken to be in Newton's method than for its floor
MOST_TURN = 0.25  # of a slip, over its size
TINY = 1e-290


@np.errstate(all="ignore")  # what is not finite proves nothing
def enclosed_minimum(bounds: Bounds) -> tuple[np.ndarray, np.ndarray] | None:
    """True (E,) for the contacts that slip at every minimum, where all others that count rest at every one; and how
    far (E,) their slips are from the given ones at most. None if that is not known."""
    network, springs = bounds.network, bounds.springs
    if springs is None or network.flows:
        return None
    slides = network.counts & (network.slip.value > MOVING * network.box.max())
    held = _Held.of(network, springs.number, network.counts & ~slides)
    return None if held is None else _nearby(bounds, held, slides)


@dataclass(frozen=True)
class _Held:
    """What T allows. rests : T, (E,). exact : motions of the pinned spheres. number : (N, 3) of unknowns.

    pinned, left : numbers of the unknowns of either kind. loose : least singular value of K of the contacts that are
    not among the pinned spheres by the other spins, rounded down; infinite of none.
    """

    rests: np.ndarray
    exact: ExactMotions
    number: np.ndarray
    pinned: np.ndarray
    left: np.ndarray
    loose: float

    @classmethod
    def of(cls, network: Network, number: np.ndarray, rests: np.ndarray) -> _Held | None:
        exact = ExactMotions.of(network, number, rests)
        of_left = numbered(~exact.spheres[:, None] & (number >= 0))
        loose = floor_of_slips(network, of_left, rests & ~exact.contacts, sharp=True)
        if loose is None:
            return None
        pinned, left = number[(of_left < 0) & (number >= 0)], number[of_left >= 0]
        return cls(rests, exact, number, pinned, left, np.sqrt(loose) / UP)


@dataclass(frozen=True)
class _Near:
    """own : the contacts of S. spin, friction : by component, (N,) and (E,), exact sums of two doubles. slips : (E,) by
    component, of these spins where they let contacts roll exactly. size : (S,), of those of S."""

    held: _Held
    own: np.ndarray
    spin: list[Enclosure]
    friction: list[Enclosure]
    slips: list[Enclosure]
    size: Enclosure

    @classmethod
    def of(
        cls, network: Network, held: _Held, own: np.ndarray, spin: list[Enclosure], friction: list[Enclosure]
    ) -> _Near:
        """friction : of T; that of S is along its slips."""
        slips = network.slips(held.exact.rolling(spin))
        along, strength = [part.at(own) for part in slips], network.holding.at(own)
        size, whole = length(along), []
        for part, slip in zip(friction, along, strict=True):
            whole.append(_pairs(part))
            whole[-1].put(own, _pairs(strength * (slip / size)))
        return cls(held, own, spin, whole, slips, size)

    def torques(self, network: Network) -> list[Enclosure]:
        return network.torques(moments(self.friction, network.normal))

    def curvature(self, network: Network, rows: sparse.csr_array, firm: np.ndarray) -> Form | None:
        """Of motions that T allows. rows : K, (3 E, n). firm : roots (T,) of stiffnesses of the contacts of T."""
        own, still, strength = self.own, np.flatnonzero(self.held.rests), network.holding.at(self.own)
        across = np.cross(network.normal[own], np.stack([part.value[own] for part in self.slips], axis=1))
        across /= np.linalg.norm(across, axis=1)[:, None]
        count, root = len(self.held.rests), np.sqrt(strength.value / self.size.value)
        at = np.append(*(np.concatenate([k * count + some for k in range(3)]) for some in (own, still)))
        row = np.append(np.tile(np.arange(len(own)), 3), len(own) + np.arange(3 * len(still)))
        shape = (len(own) + 3 * len(still), 3 * count)
        size_of = np.append(np.tile(root, 3), np.tile(firm, 3))
        value = size_of * np.append(across.T.ravel(), np.ones(3 * len(still)))
        conditions = sparse.csr_array(sparse.csr_array((value, (row, at)), shape=shape) @ rows)
        doubt = sparse.csr_array((32 * EPS * size_of, (row, at)), shape=shape) @ abs(rows)
        place = network.place[np.nonzero(self.held.number >= 0)[0]].T
        return Form.of(conditions, sparse.csr_array(doubt), place)

    def improved(self, network: Network, rows: sparse.csr_array, firm: np.ndarray) -> _Near:
        """After Newton's method, with multipliers (Hestenes 1969) for T to rest, as long as torques become less."""
        form = self.curvature(network, rows, FIRM * firm)
        factor = None if form is None else form.elimination.factorised()
        if form is None or factor is None:
            return self
        best, least, next_ = self, np.inf, self
        there, stiff = self.held.number >= 0, np.zeros(len(self.held.rests))
        stiff[self.held.rests] = (FIRM * firm) ** 2
        while True:
            torque = np.stack([part.value for part in next_.torques(network)], axis=1)[there]
            if not (left := float(np.linalg.norm(form.scale * torque))) < least / 2:
                return best
            best, least = next_, left
            slip = np.concatenate([part.value for part in best.slips])
            right = torque + rows.T @ (np.tile(stiff, 3) * slip)
            step = -form.scale * factor.solve(form.scale * right)
            pull = (np.tile(stiff, 3) * (slip + rows @ step)).reshape(3, -1)
            moved = np.zeros(there.shape)
            moved[there] = step
            spin = [_pairs(part + Enclosure.exact(by)) for part, by in zip(best.spin, moved.T, strict=True)]
            friction = [part + Enclosure.exact(by) for part, by in zip(best.friction, pull, strict=True)]
            next_ = _Near.of(network, self.held, self.own, spin, friction)


def _pairs(values: Enclosure) -> Enclosure:
    """The sums of two doubles themselves."""
    return Enclosure.exact(values.high, values.low)


def _nearby(bounds: Bounds, held: _Held, slides: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Steps 2 and 3."""
    network, number = bounds.network, held.number
    own, still, rows = np.flatnonzero(slides), np.flatnonzero(held.rests), slip_rows(network, number)
    near = _Near.of(network, held, own, network.spin, bounds.friction)
    firm = np.sqrt(network.holding.value[still] / (np.median(near.size.value) if len(own) else 1.0))
    near = near.improved(network, rows, firm)
    slips, size, strength = near.slips, near.size, network.holding.at(own)
    if not (size.least > 0).all():
        return None
    ends, there = network.contact[:, own].T, number >= 0
    missed = np.sqrt(sum((part.most[held.rests & ~held.exact.contacts] ** 2).sum() for part in slips))
    off = missed / held.loose * UP if missed else 0.0  # of spins in V from these
    wrong = length([f.at(own) - strength * (s.at(own) / size) for f, s in zip(near.friction, slips, strict=True)]).most
    left = np.stack([part.most for part in near.torques(network)], axis=1)

    def unbalanced(turn: np.ndarray) -> np.ndarray:
        """Sizes (unknowns,) of torques, where slips (S,) turn by such a share."""
        unsure, torque = (wrong + 2 * turn * strength.most) * UP**2, left.copy()
        for end in ends.T:
            np.add.at(torque, end, unsure[:, None])
        found = np.zeros(there.sum())
        found[number[there]] = torque[there] * UP
        return found

    form = near.curvature(network, rows, firm)
    if form is None or (tau := form.floor(sharp=True)) is None:
        return None
    # step 2
    scale = form.scale
    far = 2 * off * UP  # of slips at spins in V from the given ones
    slope = float(np.linalg.norm(scale * unbalanced(far / size.least))) * UP
    radius = 8 * slope / tau * UP + TINY
    largest = np.zeros(there.shape)
    largest[there] = scale[number[there]]
    largest = largest.max(axis=1)
    reach = (far + 1.5 * largest[ends].max(axis=1) * radius) * UP
    turn = reach / size.least * UP
    loss = np.zeros(len(there))
    for end in ends.T:
        np.add.at(loss, end, 8 * turn**2 * (strength.most / size.least))
    if not ((turn <= MOST_TURN).all() and (largest**2 * loss * UP < tau / 8).all()):
        return None
    # step 3
    torque = unbalanced(turn)
    by_left = float(np.linalg.norm(torque[held.left])) / held.loose * UP if np.isfinite(held.loose) else 0.0
    most = np.sqrt(2 * np.bincount(network.contact[:, network.counts].ravel()).max())
    by_pinned = (float(np.linalg.norm(torque[held.pinned])) + most * by_left) / held.exact.floor * UP**2
    room = (network.holding - length(near.friction)).lower()[still]
    if not (room > np.where(held.exact.contacts[still], by_pinned, by_left) * UP).all():
        return None
    distance = np.zeros(len(slides))
    distance[own] = reach
    # the slips with what is taken exactly differ from the given ones by no more
    moved = length([a - b for a, b in zip(network.slips(network.spin), slips, strict=True)]).most
    return slides, np.where(slides, (distance + moved) * UP, 0.0)
