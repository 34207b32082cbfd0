"""What is imposed on the two planes of a lattice, to 300 digits: proofs are of these numbers, not of their roundings.

Spins, bearing states and the direction count as the doubles that they are. A bearing state is A + C x, with x from the
centre of sphere (0, 0, 0); spins about a direction are A = omega d / |d| and C = 0. Component k of a state depends on
x_k alone, so what is said of a component is said layer by layer along k (scene/driving.py, in twice the precision).
"""

import math
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import cached_property

from taichi_bearings.lattice import Lattice

DIGITS = 300
State = tuple[Decimal, Decimal, Decimal, Decimal]
"""(A_x, A_y, A_z, C), 1/time and 1/(time length)."""


@dataclass(frozen=True)
class ExactDriving:
    """bottom, top : the states of the two planes."""

    lattice: Lattice
    bottom: State
    top: State

    @classmethod
    def by_spins(cls, lattice: Lattice, top: float, bottom: float, direction: tuple[float, ...]) -> "ExactDriving":
        """Planes that turn with these spins, of spheres about the direction."""
        with localcontext() as context:
            context.prec = DIGITS
            parts = [Decimal(d) for d in ((0.0, 0.0, 1.0) if lattice.dimension == 2 else direction)]
            size = sum((part * part for part in parts), Decimal(0)).sqrt()
            low, high = ((*(Decimal(spin) * part / size for part in parts), Decimal(0)) for spin in (bottom, top))
        return cls(lattice, low, high)  # type: ignore[arg-type]

    @classmethod
    def by_states(cls, lattice: Lattice, top: tuple[float, ...], bottom: tuple[float, ...]) -> "ExactDriving":
        """Planes in the states (A_x, A_y, A_z, C); discs have (A_z,)."""
        padded = ((0.0, 0.0, *state, 0.0) if len(state) == 1 else state for state in (bottom, top))
        low, high = (tuple(Decimal(part) for part in state) for state in padded)
        return cls(lattice, low, high)  # type: ignore[arg-type]

    def in_layers(self, component: int) -> tuple[list[Decimal], list[Decimal]]:
        """A component of the states of bottom and top at the top plane, layer by layer along it; one value where all
        are the same."""
        with localcontext() as context:
            context.prec = DIGITS
            height, spacing = self.lattice.height_axis, 2 * Decimal(self.lattice.radius)
            (low, fall), (high, rise) = ((state[component], state[3]) for state in (self.bottom, self.top))
            steps = range(self.lattice.shape[component]) if component < height else [self.lattice.shape[-1] - 1]
            at = [spacing * step for step in steps] if fall or rise else [Decimal(0)]
            return [low + fall * x for x in at], [high + rise * x for x in at]

    @cached_property
    def unit(self) -> float:
        """A power of two near the jump, the difference of both states on the top plane; 1 without one."""
        jumps = [high - low for k in self.lattice.all_spin_axes for low, high in zip(*self.in_layers(k), strict=True)]
        return power_of_two(max(abs(float(jump)) for jump in jumps))

    @cached_property
    def jump(self) -> dict[int, list[Decimal]]:
        """By component k, the state of the top less that of the bottom over `unit`, in each layer along k; one value
        where all are the same."""
        with localcontext() as context:
            context.prec = DIGITS
            unit, every = Decimal(self.unit), self.lattice.all_spin_axes
            return {k: [(high - low) / unit for low, high in zip(*self.in_layers(k), strict=True)] for k in every}

    @cached_property
    def jump_size(self) -> float:
        """|jump| where it is largest on the top plane, rounded; 1/time."""
        return math.sqrt(sum(max(float(v) * float(v) for v in jump) for jump in self.jump.values())) * self.unit


def power_of_two(value: float) -> float:
    """The largest power of two up to |value|; 1 for 0."""
    return math.ldexp(1.0, math.frexp(abs(value))[1] - 1) if value else 1.0
