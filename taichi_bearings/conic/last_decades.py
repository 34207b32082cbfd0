"""The last decades of the central path, on to where every contact either slips or sticks.

On the central path slip times friction margin is the same for all contacts. The path itself ends near products of
1e-14: margins fall below what forces are rounded to, and slips below what spins are. Here contacts that slip far leave
their cones and obey the law of friction exactly, and spins are sums of two doubles. Slips then are known to all their
digits, and add up to nothing round every loop of contacts: where they do not, contacts at rest seem to slip by what is
missing. So the product can be brought down by another ten decades, until of every contact either slip or margin falls
with it.
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.central_path import newton_step
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import MOST_NEWTON_STEPS, NewtonMatrix
from taichi_bearings.numerics.double_double import Pair

DECIDED_EXPONENT = 0.5  # power of the product with which slip or margin of a contact falls that is decided
# margin below which a contact can be at its limit (12^3 seeds 110 and 350), and below which one at rest surely is
LEAST_MARGIN_AT_LIMIT, LOST_MARGIN = 1e-6, 1e-11
VANISHING_PRODUCT = 1e-20  # product from which on contacts are judged whose slip and margin both vanish
SLIPPING_RATIO = 1e4  # ratio of slip and margin from which a contact surely slips
LEAST_PRODUCT = 1e-25  # product at which double precision ends
JUDGED_TORQUE = 1e-6  # torques, of the mean friction, up to which a point can be judged
EPS = np.finfo(np.float64).eps


@dataclass(frozen=True)
class PathEnd:
    """Spins (unknowns,), and dual (d, n), minus the forces. Masks (n,): slipping, contacts that slip or come to slip;
    critical, those whose slip and margin both vanish, like the root of the product, and which do not slip."""

    spins: Pair
    dual: np.ndarray
    slipping: np.ndarray
    critical: np.ndarray


def end_of_path(iterate: Iterate, before: Iterate | None, matrix: NewtonMatrix, ties: bool) -> PathEnd | None:
    """Go on until either slip or margin falls with the product everywhere, or, with `ties` anyhow, until double
    precision ends; None if that fails.

    iterate : where to begin. before : where it was a step before, if that is known. matrix : of its system. ties : at
    which both may vanish.
    """
    point, none = iterate, np.zeros(len(iterate.friction), dtype=bool)
    difference = iterate.system.differences(iterate.spins)  # to more digits than its own
    bound = point.bound - length(point.difference) + length(difference)
    point = replace(point, spins=np.zeros_like(point.spins), bound=bound, difference=difference)  # what the spins gain
    earlier, last = (0.0 * bound, np.inf) if before is None else (before.slip_over_margin, before.complementarity)
    late: tuple[np.ndarray, float] | None = None  # ratios and product where contacts at their limit begin to tell
    for _ in range(MOST_NEWTON_STEPS):
        ratios, product = point.slip_over_margin, point.complementarity
        smooth = none if point.smooth is None else point.smooth
        if not product > 0:  # it underflows where coefficients differ by thirty decades
            return None
        power = np.log(ratios / earlier) / abs(np.log(product / last))
        decided = (np.abs(power) > DECIDED_EXPONENT) | (ratios > SLIPPING_RATIO)
        ended = product < LEAST_PRODUCT
        if (ended or (decided.all() and not ties)) and point.unbalanced < JUDGED_TORQUE:
            slipping, critical = (ratios > 1) | (ratios > earlier), none
            if ended and late is not None:
                fall = abs(np.log(product / late[1]))  # of the product, with which steady ratios have not changed
                steady = np.abs(np.log(ratios / late[0])) < DECIDED_EXPONENT * fall
                lost = (steady & (point.margin < LEAST_MARGIN_AT_LIMIT)) | ((ratios < 1) & (point.margin < LOST_MARGIN))
                critical = ~smooth & lost
                slipping = (ratios > 1) & ~critical
            return PathEnd((iterate.spins, point.spins), point.dual, slipping, critical)
        if late is None and product < VANISHING_PRODUCT:
            late = ratios, product
        # beyond this slip the distance from the cone is lost in rounding; never near the slips in doubt
        far = length(point.difference) > max(product / (1000 * EPS), 100 * np.sqrt(product))
        point = newton_step(point.let_slip(far & ((power > DECIDED_EXPONENT) | smooth)), matrix)
        earlier, last = ratios, product
    return None
