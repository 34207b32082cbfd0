"""The last decades of the central path, on to where every contact either slips or sticks.

On the central path slip times friction margin is the same for all contacts. The path itself ends near products of
1e-14: margins fall below what forces are rounded to, and slips below what spins are. Here contacts that slip far leave
their cones and obey the law of friction exactly, and spins are sums of two doubles. Slips then are known to all their
digits, and add up to nothing round every loop of contacts: where they do not, contacts at rest seem to slip by what is
missing. So the product can be brought down by another ten decades, until of every contact either slip or margin falls
with it. Long before, few contacts are in doubt; with those tied that surely stick a step takes a third of the time.
"""

from dataclasses import replace

import numpy as np

from taichi_bearings.conic.central_path import newton_step
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import MOST_NEWTON_STEPS, NewtonMatrix
from taichi_bearings.numerics.double_double import Pair, exactly

DECIDED_EXPONENT = 0.5  # power of the product with which slip or margin of a contact falls that is decided
# margin below which a contact can be at its limit (12^3 seeds 110 and 350), and below which one at rest surely is
LEAST_MARGIN_AT_LIMIT, LOST_MARGIN = 1e-6, 1e-11
VANISHING_PRODUCT = 1e-20  # product from which on contacts are judged whose slip and margin both vanish
SLIPPING_RATIO = 1e4  # ratio of slip and margin from which a contact surely slips
# and below which one surely sticks, if it falls with the product; and its least margin
STICKING_RATIO, STICKING_MARGIN = 1e-5, 1e-5
LEAST_PRODUCT = 1e-25  # product at which double precision ends
# share of the product that a step leaves if rounding stops it, and such steps in a row
STALLED_SHARE, MOST_STALLED_STEPS = 0.6, 10
JUDGED_TORQUE = 1e-6  # torques, of the mean friction, up to which a point can be judged
EPS = np.finfo(np.float64).eps


class LastDecades:
    """A point of the path, its spins the small parts of sums of two doubles."""

    def __init__(self, iterate: Iterate, spins: Pair, difference: np.ndarray, matrix: NewtonMatrix) -> None:
        """Begin at the point `iterate`, which is not changed, with these spins and differences more precise than its
        own. matrix : of its system."""
        self._large, self._matrix = spins[0], matrix
        bound = iterate.bound - length(iterate.difference) + length(difference)
        self.point = replace(iterate, spins=spins[1], bound=bound, difference=difference)
        self.sticking = self.at_limit = np.zeros(len(iterate.friction), dtype=bool)
        self._ratios, self._product = np.zeros(len(iterate.friction)), np.inf

    @classmethod
    def after(cls, iterate: Iterate, before: Iterate | None, matrix: NewtonMatrix) -> "LastDecades":
        """Begin where the central path ends. before : where it was a step before, if that is known."""
        path = cls(iterate, exactly(iterate.spins), iterate.system.differences(iterate.spins), matrix)
        if before is not None:
            path._ratios, path._product = before.slip_over_margin, before.complementarity
        return path

    def over(self, tied: Contraction) -> "LastDecades":
        """The same point of what is left of its system."""
        spins, point = tied.contracted(self.spins), self.point
        friction, bound, difference, dual = (
            values[..., tied.kept] for values in (point.friction, point.bound, point.difference, point.dual)
        )
        smooth, viscosity = (None if v is None else v[tied.kept] for v in (point.smooth, point.viscosity))
        left = Iterate(tied.system, spins[1], friction, bound, difference, dual, smooth, viscosity)
        matrix = NewtonMatrix(tied.system, tied.order, self._matrix.memory)
        return LastDecades(left, spins, tied.differences(spins), matrix)

    @property
    def spins(self) -> Pair:
        return self._large, self.point.spins

    def decide(self, doubtful: int = 0, to_the_end: bool = False) -> np.ndarray | None:
        """Go on until either slip or margin falls with the product everywhere, but for so many contacts, or until
        double precision ends; `to_the_end` anyhow: mask (n,), the contacts that slip, or come to slip; None if
        that fails.

        Contacts that surely stick then are the `sticking` ones, (n,) mask; where the path ends, contacts whose
        slip and margin both vanish, like the root of the product, are the `at_limit` ones, and do not slip. The next
        time it goes on from there by at least one step.
        """
        before, last, stalled, fell = self._ratios, self._product, 0, np.ones(len(self.point.friction), dtype=bool)
        late: tuple[np.ndarray, float] | None = None  # ratios and product where contacts at their limit begin to tell
        for _ in range(MOST_NEWTON_STEPS):
            ratios, product = self.point.slip_over_margin, self.point.complementarity
            if not product > 0:  # it underflows where coefficients differ by thirty decades
                return None
            stalled = stalled + 1 if product > STALLED_SHARE * last else 0
            power = np.log(ratios / before) / abs(np.log(product / last))
            decided = (np.abs(power) > DECIDED_EXPONENT) | (ratios > SLIPPING_RATIO)
            enough = product < LEAST_PRODUCT or (not to_the_end and (~decided).sum() <= doubtful)
            ended = enough and self.point.unbalanced < JUDGED_TORQUE
            if ended or stalled == MOST_STALLED_STEPS:
                falls = fell & (power < -DECIDED_EXPONENT) if product > VANISHING_PRODUCT else True
                self.sticking = falls & (ratios < STICKING_RATIO) & (self.point.margin > STICKING_MARGIN)
                self._ratios, self._product = np.zeros_like(before), np.inf
                if product >= LEAST_PRODUCT or late is None:
                    return (ratios > 1) | (ratios > before)
                fall = abs(np.log(product / late[1]))  # of the product, with which steady ratios have not changed
                steady = np.abs(np.log(ratios / late[0])) < DECIDED_EXPONENT * fall
                margin, rests = self.point.margin, ratios < 1
                full = (steady & (margin < LEAST_MARGIN_AT_LIMIT)) | (rests & (margin < LOST_MARGIN))
                self.at_limit = ~self._smooth & full
                return (ratios > 1) & ~self.at_limit
            if late is None and product < VANISHING_PRODUCT:
                late = ratios, product
            # beyond this slip the distance from the cone is lost in rounding; never near the slips in doubt
            far = length(self.point.difference) > max(product / (1000 * EPS), 100 * np.sqrt(product))
            slips = far & ((power > DECIDED_EXPONENT) | self._smooth)
            self.point = newton_step(self.point.let_slip(slips), self._matrix)
            before, last, fell = ratios, product, ~(power > -DECIDED_EXPONENT)
        return None

    @property
    def _smooth(self) -> np.ndarray:
        none = np.zeros(len(self.point.friction), dtype=bool)
        return none if self.point.smooth is None else self.point.smooth
