"""Finds which contacts slip by the method of multipliers, for networks whose spin components mix.

Each contact gets a stiff spring whose force friction limits (Hestenes 1969; for friction Alart & Curnier 1991). Spins
and forces in balance with these springs, called a *minimum* here, are found repeatedly; each time a spring begins with
the force that it bore at the minimum before. So a slipless contact creeps less each time, and a contact at its friction
limit slips along its force.

Spins are sums of two doubles: the slowest of 36,000 contacts slip by 1e-12 to 1e-15 of the imposed motion, and resting
contacts must creep far less. A contact is called slow if its slip is below SLOW. Its force turns by all of its friction
while its slip changes by 1e-15, so springs beside it have to be far stiffer than elsewhere. Where contacts close loops,
springs may leave some resting contacts at their friction limit; then other forces with the same torques are sought that
are below it (friction_inside.py).

Where several minima have the same power, groups of spheres can turn without a change of power. So springs do not
determine all spins, and Newton's method fails. Then a weak inertia draws the spins to those found before (the proximal
method of multipliers; Rockafellar, Math. Oper. Res. 1, 1976). It is reduced from one minimum to the next, and with it
the torques that it exerts.

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

# Stiffnesses of the springs at successive minima, over the friction of each contact: two series, of which the second is
# tried where Newton's method fails with the first; and a series that follows as long as slow contacts and resting ones
# cannot be distinguished. A resting contact creeps by its force over its stiffness.
FIRST_STIFFNESSES, FOR_SLOW = ((1e8, 1e10), (1e6, 1e8, 1e10, 1e10)), (1e12, 1e13, 1e14)
# Ratio of the largest and the smallest friction beyond which the first series is left out: springs of strong contacts
# are then so stiff that rounding exceeds what weak ones bear, and forces would balance with fewer digits.
MOST_CONTRAST = 1e6
# With inertia: stiffnesses of the springs at successive minima; first weight of the inertia, in units of friction over
# spin; factors by which the last weight is multiplied, tried one after the other at each minimum.
WITH_INERTIA, FIRST_INERTIA, INERTIA_FACTORS = (1e6, 1e8, 1e8, 1e8, 1e8), 1e-5, (0.1, 1.0, 10.0, 100.0)
SETTLED_FORCE = 1e-11  # change of forces, or torque of inertia, that counts as none, in units of the mean friction
# A contact clearly slips if its slip is APART times the fastest creep. If not, it creeps if its slip falls by the
# factor CREEPS from minimum to minimum, or is below NO_SLIP, in units of the largest imposed slip.
APART, CREEPS, NO_SLIP = 30.0, 0.1, 1e-24
# Springs up to CONTACTS_AWAY contacts from a contact with a slip below SLOW have STIFFER_BESIDE times the stiffness mu
# F_n / slip; slips below SLOWEST count as SLOWEST.
SLOW, STIFFER_BESIDE, SLOWEST, CONTACTS_AWAY = 1e-9, 1e2, 1e-16, 3
# The force of a resting contact has settled if its last change is below CHANGE_OVER_ROOM times the difference of its
# friction and its force, or below SETTLED_CHANGE in units of the mean friction. Up to MOST_LOCAL minima with springs
# that are stiffer beside slow contacts are found until all have.
CHANGE_OVER_ROOM, SETTLED_CHANGE, MOST_LOCAL = 1e-2, 1e-9, 8
ROUNDED_EXCESS = 1e-12  # share of a friction limit by which rounding may exceed it
LEAST_SLIP = 1e-13  # slip, in units of the largest imposed one, that is more than rounding
WORSE_POWER = 1e-10  # relative growth of the power that settling may cause
SMALL_SPINS = 1e-8  # scale of the spins that are still to be found when the states are settled


@np.errstate(all="ignore")
def settled_by_springs(
    point: Iterate, matrix: NewtonMatrix
) -> tuple[Pair, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Find which contacts slip at the end of a central path by the method of multipliers: each contact gets a stiff
    spring whose force friction limits, and the minimum with these springs is found repeatedly, each time from the
    forces of the minimum before.

    point : the end of the central path, with n contacts of d tangents.
    matrix : Newton matrix of its contacts.

    Returns four things: spins (unknowns,), sums of two doubles; minus the contact forces (d, n); a mask (n,) of the
    contacts that slip; and a mask (n,) of the undecided ones, which slip by more than rounding but bear less than the
    friction limit. If the method fails the masks are None, and spins and forces are those of the path.
    """
    best, several = _Multipliers(point, matrix), may_have_several_minima(point.friction, np.zeros(0, dtype=bool))
    begins_softly = several or best.unit.max(initial=1.0) > MOST_CONTRAST * best.unit.min(initial=1.0)
    for series in FIRST_STIFFNESSES[1:] if begins_softly else FIRST_STIFFNESSES:
        best = _Multipliers(point, matrix)
        if all(best.is_settled or best.minimise(stiffness * best.unit) for stiffness in series):
            if not several:
                best.minimise_for_slow()
            break
    else:
        best.minimise_with_inertia()
    if _power(point, exactly(point.spins)) * (1 + WORSE_POWER) < _power(point, best.spins):
        # with many minima of the same power, springs can lead away from all of them: the path itself is returned
        with suppress(NotPositiveDefinite):
            point = balance(point, matrix)
        return exactly(point.spins), point.whole_dual, None, None
    return best.spins, best.within_friction, best.slipping, best.undecided


class _Multipliers:
    """The spins and forces of one sample, as the method of multipliers improves them. A *minimum* here is the state of
    balance with springs at the contacts, whose forces friction limits.

    point : the end of the central path, with n contacts of d tangents.
    spins : (unknowns,), sums of two doubles, as the slowest slips are below the rounding of spins.
    held : (d, n), forces of friction, with which the springs of the next minimum begin.
    whole_dual : (d, n), minus the contact forces.
    slipping : (n,) mask of the contacts that slip; None before the first minimum.
    undecided : (n,) mask of the contacts that slip by more than rounding but bear less than the friction limit; None
        before the first minimum.
    change : largest change of a force from the minimum before, or largest torque of the inertia if that is more.
    unit : (n,), unit of the stiffnesses: friction, or 1 where a contact has none.
    slip : (n,), slips at the last minimum.
    are_apart : True if it is clear of every contact whether it slips or creeps.
    forces_change : True if the force of some resting contact has not settled (CHANGE_OVER_ROOM, SETTLED_CHANGE).
    """

    slipping: np.ndarray | None = None
    undecided: np.ndarray | None = None

    def __init__(self, point: Iterate, matrix: NewtonMatrix) -> None:
        """Begin at the end of a central path.

        point : that end.
        matrix : Newton matrix of its contacts.
        """
        self.point, self._matrix, self.change = point, matrix, np.inf
        self.are_apart = self.forces_change = False
        self.spins, self.held, self.whole_dual = exactly(point.spins), -point.dual, point.whole_dual
        self.unit = np.where(point.friction > 0, point.friction, 1.0)

    @property
    def within_friction(self) -> np.ndarray:
        """(d, n), minus the contact forces, with friction reduced to its limit where it exceeds that by more than
        rounding. Otherwise all forces would have to be scaled down for the lower bound, which costs far more than the
        torques that this reduction leaves."""
        size, limit = length(self.held), self.point.friction
        beyond = size > limit * (1 + ROUNDED_EXCESS)
        return self.whole_dual + np.where(beyond, self.held * (1 - limit / size), 0.0)

    @property
    def is_settled(self) -> bool:
        """True if forces change no more and no contact is undecided."""
        return self.change < SETTLED_FORCE and self.undecided is not None and not self.undecided.any()

    def minimise(self, stiffness: np.ndarray, inertia: float = 0.0) -> bool:
        """Find the minimum with springs that begin with the forces `held`, and go on to it. Return True; or False, with
        nothing changed, if Newton's method does not find it.

        stiffness : (n,), stiffness of each spring.
        inertia : weight of an inertia whose torques, weight * change, draw the spins back to the present ones; in units
            of friction over spin.
        """
        # The unknown is the change of the spins, so that it has all digits; slips before it in twice the precision.
        contacts, point, rest = self.point.system, self.point, np.zeros(len(self.spins[0]))
        here = contacts.with_offset(contacts.to_all_digits(self.spins))
        stage = FrictionStage(here, self._matrix, 1.0, SMALL_SPINS, 1.0)
        with one_thread():
            friction = Friction(point.friction, stiffness, inertia, point.viscosity)
            end = stage.solve(friction, rest, self.held, rest)
        if end is None:
            return False
        # Go to the minimum; decide which contacts slip there, and of which resting ones the force still changes.
        change, slip = length(end.held - self.held), length(here.differences(end.spins))
        self.change = max(change.max(initial=0.0), inertia * np.abs(end.spins).max(initial=0.0))
        self.spins, self.held, self.whole_dual = add(self.spins, exactly(end.spins)), end.held, -end.force
        slipping = self._tell_apart(end.slips, slip, length(here.offset))
        room = point.friction - length(self.held)
        changes = ~slipping & (change > np.maximum(CHANGE_OVER_ROOM * room, SETTLED_CHANGE))
        self.forces_change = bool((changes & (point.friction > 0)).any())
        return True

    def _tell_apart(self, at_limit: np.ndarray, slip: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Return the mask (n,) of the contacts that slip, and set the fields `slipping`, `are_apart`, `undecided` and
        `slip`.

        Contacts whose springs are below the friction limit rest. Since springs stretch, these contacts slip a little
        all the same; they *creep*. A contact at its limit is in doubt if its slip is less than APART times the fastest
        creep. It rests if its slip is below NO_SLIP, or below CREEPS times that at the minimum before. If some contacts
        are still in doubt then, all contacts at their limit are taken to slip.

        at_limit : (n,) mask of the contacts whose springs are at their friction limit.
        slip, before : (n,), sizes of the slips now and at the minimum before.
        """
        creep = np.where(at_limit, 0.0, slip)
        doubtful = at_limit & (slip < APART * creep.max(initial=0.0)) & (self.point.friction > 0)
        rests = doubtful & ((slip < CREEPS * before) | (slip < NO_SLIP))
        self.are_apart = bool((rests == doubtful).all())
        slipping = at_limit & ~rests if self.are_apart else at_limit
        self.slipping, self.undecided, self.slip = slipping, creep >= LEAST_SLIP, slip
        return slipping

    def minimise_for_slow(self) -> None:
        """Go on to further minima until slow contacts and resting ones are distinguished (`are_apart`) and the forces
        of resting contacts have settled; then move these forces away from the friction limits.

        First all springs become stiffer (FOR_SLOW), until contacts are distinguished; then the springs beside slow
        contacts alone (:meth:`_stiffer_beside_slow`).
        """
        for stiffness in FOR_SLOW:
            if self.are_apart or not self.minimise(stiffness * self.unit):
                break
        for _ in range(MOST_LOCAL):
            if (self.are_apart and not self.forces_change) or not self.minimise(self._stiffer_beside_slow()):
                break
        if self.are_apart and self.slipping is not None:
            rests = ~self.slipping & (self.point.friction > 0)
            moved = moved_inside(self.point.system, self._matrix, self.point.friction, self.held, rests)
            self.whole_dual, self.held = self.whole_dual - (moved - self.held), moved

    def _stiffer_beside_slow(self) -> np.ndarray:
        """Return stiffnesses (n,) of springs that are stiffer than elsewhere at most CONTACTS_AWAY contacts from a slow
        contact, one with a slip below SLOW.

        Across a slow contact the force changes with the slip by mu F_n / slip, a large stiffness. Springs that are
        softer give way to it, and then forces change by nearly the same amount from minimum to minimum.
        """
        contacts, friction = self.point.system, self.point.friction
        assert self.slipping is not None
        slow = self.slipping & (self.slip < SLOW)
        resists = np.where(slow, friction / np.maximum(self.slip, SLOWEST), 0.0)
        ends, free = contacts.network.contact[:, contacts.numbers], np.any(contacts.moved >= 0, axis=1)
        # from the contacts to their free spheres, and on to all contacts of these
        for _ in range(CONTACTS_AWAY):
            stiffest = np.zeros(len(free))
            for end in ends:
                np.maximum.at(stiffest, end, resists)
            stiffest[~free] = 0.0
            resists = np.maximum(resists, stiffest[ends].max(axis=0))
        return np.maximum(FOR_SLOW[-1] * self.unit, STIFFER_BESIDE * resists)

    def minimise_with_inertia(self) -> None:
        """Go on to further minima with inertia, which makes spins unique where several minima have the same power,
        until forces settle or Newton's method fails with every weight of the inertia (INERTIA_FACTORS)."""
        inertia = FIRST_INERTIA
        for stiffness in WITH_INERTIA:
            if self.is_settled:
                break
            weights = (factor * inertia for factor in INERTIA_FACTORS)
            found = next((weight for weight in weights if self.minimise(stiffness * self.unit, weight)), None)
            if found is None:
                break
            inertia = found


def _power(point: Iterate, spins: Pair) -> float:
    """Return the power of given spins, or with viscosity the potential, in units of the mean friction and of the spins.
    Slips are computed in twice the precision.

    point : a point of the path, for the friction and viscosity of its contacts.
    spins : (unknowns,), sums of two doubles.
    """
    slip = length(point.system.to_all_digits(spins))
    damped = 0.0 if point.viscosity is None else float((point.viscosity * slip**2).sum()) / 2
    return float((point.friction * slip).sum()) + damped
