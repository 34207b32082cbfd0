"""What is solved, whatever its spheres are: a network, a contact law, coefficients of R samples, and what is imposed.

`Scene`, of a lattice, and `Packing`, of spheres in lists, are two front doors: they check what users give and say how
it lies in arrays. What is behind the doors takes a `Bearing` and asks it, never which door was taken.

Letters: R samples, N spheres, E contacts, C spin components.
"""

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from taichi_bearings.numerics.double_double import Pair
from taichi_bearings.read_only import cached_read_only
from taichi_bearings.scene.law import Coefficients, Law

if TYPE_CHECKING:
    from taichi_bearings.scene.network import Network

Kind = TypeVar("Kind", bound="Bearing")
LENGTHS_IN_CACHE = 16_384  # vectors of which the second cache of a processor holds all that is made of them
SAME_DRIVING = 4  # units in the last place, up to which imposed speeds are one


class Bearing:
    """R samples that differ in their coefficients alone.

    law : of all contacts. seeds : (R,), of the disorder. normal_force : of all contacts, one or (E,), force.
    """

    law: Law
    seeds: tuple[int, ...]
    normal_force: float | np.ndarray

    @property
    def network(self) -> "Network":
        """Who touches whom."""
        raise NotImplementedError

    @property
    def material(self) -> Coefficients:
        """What the functions of the law take of all contacts, (R, E) each: of a friction coefficient the force that it
        bears. Contacts between two driven spheres take no part in any sum, whatever they have here."""
        raise NotImplementedError

    @property
    def coefficient(self) -> np.ndarray:
        """(R, E), the first coefficient of the law; `strength` times it is a force, or the damping of a viscous law."""
        raise NotImplementedError

    @property
    def strength(self) -> float:
        """Factor that turns a coefficient into a contact force."""
        return 1.0

    @property
    def driven_speed(self) -> np.ndarray:
        """u = R omega (N, C) of driven spheres, measured from the spins that are taken from all, if any; 0 on free
        spheres; length/time."""
        raise NotImplementedError

    def arrays(self) -> dict[str, np.ndarray]:
        """What a file holds of one sample whose contacts are in lists, by name."""
        raise NotImplementedError

    @property
    def minimum_spin_axes(self) -> tuple[int, ...]:
        """Components of spins that a minimum needs."""
        raise NotImplementedError

    @property
    def jump(self) -> float:
        """How far imposed spins differ, as they are carried: the natural unit of their differences; 0 of none."""
        raise NotImplementedError

    @property
    def smallest_jump(self) -> float:
        """The same of the component that a minimum needs and that differs least."""
        raise NotImplementedError

    @property
    def sides(self) -> tuple[float, float]:
        """The largest imposed spins of what a torque would turn, the top, and of all else that is driven."""
        raise NotImplementedError

    def with_top(self: Kind, strength: float) -> Kind:
        """The same with spins of the top that are so many times as fast."""
        raise NotImplementedError

    def with_friction_alone(self: Kind) -> Kind:
        """The same without viscosity, of a law that has both."""
        raise NotImplementedError

    @property
    def fastest(self) -> float:
        """The largest imposed spin, as spins are carried."""
        raise NotImplementedError

    @property
    def slip_radius(self) -> float:
        """Length by which a difference of spins, as they are carried, is multiplied to be a slip; 1 where they are
        carried as u = R omega."""
        return 1.0

    @property
    def is_cut_off(self) -> np.ndarray:
        """(R,), True where no contact need slip whatever is imposed."""
        raise NotImplementedError

    @property
    def is_drawn(self) -> bool:
        """The coefficients are known to be those of the seeds."""
        return False

    def imposed_spins(self) -> Pair:
        """Spins of all spheres in the laboratory, in the shape of an answer without R, of which those of driven spheres
        are the imposed ones; and what their rounding leaves out; 1/time."""
        raise NotImplementedError

    @property
    def is_driven(self) -> np.ndarray:
        """True for the spheres whose spin is imposed, in the shape that arrays over the spheres have."""
        return ~self.network.free.reshape(self.network.shape)

    def staggered_spin(self, spin: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Spins as they are carried, (C, R, *N), of those that one sees, (R, *N), of spheres (R, *N, 3); of driven
        spheres the imposed ones."""
        raise NotImplementedError

    def laboratory_spin(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Inverse of :meth:`staggered_spin`, 1/time."""
        raise NotImplementedError

    def absolute(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Spins (C, R, *N) with what was taken from all of them: for energies."""
        raise NotImplementedError

    def impose_driving(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """The same spins (C, R, *N), changed in place: driven spheres carry their imposed values."""
        raise NotImplementedError

    def box(self, spin_axes: tuple[int, ...]) -> np.ndarray:
        """(2, C) lower and upper ends of the interval in which a minimiser has each component; 0 where that is none."""
        raise NotImplementedError

    def clip_to_box(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Spins (C, R, *N) in that interval, if there is one; it never raises the power."""
        raise NotImplementedError

    def differences(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Vectors (d, R, E) across all contacts; `slip_radius` times their length is the slip speed."""
        raise NotImplementedError

    def pulls(self, force: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Sums of the contact forces (d, R, E) that pull on each sphere, (C, R, *N)."""
        raise NotImplementedError

    def slips(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Slip speed |v| of every contact (paper Eq. 2), (R, E), length/time."""
        return self.slip_radius * vector_length(self.differences(staggered, spin_axes))

    def power(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Dissipated power (R,), energy/time (paper Eq. 4, each contact once)."""
        return self.law.power(self.material, self.slips(staggered, spin_axes)).sum(axis=1)

    def objective(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """What the stationary state minimises (R,), energy/time: the power, or for a law of which no multiple of the
        power is least there its potential. An upper bound on the least value whatever the spins are."""
        return self.law.objective(self.material, self.slips(staggered, spin_axes)).sum(axis=1)

    def sample(self: Kind, number: int) -> Kind:
        """One of the samples alone."""
        raise NotImplementedError

    def first(self: Kind, count: int) -> Kind:
        """The first so many samples."""
        raise NotImplementedError

    @property
    def named_coefficients(self) -> dict[str, np.ndarray]:
        """The coefficients of the law as they were given, (R, E) each, by their name in files, in the order of the
        law."""
        raise NotImplementedError

    @property
    def replicas(self) -> int:
        """R."""
        return len(self.seeds)

    @cached_read_only
    def acting_coefficient(self) -> np.ndarray:
        """(R, E) the coefficients with 0 for contacts between two driven spheres, which take no part."""
        return np.where(self.network.has_free_end, self.coefficient, 0.0)

    @cached_read_only
    def idle(self) -> np.ndarray:
        """(R, E) True for contacts that take no part: between two driven spheres, or absent."""
        absent = np.all([values == 0 for values in self.material], axis=0)
        return np.asarray(absent | ~self.network.has_free_end)

    @cached_read_only
    def inverse_limit(self) -> np.ndarray:
        """(R, E) 1 over the friction that contacts bear, 0 for contacts that take no part."""
        return inverse(self.strength * self.acting_coefficient)

    @cached_read_only
    def acting(self) -> np.ndarray:
        """Numbers of the contacts that have a free end and, in some sample, a coefficient."""
        some = np.any([(values > 0).any(axis=0) for values in self.material], axis=0)
        return np.flatnonzero(some & self.network.has_free_end)

    @property
    def viscosities(self) -> np.ndarray | None:
        """(R, E) slope of the force over the slip of every contact; 0 between driven spheres, None for laws without."""
        return self.law.viscosity(self.material)

    @property
    def viscosity_beside_friction(self) -> np.ndarray | None:
        """(R, E) the same of laws that have both, else None."""
        return self.viscosities if self.law.holds else None


def inverse(values: np.ndarray) -> np.ndarray:
    """1 / values, and 0 where values is 0."""
    return np.divide(1.0, values, out=np.zeros_like(values), where=values != 0)


def vector_length(components: np.ndarray) -> np.ndarray:
    """Euclidean length over the first axis; (0, ...) gives zeros, one component gives |component| exactly."""
    if len(components) == 0:
        return np.zeros(components.shape[1:])
    if components[0].size <= LENGTHS_IN_CACHE or not components.flags.c_contiguous:
        return _length(components)
    flat = components.reshape(len(components), -1)
    found = np.empty(flat.shape[1], flat.dtype)
    for first in range(0, len(found), LENGTHS_IN_CACHE):
        part = slice(first, first + LENGTHS_IN_CACHE)
        found[part] = _length(flat[:, part])
    return found.reshape(components.shape[1:])


def _length(components: np.ndarray) -> np.ndarray:
    """Of those that are not 0 everywhere, as it is of contacts along one axis."""
    size, *others = [part for part in components if part.any()] or components[:1]
    size = np.hypot(size, others[0]) if others else np.abs(size)
    return size if len(others) < 2 else np.hypot(size, others[1])


def as_one_driving(u: np.ndarray) -> np.ndarray:
    """Imposed speeds (N, C), changed in place: sizes of a component that differ by no more than 4 units in the last
    place are one driving, the least of them."""
    for part in u.T:
        size, place = np.unique(np.abs(part), return_inverse=True)
        for number in range(1, len(size)):
            if size[number] - size[number - 1] <= SAME_DRIVING * np.spacing(size[number]):
                size[number] = size[number - 1]
        part[:] = np.copysign(size[place.reshape(-1)], part)
    return u
