"""The central path over ever fewer contacts: those that surely stick are tied, those that surely slip obey their law.

On the central path slip times friction margin is the same for all contacts. What is left once most contacts are tied
(contraction.py) is small and has no huge stiffness. There the products of slip and margin of the contacts in doubt can
be brought down by another ten decades, until nobody is in doubt, as slipping ones leave their cones.
"""

import numpy as np

from taichi_bearings.conic.central_path import newton_step
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.grouped import Arrays, Grouped, each, where
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import Part

STIFF = 1e-8  # ratio of slip and margin below which a contact is tied on the way, once there are any below its square
DECIDED = 1e4  # ratio from which a contact counts as decided in the end
FARTHEST = 1e-22  # product of slip (in its unit) and margin beyond which what is in doubt remains so
LEAST = 1e-25  # product at which double precision ends
STEPS = 80
FAST = 1e3  # slip, in the unit of those in doubt, that is not in doubt
BALANCED = 1e-6  # torques, of the mean friction, up to which a point can be judged
ROUNDING = 1e-14  # of differences of spins
EPS = np.finfo(np.float64).eps


class ContractedPath:
    """A point of the path over the contacts that are left.

    kept : these contacts among those of the whole system, (n,) places a group.
    """

    def __init__(
        self, whole: Iterate, parts: list[Part], tied: Arrays, untied: Arrays | None = None, unit: float = 1.0
    ) -> None:
        """Begin at the point `whole`, which is not changed; `parts` : elimination tree over its unknowns.

        tied, untied : (n,) masks a group, contacts to tie at once, and those that must not be tied on the way.
        unit : of slip, in which those of the contacts in doubt are of order one.
        """
        self.point, self.parts, self.unit = whole, parts, unit
        self.untied = each(np.zeros_like, tied) if untied is None else untied
        self.kept = each(lambda mask: np.arange(len(mask)), tied)
        self._chain: list[Contraction] = []
        self._tie(tied)

    def _tie(self, tied: Arrays) -> None:
        """Go on without the contacts `tied`, (n,) masks over those that are left."""
        point, contraction = self.point, Contraction(self.point.system, self.parts, tied)
        self._chain.append(contraction)
        spins, keep = contraction.contracted(point.spins), contraction.kept
        tracked = point.difference[keep]
        difference = precise(contraction.system, spins, tracked)
        self.point = Iterate(
            contraction.system,
            spins,
            point.friction[keep],
            point.bound[keep] - tracked.length() + difference.length(),
            difference,
            point.dual[keep],
            None if point.smooth is None else point.smooth[keep],
        )
        self.kept = self.kept[keep]
        self.parts = contraction.parts
        self._matrix = NewtonMatrix(contraction.system, contraction.parts)

    @property
    def spins(self) -> np.ndarray:
        """Spins of the whole system."""
        spins = self.point.spins
        for contraction in reversed(self._chain):
            spins = contraction.expanded(spins)
        return spins

    def decide(self) -> Arrays | None:
        """Follow the path until slip and margin differ by DECIDED everywhere, or to its end: masks (n,) a group, the
        contacts left that slip; None if that fails."""
        for _ in range(STEPS):
            ratios = self.point.slip_over_margin / self.unit
            if self._decided(ratios):
                return ratios > 1
            held = where(self.untied[self.kept], 1.0, ratios)
            if (held < STIFF**2).any():
                self._tie(held < STIFF)
            # beyond this slip the distance from the cone is lost in rounding; never near the slips in doubt
            product = self.point.complementarity
            point = self.point.let_slip(min(max(product / (1000 * EPS), 100 * np.sqrt(product)), FAST * self.unit))
            self.point = newton_step(point, self._matrix)
        return None

    def _decided(self, ratios: Arrays) -> bool:
        """ratios : slip, in its unit, over margin of the contacts that are left."""
        if not self.point.unbalanced < BALANCED:
            return False
        if self.point.complementarity < max(FARTHEST * self.unit, LEAST):
            return True
        return ((ratios > DECIDED) | (ratios < 1 / DECIDED)).all()


def precise(system: ContactSystem, spins: np.ndarray, tracked: Arrays) -> Arrays:
    """Differences (d, n) a group: the tracked ones where those of the spins are the same but for rounding."""
    new = system.differences(spins)
    free = Grouped((g.below >= 0) | (g.above >= 0) for g in system.groups)
    return where(free & (np.abs(new - tracked) < ROUNDING), tracked, new)
