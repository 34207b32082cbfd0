"""The last decades of the central path, on to where every contact either slips or sticks.

On the central path slip times friction margin is the same for all contacts. The path itself ends near products of
1e-14: margins fall below what forces are rounded to, and slips below what spins are. Here contacts that slip far leave
their cones and obey the law of friction exactly, and spins are sums of two doubles. Slips then are known to all their
digits, and add up to nothing round every loop of contacts: where they do not, contacts at rest seem to slip by what is
missing. So the product can be brought down by another ten decades, until of every contact either slip or margin falls
with it.
"""

from dataclasses import replace

import numpy as np

from taichi_bearings.conic.central_path import newton_step
from taichi_bearings.conic.grouped import Arrays, each
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.double_double import Pair

CLEARLY = 0.5  # power of the product with which slip or margin of a contact falls that is decided
DECIDED = 1e4  # ratio of slip and margin from which a contact surely slips
LEAST = 1e-25  # product at which double precision ends
STEPS = 80
STALLING, PATIENCE = 0.6, 10  # share of the product that a step leaves if rounding stops it, and such steps in a row
BALANCED = 1e-6  # torques, of the mean friction, up to which a point can be judged
EPS = np.finfo(np.float64).eps


class LastDecades:
    """A point of the path, its spins the small parts of sums of two doubles."""

    def __init__(self, iterate: Iterate, matrix: NewtonMatrix) -> None:
        """Begin at the point `iterate`, which is not changed. matrix : of its system."""
        self._large, self._matrix = iterate.spins, matrix
        difference = iterate.system.differences(iterate.spins)
        bound = iterate.bound - iterate.difference.length() + difference.length()
        self.point = replace(iterate, spins=np.zeros_like(iterate.spins), bound=bound, difference=difference)

    @property
    def spins(self) -> Pair:
        return self._large, self.point.spins

    @property
    def ended(self) -> bool:
        """Is the product so small that double precision ends?"""
        return self.point.complementarity < LEAST

    def decide(self) -> Arrays | None:
        """Go on, at least one step, until either slip or margin falls with the product everywhere, or as far as it
        goes: masks (n,) a group, the contacts that slip, or come to slip; None if that fails.
        """
        before, last, stalled = each(np.zeros_like, self.point.friction), np.inf, 0
        for _ in range(STEPS):
            ratios, product = self.point.slip_over_margin, self.point.complementarity
            stalled = stalled + 1 if product > STALLING * last else 0
            if self._decided(ratios, ratios / before, product / last) or stalled == PATIENCE:
                self._matrix.forget()
                return (ratios > 1) | (ratios > before)
            # beyond this slip the distance from the cone is lost in rounding; never near the slips in doubt
            point = self.point.let_slip(max(product / (1000 * EPS), 100 * np.sqrt(product)))
            self.point, before, last = newton_step(point, self._matrix), ratios, product
        return None

    def _decided(self, ratios: Arrays, change: Arrays, fall: float) -> bool:
        """ratios : slip over margin. change : what has become of each in the last step. fall : and of the product."""
        if not self.point.unbalanced < BALANCED:
            return False
        clearly = each(np.abs, each(np.log, change)) > CLEARLY * abs(np.log(fall))
        return self.ended or (clearly | (ratios > DECIDED)).all()
