"""The settling of contact states by the method of multipliers, for networks whose spin components mix.

Each contact gets a stiff spring that slips where it would bear more than friction allows (Hestenes 1969; for friction
Alart & Curnier 1991). The minimum with these springs is found repeatedly, and each time a spring begins with the force
that it bore at the last one. So a slipless contact creeps less each time, and a contact at its friction limit slips
along its force.

Spins are sums of two doubles: the slowest of 36,000 contacts slip by 1e-12 to 1e-15 of what is imposed, and resting
ones must creep far less. Beside a slow contact it takes springs far stiffer than elsewhere, as its force turns by all
of the friction while its slip changes by 1e-15. Where contacts close loops, springs may leave some at rest at the limit
of their friction; other forces with the same torques are then below it (friction_inside.py).

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
from taichi_bearings.conic.friction_inside import moved_inside
from taichi_bearings.conic.friction_stage import Friction, FrictionStage
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.slipless_forces import may_have_several_minima
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import Pair, add, exactly

# Stiffnesses of the springs one after the other, in units of friction: first ones, and those with which it is begun
# anew where these are too stiff for Newton's method; then those that follow while slow contacts are not told apart from
# resting ones. A resting contact creeps by a force over its stiffness.
TRIALS, HOLDS_FOR_SLOW = ((1e8, 1e10), (1e6, 1e8, 1e10, 1e10)), (1e12, 1e13, 1e14)
# Largest ratio of two frictions up to which the first stiffnesses are tried. Beyond, springs of strong contacts are so
# stiff that rounding exceeds what weak ones bear, and forces would balance with fewer digits.
MOST_CONTRAST = 1e6
# With inertia: stiffnesses of the springs one after the other; first weight of the inertia, in units of friction over
# spin; factors of the last weight that are tried one after the other at each minimum.
HOLDS_WITH_INERTIA, FIRST_INERTIA, INERTIA_FACTORS = (1e6, 1e8, 1e8, 1e8, 1e8), 1e-5, (0.1, 1.0, 10.0, 100.0)
SETTLED_FORCE = 1e-11  # largest change of a force, in units of the mean friction, at which inertia takes no torque
# ratio of the slowest slip and the fastest creep from which both are told apart; ratio by which a slip falls that is as
# slow as creep, if it is creep; and a slip that is so in any case, in units of the largest imposed one
APART, CREEPS, NO_SLIP = 30.0, 0.1, 1e-24
# Beside contacts that slip more slowly than the first number springs are stiffer than mu F_n over such a slip, by the
# second, up to that of the third slip; that many contacts away.
SLOW, STIFFER_BESIDE, SLOWEST, CONTACTS_AWAY = 1e-9, 1e2, 1e-16, 3
# Forces of resting contacts are settled if they change by no more than these: a share of what friction is left, and in
# units of the mean friction. Until then, such springs are taken in so many minima at most.
CHANGE_OVER_ROOM, SETTLED_CHANGE, MOST_LOCAL = 1e-2, 1e-9, 8
ROUNDED_EXCESS = 1e-12  # share of a friction limit by which rounding may exceed it
LEAST_SLIP = 1e-13  # slip, in units of the largest imposed one, that is more than rounding
WORSE_POWER = 1e-10  # relative growth of the power that settling may cause
SMALL_SPINS = 1e-8  # scale of the spins that are still to be found when the states are settled


@np.errstate(all="ignore")
def settled_by_springs(
    point: Iterate, matrix: NewtonMatrix
) -> tuple[Pair, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Find which contacts slip at the end of a path by the method of multipliers.

    Each contact gets a stiff spring that slips where it would bear more than friction allows; the minimum with these
    springs is found repeatedly, and each time a spring begins with the force that it bore at the last one.

    point : the end of the central path, with n contacts of d tangents.
    matrix : Newton matrix of its contacts.

    Returns four things: spins (unknowns,), sums of two doubles; minus the contact forces (d, n); a mask (n,) of the
    contacts that slip; and a mask (n,) of the undecided ones, which slip by more than rounding but bear less than the
    friction limit. If the method fails the masks are None, and spins and forces are those of the path.
    """
    best, several = _Multipliers(point, matrix), may_have_several_minima(point.friction, np.zeros(0, dtype=bool))
    begins_softly = several or best.firm.max(initial=1.0) > MOST_CONTRAST * best.firm.min(initial=1.0)
    for holds in TRIALS[1:] if begins_softly else TRIALS:
        best = _Multipliers(point, matrix)
        if all(best.is_settled or best.take(hold * best.firm) for hold in holds):
            if not several:
                best.take_while_slow()
            break
    else:
        best.take_with_inertia()
    powers = (_power(point, of) for of in (exactly(point.spins), best.spins))
    if next(powers) * (1 + WORSE_POWER) < next(powers):
        # with many minima of the same power, springs can lead away from all of them: the path itself is returned
        with suppress(NotPositiveDefinite):
            point = balance(point, matrix)
        return exactly(point.spins), point.whole_dual, None, None
    return best.spins, best.within_friction, best.slipping, best.open


class _Multipliers:
    """The spins and forces of one sample, as the method of multipliers improves them.

    point : the end of the central path, with n contacts of d tangents.
    spins : (unknowns,), sums of two doubles, as the slowest slips are below the rounding of spins.
    held : (d, n), forces of friction, with which the next springs begin.
    whole_dual : (d, n), minus the contact forces.
    slipping : (n,) mask of the contacts that slip; None before the first minimum.
    open : (n,) mask of the contacts that slip by more than rounding but bear less than the friction limit; or None.
    change : largest change of a force by the last minimum, and largest torque that inertia took.
    firm : (n,), friction, or 1 where a contact has none.
    slip : (n,), slips at the last minimum.
    are_apart : True if every slip is clearly faster than what resting contacts creep.
    still_moves : True if the force of some resting contact has changed by more than a share of the friction that it has
        left.
    """

    slipping: np.ndarray | None = None
    open: np.ndarray | None = None

    def __init__(self, point: Iterate, matrix: NewtonMatrix) -> None:
        """Begin at the end of a central path.

        point : that end.
        matrix : Newton matrix of its contacts.
        """
        self.point, self._matrix, self.change = point, matrix, np.inf
        self.are_apart = self.still_moves = False
        self.spins, self.held, self.whole_dual = exactly(point.spins), -point.dual, point.whole_dual
        self.firm = np.where(point.friction > 0, point.friction, 1.0)

    @property
    def within_friction(self) -> np.ndarray:
        """(d, n), minus the contact forces, with friction cut to its limit where it is above by more than rounding: a
        force above its limit lowers the lower bound by the ratio of both, far more than the torque that is left."""
        size, limit = length(self.held), self.point.friction
        beyond = size > limit * (1 + ROUNDED_EXCESS)
        return self.whole_dual + np.where(beyond, self.held * (1 - limit / size), 0.0)

    @property
    def is_settled(self) -> bool:
        """True if forces change no more and no contact is open."""
        return self.change < SETTLED_FORCE and self.open is not None and not self.open.any()

    def take(self, stiffness: np.ndarray, inertia: float = 0.0) -> bool:
        """Go on to the minimum with springs that begin with the forces `held`, and return True; False if Newton's
        method fails to find it.

        stiffness : (n,), of the springs.
        inertia : weight of the inertia that draws spins to the present ones, in units of friction over spin.
        """
        # the change of the spins is solved for, with slips in twice the precision
        contacts, point, rest = self.point.system, self.point, np.zeros(len(self.spins[0]))
        here = contacts.with_offset(contacts.to_all_digits(self.spins))
        stage = FrictionStage(here, self._matrix, 1.0, SMALL_SPINS, 1.0)
        with one_thread():
            friction = Friction(point.friction, stiffness, inertia, point.viscosity)
            end = stage.solve(friction, rest, self.held, rest)
        if end is None:
            return False
        change, slip = length(end.held - self.held), length(here.differences(end.spins))
        self.change = max(change.max(initial=0.0), inertia * np.abs(end.spins).max(initial=0.0))
        self.spins, self.held, self.whole_dual = add(self.spins, exactly(end.spins)), end.held, -end.force
        self._tell_apart(end.slips, slip, length(here.offset))
        room = point.friction - length(self.held)
        rests = ~(end.slips if self.slipping is None else self.slipping)
        moves = rests & (change > np.maximum(CHANGE_OVER_ROOM * room, SETTLED_CHANGE))
        self.still_moves = bool((moves & (point.friction > 0)).any())
        return True

    def _tell_apart(self, slips: np.ndarray, slip: np.ndarray, before: np.ndarray) -> None:
        """Decide which contacts slip, and set these fields:

        slipping : (n,) mask of the contacts that slip.
        are_apart : True if that is clear for all.
        open : (n,) mask of the contacts below their limit that slip by LEAST_SLIP or more.
        slip : (n,), sizes of the slips.

        Contacts whose springs are below the limit of friction rest; what they slip all the same, as springs stretch, is
        creep. A contact at its limit is in doubt if its slip is less than APART times the fastest creep. It rests if
        its slip has fallen below CREEPS times that before, or is below NO_SLIP. If some are still in doubt then, all
        contacts at their limit are taken to slip.

        slips : (n,) mask of the contacts whose springs are at their limit.
        slip, before : (n,), sizes of the slips now and at the minimum before.
        """
        creep = np.where(slips, 0.0, slip)
        doubtful = slips & (slip < APART * creep.max(initial=0.0)) & (self.point.friction > 0)
        rests = doubtful & ((slip < CREEPS * before) | (slip < NO_SLIP))
        self.are_apart = bool((rests == doubtful).all())
        self.slipping, self.open = slips & ~rests if self.are_apart else slips, creep >= LEAST_SLIP
        self.slip = slip

    def take_while_slow(self) -> None:
        """Go on with stiffer springs while slow contacts are not told apart from resting ones; then with springs that
        are stiffer beside slow contacts alone, while that is so or forces of resting contacts still change. Then move
        these away from the limits of friction.
        """
        for hold in HOLDS_FOR_SLOW:
            if self.are_apart or not self.take(hold * self.firm):
                break
        for _ in range(MOST_LOCAL):
            if (self.are_apart and not self.still_moves) or not self.take(self._stiffer_beside_slow()):
                break
        if self.are_apart and self.slipping is not None:
            rests = ~self.slipping & (self.point.friction > 0)
            moved = moved_inside(self.point.system, self._matrix, self.point.friction, self.held, rests)
            self.whole_dual, self.held = self.whole_dual - (moved - self.held), moved

    def _stiffer_beside_slow(self) -> np.ndarray:
        """Return stiffnesses (n,) of springs that hold contacts beside slow ones more firmly than these resist.

        The force of a slow contact turns by a stiffness mu F_n / slip, and where springs are softer it moves them. So
        forces would change by nearly the same from minimum to minimum.
        """
        contacts, friction = self.point.system, self.point.friction
        assert self.slipping is not None
        slow = self.slipping & (self.slip < SLOW)
        own = np.where(slow, friction / np.maximum(self.slip, SLOWEST), 0.0)
        ends, free = contacts.network.contact[:, contacts.numbers], np.any(contacts.moved >= 0, axis=1)
        for _ in range(CONTACTS_AWAY):
            stiffest = np.zeros(len(free))
            for end in ends:
                np.maximum.at(stiffest, end, own)
            stiffest[~free] = 0.0
            own = np.maximum(own, stiffest[ends].max(axis=0))
        return np.maximum(HOLDS_FOR_SLOW[-1] * self.firm, STIFFER_BESIDE * own)

    def take_with_inertia(self) -> None:
        """Go on with inertia, which makes spins unique where minima tie, until forces settle or no weight of it is left
        to try."""
        inertia = FIRST_INERTIA
        for hold in HOLDS_WITH_INERTIA:
            if self.is_settled:
                break
            weights = (factor * inertia for factor in INERTIA_FACTORS)
            found = next((weight for weight in weights if self.take(hold * self.firm, weight)), None)
            if found is None:
                break
            inertia = found


def _power(point: Iterate, spins: Pair) -> float:
    """Return the power of some spins, or with viscosity the potential, computed from slips in twice the precision, in
    units of the mean friction and of the spins.

    point : a point of the path, which knows friction and viscosity of its contacts.
    spins : (unknowns,), sums of two doubles.
    """
    slip = length(point.system.to_all_digits(spins))
    damped = 0.0 if point.viscosity is None else float((point.viscosity * slip**2).sum()) / 2
    return float((point.friction * slip).sum()) + damped
