"""The contact system of a packing, found once for all samples of one network."""

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.scene.packing import Packing

_last: tuple[Packing, ContactSystem] | None = None  # last packing that this process solved, and its system
OF_A_NETWORK = ("center", "contact", "driven", "spin", "radius", "normal")  # all that a contact system depends on


def system_of_sample(packing: Packing) -> ContactSystem:
    """Return the contact system of a packing: the contacts that take part, and the linear map from spins to their
    slips. If only coefficients differ from the packing of the last call, as between seeds, it is the one returned then.
    """
    from taichi_bearings.conic.shared import system_of  # and with it Taichi's kernels

    global _last
    known = _last
    if known is None or not _alike(known[0], packing):
        known = _last = None  # its memory is free before another one is found
        known = _last = packing, system_of(packing)
    return known[1]


def _alike(one: Packing, other: Packing) -> bool:
    """Return True if two packings have the same spheres, contacts and imposed spins, and the same contacts take
    part.
    """
    same = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in OF_A_NETWORK)
    return same and np.array_equal(one.acting, other.acting)
