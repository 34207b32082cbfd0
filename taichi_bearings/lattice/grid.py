"""The square or cubic lattice of touching spheres and its contacts.

Contacts are named by (axis, lower site): contact [i, j, k] of axis a joins sphere (i, j, k) with its upper neighbour
along a, so an array over the contacts of axis a is one shorter than the lattice along a. The last axis is the height;
its first and last planes are driven. Spins are kept by component: ``spin_axes`` names the components a computation
carries, e.g. (2,) in 2D and (0, 1) for a cubic lattice driven in the xy plane.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.words import shown

MOST_SITES = 2**31 - 1  # Taichi indexes with 32-bit integers and would silently run nothing beyond


@dataclass(frozen=True)
class Lattice:
    """A square lattice ``(nx, ny)`` of discs or a cubic one ``(nx, ny, nz)`` of spheres that touch their neighbours.

    shape : number of spheres along each axis, height last.
    radius : length; half the lattice spacing.
    """

    shape: tuple[int, ...]
    radius: float = 0.5

    def __post_init__(self) -> None:
        if len(self.shape) not in (2, 3):
            raise InputError(f"shape is {shown(list(self.shape))}; it must have two or three numbers")
        if min(self.shape) < 2:
            raise InputError(f"shape is {shown(list(self.shape))}; every side must be 2 or more")
        if self.shape[-1] < 3:
            raise InputError(f"shape is {shown(list(self.shape))}; the height (last number) must be 3 or more")
        if self.sites > MOST_SITES // 8:
            raise InputError(f"shape is {shown(list(self.shape))}; at most {MOST_SITES // 8} spheres can be indexed")
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise InputError(f"radius is {self.radius}; it must be a positive number")

    @property
    def dimension(self) -> int:
        return len(self.shape)

    @property
    def height_axis(self) -> int:
        return self.dimension - 1

    @property
    def free_shape(self) -> tuple[int, ...]:
        """Free spheres along each axis."""
        return (*self.shape[:-1], self.shape[-1] - 2)

    @property
    def sites(self) -> int:
        return math.prod(int(n) for n in self.shape)

    @property
    def all_spin_axes(self) -> tuple[int, ...]:
        """Every component a spin of this lattice can have: z in 2D; x, y, z in 3D."""
        return (2,) if self.dimension == 2 else (0, 1, 2)

    def contact_shape(self, axis: int) -> tuple[int, ...]:
        return tuple(n - (a == axis) for a, n in enumerate(self.shape))

    @cached_property
    def parity(self) -> np.ndarray:
        """s = +1 or -1 by sublattice, shape N: neighbours differ, and a bearing state has equal s * spin."""
        return 1 - 2 * (np.indices(self.shape).sum(axis=0) % 2)

    def lower_parity(self, axis: int) -> np.ndarray:
        """That of the lower sphere of each contact of `axis`."""
        return self.parity[tuple(slice(n) for n in self.contact_shape(axis))]

    @cached_property
    def is_driven(self) -> np.ndarray:
        """True for the spheres whose spin is imposed, shape N."""
        driven = np.zeros(self.shape, dtype=bool)
        driven[..., 0] = driven[..., -1] = True
        return driven

    def between_driven(self, axis: int) -> np.ndarray:
        """True for the contacts that join two driven spheres: they never slip and are left out of every sum."""
        between = np.zeros(self.contact_shape(axis), dtype=bool)
        if axis != self.height_axis:
            between[..., 0] = between[..., -1] = True
        return between

    @cached_property
    def contacts(self) -> int:
        """Number of contacts that can slip."""
        return sum(int((~self.between_driven(a)).sum()) for a in range(self.dimension))


def tangential(axis: int, spin_axes: tuple[int, ...]) -> tuple[int, ...]:
    """Positions in `spin_axes` of the components that make a contact along `axis` slip: all but the one along it."""
    return tuple(slot for slot, component in enumerate(spin_axes) if component != axis)


def laboratory_forces(
    force: tuple[np.ndarray, ...], lattice: Lattice, spin_axes: tuple[int, ...]
) -> tuple[np.ndarray, ...]:
    """Friction on the upper sphere of each contact in the laboratory frame, of forces along the spin difference.

    force : one array (T, R, *contacts) an axis, f. The friction is -s f x n, with n the direction of the contact and s
    the sign of its lower sphere: it opposes the slip of paper Eq. 2, s R Delta Omega x n.
    returns : one array (R, *contacts, 3) an axis; in 2D (R, *contacts), the component along z x n, which is upwards at
    contacts along x and to the left at contacts along y. The lower sphere feels the opposite force.
    """
    found = []
    for axis, values in enumerate(force):
        sign = lattice.lower_parity(axis)
        if lattice.dimension == 2:
            found.append(-sign * values[0])
            continue
        friction = np.zeros((*values.shape[1:], 3))
        for part, slot in zip(values, tangential(axis, spin_axes), strict=True):
            turned, turn = _turned(axis, spin_axes[slot])
            friction[..., turned] = turn * sign * part
        found.append(friction)
    return tuple(found)


def staggered_forces(
    friction: tuple[np.ndarray, ...], lattice: Lattice, spin_axes: tuple[int, ...]
) -> tuple[np.ndarray, ...]:
    """Inverse of :func:`laboratory_forces` for the components that `spin_axes` names: (T, R, *contacts) an axis."""
    found = []
    for axis, values in enumerate(friction):
        sign = lattice.lower_parity(axis)
        if lattice.dimension == 2:
            found.append(-sign * values[None])
            continue
        parts = np.empty((len(tangential(axis, spin_axes)), *values.shape[:-1]))
        for part, slot in zip(parts, tangential(axis, spin_axes), strict=True):
            turned, turn = _turned(axis, spin_axes[slot])
            part[...] = turn * sign * values[..., turned]
        found.append(parts)
    return tuple(found)


def _turned(axis: int, component: int) -> tuple[int, int]:
    """Laboratory axis and sign of -e_component x e_axis."""
    return 3 - axis - component, 1 if (component - axis) % 3 == 1 else -1
