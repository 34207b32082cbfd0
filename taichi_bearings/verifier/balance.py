"""Can the friction of contacts that do not slip be put in balance, with that of the others exactly as it is?"""

from __future__ import annotations

import numpy as np

from taichi_bearings.verifier.curvature import Slipping
from taichi_bearings.verifier.enclosure import UP, Enclosure, length
from taichi_bearings.verifier.network import Motion


def bearable(motion: Motion, contacts: Slipping, turn: np.ndarray, unsure: dict[int, np.ndarray] | None = None) -> bool:
    """True if the friction of the contacts that rest in a motion can be put in balance inside all discs.

    contacts, turn : those that slip near a minimum, and the share by which each slip differs there. unsure : by
    component, (n,), how far the friction of others at each sphere may be from what it has to be.
    """
    network, left = motion.network, {}
    moment, torques = network.own_moment, network.own_torques
    off = _unsure(motion, contacts, turn)
    for k in network.needed:
        residual = np.where(network.free, torques[k].most if unsure is None else torques[k].most + unsure[k], 0.0)
        for slot in range(2):
            some = contacts.felt[slot] == k
            for end in network.contact[:, contacts.own[some]]:
                residual += np.bincount(end, off[slot, some], len(residual))
        residual[~network.free] = 0.0
        domain = motion.domain[k]
        left[k] = np.bincount(domain, residual)[domain] * UP
    still = np.flatnonzero(motion.rests & network.counts)
    feels = {k: network.feels[k][still] for k in network.needed}
    borne = length([moment[k].at(still).where(feels[k]) for k in network.needed])
    room = network.holding.at(still) - borne
    first = network.contact[0, still]
    more = np.sqrt(sum(np.where(feels[k], left[k][first], 0.0) ** 2 for k in network.needed))
    bears = np.any(list(feels.values()), axis=0)
    return bool((~bears | ((room.high > 0) & (room.least > more * UP))).all())


def _unsure(motion: Motion, contacts: Slipping, turn: np.ndarray) -> np.ndarray:
    """(2, n): how far the friction of slipping contacts in their components, as the file says, may be from that at the
    minimum."""
    network, found = motion.network, np.zeros(contacts.felt.shape)
    for slot in range(2):
        said = Enclosure.exact(np.zeros(len(contacts.own)))
        for k in network.needed:
            some = np.flatnonzero(contacts.felt[slot] == k)
            own = contacts.own[some]
            said.put(some, network.moment[k].at(own).signed(network.sign[k][network.contact[1, own]]))
        found[slot] = (contacts.pulls[slot] - said).most
        found[slot, contacts.curved] += 2 * turn[contacts.curved] * contacts.strength.at(contacts.curved).most
        if contacts.damping is not None:
            found[slot] += turn * (contacts.damping * contacts.size).most
    return found
