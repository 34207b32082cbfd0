"""The settling of contact states by the method of multipliers, for networks whose spin components mix.

Each contact gets a stiff spring that slips where it would bear more than friction allows (Hestenes 1969; for friction
Alart & Curnier 1991). The minimum with these springs is found repeatedly, and each time a spring begins with the force
that it bore at the last one. So a slipless contact creeps less each time, and a contact at its friction limit slips
along its force.

Where minima tie, groups of spheres can turn without a change of power, so that springs do not determine all spins, and
Newton's method fails. Then a weak inertia draws the spins to those found before (the proximal method of multipliers;
Rockafellar, Math. Oper. Res. 1, 1976). It is weakened from one minimum to the next, with the torques that it takes.

Letters: n contacts with d tangents each; the unknowns are components of u = R omega. The *dual* is minus the contact
force.
"""

from contextlib import suppress

import numpy as np

from taichi_bearings.conic.central_path import balance
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.friction_stage import Friction, FrictionStage
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import NotPositiveDefinite

# Stiffnesses of the springs one after the other, in units of friction; the second ones if contacts are still open then.
HOLDS, HOLDS_ONCE_MORE = (1e6, 1e8, 1e10, 1e10), (1e8, 1e10, 1e10, 1e10, 1e10)
# With inertia: stiffnesses of the springs one after the other; first weight of the inertia, in units of friction over
# spin; factors of the last weight that are tried one after the other at each minimum.
HOLDS_WITH_INERTIA, FIRST_INERTIA, INERTIA_FACTORS = (1e6, 1e8, 1e8, 1e8, 1e8), 1e-5, (0.1, 1.0, 10.0, 100.0)
SETTLED_FORCE = 1e-11  # largest change of a force, in units of the mean friction, at which the forces are settled
ROUNDED_EXCESS = 1e-12  # share of a friction limit by which rounding may exceed it
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
    best = _Multipliers(point, matrix)
    for number, hold in enumerate((*HOLDS, *HOLDS_ONCE_MORE)):
        if best.is_settled or (number >= len(HOLDS) and not best.has_open):
            break
        if not best.take(hold):
            best.take_with_inertia()
            break
    powers = (_power(point, of) for of in (point.spins, best.spins))
    if next(powers) * (1 + WORSE_POWER) < next(powers):
        # with many minima of the same power, springs can lead away from all of them: the path itself is returned
        with suppress(NotPositiveDefinite):
            point = balance(point, matrix)
        return point.spins, point.whole_dual, None, None
    return best.spins, best.within_friction, best.slipping, best.open


class _Multipliers:
    """The spins and forces of one sample, as the method of multipliers improves them.

    point : the end of the central path, with n contacts of d tangents.
    spins : (unknowns,).
    held : (d, n), forces of friction, with which the next springs begin.
    whole_dual : (d, n), minus the contact forces.
    slipping : (n,) mask of the contacts that slip; None before the first minimum.
    open : (n,) mask of the contacts that slip by more than rounding but bear less than the friction limit; or None.
    change : largest change of a force by the last minimum.
    """

    slipping: np.ndarray | None = None
    open: np.ndarray | None = None

    def __init__(self, point: Iterate, matrix: NewtonMatrix) -> None:
        """Begin at the end of a central path.

        point : that end.
        matrix : Newton matrix of its contacts.
        """
        self.point, self._matrix, self.change = point, matrix, np.inf
        self.spins, self.held, self.whole_dual = point.spins, -point.dual, point.whole_dual
        self._firm = np.where(point.friction > 0, point.friction, 1.0)

    @property
    def within_friction(self) -> np.ndarray:
        """(d, n), minus the contact forces, with friction cut to its limit where it is above by more than rounding: a
        force above its limit lowers the lower bound by the ratio of both, far more than the torque that is left."""
        size, limit = length(self.held), self.point.friction
        beyond = size > limit * (1 + ROUNDED_EXCESS)
        return self.whole_dual + np.where(beyond, self.held * (1 - limit / size), 0.0)

    @property
    def has_open(self) -> bool:
        """True if some contact is open, or if no minimum is found yet."""
        return self.open is None or bool(self.open.any())

    @property
    def is_settled(self) -> bool:
        """True if forces change no more and no contact is open."""
        return self.change < SETTLED_FORCE and not self.has_open

    def take(self, hold: float, inertia: float = 0.0) -> bool:
        """Go on to the minimum with springs that begin with the forces `held`, and return True; False if Newton's
        method fails to find it.

        hold : stiffness of the springs, in units of the friction of each.
        inertia : weight of the inertia that draws spins to the present ones, in units of friction over spin.
        """
        # the change of the spins is solved for, with slips in twice the precision
        contacts, point, rest = self.point.system, self.point, np.zeros(len(self.spins))
        here = contacts.with_offset(contacts.to_all_digits(self.spins))
        stage = FrictionStage(here, self._matrix, 1.0, SMALL_SPINS, 1.0)
        with one_thread():
            friction = Friction(point.friction, hold * self._firm, inertia, point.viscosity)
            end = stage.solve(friction, rest, self.held, rest)
        if end is None:
            return False
        change, slip = length(end.held - self.held).max(initial=0.0), length(here.differences(end.spins))
        change = max(change, inertia * np.abs(end.spins).max(initial=0.0))  # the torques that inertia took
        self.spins, self.held, self.whole_dual = self.spins + end.spins, end.held, -end.force
        creeps = np.where(end.slips, 0.0, slip) >= LEAST_SLIP
        if self.slipping is None or self.open is None or change < WORSE * self.change:
            self.slipping, self.open, self.change = end.slips, creeps, change
        else:  # the springs are so stiff that rounding moves them: what changes its state now is open
            self.open = self.open | creeps | (end.slips != self.slipping)
        return True

    def take_with_inertia(self) -> None:
        """Go on with inertia, which makes spins unique where minima tie, until forces settle or no weight of it is left
        to try."""
        inertia = FIRST_INERTIA
        for hold in HOLDS_WITH_INERTIA:
            if self.is_settled:
                break
            weights = (factor * inertia for factor in INERTIA_FACTORS)
            found = next((weight for weight in weights if self.take(hold, weight)), None)
            if found is None:
                break
            inertia = found


def _power(point: Iterate, spins: np.ndarray) -> float:
    """Return the power of some spins, or with viscosity the potential, computed from slips in twice the precision, in
    units of the mean friction and of the spins.

    point : a point of the path, which knows friction and viscosity of its contacts.
    spins : (unknowns,).
    """
    slip = length(point.system.to_all_digits(spins))
    damped = 0.0 if point.viscosity is None else float((point.viscosity * slip**2).sum()) / 2
    return float((point.friction * slip).sum()) + damped
