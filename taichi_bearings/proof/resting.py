"""Proof that contacts of a packing rest at every minimum, part by part, where friction is nearly known: theorem 8.

What is proven. Where the friction of slipping contacts is known closely, other contacts do not slip if friction on
them, below their limits, can balance the torques of the slipping ones. The theorem holds for any network; this file
uses it where components do not mix, borne.py for normals in any direction.

Symbols
    N spheres, E contacts. K : matrix of slips, b : slips of what is imposed; y = K u + b are the slips of spins u.
    u*, y* : spins and slips of a minimum. F* : optimal friction: in balance on every free sphere, along y* where y* is
        not 0, and then of size mu F_n + eta |y*|.
    F : friction at hand. r : bound on the torque on each sphere.
    X : the contacts that are tried. G : some friction on X.

Theorem. The contacts of X slip at no minimum if
a. spins u exist at which nothing of X slips, K u + b = 0 in the rows of X, and
b. some friction G on X can replace F* there: it exerts the same torques, K^T G = K^T F* on the free spheres, and |G| <
   mu F_n at every contact of X.
Proof. Sums are over X. As y* = K u* + b, (F* - G) . y* = (F* - G) . b, since K^T (F* - G) = 0. This is -(F* - G) . K u,
since b = -K u by a, and that is 0, since K^T (F* - G) = 0 once more. So the sum of F* . y*, that is of mu F_n |y*| +
eta |y*|^2, equals that of G . y*. But G . y* is smaller than mu F_n |y*| at every contact that slips. So none does.

What slackness says of F* (theorem 5), see `_distance_by_slackness`. Let E be the potential of the spins at hand less
what the friction at hand proves. With friction alone F* differs from mu F_n y / |y| by at most (2 mu F_n E / |y|)^1/2.

How it is used, where components do not mix (discs; normals along the axes). A *part* is what contacts of X join through
free spheres in one component.
1. Condition a holds, without any rounding, if all driven spheres that a part touches have the same imposed spin, up to
   the signs by which neighbours differ; with a loop of an odd number of contacts it has to be 0.
2. For b start from the friction F of X at hand. Its torque on a sphere differs from that of F* by no more than r: the
   torque that F leaves over there, and |F* - F| of the other contacts (`known_friction`). Changes of friction carry
   these torques along a tree of contacts of the part to its root, none larger than the sum of r over the part. The root
   is next to a driven sphere; or, without one, what arrives there cancels, as friction of X, F* less F, can balance it.
   In a part with odd loops it may not cancel: the root is put on such a loop, and half of the rest goes around it each
   way. So no force changes by more than 3/2 of the sum of r over the part.
3. Start with all contacts that have friction left. Remove those whose friction may exceed the limit, until none does.

Example. A free disc touches a still disc (mu F_n = 3) and one that turns with u = 1 (mu F_n = 1, eta = 1), along which
it slips. The friction there is known, mu F_n + eta |y| = 2. X is the first contact. Condition a: the free disc can
stand still. Condition b: G = 2 balances the disc and is below 3. So it stands still at every minimum.
"""

from __future__ import annotations

import numpy as np

from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.enclosure import UP, length
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.listed import signs
from taichi_bearings.proof.slipless_state import imposed_exactly
from taichi_bearings.scene.solution import PROVEN

# Largest change of a force over the sum of r over its part: 1 along the tree, 1/2 around a loop with an odd number.
SHARE_AROUND = 1.5
NEARLY_KNOWN = 1e-2  # (what slackness leaves open of a friction) / limit, up to which the contact is not tried


def known_friction(bounds: Bounds, far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays for E contacts: a mask (E,) of those whose friction F* is nearly known at every minimum; and a
    bound (E,) on |F* - F|, with the stored friction F, for every contact that can dissipate, 0 for others.

    F* is nearly known of three kinds of contacts: those that surely slip at every minimum; those with damping alone;
    and those with so much slip in the stored spins that slackness (`_distance_by_slackness`) leaves little open.

    bounds : bounds on the power, with the network and its friction.
    far : (E,), bound on |slip at any minimum - stored slip|, in units of the network; infinite where none is known.
    """
    network, size = bounds.network, bounds.network.slip
    slips = network.counts & ((size.least > far) | ((network.friction_limit.high == 0) & np.isfinite(far)))
    by_slackness = _distance_by_slackness(bounds)
    known = slips | (by_slackness < NEARLY_KNOWN * network.friction_limit.least)
    # Size of F less the friction of the law at the stored slips, mu F_n y / |y| + eta y, for contacts that need it.
    some, friction = np.flatnonzero(slips | np.isfinite(by_slackness)), bounds.friction or network.own_friction
    place = np.flatnonzero(network.friction_limit.high[some] > 0)
    with_limit, differences = some[place], []
    for given, slip in zip(friction, network.slips(network.spin), strict=True):
        by_law = network.damping.at(some) * slip.at(some)
        of_limit = network.friction_limit.at(with_limit) * (slip.at(with_limit) / size.at(with_limit))
        by_law.put(place, by_law.at(place) + of_limit)
        differences.append(given.at(some) - by_law)
    from_law = np.zeros(len(known))
    from_law[some] = length(differences).most
    # A slip that differs by far has a unit vector that differs by 2 far / |slip| at most; that of discs is fixed.
    turn = 0 * far if len(friction) == 1 else np.where(size.least > far, 2 * far / size.least, 0.0)
    damped = network.damping.high > 0
    damping_force = np.where(damped, network.damping.most * (size.most + far), 0.0)
    # In general F* and F may point in opposite directions: the sum of their largest sizes.
    distance = network.friction_limit.most + damping_force + length(friction).most
    # Of slipping contacts: distance of F from the law, and change of the law for slips within far.
    changed = network.friction_limit.most * turn * UP + np.where(damped, network.damping.most * far, 0.0)
    distance[slips] = (from_law + changed)[slips]
    distance = np.fmin(distance, from_law + by_slackness)
    return known, np.where(network.counts, distance * UP, 0.0)


def _distance_by_slackness(bounds: Bounds) -> np.ndarray:
    """Return a bound (E,) on |F* - mu F_n y / |y||, for E contacts with the friction F* at any minimum and the stored
    slips y. It is infinite for contacts with damping, without friction, or whose slip may be 0.

    With friction alone the power of the stored slips less the least power is the sum of mu F_n |y| - F* . y over all
    contacts. No term is negative, and the sum is at most E, the upper less the lower bound on the power. As |F*| <= mu
    F_n, |F* - mu F_n y / |y||^2 <= 2 mu F_n (mu F_n - F* . y / |y|) <= 2 mu F_n E / |y|.

    bounds : these bounds for R samples, with their spins."""
    network = bounds.network
    proven = network.on_contacts(bounds.proof == PROVEN)
    some = (
        network.counts
        & proven
        & (network.damping.high == 0)
        & (network.friction_limit.high > 0)
        & (network.slip.least > 0)
    )
    found = 2 * network.friction_limit.most * network.on_contacts(bounds.excess) / network.slip.least
    return np.where(some & np.isfinite(found), np.sqrt(found) * UP**3, np.inf)


@np.errstate(all="ignore")  # what is not finite proves nothing
def at_rest(bounds: Bounds, far: np.ndarray) -> np.ndarray:
    """Return the mask (E,) of the contacts that are proven to rest at every minimum, in a packing of discs or with
    normals along the axes.

    Contacts that can all rest at once do rest at every minimum, if friction below their limits can balance the torques
    of the other contacts. At first all contacts with friction left are assumed to rest. Those whose friction may exceed
    the limit are removed, again and again, until there is none.

    bounds : bounds on the power, with the network and its friction.
    far : (E,), bound on |slip at any minimum - stored slip|, in units of the network; infinite where none is known.
    """
    network = bounds.network
    known, distance = known_friction(bounds, far)
    margin = (network.friction_limit - length(network.own_friction)).lower()
    rests = network.counts & ~known & (margin > 0) & imposed_exactly(network)
    # Each round bounds the torques by the contacts that are not assumed to rest, then the change of friction that
    # balances them, and removes the contacts with a larger change than friction left.
    while rests.any():
        change = np.zeros(len(margin))
        for k in network.components:
            others = np.flatnonzero(network.feels[k] & ~rests)
            torque = network.own_torques[k].most
            for end in network.graph.contact[:, others]:
                torque = torque + np.bincount(end, distance[others], len(torque))
            change += _most_change(network, k, rests & network.feels[k], torque * UP) ** 2
        is_below = margin > np.sqrt(change) * UP
        if is_below[rests].all():
            break
        rests &= is_below
    found: np.ndarray = rests
    return found


def _most_change(network: JudgedNetwork, k: int, rests: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Return a bound (E,) on how much the friction of each contact that is tried as resting has to change, along spin
    component k, to balance given torques. It is infinite in parts that cannot rest, and 0 for contacts not tried.

    A *part* is a set of tried contacts that free spheres connect. It can rest (condition a at the head of this file) if
    all driven spheres that it touches have the same imposed spin, up to the signs by which neighbours differ; with a
    loop of an odd number of contacts this spin has to be 0. Torques are carried to the driven spheres along a tree of
    the contacts; in an odd loop half of each goes either way. So no force changes by more than 3/2 of their sum.

    network : a packing with N spheres and E contacts, whose slips do not mix the components of the spins.
    rests : (E,) mask of the contacts that are tried.
    torque : (N,), bound on the torque on each sphere that their change balances.
    """
    tried, count, found = np.flatnonzero(rests), len(network.free), np.zeros(len(rests))
    ends, imposed = network.graph.contact[:, tried], network.imposed[k]
    # Each contact with a driven end gets a node of its own there, so that driven spheres join no parts.
    nodes = np.where(network.free[ends], ends, count + np.arange(len(tried)))
    label, odd, sign = signs(nodes, count + len(tried))
    total = np.bincount(label[:count], np.where(network.free, torque, 0.0), len(label)) * SHARE_AROUND
    # Can it rest? Compare the imposed spins at the driven ends of each part, with their signs, as exact sums.
    with_driven = np.flatnonzero((nodes >= count).any(axis=0))
    driven = np.where(network.free[ends[0]], ends[1], ends[0])[with_driven]
    signed = imposed.at(driven).signed(sign[count + with_driven])
    part = label[count + with_driven]
    first, place = np.unique(part, return_index=True, return_inverse=True)[1:]
    differs = np.any([values != values[first][place] for values in signed.parts[:2]], axis=0)
    total[part[differs | (odd[count + with_driven] & (signed.high != 0))]] = np.inf
    found[tried] = total[label[nodes[0]]]
    return found
