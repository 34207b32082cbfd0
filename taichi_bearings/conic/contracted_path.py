"""The central path over ever fewer contacts: those that surely stick are tied, those that surely slip obey their law.

On the central path slip times friction margin is the same for all contacts. What is left once most contacts are tied
(contraction.py) is small and has no huge stiffness. There the products of slip and margin of the contacts in doubt can
be brought down by another ten decades, until nobody is in doubt, as slipping ones leave their cones.
"""

import numpy as np

from taichi_bearings.conic.central_path import Iterate, newton_step
from taichi_bearings.conic.cone import length, slip_over_margin
from taichi_bearings.conic.contact_system import ContactGroup
from taichi_bearings.conic.contraction import Contraction
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

    kept : per group, these contacts among those of the whole system. slipping : (n,) masks over them, once decided.
    """

    def __init__(
        self,
        whole: Iterate,
        parts: list[Part],
        tied: list[np.ndarray],
        untied: list[np.ndarray] | None = None,
        unit: float = 1.0,
    ) -> None:
        """Begin at the point `whole`, which is not changed; `parts` : elimination tree over its unknowns.

        tied, untied : (n,) masks a group, contacts to tie at once, and those that must not be tied on the way.
        unit : of slip, in which those of the contacts in doubt are of order one.
        """
        self.point, self.parts, self.unit = whole, parts, unit
        self.untied = untied or [np.zeros_like(mask) for mask in tied]
        self.kept = [np.arange(len(mu)) for mu in whole.friction]
        self.slipping: list[np.ndarray] = []
        self._chain: list[Contraction] = []
        self._tie(tied)

    def _tie(self, tied: list[np.ndarray]) -> None:
        """Go on without the contacts `tied`, (n,) masks over those that are left."""
        point, contraction = self.point, Contraction(self.point.system, self.parts, tied)
        self._chain.append(contraction)
        spins = contraction.contracted(point.spins)
        difference, bound = [], []
        for group, z, b, keep in zip(
            contraction.system.groups, point.difference, point.bound, contraction.kept, strict=True
        ):
            difference.append(precise(group, spins, z[:, keep]))
            bound.append(b[keep] - length(z[:, keep]) + length(difference[-1]))
        self.point = Iterate(
            contraction.system,
            spins,
            [mu[keep] for mu, keep in zip(point.friction, contraction.kept, strict=True)],
            bound,
            difference,
            [y[:, keep] for y, keep in zip(point.dual, contraction.kept, strict=True)],
            [smooth[keep] for smooth, keep in zip(point.smooth, contraction.kept, strict=True)],
        )
        self.kept = [kept[keep] for kept, keep in zip(self.kept, contraction.kept, strict=True)]
        self.parts = contraction.parts
        self._matrix = NewtonMatrix(contraction.system, contraction.parts)

    @property
    def spins(self) -> np.ndarray:
        """Spins of the whole system."""
        spins = self.point.spins
        for contraction in reversed(self._chain):
            spins = contraction.expanded(spins)
        return spins

    def decide(self) -> bool:
        """Follow the path until slip and margin differ by DECIDED everywhere, or to its end; False if that fails."""
        for _ in range(STEPS):
            ratios = self._ratios()
            if self._decided(ratios):
                self.slipping = [r > 1 for r in ratios]
                return True
            held = [np.where(u[kept], 1.0, r) for r, u, kept in zip(ratios, self.untied, self.kept, strict=True)]
            if min(float(r.min(initial=1.0)) for r in held) < STIFF**2:
                self._tie([r < STIFF for r in held])
            # beyond this slip the distance from the cone is lost in rounding; never near the slips in doubt
            product = self.point.complementarity
            self.point.let_slip(min(max(product / (1000 * EPS), 100 * np.sqrt(product)), FAST * self.unit))
            newton_step(self.point, self._matrix)
        return False

    def _ratios(self) -> list[np.ndarray]:
        """Slip, in its unit, over margin of the contacts that are left."""
        point = self.point
        return [
            slip_over_margin(mu, z, y) / self.unit
            for mu, z, y in zip(point.friction, point.difference, point.dual, strict=True)
        ]

    def _decided(self, ratios: list[np.ndarray]) -> bool:
        point = self.point
        if not np.abs(point.imbalance(point.spins, point.dual)).max(initial=0.0) < BALANCED:
            return False
        if point.complementarity < max(FARTHEST * self.unit, LEAST):
            return True
        return all(((r > DECIDED) | (r < 1 / DECIDED)).all() for r in ratios)


def precise(group: ContactGroup, spins: np.ndarray, tracked: np.ndarray) -> np.ndarray:
    """Differences (d, n): the tracked ones where those of the spins are the same but for rounding."""
    new, free = group.differences(spins), (group.below >= 0) | (group.above >= 0)
    return np.where(free & (np.abs(new - tracked) < ROUNDING), tracked, new)
