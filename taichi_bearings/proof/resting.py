"""Which contacts of a packing rest at every minimum, part by part: theorem 8, where friction is nearly known.

Let y* be the slips of a minimum and F* friction that is optimal: in balance on every free sphere, along y* where y* is
not 0, and then of size mu F_n + eta |y*|. Let R be some contacts with friction, such that

a. spins u exist at which nothing of R slips, K u + b = 0 with K the rows of R and b what driven spheres bring, and
b. there is G on R, inside all discs, |G| < mu F_n, with K^T G = K^T F* on the free spheres.

Then R rests: (F* - G) . y* = (F* - G) . (K u* + b) = (F* - G) . b = -(F* - G) . K u = 0, sums over R, so the sum of
mu F_n |y*| + eta |y*|^2 is that of G . y*, which is less unless all y* are 0.

For b it is enough to know how far F*, away from R, can be from friction F that is in balance up to torques: then K^T of
F* - F on R is no larger than the sum r of both, sphere by sphere. Where components do not mix (discs; normals along the
axes) a part is what contacts of R join through free spheres in one component. G takes r along a tree of the part, to a
driven sphere if it has any, and else to where all cancels, as K^T (F* - F) does; what an odd loop has left over goes
around it, half of it each way. So no force changes by more than 3/2 of the sum of r over the part. And a holds exactly
where driven spheres that a part joins ask for one spin, and for none where its loops are odd: nothing is rounded.
"""

from __future__ import annotations

import numpy as np

from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.enclosure import UP, length
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.listed import signs
from taichi_bearings.proof.slipless_state import imposed_exactly

SHARE_AROUND = 1.5  # of what a part leaves over, that a force of it may change by


def known_friction(bounds: Bounds, far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mask (E,) of the contacts that slip at every minimum, or that have damping alone; and how far (E,) the optimal
    friction of all contacts can be from that at hand.

    far : (E,), how far slips of minima are from the given ones at most; infinite where that is not known."""
    network, size = bounds.network, bounds.network.slip
    known = network.counts & ((size.least > far) | ((network.holding.high == 0) & np.isfinite(far)))
    own, friction = np.flatnonzero(known), bounds.friction or network.own_friction
    held = np.flatnonzero(network.holding.high[own] > 0)
    wrong = []
    for given, slip in zip(friction, network.slips(network.spin), strict=True):
        lawful = network.slope.at(own) * slip.at(own)
        turned = network.holding.at(own[held]) * (slip.at(own[held]) / size.at(own[held]))
        lawful.put(held, lawful.at(held) + turned)
        wrong.append(given.at(own) - lawful)
    turn = 0 * far if len(friction) == 1 else np.where(size.least > far, 2 * far / size.least, 0.0)  # one has no others
    damped = network.slope.high > 0
    reached = np.where(damped, network.slope.most * (size.most + far), 0.0)
    off = network.holding.most + reached + length(friction).most
    off[own] = length(wrong).most + network.holding.most[own] * turn[own] * UP
    off[own] += np.where(damped, network.slope.most * far, 0.0)[own]
    return known, np.where(network.counts, off * UP, 0.0)


@np.errstate(all="ignore")  # what is not finite proves nothing
def at_rest(bounds: Bounds, far: np.ndarray) -> np.ndarray:
    """Mask (E,) of contacts that are proven to rest at every minimum, of a network whose components do not mix.

    far : (E,), how far slips of minima are from the given ones at most; infinite where that is not known."""
    network = bounds.network
    known, off = known_friction(bounds, far)
    room = (network.holding - length(network.own_friction)).lower()
    rests = network.counts & ~known & (room > 0) & imposed_exactly(network)
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
    """(E,), by how much forces of contacts at rest (E,) may have to change in component k, where so much is left over
    of each sphere (N,); infinite where a part cannot rest."""
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
