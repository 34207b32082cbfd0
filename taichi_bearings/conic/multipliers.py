"""The settling of contact states by the method of multipliers, for networks whose spin components mix.

Each contact gets a stiff spring that slips where it would bear more than friction allows (Hestenes 1969; for friction
Alart & Curnier 1991). The minimum with these springs is found repeatedly, and each time a spring begins with the force
that it bore at the last one. So a slipless contact creeps less each time, and a contact at its friction limit slips
along its force.

Letters: n contacts with d tangents each; the unknowns are components of u = R omega. The *dual* is minus the contact
force.
"""

from contextlib import suppress
from typing import Any

import numpy as np

from taichi_bearings.conic.central_path import balance
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.friction_stage import Friction, FrictionStage
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import NotPositiveDefinite

HOLDS = (1e6, 1e8, 1e10, 1e10)  # stiffnesses of the springs one after the other, in units of friction
SETTLED_FORCE = 1e-11  # largest change of a force, in units of the mean friction, at which the forces are settled
LEAST_SLIP = 1e-13  # slip, in units of the largest imposed one, that is more than rounding
WORSE = 10.0  # growth of the change of the forces by which springs are too stiff for double precision
WORSE_POWER = 1e-10  # relative growth of the power that settling may cause
SMALL_SPINS = 1e-8  # scale of the spins that are still to be found when the states are settled


@np.errstate(all="ignore")
def settled_by_springs(
    point: Iterate, matrix: NewtonMatrix
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Find which contacts slip at the end of a path by the method of multipliers.

    Each contact gets a stiff spring that slips where it would bear more than friction allows; the minimum with these
    springs is found repeatedly, and each time a spring begins with the force that it bore at the last one.

    point : the end of the central path, with n contacts of d tangents.
    matrix : Newton matrix of its contacts.

    Returns four things: spins (unknowns,); minus the contact forces (d, n); a mask (n,) of the contacts that slip; and
    a mask (n,) of the undecided ones, which slip by more than rounding but bear less than the friction limit. If the
    method fails the masks are None, and spins and forces are those of the path.
    """
    contacts, spins, held, whole = point.system, point.spins, -point.dual, point.whole_dual
    slipping: Any = None
    open_, last = slipping, np.inf
    firm, rest = np.where(point.friction > 0, point.friction, 1.0), np.zeros(contacts.unknowns)
    for hold in HOLDS:
        # the change of the spins is solved for, with slips in twice the precision, and springs that bear `held`
        here = contacts.with_offset(contacts.to_all_digits(spins))
        stage = FrictionStage(here, matrix, 1.0, SMALL_SPINS, 1.0)
        with one_thread():
            end = stage.solve(Friction(point.friction, hold * firm, 0.0, point.viscosity), rest, held, rest)
        if end is None:
            break
        change, slip = length(end.held - held).max(initial=0.0), length(here.differences(end.spins))
        spins, held, whole = spins + end.spins, end.held, -end.force
        creeps = np.where(end.slips, 0.0, slip) >= LEAST_SLIP
        if change < WORSE * last:
            slipping, open_, last = end.slips, creeps, change
        else:  # the springs are so stiff that rounding moves them: what changes its state now is open
            open_ = open_ | creeps | (end.slips != slipping)
        if change < SETTLED_FORCE and not open_.any():
            break
    powers = (_power(point, of) for of in (point.spins, spins))
    if next(powers) * (1 + WORSE_POWER) < next(powers):
        # with many minima of the same power, springs can lead away from all of them: the path itself is returned
        with suppress(NotPositiveDefinite):
            point = balance(point, matrix)
        return point.spins, point.whole_dual, None, None
    return spins, whole, slipping, open_


def _power(point: Iterate, spins: np.ndarray) -> float:
    """Return the power of some spins, or with viscosity the potential, computed from slips in twice the precision, in
    units of the mean friction and of the spins.

    point : a point of the path, which knows friction and viscosity of its contacts.
    spins : (unknowns,).
    """
    slip = length(point.system.to_all_digits(spins))
    damped = 0.0 if point.viscosity is None else float((point.viscosity * slip**2).sum()) / 2
    return float((point.friction * slip).sum()) + damped
