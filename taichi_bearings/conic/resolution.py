"""The exact minimum, from a point near the end of the central path: which contacts slip, to the last decade of slip.

On the central path slip times friction margin is the same for all contacts, so a slip of 1e-9 can be seen only where
margins of 1e-9 can, and double precision ends before. Here

1. contacts that seem to stick are tied. Mostly all others slip. If more of them come to rest, or the tied ones cannot
   bear what is left to them, the path goes on until every contact is decided (last_decades.py);
2. with all slipless contacts tied the power is a smooth function, and Newton's method finds its minimum, in the end in
   twice the precision (polish.py);
3. the tied contacts have to bear what the slipping ones leave to them (slipless_forces.py). If they can, the contact
   states are those of a minimum; whether that is proven is for the verifier to say;
4. if they cannot, the path goes on once more. Where it ends, all slipless contacts are asked at once. Contacts at the
   limit of their friction that need not slip are settled, though not proven.
"""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.central_path import friction_stiffness
from taichi_bearings.conic.cone import inner
from taichi_bearings.conic.contraction import Contraction, Contradiction
from taichi_bearings.conic.grouped import Arrays, each, power, where
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.last_decades import LastDecades
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.polish import polished
from taichi_bearings.conic.slipless_forces import bear, nearly_borne
from taichi_bearings.numerics.cholesky import NotPositiveDefinite, Part
from taichi_bearings.numerics.double_double import Pair, exactly

SAME, NEAR = 1e-12, 1e-6  # how far the power may be above and below that of the path, relative
TRIALS = 3  # of Newton's method and proof along the last decades of the path
STEPS, BALANCED = 60, 1e-12  # steps of Newton's method, and torques, of the mean friction, that end it
ROUGHLY = 1e-4  # torques that will do if double precision ends before
NEWTON_TRIALS = 2  # of Newton's method, with contacts tied that come to rest
HALF, NEARLY_ALL = 0.5, 0.95  # of a slip, by which a step may change it; if the whole step would turn it round
COLLAPSED = 1e-2  # share of its first slip below which a contact comes to rest if the next step would turn it round
LOST = 1e-25  # slip that double precision cannot follow
NEGLIGIBLE = 1e-15  # slip of a motion from which on the contact states count as settled, though not as proven
FAINTEST, ROUGH = 1e-22, 1e-9  # smallest slip that needs no second look, known in twice the precision, and in one
HARDLY = 1e-14  # stiffness along a slip, of that across it, that keeps matrices regular
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Resolved:
    """spins (unknowns,); a group each: difference and dual (d, n), minus the forces, and slipping (n,).

    The differences are more precise than those of the spins, whose rounding can be a part of the smallest slips, unless
    `rest` (unknowns,), what is to be added to the spins, makes up for it. borne : slipless contacts bear their load.
    """

    spins: np.ndarray
    difference: Arrays
    dual: Arrays
    slipping: Arrays
    rest: np.ndarray | None = None
    borne: bool = False

    @property
    def sure(self) -> bool:
        """Can the states be proven? Slips at the level of rounding may be none, which is told from closer by."""
        faintest = ROUGH if self.rest is None else FAINTEST
        return self.borne and min(z.min(initial=np.inf) for z in self.difference.length()[self.slipping]) > faintest

    @property
    def whole_dual(self) -> Arrays:
        """Minus the force of every contact: that of friction alone, for nothing else is resolved."""
        return self.dual


def resolve(
    iterate: Iterate, tied: Arrays | None, parts: list[Part], matrix: NewtonMatrix, top: Pair
) -> Resolved | None:
    """Spins, forces and contact states at the minimum; None if they cannot be had in double precision.

    iterate : near the end of the central path; not changed. tied : (n,) mask a group, contacts that surely
    stick; None if that is not known.
    parts, matrix : of its system. top : (C,), imposed on the top, in twice the precision.
    """
    matrix.forget()
    with np.errstate(all="ignore"):  # what fails shows up as a number that is not finite and is discarded
        found = None if tied is None else _minimum(iterate, parts, exactly(iterate.spins), ~tied, top)
        settled = None if found is None else _nearly_borne(iterate, matrix, found, iterate.dual)
        if settled is None:
            with suppress(NotPositiveDefinite):
                settled = _followed(iterate, parts, matrix, top)
    if settled is None or not -NEAR < power(iterate.friction, settled.difference) / iterate.power - 1 < SAME:
        return None
    return settled


def _followed(iterate: Iterate, parts: list[Part], matrix: NewtonMatrix, top: Pair) -> Resolved | None:
    """The same by the last decades of the path: on and on, until tied contacts bear what the slipping ones leave."""
    path, found = LastDecades(iterate, matrix), None
    for _ in range(TRIALS):
        slipping = path.decide()
        if slipping is None:
            return None
        found = _minimum(iterate, parts, path.spins, slipping, top)
        settled = None if found is None else _nearly_borne(iterate, matrix, found, path.point.dual)
        if settled is not None:
            return settled
        if path.ended:
            break
    if found is None:
        return None
    borne = bear(iterate.system, parts, iterate.friction, found.dual, found.slipping)
    if borne.dual is not None:
        return replace(found, dual=borne.dual, borne=True)
    if borne.motion is None or gains(iterate, found, borne.motion):
        return None
    return replace(found, dual=iterate.dual)


def gains(iterate: Iterate, found: Resolved, motion: np.ndarray) -> bool:
    """Does the power still fall where the motion, (unknowns,), has led to slips of NEGLIGIBLE?"""
    change = iterate.system.change(motion)
    change = change * (NEGLIGIBLE / max(change.length().max(), TINY))
    there = found.difference + change
    return (iterate.friction * each(inner, there, change) / each(np.maximum, there.length(), TINY)).sum() < 0


def _nearly_borne(iterate: Iterate, matrix: NewtonMatrix, found: Resolved, near: Arrays) -> Resolved | None:
    """The same with forces of the slipless contacts, if they can have nearly those of which `near` is the dual."""
    near = where(found.slipping, found.dual, near)
    whole = nearly_borne(iterate.system, matrix, iterate.friction, near, found.slipping)
    matrix.forget()
    return None if whole is None else replace(found, dual=whole, borne=True)


def _minimum(whole: Iterate, parts: list[Part], spins: Pair, slipping: Arrays, top: Pair) -> Resolved | None:
    """The least power if just the contacts `slipping`, (n,) masks a group, slip, or those of them that do not come to
    rest.

    spins : where to begin.
    """
    with suppress(NotPositiveDefinite, Contradiction):
        for _ in range(NEWTON_TRIALS):
            trial = _Slipping(whole, parts, slipping)
            at_rest = trial.descend(spins)
            if at_rest is None:
                return trial.resolved(top)
            if not at_rest.any():
                break
            spins, slipping = trial.tied.expanded(trial.spins), slipping & ~trial.everywhere(at_rest)
    return None


class _Slipping:
    """The power of some contacts, (n,) masks a group, while all others are tied: a smooth function.

    spins, difference, dual : in the end, of the contacts that slip.
    """

    def __init__(self, whole: Iterate, parts: list[Part], slipping: Arrays) -> None:
        """parts : elimination tree over the unknowns of the whole system."""
        self.slipping, self.tied = slipping, Contraction(whole.system, parts, ~slipping)
        self.matrix = NewtonMatrix(self.tied.system, self.tied.parts)
        self.friction = whole.friction[self.tied.kept]

    def descend(self, spins: Pair) -> Arrays | None:
        """Newton's method; masks (n,) of contacts that come to rest if it fails, None at the minimum. At rest are those
        between spheres that others tie, or that the next step would turn round.
        """
        system, self.spins = self.tied.system, self.tied.contracted(spins)
        self.difference = self.tied.differences(self.spins)
        first = self.difference.length()
        if (first == 0).any():
            return first == 0
        for count in range(STEPS):
            torques = system.torques(self.dual)
            left = float(np.abs(torques).max(initial=0.0))
            if left < (BALANCED if count < STEPS - 1 else ROUGHLY):
                return None
            self.matrix.factorise(each(friction_stiffness, self.friction, self.difference, HARDLY))
            step = self.matrix.solve(torques)
            change, slip = system.change(step), self.difference.length()
            turned = each(inner, self.difference + change, self.difference) <= 0
            at_rest = turned & (slip < COLLAPSED * first)
            if at_rest.any():
                return at_rest
            along = min(1.0, 1 / max((change.length() / (where(turned, NEARLY_ALL, HALF) * slip)).max(), TINY))
            self.spins = self.spins[0], self.spins[1] + along * step
            self.difference = self.difference + along * change
        return self.difference.length() < LOST

    @property
    def dual(self) -> Arrays:
        return -self.friction * self.difference / self.difference.length()

    def resolved(self, top: Pair) -> Resolved:
        """The minimum, in twice the precision where that can be had."""
        high, low = self.tied.expanded(self.spins)
        spins, rest, difference, dual = high + low, None, self.difference, self.dual
        better = polished(self.tied, self.matrix, self.friction, self.spins, difference, top)
        if better is not None:
            (spins, rest), difference, dual = better
        return Resolved(spins, self.everywhere(difference), self.everywhere(dual), self.slipping, rest)

    def everywhere(self, values: Arrays) -> Arrays:
        """Values of slipping contacts with zeros for the others."""

        def among(slipping: np.ndarray, new: np.ndarray) -> np.ndarray:
            return np.zeros((*new.shape[:-1], len(slipping)), new.dtype)

        return each(among, self.slipping, values).placed(self.tied.kept, values)
