"""Which contacts of a packing rest at every minimum, part by part: theorem 8, where friction is nearly known.

Letters: N spheres, E contacts; K the matrix of slips, b the slips of what is imposed; y* the slips of a minimum and F*
optimal friction: in balance on every free sphere, along y* where y* is not 0, and then of size mu F_n + eta |y*|; F the
friction at hand, r torques; X some contacts with friction, such that

a. spins u exist at which nothing of X slips: K u + b = 0 in the rows of X, and
b. some friction G on X, inside all discs, |G| < mu F_n, does for F*: K^T G = K^T F* on the free spheres.

Then X rests. Over X, the sum (F* - G) . y* is (F* - G) . (K u* + b) = (F* - G) . b = -(F* - G) . K u = 0. So the sum of
mu F_n |y*| + eta |y*|^2 over X equals that of G . y*, which is less unless all y* are 0.

For b it is enough to bound how far F*, away from X, is from friction F that is in balance up to torques: on each sphere
K^T (F* - F) on X is then no larger than r, the sum of that bound over its other contacts and of its leftover torque.
Where components do not mix (discs; normals along the axes) a *part* is what contacts of X join through free spheres in
one component. Starting from F, G takes r along a tree of the part to a driven sphere, if there is one, and else to
where all cancels, as K^T (F* - F) does. What an odd loop has left over goes around it, half of it each way. So no force
changes by more than 3/2 of the sum of r over the part. Condition a holds exactly where all driven spheres that a part
joins ask for one spin, and for none where its loops are odd: nothing is rounded.
"""

from __future__ import annotations

import numpy as np

from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.enclosure import UP, length
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.listed import signs
from taichi_bearings.proof.slipless_state import imposed_exactly

SHARE_AROUND = 1.5  # largest change of a force over the sum of r over its part: 1 along the tree, 1/2 around a loop


def known_friction(bounds: Bounds, far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mask (E,) of the contacts whose friction is known, as they slip at every minimum or have damping alone; and a
    bound (E,) on how far the optimal friction of each contact is from that at hand.

    far : (E,), bound on how far slips of minima are from the given ones; infinite where none is known.
    """
    network, size = bounds.network, bounds.network.slip
    known = network.counts & ((size.least > far) | ((network.holding.high == 0) & np.isfinite(far)))
    own, friction = np.flatnonzero(known), bounds.friction or network.own_friction
    held = np.flatnonzero(network.holding.high[own] > 0)
    wrong = []
    # Friction by the law at the given slips, and how far the friction at hand is from it.
    for given, slip in zip(friction, network.slips(network.spin), strict=True):
        lawful = network.slope.at(own) * slip.at(own)
        turned = network.holding.at(own[held]) * (slip.at(own[held]) / size.at(own[held]))
        lawful.put(held, lawful.at(held) + turned)
        wrong.append(given.at(own) - lawful)
    # A slip that differs by far has a unit vector that differs by 2 far / |slip| at most; discs slip in one direction.
    turn = 0 * far if len(friction) == 1 else np.where(size.least > far, 2 * far / size.least, 0.0)  # one has no others
    damped = network.slope.high > 0
    reached = np.where(damped, network.slope.most * (size.most + far), 0.0)
    # Where friction is not known: two forces that may point in opposite directions, at most so large.
    off = network.holding.most + reached + length(friction).most
    off[own] = length(wrong).most + network.holding.most[own] * turn[own] * UP
    off[own] += np.where(damped, network.slope.most * far, 0.0)[own]
    return known, np.where(network.counts, off * UP, 0.0)


@np.errstate(all="ignore")  # what is not finite proves nothing
def at_rest(bounds: Bounds, far: np.ndarray) -> np.ndarray:
    """Mask (E,) of contacts that are proven to rest at every minimum, of a network whose components do not mix.

    far : (E,), bound on how far slips of minima are from the given ones; infinite where none is known.
    """
    network = bounds.network
    known, off = known_friction(bounds, far)
    room = (network.holding - length(network.own_friction)).lower()
    rests = network.counts & ~known & (room > 0) & imposed_exactly(network)
    # Begin with all contacts that have friction left; leave out those that may have to bear too much, until none does.
    while rests.any():
        change = np.zeros(len(room))
        for k in network.components:
            others = np.flatnonzero(network.feels[k] & ~rests)
            left = network.own_torques[k].most
            for end in network.graph.contact[:, others]:
                left = left + np.bincount(end, off[others], len(left))
            change += _changes(network, k, rests & network.feels[k], left * UP) ** 2
        bears = room > np.sqrt(change) * UP
        if bears[rests].all():
            break
        rests &= bears
    return rests


def _changes(network: JudgedNetwork, k: int, rests: np.ndarray, left: np.ndarray) -> np.ndarray:
    """(E,), bound on the change of the force of each contact in X in component k; infinite where a part cannot rest.

    rests : (E,) mask of X. left : (N,), r.
    """
    own, count, found = np.flatnonzero(rests), len(network.free), np.zeros(len(rests))
    ends, imposed = network.graph.contact[:, own], network.imposed[k]
    nodes = np.where(network.free[ends], ends, count + np.arange(len(own)))  # a driven end is not passed through
    label, odd, sign = signs(nodes, count + len(own))
    total = np.bincount(label[:count], np.where(network.free, left, 0.0), len(label)) * SHARE_AROUND
    held = np.flatnonzero((nodes >= count).any(axis=0))
    driven = np.where(network.free[ends[0]], ends[1], ends[0])[held]
    asked = imposed.at(driven).signed(sign[count + held])
    part = label[count + held]
    first, place = np.unique(part, return_index=True, return_inverse=True)[1:]
    differs = np.any([values != values[first][place] for values in asked.parts[:2]], axis=0)
    total[part[differs | (odd[count + held] & (asked.high != 0))]] = np.inf
    found[own] = total[label[nodes[0]]]
    return found
