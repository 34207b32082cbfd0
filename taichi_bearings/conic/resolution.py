"""The exact minimum, from a point near the end of the central path: which contacts slip, to the last decade of slip.

On the central path slip times friction margin is the same for all contacts, so a slip of 1e-9 can be seen only where
margins of 1e-9 can, and double precision ends before. Here

1. contacts that seem to stick are tied. Mostly all others slip. If Newton's method brings some of them to rest, or the
   tied ones cannot bear what is left to them, just those far from slipping are tied, and the path goes on in the
   unknowns that are left, until every contact is decided (contracted_path.py);
2. with all slipless contacts tied the power is a smooth function, and Newton's method finds its minimum, in the end in
   twice the precision (polish.py);
3. the tied contacts have to bear what the slipping ones leave to them (slipless_forces.py). If they can, the contact
   states are those of a minimum; whether that is proven is for the verifier to say;
4. if they cannot, some were tied wrongly: a contact that slips by 1e-12 cannot be told from one that holds until its
   neighbours are. Then a motion is known that lowers the power. It is followed to the least power on its way, and all
   begins anew from there with the contacts that move in it free, and slips in units of theirs.
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.central_path import friction_stiffness
from taichi_bearings.conic.cone import inner
from taichi_bearings.conic.contracted_path import ContractedPath
from taichi_bearings.conic.contraction import Contraction, Contradiction
from taichi_bearings.conic.grouped import Arrays, each, power, where
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.motion import Motion, largest_parts
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.polish import polished
from taichi_bearings.conic.slipless_forces import bear, nearly_borne
from taichi_bearings.numerics.cholesky import NotPositiveDefinite, Part
from taichi_bearings.numerics.double_double import Pair

SAME, NEAR = 1e-12, 1e-6  # how far the power may be above and below that of the path, relative
TRIALS = 40  # rounds of Newton's method and proof
STEPS, BALANCED = 60, 1e-12  # steps of Newton's method, and torques, of the mean friction, that end it
ROUGHLY = 1e-4  # torques that will do if double precision ends before
NEWTON_TRIALS, FEW = 30, 2  # of Newton's method, with contacts tied that come to rest; where none is expected to
HALF, NEARLY_ALL = 0.5, 0.95  # of a slip, by which a step may change it; if the whole step would turn it round
COLLAPSED = 1e-2  # share of its first slip below which a contact comes to rest if the next step would turn it round
LOST = 1e-25  # slip that double precision cannot follow: of a contact if Newton's method fails, or of a whole motion
NEGLIGIBLE = 1e-15  # slip of a motion from which on the contact states count as settled, though not as proven
FAINTEST, ROUGH = 1e-17, 1e-9  # smallest slip that needs no second look, known in twice the precision, and in one
SURELY = 0.6  # share of its friction that a contact has left which is tied where the path has to go on
START = 1.0  # product of slip and margin from which the contacts of a motion are followed, in units of their slip
SHARE = 1e-3  # of the largest slip of a motion: what slips less is left for later
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


def resolve(iterate: Iterate, tied: Arrays, parts: list[Part], matrix: NewtonMatrix, top: Pair) -> Resolved | None:
    """Spins, forces and contact states at the minimum; None if they cannot be had in double precision.

    iterate : near the end of the central path; not changed. tied : (n,) mask a group, contacts that surely stick.
    parts, matrix : of its system. top : (C,), imposed on the top, in twice the precision.
    """
    settled = None
    matrix.forget()
    with np.errstate(all="ignore"):  # what fails shows up as a number that is not finite and is discarded
        try:
            found = _minimum(iterate, parts, ContractedPath(iterate, parts, tied), None, top, FEW)
            settled = None if found is None else _nearly_borne(iterate, matrix, found, iterate.dual)
            if settled is None:
                settled = _followed(iterate, tied, parts, matrix, top)
        except (NotPositiveDefinite, Contradiction):
            pass
    if settled is None or not -NEAR < power(iterate.friction, settled.difference) / iterate.power - 1 < SAME:
        return None
    return settled


def _followed(iterate: Iterate, tied: Arrays, parts: list[Part], matrix: NewtonMatrix, top: Pair) -> Resolved | None:
    """The same by the path, which goes on with just those contacts tied that are far from slipping."""
    settled, near = None, iterate.dual
    margin = 1 - iterate.dual.length() / iterate.friction
    path = ContractedPath(iterate, parts, tied & (margin > SURELY))
    for _ in range(TRIALS):
        slipping = path.decide()
        found = None if slipping is None else _minimum(iterate, parts, path, slipping, top, NEWTON_TRIALS)
        if found is None:
            break
        near = near.placed(path.kept, path.point.dual)
        whole = _nearly_borne(iterate, matrix, found, near)
        if whole is not None:
            return whole
        borne = bear(iterate.system, parts, iterate.friction, found.dual, found.slipping)
        if borne.dual is not None:
            return replace(found, dual=borne.dual, borne=True)
        if borne.motion is None:
            break
        motion, unit = largest_parts(borne.motion, iterate.system, iterate.friction, found.difference, SHARE)
        settled = replace(found, dual=iterate.dual) if unit < NEGLIGIBLE else None
        if unit < LOST:
            break
        path = _freed(iterate, parts, found, motion, unit)
    return settled


def _nearly_borne(iterate: Iterate, matrix: NewtonMatrix, found: Resolved, near: Arrays) -> Resolved | None:
    """The same with forces of the slipless contacts, if they can have nearly those of which `near` is the dual."""
    near = where(found.slipping, found.dual, near)
    whole = nearly_borne(iterate.system, matrix, iterate.friction, near, found.slipping)
    matrix.forget()
    return None if whole is None else replace(found, dual=whole, borne=True)


def _minimum(
    whole: Iterate, parts: list[Part], path: ContractedPath, left: Arrays | None, top: Pair, trials: int
) -> Resolved | None:
    """The least power if just the contacts `left`, (n,) masks over those of the path, slip; None stands for all.

    trials : of Newton's method, each with those tied that have come to rest in the one before.
    """
    slipping, spins = each(np.zeros_like, whole.friction, bool), path.spins
    slipping = slipping.placed(path.kept, each(np.ones_like, path.kept, bool) if left is None else left)
    trial = _Slipping(whole, slipping, path.tied, path.matrix) if left is None else None
    for _ in range(trials):
        trial = trial or _Slipping.of(whole, parts, slipping)
        at_rest = trial.descend(spins)
        if at_rest is None:
            return trial.resolved(top)
        if not at_rest.any():
            return None
        spins = trial.tied.expanded(trial.spins)
        slipping, trial = slipping & ~trial.everywhere(at_rest), None
    return None


class _Slipping:
    """The power of some contacts, (n,) masks a group, while all others are tied: a smooth function.

    spins, difference, dual : in the end, of the contacts that slip.
    """

    def __init__(self, whole: Iterate, slipping: Arrays, tied: Contraction, matrix: NewtonMatrix) -> None:
        """tied : the system without those that do not slip. matrix : of it."""
        self.slipping, self.tied, self.matrix = slipping, tied, matrix
        self.friction = whole.friction[tied.kept]

    @classmethod
    def of(cls, whole: Iterate, parts: list[Part], slipping: Arrays) -> "_Slipping":
        """parts : elimination tree over the unknowns of the whole system."""
        tied = Contraction(whole.system, parts, ~slipping)
        return cls(whole, slipping, tied, NewtonMatrix(tied.system, tied.parts))

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


def _freed(whole: Iterate, parts: list[Part], found: Resolved, motion: Motion, unit: float) -> ContractedPath:
    """A path that begins at the end of the motion, its contacts free. unit : the largest slip among them."""
    free = found.slipping | motion.slipping
    difference = where(free, found.difference + whole.system.change(motion.spins), 0.0)
    point = Iterate.near(whole.system, found.spins, whole.friction, difference, START * unit)
    return ContractedPath(point, parts, ~free, unit, motion.spins + (0.0 if found.rest is None else found.rest))
