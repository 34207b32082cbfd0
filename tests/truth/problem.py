"""The contacts and unknowns of one sample, and the bounds on its least power that spins and forces prove."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import arb

from tests.truth.cones import ball, exact, length


@dataclass
class Contact:
    axis: int
    index: tuple[int, ...]
    friction: arb
    lower: list[int]  # unknown of each felt component at the lower sphere, -1 at the bottom, -2 at the top
    upper: list[int]
    offset: list[arb]


class Problem:
    """Contacts and unknowns of one sample.

    coefficient : one array (*contacts) an axis. perturbation : seed and size; coefficients times 1 + size * u, |u| < 1.
    """

    def __init__(
        self, coefficient, normal_force, radius, spin_top, spin_bottom, direction=(1, 1, 0), perturbation=None
    ):
        self.coefficient = [np.asarray(c, dtype=np.float64) for c in coefficient]
        self.dimension = len(self.coefficient)
        self.shape = tuple(n + (a == 0) for a, n in enumerate(self.coefficient[0].shape))
        self.normal_force, self.radius = Fraction(float(normal_force)), Fraction(float(radius))
        self.speed = Fraction(float(spin_top)) - Fraction(float(spin_bottom))
        self.direction = (
            [Fraction(0), Fraction(0), Fraction(1)] if self.dimension == 2 else [Fraction(float(v)) for v in direction]
        )
        candidates = (2,) if self.dimension == 2 else (0, 1)
        self.components = [k for k in candidates if self.direction[k] and self.speed]
        self.perturbation = perturbation

    def build(self):
        """All numbers in the precision that is set now."""
        norm = ball(sum(v * v for v in self.direction)).sqrt()
        self.unit_jump = [ball(self.direction[k]) / norm for k in self.components]
        values = [Fraction(v) for c in self.coefficient for v in c.ravel().tolist()]
        self.scale = sum(values) / len(values)
        rng = None if self.perturbation is None else np.random.default_rng(self.perturbation[0])
        free = self.shape[:-1] + (self.shape[-1] - 2,)
        order = np.arange(int(np.prod(free))).reshape(free[-1:] + free[:-1])  # layer by layer
        order = np.moveaxis(order, 0, -1)
        count, self.unknowns = len(self.components), int(np.prod(free)) * len(self.components)
        number = np.full((count, *self.shape), -1)
        number[..., -1] = -2
        for slot in range(count):
            number[slot][..., 1:-1] = order * count + slot
        self.contacts, self.unfelt = [], []
        for axis, values in enumerate(self.coefficient):
            felt = [slot for slot, k in enumerate(self.components) if k != axis]
            for index in np.ndindex(values.shape):
                u = 0.0 if rng is None else rng.uniform(-1, 1)
                above = tuple(i + (a == axis) for a, i in enumerate(index))
                if axis < self.dimension - 1 and index[-1] in (0, self.shape[-1] - 1):
                    continue
                if not felt:
                    self.unfelt.append((axis, index))
                    continue
                friction = ball(Fraction(float(values[index])) / self.scale)
                if rng is not None:
                    friction = (friction * (1 + arb(self.perturbation[1]) * exact(u))).mid()
                lower = [int(number[(slot, *index)]) for slot in felt]
                upper = [int(number[(slot, *above)]) for slot in felt]
                offset = [
                    self.unit_jump[slot] * ((up == -2) - (low == -2))
                    for slot, low, up in zip(felt, lower, upper, strict=True)
                ]
                self.contacts.append(Contact(axis, index, friction, lower, upper, offset))

    def height_profile(self):
        """Spins (unknowns,) that go linearly from bottom to top: where the path begins."""
        free, count = self.shape[-1] - 2, len(self.components)
        layer = self.unknowns // (free * count)
        return [self.unit_jump[i % count].mid() * (i // (layer * count) + 1) / (free + 1) for i in range(self.unknowns)]

    def differences(self, spins):
        return [
            [
                b + (spins[up] if up >= 0 else 0) - (spins[low] if low >= 0 else 0)
                for b, low, up in zip(c.offset, c.lower, c.upper, strict=True)
            ]
            for c in self.contacts
        ]

    def changes(self, steps):
        return [
            [
                (steps[up] if up >= 0 else 0) - (steps[low] if low >= 0 else arb(0))
                for low, up in zip(c.lower, c.upper, strict=True)
            ]
            for c in self.contacts
        ]

    def gathered(self, forces):
        """A' f, (unknowns,)."""
        total = [arb(0)] * self.unknowns
        for c, force in zip(self.contacts, forces, strict=True):
            for f, low, up in zip(force, c.lower, c.upper, strict=True):
                if up >= 0:
                    total[up] += f
                if low >= 0:
                    total[low] -= f
        return total

    def unit(self) -> arb:
        """What turns the power of the problem in its own units into energy/time."""
        return ball(self.normal_force * self.radius * abs(self.speed) * self.scale)

    def bounds(self, spins, forces) -> tuple[arb, arb]:
        """Power of the spins, and what the forces prove: scaled into the discs, leftover torques paid for."""
        power = sum(
            (c.friction * length(d) for c, d in zip(self.contacts, self.differences(spins), strict=True)), arb(0)
        )
        worst = arb(1)
        for c, f in zip(self.contacts, forces, strict=True):
            worst = worst.max(length(f) / c.friction)
        work = sum(
            (
                f * b
                for c, force in zip(self.contacts, forces, strict=True)
                for f, b in zip(force, c.offset, strict=True)
            ),
            arb(0),
        )
        count = len(self.components)
        torque = self.gathered(forces)
        paid = sum((abs(t) * abs(self.unit_jump[i % count]) for i, t in enumerate(torque)), arb(0))
        return power, (work - paid) / worst
