"""The physics of one contact: power, force and dissipation potential as functions of slip, and their convex duals.

A law says how large a force F(v) opposes a slip of speed v. Its potential phi(v) is the integral of F. Torques balance
where the sum of the potentials over all contacts is least, so that is the state in which every dynamics ends. The power
F v is the potential itself for friction, twice that for viscous contacts, and no multiple of it for both together. The
dual phi*(f) = max_v (f v - phi(v)) of the forces gives lower bounds: for any forces in balance,

    least potential >= work of the driven planes - sum_e phi*(|f_e|).

A law works on arrays of coefficients, in units of force or of force * time / length as `Bearing.material` has them;
slips are speeds, length/time, and forces are sizes. Its device twin is in kernels/contact.py.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.words import meant, shown

Coefficients = tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Quantity:
    """A coefficient of a law. name : in the field's words. unit : of the numbers that users give; "1" for a ratio to
    the normal force, by which it is multiplied to have a force."""

    name: str
    unit: str

    @property
    def is_friction(self) -> bool:
        return self.unit == "1"


FRICTION, DAMPING = Quantity("friction", "1"), Quantity("damping", "force*time/length")


@dataclass(frozen=True)
class Law:
    """F = holding force + viscosity * v, with either of the two left out, or another law that overrides its functions.

    name : of the option. quantities : its coefficients, in the order of `Coefficients`; those of the first are
    `Scene.coefficient`, those of the second `Scene.viscosity`. minimises : "power" or "potential", what lower bounds
    and gaps are of. share : of that in a unit of potential.
    """

    name: str
    quantities: tuple[Quantity, ...]
    minimises: str = "power"
    share: float = 1.0

    def __str__(self) -> str:
        return self.name

    @property
    def is_sum(self) -> bool:
        """True for friction, viscosity and their sum, which every method and the proofs of contact states know.

        False for a law that overrides a function. What is certified of such a law rests on its own conjugate.
        """
        return all(getattr(type(self), name) is getattr(Law, name) for name in OVERRIDDEN)

    @property
    def holds(self) -> bool:
        """True if a contact can bear a force without slipping."""
        return any(quantity.is_friction for quantity in self.quantities)

    @property
    def flows(self) -> bool:
        """True if the force grows with the slip: the slips of least potential are unique."""
        return not all(quantity.is_friction for quantity in self.quantities)

    @property
    def is_rate_independent(self) -> bool:
        """True if the force does not depend on the speed of the slip, so that contacts rest exactly or slip."""
        return self.holds and not self.flows

    def holding_force(self, of: Coefficients) -> np.ndarray | None:
        """Largest force that a contact bears without slipping; None where it bears none."""
        return of[0] if self.holds else None

    def viscosity(self, of: Coefficients) -> np.ndarray | None:
        """Slope of the force over the slip; None where there is none."""
        return of[-1] if self.flows else None

    def resistance(self, of: Coefficients, slip: np.ndarray) -> np.ndarray | None:
        """Force beyond the holding force over the slip, (..., E), force * time/length; None for friction alone.

        of : coefficients (..., E) each. slip : speeds (..., E). That is the viscosity, whatever the slip; of a law that
        overrides `force` it is found from that, 0 where nothing slips.
        """
        if type(self).force is Law.force:
            return self.viscosity(of)
        held = self.holding_force(of)
        excess = self.force(of, slip) - (0.0 if held is None else held)
        return np.divide(excess, slip, out=np.zeros_like(excess), where=slip > 0)

    def steepest(self, of: Coefficients, slip: float) -> np.ndarray:
        """Largest slope of the force over the slip, (..., E), at slips from 0 to this one; infinite if it is not known.

        of : coefficients (..., E) each. A law that overrides `force` overrides this too if gradient descent is to
        solve it: its steps are as long as the slope allows.
        """
        found = self.viscosity(of)
        if self.is_sum and found is not None and not self.holds:
            return found
        return np.full_like(of[0], np.inf)

    def force(self, of: Coefficients, slip: np.ndarray) -> np.ndarray:
        """Of a slipping contact."""
        return self._sum(of, np.ones_like(slip), slip)

    def power(self, of: Coefficients, slip: np.ndarray) -> np.ndarray:
        return self._sum(of, slip, slip**2)

    def potential(self, of: Coefficients, slip: np.ndarray) -> np.ndarray:
        """Integral of the force over the slip, energy/time."""
        return self._sum(of, slip, slip**2 / 2)

    def objective(self, of: Coefficients, slip: np.ndarray) -> np.ndarray:
        """What the stationary state minimises, `share` times the potential."""
        return self.power(of, slip) if self.minimises == "power" else self.potential(of, slip)

    def conjugate(self, of: Coefficients, force: np.ndarray) -> np.ndarray:
        """phi*(f), energy/time, for forces of these sizes; infinite beyond what friction alone can bear."""
        held, viscosity = self.holding_force(of), self.viscosity(of)
        excess = force if held is None else np.maximum(force - held, 0.0)
        if viscosity is None:
            return np.where(excess > 0, np.inf, 0.0)
        return excess**2 * np.divide(0.5, viscosity, out=np.zeros_like(viscosity), where=viscosity > 0)

    def _sum(self, of: Coefficients, friction: np.ndarray, viscous: np.ndarray) -> np.ndarray:
        """Each coefficient times its function of the slip."""
        terms = [
            values * (friction if quantity.is_friction else viscous)
            for quantity, values in zip(self.quantities, of, strict=True)
        ]
        return terms[0] if len(terms) == 1 else np.sum(terms, axis=0)


OVERRIDDEN = ("force", "power", "potential", "conjugate")
"""Functions of which a law of one's own overrides all four."""
COULOMB = Law("coulomb", (FRICTION,))
VISCOUS = Law("viscous", (DAMPING,), share=2.0)
COULOMB_VISCOUS = Law("coulomb-viscous", (FRICTION, DAMPING), minimises="potential")
LAWS = {law.name: law for law in (COULOMB, VISCOUS, COULOMB_VISCOUS)}
"""The laws that scenes can have, by the names of the option."""


def check_law(law: Law, of: Coefficients, fastest: float) -> None:
    """Spot-check a law of one's own: InputError names the first statement about it that is false.

    law : it. of : coefficients (..., E) each; some of the contacts are tried. fastest : slip speed around which, over
    twelve decades, the force is looked at.

    A lower bound follows from any balanced forces if phi is convex and phi* is its conjugate (Rockafellar, Convex
    Analysis, section 12). So the force must grow with the slip, force times slip must be the power, and with f = F(v)
    phi(v) + phi*(f) = f v, while phi(v) + phi*(f) >= f v for all other pairs.
    """
    acting = np.flatnonzero(np.all([values.ravel() > 0 for values in of], axis=0))
    some = acting[np.unique(np.linspace(0, len(acting) - 1, min(len(acting), CONTACTS_TRIED)).astype(int))]
    slip = np.append(0.0, fastest * np.logspace(-9, 3, 49))[:, None]
    at = tuple(np.broadcast_to(values.ravel()[some], (len(slip), len(some))) for values in of)
    speed = np.broadcast_to(slip, at[0].shape)
    with np.errstate(all="ignore"):
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
        }
        if law.minimises == "power":
            wrong["its power must be `share` times its potential"] = np.abs(
                power - law.share * potential
            ) > TERM_ROUNDING * np.abs(power)
    for sentence, places in wrong.items():
        if places.any():
            row, column = np.argwhere(places)[0]
            given = ", ".join(f"{values[row, column]:g}" for values in at)
            raise InputError(
                f"law is {law.name!r}, which is wrong at a contact of coefficient {given} that slips at "
                f"{speed[row, column]:g}: {sentence}"
            )


CONTACTS_TRIED = 32  # contacts at which a law is looked at
TERM_ROUNDING = 1e-9  # of the terms of a statement, that rounding may leave


def law_named(law: "str | Law") -> Law:
    """The law of this name, or the law itself; InputError if there is none."""
    if isinstance(law, Law):
        return law
    if not isinstance(law, str) or law not in LAWS:
        raise InputError(f"law is {shown(law)}; allowed are {', '.join(LAWS)}{meant(law, LAWS)}")
    return LAWS[law]
