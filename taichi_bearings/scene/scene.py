"""What is solved: a lattice, a contact law, a coefficient for every contact, and the imposed bearing states."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import contact_differences, tangential
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

LAWS = ("coulomb", "viscous")
AXIS_NAMES = ("x", "y", "z")
LEAST_COEFFICIENT, MOST_COEFFICIENT = 1e-15, 1e15


@dataclass(frozen=True)
class Scene:
    """A frustrated bearing: R samples of the disorder (replicas) on one lattice with one driving.

    coefficient : one array (R, *contacts) an axis; friction (coulomb) or damping (viscous), all positive.
    spin_top, spin_bottom : 1/time; imposed spin of the top and bottom planes, with the sign of the sublattice.
    direction : axis of the imposed spins in 3D, normalised; ignored in 2D, where spins point along z.
    normal_force : force at every contact (coulomb).
    seeds : seed of each replica, for the record and for random initial spins.
    """

    lattice: Lattice
    law: str
    coefficient: tuple[np.ndarray, ...]
    spin_top: float = 1.0
    spin_bottom: float = 0.0
    direction: tuple[float, float, float] = (1.0, 1.0, 0.0)
    normal_force: float = 50.0
    seeds: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise InputError(f"law is {self.law!r}; allowed are {', '.join(LAWS)}")
        for name in ("spin_top", "spin_bottom", "normal_force"):
            if not np.isfinite(getattr(self, name)):
                raise InputError(f"{name} is {getattr(self, name)}; it must be a finite number")
        if self.normal_force <= 0:
            raise InputError(f"normal_force is {self.normal_force}; it must be positive")
        if len(self.direction) != 3 or not np.all(np.isfinite(self.direction)) or not np.any(self.direction):
            raise InputError(f"direction is {list(self.direction)}; it must be three finite numbers, not all zero")
        for axis in range(self.lattice.dimension):
            self._check_coefficients(axis)

    def _check_coefficients(self, axis: int) -> None:
        name, expected = AXIS_NAMES[axis], (len(self.seeds), *self.lattice.contact_shape(axis))
        values = self.coefficient[axis]
        if values.shape != expected:
            raise InputError(f"coefficients along {name} have shape {values.shape}; this lattice needs {expected}")
        bad = ~((values >= LEAST_COEFFICIENT) & (values <= MOST_COEFFICIENT))
        if bad.any():
            where = tuple(int(i) for i in np.argwhere(bad)[0])
            raise InputError(
                f"coefficient {values[where]} at {list(where[1:])} along {name} is not allowed; "
                "every coefficient must be a positive number from 1e-15 to 1e15"
            )

    @property
    def replicas(self) -> int:
        return len(self.seeds)

    @cached_property
    def axis_pair(self) -> Pair:
        """Unit vector (3,) of the imposed spins, in twice the precision."""
        vector = np.array([0.0, 0.0, 1.0] if self.lattice.dimension == 2 else self.direction, dtype=np.float64)
        vector = np.ldexp(vector, -int(np.frexp(np.abs(vector).max())[1]))
        squares = two_product(vector, vector)
        total = exactly(np.zeros(1))
        for k in range(3):
            total = add(total, (squares[0][k : k + 1], squares[1][k : k + 1]))
        return divide(exactly(vector), square_root(total))

    @property
    def axis_vector(self) -> np.ndarray:
        """Unit vector (3,) of the imposed spins."""
        return self.axis_pair[0]

    @cached_property
    def minimum_spin_axes(self) -> tuple[int, ...]:
        """Components the minimum needs.

        Where top and bottom agree, the staggered spin is constant (PHYSICS 3.3). Nor is the component along the height
        of a cubic lattice ever needed: contacts along the height do not feel it, so it is constant in each layer.
        """
        jump = self.jump_pair[0]
        height = self.lattice.height_axis
        needed = tuple(k for k in self.lattice.all_spin_axes if jump[k] != 0.0 and k != height)
        return needed or self.lattice.all_spin_axes[:1]  # no frustration: one component, to have something to show

    def driven_values(self, spin_axes: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Staggered spin (C,) of the bottom and of the top plane: zero and the jump.

        All staggered spins are measured from the bottom, whose bearing state makes no contact slip (PHYSICS 3.1).
        Where the driving is nearly equal, slips are then not lost in the rounding of the spins.
        """
        top = self.jump_pair[0][list(spin_axes)]
        return np.zeros_like(top), top

    @cached_property
    def jump_pair(self) -> Pair:
        """Imposed staggered spin (3,) of the top above that of the bottom, in twice the precision, 1/time."""
        return multiply(two_sum(np.array([self.spin_top]), np.array([-self.spin_bottom])), self.axis_pair)

    @cached_property
    def bottom_pair(self) -> Pair:
        """Staggered spin (3,) of the bottom, from which all others are measured, in twice the precision, 1/time."""
        return multiply(exactly(np.array([self.spin_bottom])), self.axis_pair)

    def bottom_spin(self, spin_axes: tuple[int, ...]) -> np.ndarray:
        """(C,) what the staggered spins are measured from, 1/time."""
        return self.bottom_pair[0][list(spin_axes)]

    @property
    def jump(self) -> float:
        """|difference of the imposed staggered spins|, 1/time: the natural unit of spin differences."""
        return abs(self.spin_top - self.spin_bottom)

    @property
    def strength(self) -> float:
        """Factor that turns a coefficient into a contact force: the normal force, or 1 for the viscous law."""
        return self.normal_force if self.law == "coulomb" else 1.0

    @cached_property
    def acting_coefficient(self) -> tuple[np.ndarray, ...]:
        """The coefficients with 0 for contacts between two driven spheres, which take no part."""
        return tuple(
            np.where(self.lattice.between_driven(axis), 0.0, values) for axis, values in enumerate(self.coefficient)
        )

    def power_of(self, slip: np.ndarray, axis: int) -> np.ndarray:
        """Power dissipated at the contacts of `axis` with slip speed `slip` (R, *contacts)."""
        force = self.strength * self.acting_coefficient[axis]
        return force * slip if self.law == "coulomb" else force * slip**2

    def slips(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> tuple[np.ndarray, ...]:
        """Slip speed |v| of every contact (paper Eq. 2), one array (R, *contacts) an axis, length/time."""
        differences = contact_differences(staggered, self.lattice, spin_axes)
        return tuple(self.lattice.radius * vector_length(values) for values in differences)

    def contact_powers(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> tuple[np.ndarray, ...]:
        """Power of every contact (paper Eq. 4, each contact once), one array (R, *contacts) an axis."""
        return tuple(self.power_of(slip, axis) for axis, slip in enumerate(self.slips(staggered, spin_axes)))

    def power(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Dissipated power (R,), energy/time: an upper bound on the least power whatever the spins are."""
        per_contact = self.contact_powers(staggered, spin_axes)
        return np.sum([values.reshape(self.replicas, -1).sum(axis=1) for values in per_contact], axis=0)

    def laboratory_spin(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Spins as one sees them: (R, *N) in 2D, (R, *N, 3) in 3D, 1/time.

        Components left out go linearly from bottom to top, which is constant where the two agree.
        """
        return self.laboratory_pair(staggered, None, spin_axes)[0]

    def laboratory_pair(self, staggered: np.ndarray, rest: np.ndarray | None, spin_axes: tuple[int, ...]) -> Pair:
        """The same in twice the precision: spins, and what their rounding leaves out.

        rest : (C, R, *N), what is to be added to the staggered spins, if anything; of the driven planes it is known.
        """
        every = self.lattice.all_spin_axes
        high = np.empty((len(every), self.replicas, *self.lattice.shape))
        low = np.zeros_like(high)
        for slot, component in enumerate(every):
            top = self.jump_pair[0][component]
            high[slot] = np.linspace(0.0, top, self.lattice.shape[-1])
            if component in spin_axes:
                high[slot] = staggered[spin_axes.index(component)]
                if rest is not None:
                    low[slot] = rest[spin_axes.index(component)]
            if top != 0:
                low[slot][..., -1] = self.jump_pair[1][component]
        bottom = tuple(part[list(every)].reshape(-1, *(1,) * (high.ndim - 1)) for part in self.bottom_pair)
        pair = [part * self.lattice.parity for part in add((high, low), (bottom[0], bottom[1]))]
        spin, rounding = (
            p[0] if self.lattice.dimension == 2 else np.ascontiguousarray(np.moveaxis(p, 0, -1)) for p in pair
        )
        return spin, rounding

    def staggered_spin(self, spin: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Inverse of :meth:`laboratory_spin`: (C, R, *N) with the driven planes set to their imposed values."""
        if self.lattice.dimension == 2:
            staggered = (spin * self.lattice.parity)[None].astype(np.float64)
        else:
            staggered = np.moveaxis((spin * self.lattice.parity[..., None])[..., list(spin_axes)], -1, 0)
            staggered = np.ascontiguousarray(staggered, dtype=np.float64)
        staggered -= self.bottom_spin(spin_axes).reshape(-1, *(1,) * (staggered.ndim - 1))
        return self.impose_driving(staggered, spin_axes)

    def impose_driving(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """The same staggered spins (C, R, *N), changed in place: the driven planes carry their imposed values."""
        for slot, (bottom, top) in enumerate(zip(*self.driven_values(spin_axes), strict=True)):
            staggered[slot][..., 0], staggered[slot][..., -1] = bottom, top
        return staggered

    def no_force(self, spin_axes: tuple[int, ...]) -> tuple[np.ndarray, ...]:
        """Contact forces of zero, one array (T, R, *contacts) an axis."""
        return tuple(
            np.zeros((len(tangential(axis, spin_axes)), self.replicas, *self.lattice.contact_shape(axis)))
            for axis in range(self.lattice.dimension)
        )

    def clip_to_box(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Staggered spins (C, R, *N) in the interval of the driven values (PHYSICS 3.4).

        A minimiser lies there, and clipping never raises the power.
        """
        low, high = np.sort(self.driven_values(spin_axes), axis=0)
        shape = (-1, *(1,) * (staggered.ndim - 1))
        return np.clip(staggered, low.reshape(shape), high.reshape(shape))


def vector_length(components: np.ndarray) -> np.ndarray:
    """Euclidean length over the first axis; (0, ...) gives zeros, one component gives |component| exactly."""
    if len(components) == 0:
        return np.zeros(components.shape[1:])
    if len(components) == 1:
        return np.abs(components[0])
    return np.hypot(components[0], components[1])
