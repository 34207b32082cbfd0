"""Which contacts of a Coulomb network with oblique normals slip at every minimum, from one that is enclosed.

Let S be the contacts that slip in the given spins, T the others, and V all spins at which T rests.

1. Where contacts of T put more conditions on spheres than these have freedom for, they must roll exactly: the spheres
   turn as one of their exact motions does, which also have a floor of the other singular values (exact_motions.py).
   Contacts of T that are left have independent rows in the spins that are left, by a floor of K K^T. So V is not
   empty, and some of its spins are near the given ones, or those that Newton's method has improved (newton.py).
2. Within V the power has one minimum near these: along motions x that T allows its curvature is |B x|^2, the sum of
   mu F_n / |y| (K x across y)^2 over S, and elimination proves a floor tau of it with springs at T. Its slope there is
   r . x for torques r that are left over, and b . B x for what friction is off across slips. The power rises where
   |B x| is above (|r| / tau^1/2 + |b|) / 0.72, as long as no slip changes by more than a quarter (curvature.py).
3. There the friction of S is known, and what it leaves to T is borne by the friction of T at hand and a correction, the
   size of which the floors of step 1 bound: the power has no slope in V, so T can bear it. If all of that is inside the
   discs it is one of the whole power; as T bears less than its friction, it rests at every minimum, so all lie in V,
   and there is only one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.verifier.bounds import Bounds
from taichi_bearings.verifier.enclosure import UP, Enclosure, length
from taichi_bearings.verifier.exact_motions import ExactMotions, numbered
from taichi_bearings.verifier.newton import Near
from taichi_bearings.verifier.springs import floor_of_slips

MOVING = 1e-10  # of the fastest imposed component, above which a contact is taken to slip
MOST_TURN = 0.25  # of a slip, over its size
TINY = 1e-290


@np.errstate(all="ignore")  # what is not finite proves nothing
def enclosed_minimum(bounds: Bounds) -> tuple[np.ndarray, np.ndarray] | None:
    """True (E,) for the contacts that slip at every minimum, where all others that count rest at every one; and how
    far (E,) their slips are from the given ones at most. None if that is not known."""
    network, springs = bounds.network, bounds.springs
    if springs is None or network.flows:
        return None
    slides, number = network.counts & (network.slip.value > MOVING * network.box.max()), springs.number
    own, still = np.flatnonzero(slides), np.flatnonzero(network.counts & ~slides)
    exact = ExactMotions.of(network, number, network.counts & ~slides)
    others = network.counts & ~slides & ~exact.contacts
    loose = floor_of_slips(network, numbered(~exact.spheres[:, None] & (number >= 0)), others, sharp=True)
    if loose is None:
        return None
    near = Near(network, exact, number, own, still, network.spin, bounds.friction)
    reach = _reach(near, np.sqrt(loose) / UP)
    if reach is None:
        near = near.improved()
        reach = _reach(near, np.sqrt(loose) / UP)
    if reach is None:
        return None
    # slips of the improved spins are not quite the given ones
    found, moved = np.zeros(len(slides)), [a - b for a, b in zip(network.slips(network.spin), near.slips, strict=True)]
    found[own] = (reach + length(moved).most[own]) * UP
    return slides, found


def _reach(near: Near, loose: float) -> np.ndarray | None:
    """(S,), how far slips of the only minimum are from these at most; None if that is not known."""
    place = _Place(near, loose)
    reach = place.reach() if (near.size.least > 0).all() else None
    return reach if reach is not None and place.holds(reach) else None


@dataclass(frozen=True)
class _Place:
    """near : spins, some of V close to them. loose : least singular value of K^T, of the contacts of T that exact
    motions leave out by the spheres that they leave out; rounded down, infinite of no contacts."""

    near: Near
    loose: float

    @property
    def _left(self) -> np.ndarray:
        """(N,) mask of these spheres."""
        return np.asarray(self.near.network.free & ~self.near.exact.spheres)

    @property
    def _ends(self) -> np.ndarray:
        """(2, S)."""
        return np.asarray(self.near.network.contact[:, self.near.own])

    @cached_property
    def _strength(self) -> Enclosure:
        """(S,)."""
        return self.near.network.holding.at(self.near.own)

    @cached_property
    def _wrong(self) -> np.ndarray:
        """(S,), how far friction is from that along slips."""
        pairs = zip(self.near.friction, self.near.slips, strict=True)
        own, size = self.near.own, self.near.size
        return length([f.at(own) - self._strength * (s.at(own) / size) for f, s in pairs]).most

    def _torques(self, unsure: np.ndarray) -> np.ndarray:
        """(N, 3), sizes at the unknowns, where friction of S is not sure by as much (S,)."""
        found = np.stack([part.most for part in self.near.torques], axis=1)
        for end in self._ends:
            np.add.at(found, end, unsure[:, None] * UP)
        return np.where(self.near.number >= 0, found * UP, 0.0)

    def reach(self) -> np.ndarray | None:
        """Step 2: (S,), how far slips are from these at the minimum in V, at most; or None."""
        near, size, form = self.near, self.near.size, self.near.form()
        if form is None or (tau := form.floor(sharp=True)) is None:
            return None
        others = np.setdiff1d(near.still, np.flatnonzero(near.exact.contacts))
        missed = float(np.sqrt(sum((part.most[others] ** 2).sum() for part in near.slips)))
        off = missed / self.loose * UP if missed else 0.0  # of spins in V from these
        far = np.where(self._left[self._ends].any(axis=0), 2 * off * UP, 0.0)  # of their slips
        bends = (self._wrong / self._strength.least + 2 * far / size.least) * UP  # of friction across slips, over it
        longer = (length([part.at(near.own) for part in near.friction]) - self._strength).most
        scale = np.zeros(near.number.shape)
        scale[near.number >= 0] = form.scale
        slope = np.linalg.norm(scale * self._torques(longer + self._strength.most * bends**2 * UP)) / tau
        slope += np.sqrt((self._strength.most * size.most * bends**2).sum() / tau)
        largest = scale.max(axis=1)
        found = (far + 12 * largest[self._ends].max(axis=0) * slope * UP**2 + TINY) * UP
        turn, loss = found / size.least * UP, np.zeros(len(scale))
        for end in self._ends:
            np.add.at(loss, end, 8 * turn**2 * (self._strength.most / size.least))
        known = (turn <= MOST_TURN).all() and (largest**2 * loss * UP < tau / 8).all()
        return found if known else None

    def holds(self, reach: np.ndarray) -> bool:
        """Step 3, where slips (S,) are as far from these."""
        near, network = self.near, self.near.network
        torque = self._torques(self._wrong + 2 * reach / near.size.least * UP * self._strength.most)
        by_left = float(np.linalg.norm(torque[self._left])) / self.loose * UP
        most = np.sqrt(2 * np.bincount(network.contact[:, network.counts].ravel()).max())
        by_exact = (float(np.linalg.norm(torque[near.exact.spheres])) + most * by_left) / near.exact.floor * UP**2
        room = (network.holding - length(near.friction)).lower()[near.still]
        return bool((room > np.where(near.exact.contacts[near.still], by_exact, by_left) * UP).all())
