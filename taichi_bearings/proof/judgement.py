"""Power, lower bound and contact states of samples of a lattice, or of a packing: what is rigorously true of them.

A judgement takes a scene, spins and friction, and trusts nothing of the method that found them. It proves nothing by
itself, but asks, in this order: enclosed.py for the network with all numbers as enclosures, bounds.py for an upper
bound (the potential of the spins) and a lower one (what the friction proves), slipless_state.py whether a state without
slip exists, and states.py which contacts slip at every minimum. Results are converted from the units of the network,
powers of two, to those of the scene, and bounds are rounded outwards once more.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.enclosed import judged_network
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.slipless_state import exists_without_slip
from taichi_bearings.proof.states import STILL, States, proven_states
from taichi_bearings.scene import Bearing
from taichi_bearings.scene.law import Law
from taichi_bearings.scene.solution import PROVEN, SLIPLESS


@dataclass(frozen=True)
class Judgement:
    """What stored spins and friction of a scene prove about its minimum: power, bounds on it, and contact states.
    Nothing else that a method reports is used. Results have the units of the scene; bounds are rounded outwards.

    scene : a lattice (shape *N) or a packing (N spheres) with R samples of E contacts each. In the samples of a packing
        the same contacts must act.
    spin, spin_rounding : in the laboratory frame, (R, *N, 3), of discs (R, *N), 1/time; the spin is the sum of the two.
    friction : on the second sphere of each contact, (R, E, 3); of discs (R, E), the component along z x n with the
        normal n.

    Arrays of a single sample of a packing may come without the axis R."""

    scene: Bearing
    spin: np.ndarray
    spin_rounding: np.ndarray
    friction: np.ndarray

    @property
    def law(self) -> Law:
        """The contact law of the scene."""
        return self.scene.law

    @classmethod
    def of(cls, scene: Bearing, spin: np.ndarray, spin_rounding: np.ndarray, friction: np.ndarray) -> Judgement | None:
        """Return the judgement of spins and friction; None for numbers that are not finite, or so large or small that
        products might overflow or underflow.

        scene : R samples of a lattice or a packing, with N spheres (on lattices *N, their shape) and E contacts each.
        spin, spin_rounding : (R, *N, 3), of discs (R, *N), laboratory spins, 1/time: the spin is the sum of the two.
        friction : (R, E, 3), of discs (R, E), force on the second sphere of each contact.
        """
        found = cls(scene, spin, spin_rounding, friction)
        return found if found.can_be_judged else None

    def one(self, number: int) -> Judgement:
        """Return the judgement of the single sample with this number, 0 to R - 1."""
        if self.scene.replicas == 1:
            return self
        pick = slice(number, number + 1)
        parts = (of[pick] for of in (self.spin, self.spin_rounding, self.friction))
        return Judgement(self.scene.sample(number), *parts)

    @property
    def can_be_judged(self) -> bool:
        """True if the proofs can be made. False for numbers that are not finite, or whose scales are so large or small
        that products might overflow or underflow."""
        return self._network is not None

    @cached_property
    def _network(self) -> JudgedNetwork | None:
        """The spins, friction and contacts of all R samples as enclosures; None if numbers are not finite or their
        scales too large or small."""
        return judged_network(self.scene, self.spin, self.spin_rounding, self.friction)

    @property
    def network(self) -> JudgedNetwork:
        """The spins, friction and contacts of all R samples as enclosures. An assertion fails where `can_be_judged` is
        False."""
        assert self._network is not None
        return self._network

    @cached_property
    def bounds(self) -> Bounds:
        """Upper and lower bounds on the least potential of each of R samples, in the units of `network`."""
        return Bounds.of(self.network)

    def _by_sample(self, of_contacts: np.ndarray) -> np.ndarray:
        """Return the values `of_contacts` (R * E,), one for each contact of R samples, as an array (R, E)."""
        return of_contacts.reshape(self.network.count, -1)

    @property
    def acts(self) -> np.ndarray:
        """(R, E) mask, for R samples of E contacts: True for those with a coefficient and a free sphere."""
        return self._by_sample(self.network.acts)

    @property
    def force_unit(self) -> np.ndarray:
        """(R,), for each of R samples the power of two in which its forces are measured in `network`."""
        return self.network.force_unit

    @cached_property
    def can_all_rest(self) -> np.ndarray:
        """(R,) mask of the samples in which no contact has to slip: a state without any slip is proven to exist, so
        that the least objective (power, or potential with viscosity) is 0."""
        return exists_without_slip(self.network)

    @cached_property
    def spins_are_at_rest(self) -> np.ndarray:
        """(R,) mask of the samples at rest: a state without any slip is proven to exist, and the stored spins are such
        a state up to rounding, as none of their slips exceeds STILL times the largest imposed speed."""
        found = self.can_all_rest.copy()
        if found.any():
            network = self.network
            fastest = float(network.largest_imposed.max(initial=0.0)) or 1.0
            slip = self._by_sample(np.where(network.acts, network.slip.most, 0.0))
            found &= slip.max(axis=1, initial=0.0) <= STILL * fastest
        result: np.ndarray = found
        return result

    @cached_property
    def slip(self) -> np.ndarray:
        """(R, E), slip speed of each of E contacts of R samples in the stored spins, to the nearest doubles,
        length/time; 0 for samples at rest (`spins_are_at_rest`)."""
        slip = self._by_sample(self.network.slip.value * self.network.speed_unit)
        return (
            np.where(self.spins_are_at_rest[:, None] & self.acts, 0.0, slip) if self.spins_are_at_rest.any() else slip
        )

    @cached_property
    def states(self) -> list[States]:
        """Contact states at every minimum, a list with an object for each of R samples; SLIPLESS for all contacts of
        samples for which a state without any slip is proven to exist."""
        nothing_slips = States(np.full(self.acts.shape[1], SLIPLESS), True)
        if self.can_all_rest.all():
            return [nothing_slips] * self.network.count
        found = proven_states(self.bounds)
        return [nothing_slips if rests else states for rests, states in zip(self.can_all_rest, found, strict=True)]

    @property
    def known(self) -> np.ndarray:
        """(R, E), for each of E contacts of R samples the state that is proven of all minima, UNDECIDED where nothing
        is proven."""
        return np.stack([of.known for of in self.states])

    def _reported(self, values: np.ndarray, towards: float) -> np.ndarray:
        """Return bounds (R,) on the objective (power, or potential with viscosity), energy/time, from bounds on the
        potential.

        values : (R,), bounds of the potential, in units of power of the network.
        towards : plus or minus infinity, the way in which they are rounded.
        """
        return rounded_out(values, self.network.power_unit * self.law.share, towards)

    @property
    def lower_bound(self) -> np.ndarray:
        """(R,), for each of R samples a number not above the least objective (power, or potential with viscosity),
        energy/time.

        The reported objective, a nearest double, may lie below the upper bound. Then this bound is scaled down by the
        same ratio. So the gap of the reported numbers never looks smaller than the proven one."""
        lower = np.maximum(self._reported(self.bounds.lower, -np.inf), 0.0)
        upper, objective = self.upper_bound, self.objective
        share = np.divide(objective, upper, out=np.ones_like(upper), where=np.isfinite(upper) & (upper > objective))
        lowered = np.where(share < 1, np.nextafter(lower * np.nextafter(share, 0.0), 0.0), lower)
        return np.where(self.can_all_rest, 0.0, lowered)

    @property
    def upper_bound(self) -> np.ndarray:
        """(R,), for each of R samples a number not below the least objective, energy/time: the objective of the stored
        spins, rounded up; 0 for samples at rest (`spins_are_at_rest`)."""
        return np.where(self.spins_are_at_rest, 0.0, self._reported(self.bounds.upper, np.inf))

    @property
    def power(self) -> np.ndarray:
        """(R,), the power that the stored spins of each of R samples dissipate, to the nearest doubles, energy/time; 0
        for samples at rest (`spins_are_at_rest`)."""
        return self._of_spins(1.0, self.network.power_unit)

    @property
    def objective(self) -> np.ndarray:
        """(R,), the objective of each of R samples at the stored spins, to the nearest doubles, energy/time: the power,
        or with friction and viscosity the potential. The stationary state minimises it."""
        return self._of_spins(0.5, self.network.power_unit * self.law.share)

    def _of_spins(self, of_slope: float, unit: np.ndarray) -> np.ndarray:
        """Return for each of R samples, (R,), the power or the potential at the stored spins, energy/time: the sum over
        contacts of mu F_n |slip| + `of_slope` eta slip^2, times `unit`. It is infinite for spins that no motion can
        have, and 0 for samples of which a state at rest is known (`spins_are_at_rest`).

        of_slope : factor of the viscous term, 1 for the power and 1/2 for the potential.
        unit : (R,), energy/time, of a unit of power of the network.
        """
        taken = np.where(np.isinf(self.bounds.upper), np.inf, self.network.dissipated(of_slope).value * unit)
        return np.where(self.spins_are_at_rest, 0.0, taken)

    @property
    def price(self) -> np.ndarray:
        """(R,), for each of R samples how much of the relative gap is due to torques that the stored friction leaves
        over on free spheres: the most power that these can cost if no component of a spin exceeds the largest imposed
        one, over the upper bound on the power. Infinite where that bound is 0 but the cost is not; 0 for samples with a
        state without any slip."""
        price, upper = np.where(self.can_all_rest, 0.0, self.bounds.price), self.bounds.upper
        found: np.ndarray = np.divide(price, upper, out=np.where(price > 0, np.inf, 0.0), where=upper > 0)
        return found

    @property
    def gap(self) -> np.ndarray:
        """(R,), for each of R samples (objective - lower bound) / objective of the reported numbers; 0 for samples at
        rest (`spins_are_at_rest`), NaN for stored spins that no motion can have."""
        objective = self.objective
        gap = np.where(np.isfinite(objective), 0.0, np.nan)
        some = np.isfinite(objective) & (objective > 0)
        gap[some] = (objective[some] - self.lower_bound[some]) / objective[some]
        return gap

    @property
    def proof(self) -> np.ndarray:
        """(R,), for each of R samples a text: PROVEN if its lower bound holds for all spins, else the words that
        restrict it to spins up to some speed."""
        otherwise = PROVEN if self.can_all_rest.all() else self.bounds.proof  # bounds only where they are needed
        return np.where(self.can_all_rest, PROVEN, otherwise)

    @property
    def largest_torque(self) -> np.ndarray:
        """(R,), for each of R samples the largest torque that the stored friction leaves over on a free sphere, rounded
        up, force * length; for packings over the radius of the sphere, force."""
        radius = self.scene.slip_radius
        return rounded_out(self.bounds.largest_torque, self.force_unit * radius, np.inf)

    @property
    def driven_power(self) -> np.ndarray:
        """(R,), for each of R samples the power that contacts between driven spheres of a packing dissipate,
        energy/time. They are no part of the problem."""
        between = ~self.network.free[self.network.graph.contact].any(axis=0)
        return np.asarray(self.network.dissipated(1.0, between).value * self.network.power_unit)


def rounded_out(values: np.ndarray, unit: np.ndarray, towards: float) -> np.ndarray:
    """Return values times their units, (R,), rounded outwards: towards plus or minus infinity. Two units in the last
    place are allowed, as the unit and the product are each rounded once. 0 stays 0, and a unit that is a power of two
    rounds only tiny numbers.

    values, unit : (R,) each.
    towards : plus or minus infinity."""
    found = values * unit
    for _ in range(2):
        inexact = (np.frexp(unit)[0] != 0.5) | (np.abs(found) < np.finfo(float).tiny * 2**60)
        found = np.where((found != 0) & inexact, np.nextafter(found, towards), found)
    result: np.ndarray = found
    return result
