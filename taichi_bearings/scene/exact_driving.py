"""What is imposed on the two planes of a lattice, to 300 digits: proofs are of these numbers, not of their roundings.

The doubles that users give for spins, bearing states and the direction are taken as exact. A bearing state is the
staggered spin A + C x, with x from the centre of sphere (0, 0, 0). A spin omega about a direction d is the state A =
omega d / |d| and C = 0. Component k of a state depends on x_k alone, so it has one value for each layer of spheres
along k. scene/driving.py has the same states in twice the precision.

jump : the state of the top less that of the bottom.
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
    """The bearing states A + C x that are imposed on the two planes of a lattice, to 300 digits.

    lattice : the lattice, whose first and last planes are driven.
    bottom, top : the states, four numbers each: A_x, A_y, A_z in 1/time and C in 1/(time length).
    """

    lattice: Lattice
    bottom: State
    top: State

    @classmethod
    def by_spins(cls, lattice: Lattice, top: float, bottom: float, direction: tuple[float, ...]) -> "ExactDriving":
        """Return the driving of planes that turn about one axis.

        lattice : the lattice, whose first and last planes are driven.
        top, bottom : spins of the two planes, 1/time.
        direction : the axis, of any length but 0; ignored in 2D, where spins point along z.
        """
        with localcontext() as context:
            context.prec = DIGITS
            parts = [Decimal(d) for d in ((0.0, 0.0, 1.0) if lattice.dimension == 2 else direction)]
            size = sum((part * part for part in parts), Decimal(0)).sqrt()
            low, high = ((*(Decimal(spin) * part / size for part in parts), Decimal(0)) for spin in (bottom, top))
        return cls(lattice, low, high)  # type: ignore[arg-type]

    @classmethod
    def by_states(cls, lattice: Lattice, top: tuple[float, ...], bottom: tuple[float, ...]) -> "ExactDriving":
        """Return the driving of planes in bearing states: staggered spins A + C x at position x.

        lattice : the lattice, whose first and last planes are driven.
        top, bottom : the numbers (A_x, A_y, A_z, C) of the plane, or in 2D (A_z,): the vector A in 1/time, the rate C
            in 1/(time length).
        """
        padded = ((0.0, 0.0, *state, 0.0) if len(state) == 1 else state for state in (bottom, top))
        low, high = (tuple(Decimal(part) for part in state) for state in padded)
        return cls(lattice, low, high)  # type: ignore[arg-type]

    def in_layers(self, component: int) -> tuple[list[Decimal], list[Decimal]]:
        """Return one component k of the two states at the top plane, 1/time: a list for the bottom, one for the top.

        Each has a value for every layer of spheres along k, or a single value where all are the same. For k along the
        height only the last layer is in the top plane.

        component : k.
        """
        with localcontext() as context:
            context.prec = DIGITS
            height, spacing = self.lattice.height_axis, 2 * Decimal(self.lattice.radius)
            (low, fall), (high, rise) = ((state[component], state[3]) for state in (self.bottom, self.top))
            steps = range(self.lattice.shape[component]) if component < height else [self.lattice.shape[-1] - 1]
            at = [spacing * step for step in steps] if fall or rise else [Decimal(0)]
            return [low + fall * x for x in at], [high + rise * x for x in at]

    @cached_property
    def unit(self) -> float:
        """A power of two near the largest component of the jump on the top plane, 1/time; 1 where the jump is 0. The
        jump is the state of the top less that of the bottom.
        """
        jumps = [high - low for k in self.lattice.all_spin_axes for low, high in zip(*self.in_layers(k), strict=True)]
        return power_of_two(max(abs(float(jump)) for jump in jumps))

    @cached_property
    def jump(self) -> dict[int, list[Decimal]]:
        """The jump, the state of the top less that of the bottom, divided by `unit`: a dictionary in which the key is
        the number k of a component, and the value a list of its numbers of 300 digits in the layers of spheres along k,
        or a single one for all layers.
        """
        with localcontext() as context:
            context.prec = DIGITS
            unit, every = Decimal(self.unit), self.lattice.all_spin_axes
            return {k: [(high - low) / unit for low, high in zip(*self.in_layers(k), strict=True)] for k in every}

    @cached_property
    def jump_size(self) -> float:
        """Largest size of the jump, the state of the top less that of the bottom, on the top plane, 1/time, as a
        rounded double.
        """
        return math.sqrt(sum(max(float(v) * float(v) for v in jump) for jump in self.jump.values())) * self.unit


def power_of_two(value: float) -> float:
    """Return the largest power of two that is not above |value|; 1 for 0."""
    return math.ldexp(1.0, math.frexp(abs(value))[1] - 1) if value else 1.0
