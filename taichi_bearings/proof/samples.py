"""Samples as a file holds them: what is imposed, the coefficients, and the spins and friction to be judged.

Everything is in the laboratory frame. With n the direction of a contact, s = +1 or -1 the sublattice of a sphere, and
w_i, w_j the spins at its lower and upper end, the upper surface slips past the lower one with v = -R (w_i + w_j) x n
(paper, Eq. 2); friction F on the upper sphere turns both spheres alike, with the torque -R n x F. Call s w the signed
spin: across a contact the sum w_i + w_j is, up to its sign, the difference of the signed spins, and where all signed
spins are equal nothing slips, nor does it where they are A + C x, which differs along the contacts alone. Such a
bearing state can be added to all spins, so these are measured from that of the bottom. Component k of the jump, the
state of the top measured so, depends on x_k alone, and no contact that feels component k leads from a layer x_k to
another: what is said of a component is said layer by layer.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from decimal import Decimal, localcontext
from functools import cached_property

import numpy as np

from taichi_bearings.proof.enclosure import Enclosure

DIGITS = 300
LEAST_SCALE, MOST_SCALE = 1e-60, 1e60  # scales of a sample
LEAST_JUMP = 1e-140  # component of the jump, of the whole
SLIPLESS, SLIPPING, UNPROVEN, TIED = 0, 1, 2, 4  # what can be proven of a contact (states.py)
DRIVEN_STATE = 3  # of a contact that takes no part, in files
LAWS = {"coulomb": (True, False), "viscous": (False, True), "coulomb-viscous": (True, True)}
"""Law -> does a contact bear a force without slipping, and does its force grow with the slip."""


class OfLaw:
    """What follows from a law, a key of LAWS."""

    law: str
    is_lattice = False

    @property
    def holds(self) -> bool:
        """True if a contact bears a force without slipping."""
        return LAWS[self.law][0]

    @property
    def flows(self) -> bool:
        """True if the force grows with the slip."""
        return LAWS[self.law][1]

    @property
    def share(self) -> float:
        """What is least at rest, the objective, over the potential of the forces: the power of viscous contacts is
        twice theirs; beside friction it is no multiple of it, and the potential itself is least."""
        return 1.0 if self.holds else 2.0


@dataclass(frozen=True)
class Samples(OfLaw):
    """R samples that differ in their coefficients alone.

    shape : N, spheres along each axis, height last. law : a key of LAWS.
    coefficient : one array (R, *contacts) an axis; viscosity : the same of contacts that have friction and damping,
    else empty. spin, spin_rounding : (R, *N, 3), in 2D (R, *N); the spin is the sum of the two.
    friction : (R, *contacts, 3) an axis, on the upper sphere; in 2D the component along z x n.
    top, bottom : states (A_x, A_y, A_z, C) that are imposed, in 2D (A_z,), x from the first sphere; spin_top and
    spin_bottom are then their largest sizes on the planes. None: spins along `direction`.
    periodic : axes along which the last spheres touch the first; arrays of their contacts are as long as the lattice.
    """

    shape: tuple[int, ...]
    law: str
    coefficient: tuple[np.ndarray, ...]
    spin_top: float
    spin_bottom: float
    direction: tuple[float, ...]
    normal_force: float
    radius: float
    spin: np.ndarray
    spin_rounding: np.ndarray
    friction: tuple[np.ndarray, ...]
    viscosity: tuple[np.ndarray, ...] = ()
    top: tuple[float, ...] | None = None
    bottom: tuple[float, ...] | None = None
    periodic: tuple[int, ...] = ()
    is_lattice = True

    @property
    def count(self) -> int:
        return len(self.spin)

    def one(self, number: int) -> Samples:
        """One of them alone."""
        return self.some(slice(number, number + 1))

    def some(self, pick: slice) -> Samples:
        """A few of them."""
        return replace(
            self,
            coefficient=tuple(values[pick] for values in self.coefficient),
            viscosity=tuple(values[pick] for values in self.viscosity),
            spin=self.spin[pick],
            spin_rounding=self.spin_rounding[pick],
            friction=tuple(values[pick] for values in self.friction),
        )

    @property
    def can_be_judged(self) -> bool:
        """False for a law that is not known here, and for numbers that are not finite, too large or small for products,
        or not positive where they must be."""
        imposed = (self.normal_force, self.radius, self.spin_top, self.spin_bottom, *self.direction)
        if self.law not in LAWS or not np.isfinite(imposed).all() or not any(self.direction):
            return False
        scales = [self.normal_force, self.radius, self.jump_size or 1.0]
        strengths = [self.normal_force * c for c in self.coefficient]
        strengths += [self.radius * self.spin_unit * values for values in self.viscosity]
        given = zip(strengths, (*self.coefficient, *self.viscosity), strict=True)
        arrays = (self.spin, self.spin_rounding, *self.friction, *strengths)
        sizes = [float(np.abs(values).max(initial=0.0)) for values in arrays]
        return (
            all(LEAST_SCALE < scale < MOST_SCALE for scale in scales)
            and all(size < MOST_SCALE for size in sizes)  # False for what is no number
            and all(bool(((values > LEAST_SCALE) | (c == 0)).all()) for values, c in given)  # lost products are not 0
            and all(((c == 0) == (v == 0)).all() for c, v in zip(self.coefficient, self.viscosity, strict=False))
            and all(value == 0 or abs(value) > LEAST_JUMP for jump in self.exact_jump.values() for value in jump)
        )

    @property
    def dimension(self) -> int:
        return len(self.shape)

    @property
    def components(self) -> tuple[int, ...]:
        """Of the spins: about z in 2D, and about x, y and z in 3D."""
        return (2,) if self.dimension == 2 else (0, 1, 2)

    @cached_property
    def states(self) -> tuple[list[Decimal], list[Decimal]]:
        """States (A_x, A_y, A_z, C) of bottom and top, to DIGITS digits."""
        with localcontext() as context:
            context.prec = DIGITS
            if self.top is not None and self.bottom is not None:
                padded = ((0.0, 0.0, *s, 0.0) if len(s) == 1 else s for s in (self.bottom, self.top))
                bottom, top = ([Decimal(part) for part in state] for state in padded)
                return bottom, top
            parts = [Decimal(d) for d in ((0.0, 0.0, 1.0) if self.dimension == 2 else self.direction)]
            size = sum((part * part for part in parts), Decimal(0)).sqrt()
            bottom, top = (
                [*(Decimal(spin) * part / size for part in parts), Decimal(0)]
                for spin in (self.spin_bottom, self.spin_top)
            )
            return bottom, top

    @cached_property
    def exact_jump(self) -> dict[int, list[Decimal]]:
        """By component k, signed spin of the top less that of the bottom's state, in units of `spin_unit`, in each
        layer x_k along k, one where it is the same in all of them, to DIGITS digits."""
        with localcontext() as context:
            context.prec = DIGITS
            unit = Decimal(self.spin_unit)
            return {
                k: [(high - low) / unit for low, high in zip(*self.imposed_in_layers(k), strict=True)]
                for k in self.components
            }

    def imposed_in_layers(self, component: int) -> tuple[list[Decimal], list[Decimal]]:
        """Component k of the states of bottom and top at the top plane, layer by layer along k; one value where all
        are the same."""
        with localcontext() as context:
            context.prec = DIGITS
            height, spacing = self.dimension - 1, 2 * Decimal(self.radius)
            (low, fall), (high, rise) = ((state[component], state[3]) for state in self.states)
            last = self.shape[-1] - 1
            steps = range(self.shape[component]) if component < height else [last]
            at = [spacing * step for step in steps] if fall or rise else [Decimal(0)]
            return [low + fall * x for x in at], [high + rise * x for x in at]

    @cached_property
    def jump(self) -> dict[int, Enclosure]:
        """The same in doubles, (layers,) or (1,) each."""
        return {k: Enclosure.of_decimals(values) for k, values in self.exact_jump.items()}

    @cached_property
    def jump_size(self) -> float:
        """|difference of the imposed spins|, rounded, the largest on the top; 1/time."""
        return (
            math.sqrt(sum(max(float(v) * float(v) for v in jump) for jump in self.exact_jump.values())) * self.spin_unit
        )

    @cached_property
    def spin_unit(self) -> float:
        """A power of two near the jump; 1 without one."""
        jumps = (high - low for k in self.components for low, high in zip(*self.imposed_in_layers(k), strict=True))
        return power_of_two(max(abs(float(jump)) for jump in jumps))

    @cached_property
    def force_unit(self) -> float:
        """A power of two near the largest friction, or without friction near the force of damping at `spin_unit`."""
        strength = self.normal_force if self.holds else power_of_two(self.radius * self.spin_unit)
        return power_of_two(max(float(c.max()) for c in self.coefficient) * strength)

    @cached_property
    def sublattice(self) -> np.ndarray:
        """s = +1 or -1, (*N,)."""
        return 1.0 - 2.0 * (np.indices(self.shape).sum(axis=0) % 2)

    def jump_at(self, component: int) -> Enclosure:
        """(R * N,), the jump of a component in the layer of each sphere; read-only where it is the same in all."""
        jump, count = self.jump[component], self.count * self.sublattice.size
        if len(jump.high) == 1:
            return jump.spread((count,))
        return jump.at(np.tile(self.layer(component), self.count))

    def layer(self, component: int) -> np.ndarray:
        """(N,), the layer of `jump` of each sphere: its number along k, or 0 where the top turns as one."""
        if len(self.exact_jump[component]) == 1:
            return np.zeros(math.prod(self.shape), dtype=np.int64)
        return np.indices(self.shape)[component].ravel()

    def leader(self, component: int) -> np.ndarray:
        """(2, R * N), the first spheres of the bottom and of the top in the layer of each sphere, which turn about k as
        all driven ones there."""
        first = self.layer(component) * math.prod(self.shape[component + 1 :])
        low = (np.arange(self.count)[:, None] * first.size + first).ravel()
        return np.stack([low, low + self.shape[-1] - 1])

    def as_led(self, values: np.ndarray, component: int) -> np.ndarray:
        """The same array (R * N,), in which driven spheres have what the first of their plane and layer has."""
        spheres = values.reshape(self.count, *self.shape)
        first = [slice(None), *[slice(0, 1)] * (self.dimension - 1)]
        if len(self.exact_jump[component]) > 1:
            first[1 + component] = slice(None)
        for plane in (spheres[..., 0], spheres[..., -1]):
            plane[...] = plane[tuple(first)].copy()
        return values

    def anchor(self, component: int) -> np.ndarray:
        """(R * N,), the sphere that each turns as along a component: itself, or the first of its plane and layer."""
        return self.as_led(np.arange(self.count * self.sublattice.size), component)

    @cached_property
    def signed_spin(self) -> dict[int, Enclosure]:
        """(R * N,) component by component, spins with the sign of their sublattice, in units of `spin_unit`; driven
        spheres as their leaders. Without any error."""
        sign, found = self.sublattice / self.spin_unit, {}  # a power of two
        for at, k in enumerate(self.components):
            pair = (
                part.reshape(self.count, *self.shape, -1)[..., at] * sign for part in (self.spin, self.spin_rounding)
            )
            high, low, error = Enclosure.exact(*(part.reshape(-1) for part in pair)).parts
            found[k] = Enclosure(self.as_led(high, k), self.as_led(low, k), error)
        return found

    @cached_property
    def shift(self) -> dict[int, Enclosure]:
        """(R * N,) by component, what the signed spin of spheres of the top, as stored, lacks of the imposed one,
        measured from the bottom; 0 of all others."""
        return {k: self._shift(k, stored) for k, stored in self.signed_spin.items()}

    def _shift(self, component: int, stored: Enclosure) -> Enclosure:
        jump, size = self.exact_jump[component], self.sublattice.size
        first = np.arange(self.count)[:, None] * size
        if len(jump) > 1:
            first = first + np.arange(len(jump)) * math.prod(self.shape[component + 1 :])
        bottom, top = (stored.at(end.ravel()).parts[:2] for end in (first, first + self.shape[-1] - 1))
        with localcontext() as context:
            context.prec = DIGITS
            given = zip(*(np.transpose(pair).tolist() for pair in (bottom, top)), strict=True)
            missing = [
                jump[number % len(jump)] + sum(Decimal(v) for v in (*low, *(-v for v in high)))
                for number, (low, high) in enumerate(given)
            ]
            exact = Enclosure.of_decimals(missing)
        found = Enclosure.exact(np.zeros(self.count * size))
        along = [1] * (self.dimension - 1)
        along[component if len(jump) > 1 else 0] = len(jump)
        for whole, values in zip(found.parts, exact.parts, strict=True):
            whole.reshape(self.count, *self.shape)[..., -1] = values.reshape(self.count, *along)
        return found

    def flat(self, of_axes: Iterable[np.ndarray]) -> np.ndarray:
        """(R, E) from arrays (R, *contacts) an axis: all contacts along x, then y, then z."""
        return np.concatenate([values.reshape(self.count, -1) for values in of_axes], axis=1)

    @property
    def flat_friction(self) -> np.ndarray:
        """The same of friction, (R, E, C)."""
        parts = [of.reshape(self.count, -1, len(self.components)) for of in self.friction]
        return np.concatenate(parts, axis=1)

    @property
    def is_finite(self) -> bool:
        return all(np.isfinite(values).all() for values in (self.spin, self.spin_rounding, *self.friction))


def power_of_two(value: float) -> float:
    """The largest power of two up to |value|; 1 for 0."""
    return float(np.ldexp(1.0, int(np.frexp(abs(value))[1]) - 1)) if value else 1.0
