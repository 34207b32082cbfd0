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
from taichi_bearings.verifier.network import Network
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


def _nearby(bounds: Bounds, held: _Held, slides: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Steps 2 and 3."""
    network, number = bounds.network, held.number
    own, still = np.flatnonzero(slides), np.flatnonzero(held.rests)
    near = Near(network, held.exact, number, own, still, network.spin, bounds.friction).improved()
    slips, size, strength = near.slips, near.size, network.holding.at(own)
    if not (size.least > 0).all():
        return None
    ends, there = network.contact[:, own].T, number >= 0
    missed = np.sqrt(sum((part.most[held.rests & ~held.exact.contacts] ** 2).sum() for part in slips))
    off = missed / held.loose * UP if missed else 0.0  # of spins in V from these
    touches = np.zeros(there.shape[0], dtype=bool)
    touches[there.any(axis=1)] = np.isin(number, held.left)[there.any(axis=1)].any(axis=1)
    far = np.where(touches[ends].any(axis=1), 2 * off * UP, 0.0)  # of slips at spins in V from these
    left, bears = np.stack([part.most for part in near.torques], axis=1), [part.at(own) for part in near.friction]
    wrong = length([f - strength * (s.at(own) / size) for f, s in zip(bears, slips, strict=True)]).most

    def unbalanced(unsure: np.ndarray) -> np.ndarray:
        """Sizes (unknowns,) of torques, where friction of S is not sure by as much (S,)."""
        torque = left.copy()
        for end in ends.T:
            np.add.at(torque, end, unsure[:, None] * UP)
        found = np.zeros(there.sum())
        found[number[there]] = torque[there] * UP
        return found

    form = near.form()
    if form is None or (tau := form.floor(sharp=True)) is None:
        return None
    # step 2
    scale = form.scale
    bends = (wrong / strength.least + 2 * far / size.least) * UP  # what friction is off across slips, over itself
    longer = (length(bears) - strength).most + strength.most * bends**2 * UP  # and along them
    slope = float(np.linalg.norm(scale * unbalanced(longer))) / tau + np.sqrt(
        (strength.most * size.most * bends**2).sum() / tau
    )
    radius = 8 * slope * UP**2 + TINY
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
    torque = unbalanced(wrong + 2 * turn * strength.most)
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
