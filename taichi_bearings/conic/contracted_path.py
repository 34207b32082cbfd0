"""The central path over ever fewer contacts: those that surely stick are tied, those that surely slip obey their law.

On the central path slip times friction margin is the same for all contacts. What is left once most contacts are tied
(contraction.py) is small and has no huge stiffness. There the products of slip and margin of the contacts in doubt can
be brought down by another ten decades, until nobody is in doubt, as slipping ones leave their cones.
"""

import numpy as np

from taichi_bearings.conic.central_path import newton_step
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.grouped import Arrays, each
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import Part
from taichi_bearings.numerics.double_double import Pair

DECIDED = 1e4  # ratio of slip, in its unit, and margin from which a contact surely slips
CLEARLY = 0.7  # power of the product with which slip or margin of a contact falls that is decided
LEAST = 1e-25  # product at which double precision ends
STEPS = 80
STALLING, PATIENCE = 0.6, 10  # share of the product that a step leaves if rounding stops it, and such steps in a row
FAST = 1e3  # slip, in the unit of those in doubt, that is not in doubt
BALANCED = 1e-6  # torques, of the mean friction, up to which a point can be judged
EPS = np.finfo(np.float64).eps


class ContractedPath:
    """A point of the path over the contacts that are left, its spins the small parts of sums of two doubles.

    tied : what the contacts that are tied leave over. kept : the contacts left among those of the whole system, (n,)
    places a group.
    """

    def __init__(
        self, whole: Iterate, parts: list[Part], tied: Arrays, unit: float = 1.0, rest: np.ndarray | float = 0.0
    ) -> None:
        """Begin at the point `whole`, which is not changed; `parts` : elimination tree over its unknowns.

        tied : (n,) masks a group, contacts to tie. unit : of slip, in which those of the contacts in doubt are of order
        one. rest : what is to be added to the spins.
        """
        self.unit, self.tied = unit, Contraction(whole.system, parts, tied)
        self.kept, system = self.tied.kept, self.tied.system
        self.matrix = NewtonMatrix(system, self.tied.parts)
        self._base, beyond = self.tied.contracted((whole.spins, rest + np.zeros_like(whole.spins)))
        difference = self.tied.differences((self._base, beyond))
        bound = (whole.bound - whole.difference.length())[self.kept] + difference.length()
        self.point = Iterate(system, beyond, whole.friction[self.kept], bound, difference, whole.dual[self.kept])

    @property
    def spins(self) -> Pair:
        """Spins of the whole system."""
        return self.tied.expanded((self._base, self.point.spins))

    def decide(self) -> Arrays | None:
        """Follow the path until either slip or margin falls with the product everywhere, or as far as it goes: masks
        (n,) a group, the contacts left that slip, or come to slip; None if that fails.

        None is tied on the way: there the slip of a contact can be far below what it will be in the end.
        """
        before, last, stalled = each(np.zeros_like, self.point.friction), np.inf, 0
        for _ in range(STEPS):
            ratios, product = self.point.slip_over_margin, self.point.complementarity
            stalled = stalled + 1 if product > STALLING * last else 0
            if self._decided(ratios, ratios / before, product / last) or stalled == PATIENCE:
                self.matrix.forget()
                return (ratios > self.unit) | (ratios > before)
            # beyond this slip the distance from the cone is lost in rounding; never near the slips in doubt
            point = self.point.let_slip(min(max(product / (1000 * EPS), 100 * np.sqrt(product)), FAST * self.unit))
            self.point, before, last = newton_step(point, self.matrix), ratios, product
        return None

    def _decided(self, ratios: Arrays, change: Arrays, fall: float) -> bool:
        """ratios : slip over margin of the contacts that are left. change : by what factor they differ from those of
        the step before, in which the product fell as told."""
        if not self.point.unbalanced < BALANCED:
            return False
        clearly = each(np.abs, each(np.log, change)) > CLEARLY * abs(np.log(fall))
        surely = (ratios == 0) | (ratios > DECIDED * self.unit)  # of spheres that others tie, or far from sticking
        return self.point.complementarity < LEAST or (clearly | surely).all()
