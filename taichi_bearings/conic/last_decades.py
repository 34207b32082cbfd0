"""Follows the last decades of the central path, until it is clear of every contact whether it slips or sticks.

On the central path slip times friction margin, the product, is about the same for all contacts. The path in doubles
ends near products of 1e-14: margins fall below the rounding of forces, and slips below that of spins. Two changes let
the product fall by another ten decades. Contacts with large slips leave their cones and obey the law of friction
exactly; they are called *smooth*. And spins are sums of two doubles, so that slips have all their digits, and sum to 0
round every loop of contacts; otherwise contacts at rest would seem to slip by the rounding.

A contact that slips keeps its slip, and its margin falls in proportion to the product; a contact that sticks keeps its
margin, and its slip falls. So the ratio slip / margin changes like 1 / product or like the product, and shows which is
the case: the contact is *decided*. At a contact that bears all its friction and does not slip ("at its limit") both
fall like the root of the product, and the ratio stays.
"""

from dataclasses import replace

import numpy as np

from taichi_bearings.conic.central_path import newton_step
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import MOST_NEWTON_STEPS, NewtonMatrix
from taichi_bearings.numerics.double_double import Pair, exactly

# A contact is decided if slip / margin changes faster than the product to this power: halfway between 0 for contacts at
# their limit, and 1 for contacts that slip or stick.
DECIDED_EXPONENT = 0.5
# A contact is at its limit if its margin falls like a power of the product that differs from 1/2 by less than the first
# number (it is 1/4 where the margin is as large as a component of a force across its limit; 16^3 spheres with two
# frictions, seed 0), or if it rests and its margin is below the second one.
AT_LIMIT_EXPONENTS, LOST_MARGIN = 0.375, 1e-11
VANISHING_PRODUCT = 1e-20  # below this product the margin shows which contacts are at their limit
SLIPPING_RATIO = 1e4  # ratio slip / margin above which a contact surely slips
# A contact surely sticks if its ratio slip / margin is below the first number and falls with the product, and its
# margin is above the second.
STICKING_RATIO, STICKING_MARGIN = 1e-5, 1e-5
LEAST_PRODUCT = 1e-25  # product at which double precision ends
# a step has stalled by rounding if more than this share of the product is left; the path ends after so many in a row
STALLED_SHARE, MOST_STALLED_STEPS = 0.6, 10
JUDGED_TORQUE = 1e-6  # torque over the mean friction, up to which a point can be judged
EPS = np.finfo(np.float64).eps


class LastDecades:
    """A point of the central path, whose spins are sums of two doubles; it is moved along the path to its end.

    Letters: n contacts. The margin of a contact is the share of its friction that it has left.

    point : the iterate; its field `spins` holds only the low parts of the spins.
    spins : (unknowns,), the whole spins as (high, low).
    sticking : (n,) mask of contacts that surely stick, once :meth:`decide` has ended.
    at_limit : (n,) mask of contacts that bear all their friction and yet do not slip, once :meth:`decide` has ended.
    """

    def __init__(self, iterate: Iterate, spins: Pair, difference: np.ndarray, matrix: NewtonMatrix) -> None:
        """Begin at a point of the path, given in doubles and, for spins and slips, more precisely.

        iterate : the point in doubles; not changed.
        spins : (unknowns,), the spins there as sums of two doubles. Steps will change their low parts alone.
        difference : (d, n), the slips that follow from these spins, of n contacts with up to d components.
        matrix : Newton matrix of the system of contacts.
        """
        self._large, self._matrix = spins[0], matrix
        # The bounds keep their distance above the slips.
        bound = iterate.bound - length(iterate.difference) + length(difference)
        self.point = replace(iterate, spins=spins[1], bound=bound, difference=difference)
        self.sticking = self.at_limit = np.zeros(len(iterate.friction), dtype=bool)
        # One step before: slip over margin (n,), and the product; 0 and infinity if no such point is known.
        self._ratios, self._product = np.zeros(len(iterate.friction)), np.inf
        self._raised = 0  # index in DIAGONAL_SHIFTS of the addition to the diagonal in the last step

    @classmethod
    def after(cls, iterate: Iterate, before: Iterate | None, matrix: NewtonMatrix) -> "LastDecades":
        """Return the path that goes on, with spins as sums of two doubles, from a point of the path in doubles.

        iterate : this point.
        before : the point one Newton step before, None if unknown.
        matrix : Newton matrix of the system of contacts.
        """
        spins = exactly(iterate.spins)
        path = cls(iterate, spins, iterate.system.precise_differences(spins), matrix)
        if before is not None:
            path._ratios, path._product = before.slip_over_margin, before.complementarity
        return path

    def over(self, tied: Contraction) -> "LastDecades":
        """Return this point of the path for a smaller system, in which some contacts are tied.

        tied : the system of the contacts that are left.
        """
        spins, point = tied.contracted(self.spins), self.point
        friction, bound, difference, dual = (
            values[..., tied.kept] for values in (point.friction, point.bound, point.difference, point.dual)
        )
        smooth, viscosity = (None if v is None else v[tied.kept] for v in (point.smooth, point.viscosity))
        left = Iterate(tied.system, spins[1], friction, bound, difference, dual, smooth, viscosity)
        of_all = self._matrix
        matrix = NewtonMatrix(tied.system, tied.order, of_all.memory, shared_passes=of_all.shared_passes)
        return LastDecades(left, spins, tied.differences(spins), matrix)

    @property
    def spins(self) -> Pair:
        """The spins (unknowns,) of the point that was reached, as sums of two doubles."""
        return self._large, self.point.spins

    def decide(self, doubtful: int = 0, to_the_end: bool = False) -> np.ndarray | None:
        """Go on along the path until it is decided which of the n contacts slip, by the rule at the head of this file.
        Return a mask (n,) of these; None if that fails. The next call goes on by at least one step.

        Sets `sticking`, and, if the path has come to the end of double precision, `at_limit`.

        doubtful : number of contacts that may be left undecided.
        to_the_end : True to go on until double precision ends, even if all contacts are decided.
        """
        before, last, stalled = self._ratios, self._product, 0  # ratios and product one step before
        fell = np.ones(len(before), dtype=bool)  # (n,) mask: the ratio fell in the step before that, or is not known
        late: tuple[np.ndarray, float] | None = None  # margins and product at the first point below VANISHING_PRODUCT
        for _ in range(MOST_NEWTON_STEPS):
            ratios, product = self.point.slip_over_margin, self.point.complementarity
            if not product > 0:  # it underflows where coefficients differ by thirty decades
                return None
            # Exponent with which slip / margin rises (or falls, below 0) with 1 / product over the last step.
            power = np.log(ratios / before) / abs(np.log(product / last))
            decided = (np.abs(power) > DECIDED_EXPONENT) | (ratios > SLIPPING_RATIO)
            # The path ends if enough is decided and torques balance, or if rounding has stalled it.
            enough = product < LEAST_PRODUCT or (not to_the_end and (~decided).sum() <= doubtful)
            stalled = stalled + 1 if product > STALLED_SHARE * last else 0
            if (enough and self.point.unbalanced < JUDGED_TORQUE) or stalled == MOST_STALLED_STEPS:
                # Contacts surely stick if their ratio is small, and, unless the product has vanished, fell fast twice.
                falls = (fell & (power < -DECIDED_EXPONENT)) | (product <= VANISHING_PRODUCT)
                self.sticking = falls & (ratios < STICKING_RATIO) & (self.point.margin > STICKING_MARGIN)
                self._ratios, self._product = np.zeros_like(before), np.inf
                # Contacts slip with a large ratio; before the end of double precision, also with one that rises.
                if product >= LEAST_PRODUCT or late is None:
                    return (ratios > 1) | (ratios > before)
                self.at_limit = self._seem_at_limit(ratios, product, *late)
                return (ratios > 1) & ~self.at_limit
            if late is None and product < VANISHING_PRODUCT:
                late = self.point.margin, product
            self._step(product, rises=power > DECIDED_EXPONENT)
            before, last, fell = ratios, product, ~(power > -DECIDED_EXPONENT)
        return None

    def _seem_at_limit(
        self, ratios: np.ndarray, product: float, late_margin: np.ndarray, late_product: float
    ) -> np.ndarray:
        """Return a mask (n,) of the contacts at their limit, judged where double precision ends. While the product
        falls, a margin falls like it at contacts that slip, and stays at those that stick; at the limit it falls like
        the root, or the fourth root, of the product.

        ratios, product : slip / margin (n,), and the product, at this point.
        late_margin, late_product : margins (n,), and the product, at an earlier point.
        """
        margin = self.point.margin
        power = np.log(margin / late_margin) / np.log(product / late_product)
        full = (np.abs(power - 0.5) < AT_LIMIT_EXPONENTS) | ((ratios < 1) & (margin < LOST_MARGIN))
        found: np.ndarray = ~self._smooth & full
        return found

    def _step(self, product: float, rises: np.ndarray) -> None:
        """Make one Newton step. Before it contacts leave their cones that are known to slip, and slip so far that
        rounding hides their distance from the cone; those that have left stay outside as long as they slip so far.

        product : the product at this point.
        rises : (n,) mask of the contacts that are decided to slip, as slip / margin rose in the last step.
        """
        far = length(self.point.difference) > max(product / (1000 * EPS), 100 * np.sqrt(product))
        self.point = newton_step(self.point.let_slip(far & (rises | self._smooth)), self._matrix, self._raised)
        self._raised = self._matrix.raised  # the next matrix, with larger ratios of stiffnesses, needs no less

    @property
    def _smooth(self) -> np.ndarray:
        """(n,) mask of the contacts that have left their cones and obey the law of friction exactly."""
        none = np.zeros(len(self.point.friction), dtype=bool)
        return none if self.point.smooth is None else self.point.smooth
