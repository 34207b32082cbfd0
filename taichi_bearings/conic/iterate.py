"""A point of the central path: spins, bounds, slips and forces of all contacts, and numbers that follow from them.

Letters: n contacts with up to d slip components (conic/__init__.py).
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.cones import inner, length
from taichi_bearings.conic.contact_system import ContactSystem

LEAST_GAP = 1e-13  # relative gap at which double precision ends: some hundred roundings of 1e-15
# Numbers of `Iterate.near_path`, found by trial: product over median friction and slack; least friction by which that
# is divided, and largest force, both over the median friction; root mean square of the slips over slack, above which
# the start has no forces.
START_PRODUCT, START_LEAST_FRICTION, START_LARGEST_FORCE, START_MOST_SLIP = 0.7, 0.03, 2.0, 2.0
EVEN_SHARE = 0.1  # frictions are even if at least half of them exceed this share of their mean
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Inertia:
    """The inertia of the spheres in a step in time: the cost weight / 2 |spins - origin|^2, which is added to the
    power. The torques of the contacts then have to be weight * (spins - origin) instead of 0.

    weight : moment of inertia over duration of the step, in units of friction over spin.
    origin : (unknowns,), spins before the step.
    """

    weight: float
    origin: np.ndarray

    def torques(self, spins: np.ndarray) -> np.ndarray:
        """Return the torques (unknowns,) that change the spins, during the step in time, from `origin` to other ones.

        spins : (unknowns,), spins at the end of the step.
        """
        found: np.ndarray = self.weight * (spins - self.origin)
        return found


@dataclass(frozen=True)
class Iterate:
    """A point of an interior-point method, inside the cones of all n contacts: slips below their bounds, forces below
    friction.

    system : the contacts, with the matrix from spins to slips (d components each).
    spins : (unknowns,).
    friction : (n,), largest friction force, in units of the mean of the sample.
    bound : (n,), bounds on the slip speeds, each above its speed.
    difference : (d, n), slips.
    dual : (d, n), minus the contact force without its viscous part.
    smooth : (n,) mask of contacts that are in no cone but obey the law of friction exactly: dual = -friction *
        direction of slip, bound = slip speed; None for none.
    viscosity : (n,), viscous force over slip speed; None for Coulomb friction.
    inertia : what resists a change of the spins; None if the minimum of the power is sought.
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
        """Return a point without forces other than viscous ones, with the bound sqrt(slip^2 + slack^2) above the slip
        of each of n contacts.

        system : the contacts.
        spins : (unknowns,), spins of the point.
        friction : (n,), largest friction force of each contact.
        slack : how far the bound of a contact without slip is above 0, in units of slip. The larger it is, the further
            the point is from the end of the central path; 0 puts bounds on the slips themselves.
        viscosity : (n,), viscous force over slip speed; None for no viscosity.
        """
        difference = system.differences(spins)
        bound = np.hypot(length(difference), slack)
        return cls(system, spins, friction, bound, difference, np.zeros_like(difference), viscosity=viscosity)

    @classmethod
    def near_path(cls, system: ContactSystem, spins: np.ndarray, friction: np.ndarray, slack: float) -> "Iterate":
        """Return a point at which friction * bound - slip . force is about the same for all contacts, as on the central
        path, but torques do not balance. From there the path takes one Newton step in ten less than from a point
        without forces.

        Forces that leave large torques would cost many steps. So they are at most START_LARGEST_FORCE times the median
        friction; and they are 0, as in :meth:`start`, if slips are far from those of a minimum (START_MOST_SLIP), as at
        random spins, or if frictions are decades apart.

        system : the n contacts.
        spins : (unknowns,), spins of the point.
        friction : (n,), largest friction force of each contact.
        slack : typical slip of a contact; the bounds of contacts without slip are of this size.
        """
        difference, middle = system.differences(spins), len(friction) // 2
        slip, median = length(difference), float(np.partition(friction, middle)[middle])
        if not (are_even(friction) and np.mean(slip * slip) <= (START_MOST_SLIP * slack) ** 2):
            return cls.start(system, spins, friction, slack)
        # The force largest * slip / bound makes the product about largest * (bound - slip^2 / bound), which is to be
        # START_PRODUCT * median * slack: a quadratic equation for the bound.
        largest = np.minimum(friction, START_LARGEST_FORCE * median)
        shift = START_PRODUCT * median * slack / np.maximum(largest, START_LEAST_FRICTION * median)
        bound = (shift + np.sqrt(shift * shift + 4 * slip * slip)) / 2
        return cls(system, spins, friction, bound, difference, -largest * difference / bound)

    def let_slip(self, slips: np.ndarray) -> "Iterate":
        """Return the point with another choice of *smooth* contacts, which are in no cone but obey the law of friction
        exactly: force = friction along the slip, bound = slip.

        slips : (n,) mask of the contacts that are smooth from now on. All others are in their cones, bound >= |slip|
            and friction >= |force|. Those of them that were smooth before get a force along their slip, and a bound
            such that their product friction * bound - slip . force is the mean one.
        """
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
        """Number of contacts in cones (bound >= |slip|, friction >= |force|): all but those in the mask `smooth`, which
        obey the law of friction exactly.
        """
        return len(self.friction) - (0 if self.smooth is None else int(self.smooth.sum()))

    @property
    def complementarity(self) -> float:
        """The mean over the contacts in cones of friction * bound - slip . force, which is the same for all contacts on
        the central path and falls to 0 at its end.
        """
        products = self.friction * self.bound + inner(self.difference, self.dual)
        products = products if self.smooth is None else np.where(self.smooth, 0.0, products)
        return float(products.sum()) / max(1, self.in_cones)

    @property
    def margin(self) -> np.ndarray:
        """(n,), the share of its friction that each contact has left: 1 - |dual| / friction."""
        found: np.ndarray = 1 - length(self.dual) / self.friction
        return found

    @property
    def slip_over_margin(self) -> np.ndarray:
        """(n,), slip speed over margin. Along the path it goes to 0 where a contact sticks, and to infinity where it
        slips."""
        found: np.ndarray = length(self.difference) / np.maximum(self.margin, TINY)
        return found

    @property
    def whole_dual(self) -> np.ndarray:
        """(d, n), minus the force of every contact, with its viscous part. Letters: n contacts with up to d slip
        components."""
        return whole_dual(self.dual, self.viscosity, self.difference)

    def to_balance(self, spins: np.ndarray) -> np.ndarray | float:
        """Return the torques (unknowns,) that the contacts have to exert at given spins: those that accelerate spheres
        to them during a step in time; 0 without inertia, where the minimum is sought.

        spins : (unknowns,), spins at the end of the step.
        """
        return 0.0 if self.inertia is None else self.inertia.torques(spins)

    @property
    def unbalanced(self) -> float:
        """Largest torque that the contact forces leave on a sphere, apart from what accelerates it, in units of the
        mean friction."""
        left = self.system.torques(self.whole_dual) - self.to_balance(self.spins)
        return float(np.abs(left).max(initial=0.0))

    @property
    def power(self) -> float:
        """Power of friction: friction times slip speed, summed over the contacts."""
        return float(self.friction @ length(self.difference))

    @property
    def cost(self) -> float:
        """The function that is minimised, without the part of inertia: friction times slip speed and half the viscous
        power, summed over the contacts."""
        if self.viscosity is None:
            return self.power
        return self.power + float((self.viscosity * self.difference**2).sum()) / 2

    @property
    def price_of_torques(self) -> float:
        """Bound on the relative loss of the lower bound on the cost by unbalanced torques: the sum of the sizes of the
        torques, divided by the cost. It holds if no spin of a minimum exceeds the unit of spin."""
        found: float = float(np.abs(self.system.torques(self.whole_dual)).sum()) / max(self.cost, TINY)
        return found

    @property
    def excess(self) -> float:
        """Upper bound on how far the cost is above the least one, if the forces balance: the sum over the contacts of
        friction * |slip| + slip . dual, in which `dual` is minus the force. Each term is 0 if the contact obeys the law
        of friction, and positive otherwise, so that nothing cancels. It holds with or without inertia and viscosity:
        the dual cost of a force f, max(|f| - friction, 0)^2 / (2 viscosity), is never more than the cost viscosity *
        slip^2 / 2 that is counted in its place.
        """
        return float((self.friction * length(self.difference) + inner(self.difference, self.dual)).sum())

    @property
    def gap(self) -> float:
        """Relative gap (cost - lower bound) / cost of the point, for balanced forces."""
        found: float = self.excess / max(self.cost, TINY)
        return found


def whole_dual(dual: np.ndarray, viscosity: np.ndarray | None, difference: np.ndarray) -> np.ndarray:
    """Return minus the forces (d, n) of friction and viscosity of n contacts.

    dual : (d, n), minus the friction forces.
    viscosity : (n,), viscous force over slip speed; None for none.
    difference : (d, n), slips.

    Letters: d slip components.
    """
    return dual if viscosity is None else dual - viscosity * difference


def are_even(friction: np.ndarray) -> bool:
    """Return True if frictions are not decades apart: if at least half of them exceed EVEN_SHARE times their mean.

    friction : (n,), largest friction force of each of n contacts.
    """
    many = np.count_nonzero(friction > EVEN_SHARE * np.mean(friction))
    return bool(2 * many >= len(friction))
