"""What drives a scene: the bearing states that are imposed on the top and on the bottom plane, or a torque on the top.

A bearing state is a staggered spin A + C x, with the position x measured from the centre of sphere (0, 0, 0): no
contact slips in it, because the ends of a contact differ along the contact alone. A state can therefore be taken from
all spins, and here that of the bottom is: the bottom is then at rest, and the top carries the *jump*, the difference of
the two states. Component k of the jump depends on x_k alone, and contacts along k do not feel it: each layer x_k =
const has a problem of its own in that component. Discs have one component, and no C.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.double_double import (
    Pair,
    add,
    divide,
    exactly,
    multiply,
    square_root,
    two_product,
    two_sum,
)


@dataclass(frozen=True)
class BearingState:
    """Staggered spin A + C x, in twice the precision. spin : A, (3,), 1/time. rate : C, (1,), 1/(time length)."""

    spin: Pair
    rate: Pair

    def along(self, component: int, position: np.ndarray) -> Pair:
        """Component k at positions x_k, (n,), length."""
        high, low = (np.repeat(part[component], len(position)) for part in self.spin)
        return add((high, low), multiply(self.rate, exactly(position))) if self.rate[0][0] else (high, low)


@dataclass(frozen=True, eq=False)
class Driving:
    """bottom : state imposed on the bottom plane. jump : that of the top less that of the bottom.

    unit : (1,), what spins are measured in where they are to be of order one, 1/time, in twice the precision; in_units
    : the jump in this unit where it is the same on the whole top, else None.
    """

    lattice: Lattice
    bottom: BearingState
    jump: BearingState
    unit: Pair
    in_units: BearingState | None = None

    @classmethod
    def by_spins(cls, lattice: Lattice, top: float, bottom: float, direction: tuple[float, float, float]) -> "Driving":
        """Planes that turn with spins about one axis (paper, Eq. 1). direction : its, not normalised; of spheres."""
        axis = _unit_vector(np.array([0.0, 0.0, 1.0] if lattice.dimension == 2 else direction))
        at_rest, sign = exactly(np.zeros(1)), np.sign(top - bottom)
        low = BearingState(multiply(exactly(np.array([bottom])), axis), at_rest)
        jump = BearingState(multiply(two_sum(np.array([top]), np.array([-bottom])), axis), at_rest)
        unit = two_sum(np.array([sign * top]), np.array([-sign * bottom]))
        return cls(lattice, low, jump, unit, BearingState((sign * axis[0], sign * axis[1]), at_rest))

    @classmethod
    def by_states(cls, lattice: Lattice, top: tuple[float, ...], bottom: tuple[float, ...]) -> "Driving":
        """Planes in the bearing states (A_x, A_y, A_z, C); discs have (A_z,)."""
        padded = ((0.0, 0.0, *state, 0.0) if len(state) == 1 else state for state in (top, bottom))
        (high, rise), (low, fall) = ((np.array(state[:3]), np.array(state[3:])) for state in padded)
        states = BearingState(exactly(low), exactly(fall)), BearingState(two_sum(high, -low), two_sum(rise, -fall))
        largest = cls(lattice, *states, exactly(np.ones(1))).largest_jump
        return cls(lattice, *states, exactly(np.exp2(np.floor(np.log2([largest or 1.0])))))

    def positions(self, component: int) -> np.ndarray:
        """x_k, (n,), of the layers of spheres along k, length; of discs (1,)."""
        if self.lattice.dimension == 2:
            return np.zeros(1)
        return 2 * self.lattice.radius * np.arange(self.lattice.shape[component])

    def _of_layers(self, state: BearingState, spin_axes: tuple[int, ...], shape: tuple[int, ...]) -> Pair:
        """A state at the spheres of the first layers, as many along each axis as `shape` says, (C, *shape), in twice
        the precision, 1/time; components along an axis that it lacks are those of the last layer."""
        found = np.empty((2, len(spin_axes), *shape))
        for slot, k in enumerate(spin_axes):
            position = self.positions(k)
            pair = state.along(k, position[: shape[k]] if k < len(shape) else position[-1:])
            for whole, part in zip(found, pair, strict=True):
                whole[slot] = part.reshape([-1 if a == k else 1 for a in range(len(shape))])
        return found[0], found[1]

    @cached_property
    def _all_on_top(self) -> Pair:
        """Jump at each sphere of the top plane by every component of the lattice."""
        return self._of_layers(self.jump, self.lattice.all_spin_axes, self.lattice.shape[:-1])

    def imposed_on_top(self, spin_axes: tuple[int, ...]) -> Pair:
        """The same of these components, (C, nx, ny), in 2D (C, nx)."""
        slots = [self.lattice.all_spin_axes.index(k) for k in spin_axes]
        high, low = self._all_on_top
        return high[slots], low[slots]

    def top_in_units(self, spin_axes: tuple[int, ...]) -> Pair:
        """The same over `unit`, a power of two where the jump varies."""
        if self.in_units is not None:
            return self._of_layers(self.in_units, spin_axes, self.lattice.shape[:-1])
        high, low = self.imposed_on_top(spin_axes)
        return high / self.unit[0], low / self.unit[0]

    def bottom_state(self, spin_axes: tuple[int, ...]) -> Pair:
        """Staggered spin of the bottom's state at all spheres, (C, 1, *N) or with sides of 1 where it does not vary, in
        twice the precision, 1/time."""
        varies = bool(self.bottom.rate[0][0])
        high, low = self._of_layers(
            self.bottom, spin_axes, self.lattice.shape if varies else (1,) * self.lattice.dimension
        )
        return high[:, None], low[:, None]

    @cached_property
    def largest_jump(self) -> float:
        """|jump| where it is largest on the top plane, 1/time: the natural unit of spin differences."""
        if self.in_units is not None:
            return float(self.unit[0][0])
        return float(np.linalg.norm(self.imposed_on_top(self.lattice.all_spin_axes)[0], axis=0).max())

    @property
    def largest_spins(self) -> tuple[float, float]:
        """|spin| imposed on the top and on the bottom, where it is largest, 1/time."""
        axes = self.lattice.all_spin_axes
        whole, rest = (
            np.broadcast_to(part[:, 0], (len(axes), *self.lattice.shape)) for part in self.bottom_state(axes)
        )
        high = add((whole[..., -1], rest[..., -1]), self.imposed_on_top(axes))[0]
        return tuple(float(np.linalg.norm(of, axis=0).max()) for of in (high, whole[..., 0]))  # type: ignore[return-value]


def _unit_vector(vector: np.ndarray) -> Pair:
    """(3,) along a vector that is not 0, in twice the precision."""
    vector = np.asarray(vector, dtype=np.float64)
    vector = np.ldexp(vector, -int(np.frexp(np.abs(vector).max())[1]))
    squares = two_product(vector, vector)
    total = exactly(np.zeros(1))
    for k in range(3):
        total = add(total, (squares[0][k : k + 1], squares[1][k : k + 1]))
    return divide(exactly(vector), square_root(total))
