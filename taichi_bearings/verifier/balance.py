"""Can the friction of contacts that do not slip be put in balance, with that of the others exactly as it is?"""

from __future__ import annotations

import numpy as np

from taichi_bearings.verifier.curvature import Slipping
from taichi_bearings.verifier.enclosure import UP, Enclosure
from taichi_bearings.verifier.motion import Motion, length


def bearable(
    motion: Motion,
    contacts: Slipping,
    turn: np.ndarray,
    rests: tuple[np.ndarray, ...] | None = None,
    unsure: dict[int, np.ndarray] | None = None,
) -> bool:
    """True if the friction of some contacts can be put in balance inside all discs.

    contacts, turn : those that slip near a minimum, and the share by which each slip differs there. rests : masks
    (R, *contacts) an axis of those contacts; if not given, all that do not slip. unsure : by component, (R, *N), how
    far the friction of others at each sphere may be from what it has to be.
    """
    samples, domain = motion.samples, motion.domain
    if rests is None:
        rests = motion.still
    else:
        domain = {k: motion.domains(k, rests) for k in samples.needed}
    left = {}
    for slot, k in enumerate(samples.needed):
        residual = samples.torques[k].most + _unsure(motion, contacts, turn, slot)
        left[k] = _summed(motion, domain[k], residual if unsure is None else residual + unsure[k])
    for axis, still in enumerate(rests):
        own, felt = still & ~samples.between_driven(axis), [k for k in samples.needed if k in samples.felt(axis)]
        if felt:
            low, _ = samples.ends(axis)
            borne = length([Enclosure.exact(samples.turning[axis][k][own]) for k in felt])
            room, correction = (
                samples.strength[axis][own] - borne,
                np.sqrt(sum(left[k][low][own] ** 2 for k in felt)),
            )
            if not ((room.high > 0) & (room.least > correction * UP)).all():
                return False
    return True


def _unsure(motion: Motion, contacts: Slipping, turn: np.ndarray, slot: int) -> np.ndarray:
    """(R, *N): how far the friction of slipping contacts in a component, as the file says, may be from that at the
    minimum, summed at each sphere."""
    samples, component = motion.samples, motion.samples.needed[slot]
    sides = samples.sublattice.ravel()[contacts.spheres[1] % samples.sublattice.size]
    said = np.concatenate(
        [
            turning[component].take(slips.own) if component in turning else np.zeros(len(slips.own))
            for turning, slips in zip(samples.turning, motion.slips, strict=True)
        ]
    )
    unsure = contacts.pulls[slot].signed(sides).plus(-said).most
    unsure[contacts.curved] += 2 * turn[contacts.curved] * contacts.strength.at(contacts.curved).most
    shape = (samples.count, *samples.shape)
    return np.bincount(contacts.spheres.ravel(), np.tile(unsure, 2), int(np.prod(shape))).reshape(shape)


def _summed(motion: Motion, domain: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """E_D of the domain of each sphere, (R, *N): residual torques of its free spheres, summed."""
    samples = motion.samples
    residual = residual.copy()
    residual[..., [0, -1]] = 0.0
    sample = np.arange(samples.count).reshape(-1, *(1,) * samples.dimension)
    own = np.where(domain > 1, domain + 2 * samples.count, domain * samples.count + sample)  # driven ones, too
    return (np.bincount(own.ravel(), residual.ravel()) * UP)[own]
