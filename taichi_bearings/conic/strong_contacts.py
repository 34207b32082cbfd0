"""Reduces the friction of very strong contacts without a change of the minima.

Theorem. Let all spheres of the top have one spin, and all of the bottom. Then contact forces in balance, along one spin
component, are a flow from top to bottom; it can be chosen without circles. On no contact is that flow larger than the
total friction C of a cut, a set of contacts whose removal separates top and bottom. So a contact whose friction exceeds
C times the number of its slip components rests at every minimum. With friction 2 C for each component it still does:
power, spins and slips of the minima stay the same. The reduced frictions span fewer decades, so that the rounding of
strong contacts no longer hides weak ones.
"""

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.numerics.graphs import pieces

SPREAD = 1e3  # ratio of largest and smallest friction up to which nothing is changed: doubles can handle that


def weakened(system: ContactSystem, friction: np.ndarray) -> np.ndarray:
    """Return the friction (n,) of n contacts of a lattice, reduced for the strongest ones as far as is proven not to
    change the minima: a contact that can bear more than all contacts of a cut together rests at every minimum.

    system : the n contacts of a lattice.
    friction : (n,), all positive. It is returned unchanged if it spans few decades (SPREAD), or if the spins of the top
        differ.
    """
    if friction.max() <= SPREAD * friction.min() or not _is_uniform(system):
        return friction
    assert system.ends is not None
    (low, high), contact = system.ends[:, system.felt], np.nonzero(system.felt)[1]
    low, high = np.where(low < 0, system.unknowns, low), np.where(high < 0, system.unknowns + 1, high)
    cut = _cut(low, high, friction[contact], system.unknowns, system.unknowns + 1)
    found: np.ndarray = np.minimum(friction, 2 * cut * system.felt.sum(axis=0))
    return found


def _is_uniform(system: ContactSystem) -> bool:
    """Return True if all spheres of the top have one spin: if in each slip component the imposed spins add the same
    number to every slip to which they add anything.

    system : the contacts: `slot` is the component of each slip, `offset` what imposed spins add to it.
    """
    pairs = np.stack([np.asarray(system.slot, dtype=float), system.offset])[:, system.offset != 0]
    found: bool = np.unique(pairs, axis=1).shape[1] == len(np.unique(pairs[0]))
    return found


def _cut(low: np.ndarray, high: np.ndarray, friction: np.ndarray, bottom: int, top: int) -> float:
    """Return the sum of the friction of the links across a cut: a set of links whose removal parts the nodes `bottom`
    and `top`. Of all cuts one is taken whose strongest link is as weak as possible.

    low, high : (k,), nodes at the two ends of each of k links (spin components of contacts), numbered up to `top`.
    friction : (k,), friction of each link.
    bottom, top : numbers of the nodes that stand for the driven bottom and top.
    """
    levels = np.unique(friction)
    begin, end = 0, len(levels) - 1

    def joined(level: int) -> np.ndarray:
        """Return the number (top + 1,) of the connected piece of each node, joined by links stronger than number
        `level` of the sorted frictions."""
        some = friction > levels[level]
        return pieces(top + 1, low[some], high[some])

    # Bisection for the weakest level of friction above which links no longer join bottom and top.
    while begin < end:
        middle = (begin + end) // 2
        label = joined(middle)
        begin, end = (middle + 1, end) if label[bottom] == label[top] else (begin, middle)
    label = joined(begin)
    side = label == label[bottom]
    return float(friction[side[low] != side[high]].sum())
