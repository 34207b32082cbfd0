"""Motions that lower the power: their independent parts, and how far each may go.

Parts of a motion that no contact joins have scales of their own: one may lower the power up to a slip of 1e-9, another
up to 1e-14.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.conic.cone import inner, length
from taichi_bearings.conic.contact_system import ContactSystem, joined
from taichi_bearings.conic.grouped import Arrays, Grouped, each

STILL = 1e-4  # of the fastest spin, below which one does not move
SHORTEST, CLOSELY = 1e-20, 1.01  # least way along a motion, and factor to which the best is found
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Motion:
    """A change of the spins (unknowns,) that lowers the power, if it is small enough.

    slipping : (n,) masks a group, contacts said to be slipless that slip in it.
    """

    spins: np.ndarray
    slipping: Arrays


def largest_parts(
    motion: Motion, system: ContactSystem, friction: Arrays, difference: Arrays, share: float
) -> tuple[Motion, float]:
    """The parts that move farthest, each brought to where the power is least on its way, and the slip of the farthest.

    friction (n,), difference (d, n) a group : where the motion begins. share : parts that move less than this share of
    the farthest are left out.
    """
    part, of_contact = _parts(motion.spins, system)
    steps = system.change(np.where(part >= 0, motion.spins, 0.0))
    longest = 1 / max(float(np.abs(motion.spins).max(initial=0.0)), TINY)
    along = _lowest(friction, difference, steps, of_contact, int(part.max(initial=-1)) + 1, longest)
    reach = np.zeros(len(along))
    for dz, slips, home in zip(steps, motion.slipping, of_contact, strict=True):
        np.maximum.at(reach, home[slips & (home >= 0)], length(dz)[slips & (home >= 0)])
    reach *= np.where(along > SHORTEST, along, 0.0)
    far = np.append(reach > share * reach.max(initial=0.0), False)
    spins = np.where(far[part], np.append(along, 0.0)[part] * motion.spins, 0.0)
    return Motion(spins, motion.slipping & each(far.take, of_contact)), float(reach.max(initial=0.0))


def _parts(spins: np.ndarray, system: ContactSystem) -> tuple[np.ndarray, Arrays]:
    """Number of the part of each spin, (unknowns,), and of each contact, (n,) a group; -1 for what does not move."""
    moves = np.append(np.abs(spins) > STILL * np.abs(spins).max(initial=0.0), False)
    first, second = [], []
    for group in system.groups:
        ends = np.concatenate([group.below, group.above])
        some = ends[np.argmax(moves[ends], axis=0), np.arange(ends.shape[1])]  # a moving one if there is any
        for end in ends:
            both = moves[end] & moves[some]
            first.append(end[both])
            second.append(some[both])
    label = joined(np.concatenate(first), np.concatenate(second), len(spins))[1]
    part = np.full(len(spins) + 1, -1)
    part[:-1][moves[:-1]] = np.unique(label[moves[:-1]], return_inverse=True)[1]
    return part[:-1], Grouped(
        part[np.concatenate([group.below, group.above])].max(axis=0, initial=-1) for group in system.groups
    )


def _lowest(
    friction: Arrays, difference: Arrays, steps: Arrays, part: Arrays, parts: int, longest: float
) -> np.ndarray:
    """How far along its steps the power of each part is least, (parts,), by bisection of the logarithm."""
    low, high = np.full(parts, SHORTEST), np.full(parts, longest)
    while (high > CLOSELY * low).any():
        middle = np.sqrt(low * high)
        slope = np.zeros(parts)
        for mu, z, dz, home in zip(friction, difference, steps, part, strict=True):
            there = z + np.append(middle, 0.0)[home] * dz
            rise = mu * inner(there, dz) / np.maximum(length(there), TINY)
            slope += np.bincount(home[home >= 0], rise[home >= 0], parts)
        low, high = np.where(slope < 0, middle, low), np.where(slope < 0, high, middle)
    return low
