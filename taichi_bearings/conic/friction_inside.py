"""Friction of resting contacts, moved away from its limits: the forces of contacts that close loops are not unique.

Springs bring contacts to rest at the first forces that do, which may be at the limit of some of them. Whether these
contacts rest can then be proven only with other forces, that exert the same torques and are below every limit. Such
forces are sought by Newton's method, which lowers the sum of -log(ratio^2 limit^2 - |force|^2) over the resting
contacts while a ratio falls that all forces over their limits stay below (a barrier method).

Letters: n contacts with up to d slip components (conic/__init__.py).
"""

from functools import partial

import numpy as np

from taichi_bearings.conic.cones import determinant, inner, isotropic, length, longest_step
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.newton_matrix import NewtonMatrix, resisted
from taichi_bearings.numerics.cholesky import NotPositiveDefinite

INSIDE_SHARE = 1 - 1e-7  # largest force over its limit at which the search ends
MOST_BARRIERS, SHARE_OF_REACH = 6, 0.9  # Newton steps at most; share of the way to the barrier that a step goes at most
# the ratio at the start, over the largest force over its limit; factor by which a step brings it closer to that
FIRST_RATIO, NEARER = 1 + 1e-6, 0.1
MOVED_TORQUE = 1e-12  # torque that may change by rounding, over the largest limit
HELD = 1e-12  # spring at every spin that keeps matrices regular, over the mean square of limits


@np.errstate(all="ignore")
def moved_inside(
    system: ContactSystem, matrix: NewtonMatrix, friction: np.ndarray, force: np.ndarray, rests: np.ndarray
) -> np.ndarray:
    """Return forces (d, n) with the torques of the given ones that are below the limits of the resting contacts; the
    given ones if such forces are not found, or if none of them is at its limit. Those of other contacts stay.

    system : the n contacts.
    matrix : their Newton matrix, which is factorised anew.
    friction : (n,), friction limits; above 0 for resting contacts.
    force : (d, n), forces, with up to d components.
    rests : (n,) mask of the contacts that rest.
    """
    limit = np.where(rests, friction, 1.0)
    found = np.where(rests, force, 0.0)
    largest = float((length(found) / limit).max(initial=0.0))
    if largest <= INSIDE_SHARE:
        return force
    ratio = FIRST_RATIO * largest
    for _ in range(MOST_BARRIERS):
        room = determinant((ratio * limit, found))
        slope = np.where(rests, found / room, 0.0)
        # inverse of the second derivative of half the barrier: room in all directions, less along the force
        along = room / (room + 2 * inner(found, found)) * found
        compliance = np.where(rests, isotropic(found, room) - 2 * along[:, None] * found[None, :], 0.0)
        try:
            matrix.factorise(compliance, HELD * float((limit**2).mean()))
        except NotPositiveDefinite:
            break
        # a step down the barrier, and springs that take the torques of it away
        down = found - resisted(compliance, slope)
        there = matrix.stretched(down, partial(resisted, compliance), system.torques(found))
        reach = longest_step((ratio * limit, found), (np.zeros_like(limit), there - found))
        share = min(1.0, SHARE_OF_REACH * reach)
        moved = found + share * (there - found)
        now = float((length(moved) / limit).max(initial=0.0))
        if not now < ratio:
            break
        found, largest = moved, now
        if largest <= INSIDE_SHARE:
            break
        ratio = largest + NEARER * (ratio - largest)
    found = np.where(rests, found, force)
    left = np.abs(system.torques(found - force)).max(initial=0.0)
    return found if largest <= INSIDE_SHARE and left <= MOVED_TORQUE * float(limit.max()) else force
