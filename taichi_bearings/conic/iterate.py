"""A point of the central path: spins, bounds, slips and forces of all contacts, and numbers that follow from them.

Letters: n contacts with up to d slip components (conic/__init__.py).
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.cones import inner, length
from taichi_bearings.conic.contact_system import ContactSystem

LEAST_GAP = 1e-13  # relative gap at which double precision ends
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Inertia:
    """The cost weight / 2 |spins - origin|^2 beside the power: the torques then balance weight * (spins - origin)."""

    weight: float
    origin: np.ndarray

    def torques(self, spins: np.ndarray) -> np.ndarray:
        """Torques (unknowns,) that bring the spins from their origin to `spins`."""
        return self.weight * (spins - self.origin)


@dataclass(frozen=True)
class Iterate:
    """A point inside all cones.

    system : the contacts.
    spins : (unknowns,).
    friction : (n,), largest friction force.
    bound : (n,), above the slip speed.
    difference : (d, n), slips.
    dual : (d, n), minus the contact force without its viscous part.
    smooth : (n,) mask of contacts that are in no cone but obey the law of friction exactly: dual = -friction *
        direction of slip; None for none.
    viscosity : (n,), None for Coulomb friction.
    inertia : what resists a change of the spins; None if the minimum is sought.
    """

    system: ContactSystem
    spins: np.ndarray
    friction: np.ndarray
    bound: np.ndarray
    difference: np.ndarray
    dual: np.ndarray
    smooth: np.ndarray | None = None
    viscosity: np.ndarray | None = None
    inertia: Inertia | None = None

    @classmethod
    def start(
        cls,
        system: ContactSystem,
        spins: np.ndarray,
        friction: np.ndarray,
        slack: float,
        viscosity: np.ndarray | None = None,
    ) -> "Iterate":
        """A point with bounds above the slips by about `slack`, and without forces other than viscous ones. spins :
        (unknowns,). friction, viscosity : (n,)."""
        difference = system.differences(spins)
        bound = np.hypot(length(difference), slack)
        return cls(system, spins, friction, bound, difference, np.zeros_like(difference), viscosity=viscosity)

    def let_slip(self, slips: np.ndarray) -> "Iterate":
        """The point after contacts of the mask `slips` (n,) have left their cones, and all others have come back into
        them."""
        bound, dual = self.bound, self.dual
        if self.smooth is not None:
            # contacts that come back are put on the path, with the mean product and a force along the slip
            back, product = self.smooth & ~slips, self.complementarity / self.friction
            central = (product + np.hypot(product, 2 * length(self.difference))) / 2
            bound, dual = (
                np.where(back, central, bound),
                np.where(back, -self.friction * self.difference / central, dual),
            )
        if slips.any():
            slip = length(self.difference)
            bound, dual = np.where(slips, slip, bound), np.where(slips, -self.friction * self.difference / slip, dual)
        return replace(self, bound=bound, dual=dual, smooth=slips)

    @property
    def in_cones(self) -> int:
        """The number of contacts in cones."""
        return len(self.friction) - (0 if self.smooth is None else int(self.smooth.sum()))

    @property
    def complementarity(self) -> float:
        """The product of the path: mean over the contacts in cones of friction * bound - slip . force."""
        products = self.friction * self.bound + inner(self.difference, self.dual)
        products = products if self.smooth is None else np.where(self.smooth, 0.0, products)
        return float(products.sum()) / max(1, self.in_cones)

    @property
    def margin(self) -> np.ndarray:
        """(n,), the share of its friction that each contact has left."""
        return 1 - length(self.dual) / self.friction

    @property
    def slip_over_margin(self) -> np.ndarray:
        """(n,), slip speed over margin: along the path it goes to 0 where a contact sticks, and to infinity where it
        slips."""
        return length(self.difference) / np.maximum(self.margin, TINY)

    @property
    def whole_dual(self) -> np.ndarray:
        """(d, n), minus the force of every contact, with its viscous part."""
        return whole_dual(self.dual, self.viscosity, self.difference)

    def to_balance(self, spins: np.ndarray) -> np.ndarray | float:
        """Torques (unknowns,) that the inertia needs to have these spins; 0 without inertia."""
        return 0.0 if self.inertia is None else self.inertia.torques(spins)

    @property
    def unbalanced(self) -> float:
        """Largest torque that the forces leave on a sphere, apart from those that the inertia needs."""
        left = self.system.torques(self.whole_dual) - self.to_balance(self.spins)
        return float(np.abs(left).max(initial=0.0))

    @property
    def power(self) -> float:
        """Friction times slip, summed over the contacts."""
        return float(self.friction @ length(self.difference))

    @property
    def cost(self) -> float:
        """The function that is minimised, without its part from inertia: friction times slip, and half the viscous
        power."""
        if self.viscosity is None:
            return self.power
        return self.power + float((self.viscosity * self.difference**2).sum()) / 2

    @property
    def price_of_torques(self) -> float:
        """Bound on what leftover torques take from the lower bound, relative to the cost."""
        return float(np.abs(self.system.torques(self.whole_dual)).sum()) / max(self.cost, TINY)

    @property
    def excess(self) -> float:
        """Cost less dual cost for balanced forces, summed without cancellation; with or without inertia and viscosity.

        With viscosity the dual cost of a force f is max(|f| - friction, 0)^2 / (2 viscosity). That is never more than
        the cost of the present slip, viscosity * slip^2 / 2, which is counted here.
        """
        return float((self.friction * length(self.difference) + inner(self.difference, self.dual)).sum())

    @property
    def gap(self) -> float:
        """(cost - lower bound) / cost for balanced forces."""
        return self.excess / max(self.cost, TINY)


def whole_dual(dual: np.ndarray, viscosity: np.ndarray | None, difference: np.ndarray) -> np.ndarray:
    """Minus the forces (d, n) of friction and viscosity. dual : (d, n). viscosity : (n,), None for none. difference :
    slips (d, n)."""
    return dual if viscosity is None else dual - viscosity * difference
