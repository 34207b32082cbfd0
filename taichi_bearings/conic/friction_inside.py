"""Finds forces of resting contacts that are below the friction limits and exert the same torques as given ones.

Where contacts close loops, balance does not determine their forces. Springs then leave some resting contacts at their
friction limit. But that a contact rests can be proven only from a force below the limit. So other forces are sought by
a barrier method: Newton's method lowers the sum of -log(ratio^2 limit^2 - |force|^2) over the resting contacts, where
`ratio` is a bit larger than the largest force over its limit, and is lowered from step to step.

Letters: n contacts with up to d slip components (conic/__init__.py).
"""

from functools import partial

import numpy as np

from taichi_bearings.conic.cones import determinant, inner, isotropic, length, longest_step
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.newton_matrix import NewtonMatrix, resisted
from taichi_bearings.numerics.cholesky import NotPositiveDefinite

INSIDE_SHARE = 1 - 1e-7  # the search ends when every force over its limit is at most so large
MOST_BARRIERS, SHARE_OF_REACH = 6, 0.9  # Newton steps at most; share of the way to the barrier that a step goes at most
# With the largest force over its limit as the unit: `ratio` at the start; and the factor by which each step reduces the
# distance of `ratio` from it.
FIRST_RATIO, NEARER = 1 + 1e-6, 0.1
MOVED_TORQUE = 1e-12  # change of a torque that is accepted as rounding, over the largest limit
HELD = 1e-12  # stiffness of a spring at every spin that keeps matrices regular, over the mean square of limits


@np.errstate(all="ignore")
def moved_inside(
    system: ContactSystem, matrix: NewtonMatrix, friction: np.ndarray, force: np.ndarray, rests: np.ndarray
) -> np.ndarray:
    """Return contact forces (d, n) that exert the same torques as the given ones and are below the friction limits of
    all resting contacts. The given forces are returned if they are below the limits, or if none are found that are.

    system : the n contacts, with up to d slip components.
    matrix : their Newton matrix, which is factorised anew.
    friction : (n,), friction limits; above 0 for resting contacts.
    force : (d, n), given forces; those of contacts that do not rest stay.
    rests : (n,) mask of the contacts that rest.
    """
    limit = np.where(rests, friction, 1.0)
    found = np.where(rests, force, 0.0)
    largest = float((length(found) / limit).max(initial=0.0))
    if largest <= INSIDE_SHARE:
        return force
    ratio = FIRST_RATIO * largest
    for _ in range(MOST_BARRIERS):
        # half the barrier is -log(room) / 2 for each contact; its gradient is `slope`
        room = determinant((ratio * limit, found))
        slope = np.where(rests, found / room, 0.0)
        # the inverse of its second derivative: room * (unit matrix - 2 f f^T / (room + 2 |f|^2)) at the force f
        along = room / (room + 2 * inner(found, found)) * found
        compliance = np.where(rests, isotropic(found, room) - 2 * along[:, None] * found[None, :], 0.0)
        try:
            matrix.factorise(compliance, HELD * float((limit**2).mean()))
        except NotPositiveDefinite:
            break
        # a Newton step of the barrier, and then forces of springs, by which the torques are again those before
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
