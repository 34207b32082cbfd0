"""The square or cubic lattice of touching spheres and its contacts.

A value on the contacts is a flat array (..., E): all contacts along x, then along y (, then along z), each axis in C
order of the lower spheres. A vector on the contacts is (C, ..., E), one row a spin component; it is 0 in the component
along the contact, at which the contact does not slip. Files and figures have one array an axis instead, one shorter
than the lattice along it: entry [i, j, k] is the contact of sphere (i, j, k) with its upper neighbour. Along a periodic
axis the last sphere is followed by the first, so the array is as long as the lattice. `by_axis` and `flat` lead from
one form to the other.

The last axis is the height; its first and last planes are driven. Spins are kept by component: ``spin_axes`` names the
components a computation carries, e.g. (2,) in 2D and (0, 1) for a cubic lattice driven in the xy plane.

Letters: C spin components, R replicas (samples), N the shape of the lattice, E contacts.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.words import shown

Index = tuple[Any, ...]  # what picks spheres out of an array over the lattice
AXIS_NAMES = ("x", "y", "z")
MOST_SITES = 2**31 - 1  # Taichi indexes with 32-bit integers; a kernel over more sites would silently do nothing


@dataclass(frozen=True)
class Lattice:
    """A square lattice ``(nx, ny)`` of discs or a cubic one ``(nx, ny, nz)`` of spheres that touch their neighbours.

    shape : number of spheres along each axis, height last.
    radius : radius of the spheres, length; half the lattice spacing.
    periodic : axes, 0 for x and 1 for y, that close on themselves: the last sphere along them touches the first. Not
        the height, and even in length: an odd ring of spheres cannot turn without slip.
    """

    shape: tuple[int, ...]
    radius: float = 0.5
    periodic: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError if shape, radius and periodic axes make no lattice."""
        if len(self.shape) not in (2, 3):
            raise InputError(f"shape is {shown(list(self.shape))}; it must have two or three numbers")
        if min(self.shape) < 2:
            raise InputError(f"shape is {shown(list(self.shape))}; every side must be 2 or more")
        if self.shape[-1] < 3:
            raise InputError(f"shape is {shown(list(self.shape))}; the height (last number) must be 3 or more")
        if self.sites > MOST_SITES // 8:
            raise InputError(f"shape is {shown(list(self.shape))}; there can be at most {MOST_SITES // 8} spheres")
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise InputError(f"radius is {self.radius}; it must be a positive number")
        for axis in self.periodic:
            self._check_periodic(axis)

    @staticmethod
    def of(contacts: Sequence[np.ndarray]) -> "Lattice":
        """Return the lattice that has these contacts.

        contacts : one array (..., *contacts) for each axis, height last. An axis with as many contacts as spheres is
            periodic if its length is even.
        """
        *sides, gaps = contacts[-1].shape[-len(contacts) :]
        own = [values.shape[axis - len(contacts)] for axis, values in enumerate(contacts)]
        closed = (axis for axis, side in enumerate(sides) if own[axis] == side and side % 2 == 0)
        return Lattice((*sides, gaps + 1), periodic=tuple(closed))

    def _check_periodic(self, axis: int) -> None:
        """Raise InputError if this axis cannot close on itself: the height, one that is not there, or one of odd
        length."""
        name = AXIS_NAMES[axis]
        if axis >= self.height_axis:
            allowed = " and ".join(AXIS_NAMES[: self.height_axis])
            raise InputError(f"periodic is {name}; with shape {shown(list(self.shape))} it can only be {allowed}")
        if self.shape[axis] % 2:
            raise InputError(
                f"periodic is {name}, along which shape {shown(list(self.shape))} has {self.shape[axis]} spheres; the "
                "number must be even, or neighbours cannot turn in opposite ways all around"
            )

    @property
    def periodic_names(self) -> tuple[str, ...]:
        """Names of the periodic axes, such as ("x",)."""
        return tuple(AXIS_NAMES[axis] for axis in self.periodic)

    @property
    def dimension(self) -> int:
        """Number of axes, 2 or 3."""
        return len(self.shape)

    @property
    def height_axis(self) -> int:
        """Number of the axis across which the lattice is driven, the last one."""
        return self.dimension - 1

    @property
    def free_shape(self) -> tuple[int, ...]:
        """Number of free spheres along each axis."""
        return (*self.shape[:-1], self.shape[-1] - 2)

    @property
    def sites(self) -> int:
        """Number of spheres."""
        return math.prod(int(n) for n in self.shape)

    @property
    def all_spin_axes(self) -> tuple[int, ...]:
        """Every component a spin of this lattice can have: z in 2D; x, y, z in 3D."""
        return (2,) if self.dimension == 2 else (0, 1, 2)

    def contact_shape(self, axis: int) -> tuple[int, ...]:
        """Return the shape of an array of the contacts along an axis: one shorter than the lattice there, unless it is
        periodic."""
        return tuple(n - (a == axis and a not in self.periodic) for a, n in enumerate(self.shape))

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        """For each axis, the slice of an array over all contacts that has the contacts along this axis."""
        ends = np.cumsum([math.prod(self.contact_shape(axis)) for axis in range(self.dimension)]).tolist()
        return tuple(slice(begin, end) for begin, end in zip([0, *ends[:-1]], ends, strict=True))

    @property
    def all_contacts(self) -> int:
        """Number of contacts, those between driven spheres included."""
        return int(self.spans[-1].stop)

    def by_axis(self, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return values (..., E) on all E contacts as a tuple of views, one for each axis: (..., *contacts) in the
        shape of the contacts along it. In `values` contacts along x come first, then those along y (then z).
        """
        head = values.shape[:-1]
        return tuple(values[..., span].reshape(*head, *self.contact_shape(a)) for a, span in enumerate(self.spans))

    def flat(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Return values (..., E) on all E contacts as one array, first those along x, then y (then z): the inverse of
        :meth:`by_axis`.

        parts : one array (..., *contacts) for each axis, in the shape of the contacts along it.
        """
        head = parts[0].shape[: parts[0].ndim - self.dimension]
        return np.concatenate([part.reshape(*head, -1) for part in parts], axis=-1)

    @cached_property
    def axis(self) -> np.ndarray:
        """(E contacts,) number of the axis along which each contact lies, int8."""
        return np.repeat(np.arange(self.dimension, dtype=np.int8), [span.stop - span.start for span in self.spans])

    def along(self, axis: int) -> tuple[Index, Index]:
        """Return the indices of the lower and of the upper spheres of all contacts along an axis, for arrays whose last
        axes are those of the lattice. Neither holds a sphere twice."""
        if axis in self.periodic:
            low: Any = slice(None)
            high: Any = np.roll(np.arange(self.shape[axis]), -1)
        else:
            low, high = slice(None, -1), slice(1, None)
        after = (slice(None),) * (self.dimension - 1 - axis)
        return (..., low, *after), (..., high, *after)

    @cached_property
    def ends(self) -> np.ndarray:
        """(2, E contacts) lower and upper sphere of each contact, as numbers in C order."""
        sphere = np.arange(self.sites).reshape(self.shape)
        pairs = [[sphere[end] for end in self.along(axis)] for axis in range(self.dimension)]
        return np.stack([self.flat(end) for end in zip(*pairs, strict=True)])

    @cached_property
    def column(self) -> np.ndarray:
        """(E contacts,) number of the column of spheres, upright in the lattice, that holds the upper sphere of each
        contact: the index of its top sphere in the top plane, in C order."""
        found: np.ndarray = self.ends[1] // self.shape[-1]
        return found

    def by_plane(self, values: np.ndarray, component: int) -> np.ndarray:
        """Return a view (R samples, planes, rows, columns) of values of the spheres, or of the contacts along one axis,
        sorted by layers of the lattice.

        values : (R, ...), whose axes after the first are those of the lattice, the height last.
        component : number of a spin component; the planes are the layers across its axis. A square lattice is one
            plane.
        """
        return values[:, None] if self.dimension == 2 else np.moveaxis(values, 1 + component, 1)

    def across(self, component: int) -> "Lattice":
        """Return the lattice of one plane of spheres across an axis, whose contacts couple the spin component along
        this axis. For a square lattice it is the lattice itself.

        component : number of the axis.
        """
        axes = [axis for axis in range(self.dimension) if axis != component]
        closed = tuple(number for number, axis in enumerate(axes) if axis in self.periodic)
        return Lattice(tuple(self.shape[axis] for axis in axes), self.radius, closed)

    def tangential_mask(self, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return a mask (C components, E contacts), True for the spin components that make each contact slip: all but
        the one along it.

        spin_axes : numbers of the axes of the C components.
        """
        found: np.ndarray = np.array(spin_axes)[:, None] != self.axis
        return found

    @cached_property
    def parity(self) -> np.ndarray:
        """Sign s = +1 or -1 of each sphere, in the shape of the lattice: neighbours differ. In a bearing state, in
        which no contact slips, s * spin is the same for all.
        """
        found: np.ndarray = 1 - 2 * (np.indices(self.shape).sum(axis=0) % 2)
        return found

    @cached_property
    def lower_parity(self) -> np.ndarray:
        """(E contacts,) sign s = +1 or -1 of the lower sphere of each contact, int8."""
        sign = self.parity.astype(np.int8)
        return self.flat([sign[self.along(axis)[0]] for axis in range(self.dimension)])

    @cached_property
    def driven(self) -> np.ndarray:
        """Number of the driven body that each sphere belongs to, in the shape of the lattice: 0 bottom, 1 top, -1
        none.
        """
        body = np.full(self.shape, -1)
        body[..., 0], body[..., -1] = 0, 1
        return body

    @cached_property
    def is_driven(self) -> np.ndarray:
        """True for spheres whose spin is imposed, in the shape of the lattice."""
        return self.driven >= 0

    @cached_property
    def between_driven(self) -> np.ndarray:
        """(E contacts,) True for the contacts that join two driven spheres: they never slip and are left out of every
        sum.
        """
        ends = map(self.along, range(self.dimension))
        return self.flat([self.is_driven[low] & self.is_driven[high] for low, high in ends])

    @cached_property
    def contacts(self) -> int:
        """Number of contacts that can slip."""
        return int((~self.between_driven).sum())


def axis_numbers(names: Sequence[str]) -> tuple[int, ...]:
    """Return the numbers of axes that are given by their names: 0 for "x", 1 for "y", 2 for "z"."""
    return tuple(map(AXIS_NAMES.index, names))


def tangential(axis: int, spin_axes: tuple[int, ...]) -> tuple[int, ...]:
    """Return which spin components make a contact along `axis` slip, as positions in `spin_axes` (the axes of the
    components): all but the component along the contact."""
    return tuple(slot for slot, component in enumerate(spin_axes) if component != axis)


def laboratory_forces(force: np.ndarray, lattice: Lattice, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return the friction on the upper sphere of each contact, in the laboratory frame: (samples R, contacts E, 3), or
    (R, E) in 2D. The lower sphere feels the opposite force.

    force : (C, R, E), contact forces f by spin component, along the difference of staggered spins.
    lattice : lattice of the contacts.
    spin_axes : axes of the C spin components.

    The friction is -s f x n, with n the direction of the contact and s = +1 or -1 the sign of its lower sphere. It
    opposes the slip s R Delta Omega x n of paper Eq. 2. In 2D its component along z x n is returned: upwards at
    contacts along x, to the left at contacts along y.
    """
    if lattice.dimension == 2:
        found: np.ndarray = -lattice.lower_parity * force[0]
        return found
    friction = np.zeros((*force.shape[1:], 3))
    for slot, span, across, sign in _laboratory_axes(lattice, spin_axes):
        friction[:, span, across] = sign * force[slot][:, span]
    return friction


def friction_by_axis(friction: np.ndarray, lattice: Lattice) -> tuple[np.ndarray, ...]:
    """Return friction on all E contacts of a lattice as one array for each axis: (..., *contacts, 3), in 2D (...,
    *contacts).

    friction : (..., E, 3), in 2D (..., E).
    """
    if lattice.dimension == 2:
        return lattice.by_axis(friction)
    parts = zip(*map(lattice.by_axis, np.moveaxis(friction, -1, 0)), strict=True)
    return tuple(np.stack(of_axis, axis=-1) for of_axis in parts)


def staggered_forces(friction: np.ndarray, lattice: Lattice, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return contact forces f (C components, R samples, E contacts), from friction in the laboratory. f is along the
    difference of staggered spins, whose signs alternate between neighbours: the friction is -s f x n, with n the
    direction of a contact and s = +1 or -1 the sign of its lower sphere.

    friction : (R, E, 3), in 2D (R, E), on the upper sphere of each contact.
    lattice : lattice of the contacts.
    spin_axes : numbers of the C spin components of the result.
    """
    if lattice.dimension == 2:
        found: np.ndarray = -lattice.lower_parity * friction[None]
        return found
    force = np.zeros((len(spin_axes), *friction.shape[:-1]))
    for slot, span, across, sign in _laboratory_axes(lattice, spin_axes):
        force[slot][:, span] = sign * friction[:, span, across]
    return force


def _laboratory_axes(lattice: Lattice, spin_axes: tuple[int, ...]) -> Iterator[tuple[int, slice, int, np.ndarray]]:
    """Yield how forces on contacts become forces in the laboratory: once for each axis of contacts and each spin
    component that makes these contacts slip. A force f along the component becomes -s f x n, which lies along one axis
    of the lattice.

    lattice : lattice of the contacts; n is along their axis, and s = +1 or -1 is the sign of their lower sphere.
    spin_axes : numbers of the axes of the spin components.
    yields : index of the component in `spin_axes`; slice of these contacts among all contacts; number of the axis along
        which the laboratory force lies; and (contacts,) its sign for f = 1.
    """
    for axis, span in enumerate(lattice.spans):
        for slot in tangential(axis, spin_axes):
            # -e_k x e_axis is + e_m if k follows the axis in the cycle x, y, z, else - e_m, with m the third axis
            sign = 1 if (spin_axes[slot] - axis) % 3 == 1 else -1
            yield slot, span, 3 - axis - spin_axes[slot], sign * lattice.lower_parity[span]
