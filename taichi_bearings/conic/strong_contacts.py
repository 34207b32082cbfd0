"""Friction that is so strong that it might as well be less.

Where all of the top turns alike, as all of the bottom does, and no force is larger than it has to be, the forces along
each spin component are a flow from the top to the bottom without circles. On no contact is it larger than the friction
C of all contacts of a cut. So a contact with more friction than C for each component that it feels rests at every
minimum, and it rests as well with twice that friction: power, spins and slips of the minima stay the same. What is left
spans fewer decades, and the rounding of strong contacts hides weak ones no longer.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.conic.contact_system import ContactSystem

SPREAD = 1e3  # ratio of frictions, up to which they are all taken as they are: double precision has room for that


def weakened(system: ContactSystem, friction: np.ndarray) -> np.ndarray:
    """Friction (n,), none more than the given one, with which a lattice has the same minima.

    system : of a lattice. friction : (n,), all positive.
    """
    if friction.max() <= SPREAD * friction.min() or not _is_uniform(system):
        return friction
    (low, high), contact = system.ends[:, system.felt], np.nonzero(system.felt)[1]
    low, high = np.where(low < 0, system.unknowns, low), np.where(high < 0, system.unknowns + 1, high)
    cut = _cut(low, high, friction[contact], system.unknowns, system.unknowns + 1)
    return np.minimum(friction, 2 * cut * system.felt.sum(axis=0))


def _is_uniform(system: ContactSystem) -> bool:
    """True if the imposed spins add the same to all contacts of a component to which they add anything."""
    pairs = np.stack([np.asarray(system.slot, dtype=float), system.offset])[:, system.offset != 0]
    return np.unique(pairs, axis=1).shape[1] == len(np.unique(pairs[0]))


def _cut(low: np.ndarray, high: np.ndarray, friction: np.ndarray, bottom: int, top: int) -> float:
    """Sum of the friction of links (k,) across a cut between two nodes, the strongest link of which is as weak as can
    be. low, high : (k,), the nodes at the ends of the links, numbered up to `top`."""
    levels = np.unique(friction)
    begin, end = 0, len(levels) - 1

    def pieces(level: int) -> np.ndarray:
        """(top + 1,), numbers of the pieces that links stronger than a level join."""
        some = friction > levels[level]
        links = (np.ones(some.sum(), dtype=np.int8), (low[some], high[some]))
        graph = sparse.coo_matrix(links, shape=(top + 1, top + 1))
        return np.asarray(connected_components(graph, directed=False)[1])

    while begin < end:
        middle = (begin + end) // 2
        label = pieces(middle)
        begin, end = (middle + 1, end) if label[bottom] == label[top] else (begin, middle)
    label = pieces(begin)
    side = label == label[bottom]
    return float(friction[side[low] != side[high]].sum())
