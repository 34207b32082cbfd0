"""The physics of one contact: power, force and dissipation potential as functions of slip, and their convex duals.

A law says how large a force F(v) opposes a slip of speed v. Its potential phi(v) is the integral of F. Torques balance
where the sum of the potentials over all contacts is least, so that is the state in which every dynamics ends. The power
F v is the potential itself for friction, twice that for viscous contacts, and no multiple of it for both together. The
dual phi*(f) = max_v (f v - phi(v)) of the forces gives lower bounds: for any forces in balance,

    least potential >= work of the driven planes - sum_e phi*(|f_e|).

A law works on arrays of coefficients, in units of force or of force * time / length as `Bearing.material` has them;
slips are speeds, length/time, and forces are sizes. kernels/contact.py has the same laws for kernels. The *holding
force* is the largest force that a contact bears without slipping, its friction force.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.words import meant, shown

Coefficients = tuple[np.ndarray, ...]
"""One array for each coefficient of a law, all of the same shape, whose last axis is that of the contacts."""


@dataclass(frozen=True)
class Quantity:
    """A coefficient of a law.

    name : "friction" or "damping", or another word for messages and labels.
    unit : unit of the numbers that users give. The unit "1" says that the number times the normal force is a
        force that a contact bears without slip, as friction does.
    """

    name: str
    unit: str

    @property
    def is_friction(self) -> bool:
        """True if the coefficient is a pure number, that of friction."""
        return self.unit == "1"


FRICTION, DAMPING = Quantity("friction", "1"), Quantity("damping", "force*time/length")


@dataclass(frozen=True)
class Law:
    """The law F(v) = holding force + viscosity * v, or one of the two terms alone; a subclass may define another law.

    F is the size of the force at a contact that slips with speed v; the holding force is the largest one that it bears
    without slipping. The potential of the law is the integral of F from 0 to v.

    name : name that users write in the option `law`.
    quantities : the one or two coefficients of the law. Users give the first as `coefficient`, the second as
        `viscosity`.
    minimises : the objective, which a stationary state minimises: "power", or "potential" where the power is no
        multiple of it. Lower bounds and gaps are of the objective.
    share : the objective divided by the potential.
    """

    name: str
    quantities: tuple[Quantity, ...]
    minimises: str = "power"
    share: float = 1.0

    def __str__(self) -> str:
        """Return the name of the law."""
        return self.name

    @property
    def is_sum(self) -> bool:
        """True for friction, viscosity and their sum, which every method and the proofs of contact states know.

        False for a law that overrides a function. Lower bounds for such a law are only as good as its own `conjugate`.
        """
        return all(getattr(type(self), name) is getattr(Law, name) for name in OVERRIDDEN)

    @property
    def has_friction(self) -> bool:
        """True if a coefficient is friction, so that a contact can bear a force without slipping."""
        return any(quantity.is_friction for quantity in self.quantities)

    @property
    def has_viscosity(self) -> bool:
        """True if not all coefficients are friction. The force then grows with the slip, so that slips are unique."""
        return not all(quantity.is_friction for quantity in self.quantities)

    @property
    def is_rate_independent(self) -> bool:
        """True for Coulomb friction alone, whose force does not depend on the slip; False for laws of one's own."""
        return self.is_sum and self.has_friction and not self.has_viscosity

    def holding_force(self, coefficients: Coefficients) -> np.ndarray | None:
        """Return the largest force (..., E) that each of E contacts bears without slipping; None for a law without
        friction.

        coefficients : in the order of `quantities`, a tuple of arrays (..., E) over E contacts; friction as a force.
        """
        return coefficients[0] if self.has_friction else None

    def viscosity(self, coefficients: Coefficients) -> np.ndarray | None:
        """Return the viscous force over the slip, (..., E), force * time/length, of each contact; None for a law
        without viscosity.

        coefficients : in the order of `quantities`, a tuple of arrays (..., E) over E contacts; friction as a force.
        """
        return coefficients[-1] if self.has_viscosity else None

    def resistance(self, coefficients: Coefficients, slip: np.ndarray) -> np.ndarray | None:
        """Return (force - holding force) / slip, (..., E), force * time/length; None for friction alone.

        coefficients : in the order of `quantities`, a tuple of arrays (..., E) over E contacts; friction as a force.
        slip : speeds (..., E), length/time.

        The holding force is the largest force without slip. The result is the viscosity at any slip. For a law that
        overrides `force` it is computed from that function, and is 0 where nothing slips.
        """
        if type(self).force is Law.force:
            return self.viscosity(coefficients)
        held = self.holding_force(coefficients)
        excess = self.force(coefficients, slip) - (0.0 if held is None else held)
        found: np.ndarray | None = np.divide(excess, slip, out=np.zeros_like(excess), where=slip > 0)
        return found

    def steepest(self, coefficients: Coefficients, slip: float) -> np.ndarray:
        """Return the largest derivative (..., E) of the force by the slip speed, force * time/length, over all speeds
        from 0 to `slip`.

        coefficients : in the order of `quantities`, a tuple of arrays (..., E) over E contacts; friction as a force.
        slip : largest slip speed, length/time.

        The derivative is infinite for laws with friction, and where it is not known. A law of one's own that overrides
        `force` has to override this as well, if gradient descent is to solve it: the derivative limits its steps.
        """
        found = self.viscosity(coefficients)
        if self.is_sum and found is not None and not self.has_friction:
            return found
        return np.full_like(coefficients[0], np.inf)

    def force(self, coefficients: Coefficients, slip: np.ndarray) -> np.ndarray:
        """Return the size of the force (..., E) at each slipping contact.

        coefficients : in the order of `quantities`, a tuple of arrays (..., E) over E contacts; friction as a force.
        slip : speeds (..., E), length/time.
        """
        return self._sum(coefficients, np.ones_like(slip), slip)

    def power(self, coefficients: Coefficients, slip: np.ndarray) -> np.ndarray:
        """Return the dissipated power (..., E) of each contact, energy/time.

        coefficients : in the order of `quantities`, a tuple of arrays (..., E) over E contacts; friction as a force.
        slip : speeds (..., E), length/time.
        """
        return self._sum(coefficients, slip, slip**2)

    def potential(self, coefficients: Coefficients, slip: np.ndarray) -> np.ndarray:
        """Return the dissipation potential (..., E) of each contact, energy/time: the integral of the force from 0 to
        the slip.

        coefficients : in the order of `quantities`, a tuple of arrays (..., E) over E contacts; friction as a force.
        slip : speeds (..., E), length/time.
        """
        return self._sum(coefficients, slip, slip**2 / 2)

    def objective(self, coefficients: Coefficients, slip: np.ndarray) -> np.ndarray:
        """Return the power or the potential (..., E) of each contact, energy/time: whichever the law `minimises`.

        coefficients : in the order of `quantities`, a tuple of arrays (..., E) over E contacts; friction as a force.
        slip : speeds (..., E), length/time.
        """
        return self.power(coefficients, slip) if self.minimises == "power" else self.potential(coefficients, slip)

    def conjugate(self, coefficients: Coefficients, force: np.ndarray) -> np.ndarray:
        """Return the convex conjugate of the potential (..., E), energy/time, of each contact: phi*(f) = max over slips
        v of (f v - potential(v)).

        coefficients : in the order of `quantities`, a tuple of arrays (..., E) over E contacts; friction as a force.
        force : sizes f of forces, (..., E).

        With friction alone it is 0, or infinite for a force above the friction force.
        """
        held, viscosity = self.holding_force(coefficients), self.viscosity(coefficients)
        excess = force if held is None else np.maximum(force - held, 0.0)
        if viscosity is None:
            return np.where(excess > 0, np.inf, 0.0)
        found: np.ndarray = excess**2 * np.divide(0.5, viscosity, out=np.zeros_like(viscosity), where=viscosity > 0)
        return found

    def _sum(self, coefficients: Coefficients, friction: np.ndarray, viscous: np.ndarray) -> np.ndarray:
        """Return the force or the power of each contact, (..., E contacts): a sum over the coefficients of the law, in
        which a friction coefficient is multiplied by `friction` and a viscosity by `viscous`.

        coefficients : in the order of `quantities`, a tuple of arrays (..., E); friction as a force.
        friction, viscous : (..., E), functions of the slip of each contact, already evaluated: for the force 1 and the
            slip, for the power the slip and its square.
        """
        terms = [
            values * (friction if quantity.is_friction else viscous)
            for quantity, values in zip(self.quantities, coefficients, strict=True)
        ]
        found: np.ndarray = terms[0] if len(terms) == 1 else np.sum(terms, axis=0)
        return found


OVERRIDDEN = ("force", "power", "potential", "conjugate")
"""The methods that a law of one's own must override, all four."""
COULOMB = Law("coulomb", (FRICTION,))
VISCOUS = Law("viscous", (DAMPING,), share=2.0)
COULOMB_VISCOUS = Law("coulomb-viscous", (FRICTION, DAMPING), minimises="potential")
LAWS = {law.name: law for law in (COULOMB, VISCOUS, COULOMB_VISCOUS)}
"""The laws that scenes can have, by the names that users give."""


def check_law(law: Law, coefficients: Coefficients, fastest: float) -> None:
    """Check a law that a user has defined, at some contacts and slips; raise InputError with the first condition that
    it violates.

    law : the law.
    coefficients : its coefficients, a tuple of arrays (..., E contacts), of which `CONTACTS_TRIED` contacts are tried.
    fastest : length/time. The slips that are tried are 0, and 1e-9 to 1e3 times this speed.

    A lower bound follows from any balanced forces if phi is convex and phi* is its conjugate (Rockafellar, Convex
    Analysis, section 12). So these conditions are checked:

    * the force grows with the slip;
    * force times slip is the power;
    * phi(v) + phi*(f) = f v for f = F(v), and phi(v) + phi*(f) >= f v for all other pairs, forces beyond the largest
      F(v) included: there phi* may be infinite;
    * `steepest`, if the law defines it, is no less than a slope of the force;
    * all functions are 0 at contacts that take no part, where the coefficients are 0.
    """
    _check_objective(law)
    at, speed = _tried(coefficients, fastest)
    with np.errstate(all="ignore"):
        # potential + conjugate less f v: `missed` for the force of each slip, `pairs` for forces of three other slips
        force, power, potential = (function(at, speed) for function in (law.force, law.power, law.potential))
        dual = law.conjugate(at, force)
        work = force * speed
        missed = potential + dual - work
        pairs = [potential + law.conjugate(at, np.roll(force, shift, 0)) - np.roll(force, shift, 0) * speed
                 for shift in (1, 7, 24)]  # fmt: skip
        size = np.abs(potential) + np.abs(dual) + np.abs(work)
        wrong = {
            "its force, power, potential and conjugate must be finite numbers": ~np.isfinite(
                force + power + potential + dual
            ),
            "its potential and its power must be 0 without slip": (speed == 0) & ((potential != 0) | (power != 0)),
            "its force must not fall as the slip grows": np.diff(force, axis=0, prepend=0)
            < -TERM_ROUNDING * np.abs(force),
            "its power must be force times slip": np.abs(power - work) > TERM_ROUNDING * np.abs(work),
            "potential(v) + conjugate(force(v)) must be force(v) * v": np.abs(missed) > TERM_ROUNDING * size,
            "potential(v) + conjugate(f) must be at least f * v": np.min(pairs, axis=0) < -TERM_ROUNDING * size,
            "its `steepest` must be at least the slope of its force at all slips up to this one": _steeper(
                law, at, speed
            ),
            **_wrong_beyond(law, at, speed),
        }
        if law.minimises == "power":
            wrong["its power must be `share` times its potential"] = np.abs(
                power - law.share * potential
            ) > TERM_ROUNDING * np.abs(power)
    # the first condition that is violated, at the first slip and contact where it is
    for sentence, places in wrong.items():
        if places.any():
            row, column = np.argwhere(places)[0]
            given = ", ".join(f"{values[row, column]:g}" for values in at)
            raise InputError(
                f"law is {law.name!r}, whose functions contradict each other at a contact with coefficient {given} "
                f"that slips at {speed[row, column]:g}, or one of them loses digits there: {sentence}"
            )
    _check_absent(law, fastest)


def _tried(coefficients: Coefficients, fastest: float) -> tuple[Coefficients, np.ndarray]:
    """Return the coefficients and the slips at which a law is tried, for S slips at each of E contacts: a tuple of
    arrays (S, E), and an array (S, E).

    coefficients : coefficients of all contacts, a tuple of arrays. At most CONTACTS_TRIED contacts are picked, of those
        whose coefficients are all positive.
    fastest : length/time. The slips are 0, and 1e-9 to 1e3 times this speed.
    """
    acting = np.flatnonzero(np.all([values.ravel() > 0 for values in coefficients], axis=0))
    some = acting[np.unique(np.linspace(0, len(acting) - 1, min(len(acting), CONTACTS_TRIED)).astype(int))]
    slip = np.append(0.0, fastest * np.logspace(-9, 3, 49))[:, None]
    at = tuple(np.broadcast_to(values.ravel()[some], (len(slip), len(some))) for values in coefficients)
    return at, np.broadcast_to(slip, at[0].shape)


def _steeper(law: Law, coefficients: Coefficients, slip: np.ndarray) -> np.ndarray:
    """Return a mask (S, E), True where the mean slope of the force between two neighbouring slips, up to this one,
    exceeds what `steepest` returns for this slip; all False for a law that does not define it.

    law : the law, defined by a user.
    coefficients : its coefficients, a tuple of arrays (S, E).
    slip : (S, E), for S slips in ascending order, of which the first is 0.
    """
    found = np.zeros(slip.shape, dtype=bool)
    if type(law).steepest is not Law.steepest:
        force = law.force(coefficients, slip)
        slope = (np.diff(force, axis=0) - TERM_ROUNDING * force[1:]) / np.diff(slip, axis=0)
        at_contacts = tuple(values[0] for values in coefficients)
        largest = np.stack([law.steepest(at_contacts, speed) for speed in slip[1:, 0]])
        found[1:] = ~(np.maximum.accumulate(slope) <= largest * (1 + TERM_ROUNDING))
    return found


def _check_absent(law: Law, fastest: float) -> None:
    """Raise InputError for a law of which a function is not 0 at contacts that take no part.

    law : the law, defined by a user.
    fastest : slip speed at which force, power and potential are tried; the conjugate is tried without a force.
    """
    nothing = tuple(np.zeros(1) for _ in law.quantities)
    with np.errstate(all="ignore"):
        for name in OVERRIDDEN:
            value = getattr(law, name)(nothing, np.zeros(1) if name == "conjugate" else np.full(1, fastest))[0]
            if value != 0:
                raise InputError(
                    f"law is {law.name!r}, whose {name} is {value:g} at contacts that take no part, with coefficient "
                    "0; it must be 0 there, so a division by the coefficient needs np.divide with `where=`"
                )


def _wrong_beyond(law: Law, coefficients: Coefficients, slip: np.ndarray) -> dict[str, np.ndarray]:
    """Return where the conjugate of a law violates a condition: two masks (S, E), by the sentence of the condition. It
    is tried for forces beyond the largest F(v), as forces in balance may be so large, if only by rounding.

    law : the law, defined by a user.
    coefficients : its coefficients, a tuple of arrays (S, E).
    slip : (S, E), for S slips at each of E contacts, of which the last is the largest.
    """
    largest, potential = law.force(coefficients, slip)[-1], law.potential(coefficients, slip)
    is_no_number, is_less = np.zeros(slip.shape, dtype=bool), np.zeros(slip.shape, dtype=bool)
    for excess in BEYOND:
        force = np.broadcast_to(largest * (1 + excess), slip.shape)
        dual, work = law.conjugate(coefficients, force), force * slip
        is_no_number |= np.isnan(dual)
        is_less |= potential + dual - work < -TERM_ROUNDING * (potential + work)
    return {
        "its conjugate must be a number for any force, or infinite beyond the largest one": is_no_number,
        "potential(v) + conjugate(f) must be at least f * v for an f beyond the largest force(v), too": is_less,
    }


def _check_objective(law: Law) -> None:
    """Raise InputError for a law that minimises something unknown, or whose `share` is wrong for its potential.

    law : the law, defined by a user.
    """
    if law.minimises not in ("power", "potential"):
        raise InputError(f"law is {law.name!r}, which minimises {law.minimises!r}; it must be 'power' or 'potential'")
    if law.minimises == "potential" and law.share != 1:
        raise InputError(
            f"law is {law.name!r}, which minimises its potential, so its `share` must be 1, not {law.share:g}"
        )


BEYOND = (1e-6, 1e-2, 1.0, 1e3)  # how far beyond the largest force forces are tried, relative to it
CONTACTS_TRIED = 32  # contacts at which a law is checked
TERM_ROUNDING = 1e-9  # rounding error that a condition may have, relative to its terms


def law_named(law: "str | Law") -> Law:
    """Return the law of this name, or the law itself; raise InputError if there is no such law."""
    if isinstance(law, Law):
        return law
    if not isinstance(law, str) or law not in LAWS:
        raise InputError(f"law is {shown(law)}; allowed are {', '.join(LAWS)}{meant(law, LAWS)}")
    return LAWS[law]
