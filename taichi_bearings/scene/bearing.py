"""What is solved, whatever its spheres are: a network, a contact law, coefficients of R samples, and what is imposed.

`Scene`, of a lattice, and `Packing`, of spheres in lists, are two front doors: they check what users give and say how
it lies in arrays. What is behind the doors takes a `Bearing` and asks it, never which door was taken.

Letters: R samples, N spheres (*N is the shape of arrays over them), E contacts, C spin components, d tangents.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from taichi_bearings.numerics.double_double import Pair
from taichi_bearings.read_only import cached_read_only
from taichi_bearings.scene.driving import Driving
from taichi_bearings.scene.law import Coefficients, Law

if TYPE_CHECKING:
    from taichi_bearings.scene.network import Network

Kind = TypeVar("Kind", bound="Bearing")
LENGTHS_IN_CACHE = 16_384  # vectors of which the second cache of a processor holds all that is made of them
# of the mean coefficient: what stands for an absent contact where a method must divide by it
ABSENT_COEFFICIENT = 1e-12


class Bearing(ABC):
    """R samples that differ in their coefficients alone.

    law : of all contacts. seeds : (R,), of the disorder. normal_force : of all contacts, one or (E,), force. drawn :
    the distributions that the coefficients are known to be drawn from with these seeds, by option. schematic : True
    where centres only say where spheres are drawn.

    A front door says the six things that are abstract here, in the arrays that its users give.
    """

    law: Law
    seeds: tuple[int, ...]
    normal_force: float | np.ndarray
    drawn: Mapping[str, str] = MappingProxyType({})
    schematic: bool = False

    @property
    @abstractmethod
    def network(self) -> "Network":
        """Who touches whom."""

    @property
    @abstractmethod
    def driving(self) -> Driving:
        """What is imposed, and how spins are carried."""

    @property
    @abstractmethod
    def named_coefficients(self) -> dict[str, np.ndarray]:
        """The coefficients of the law as they were given, (R, E) each, by their name in files, in the order of the
        law."""

    @abstractmethod
    def with_top(self: Kind, strength: float) -> Kind:
        """The same with spins of the top that are so many times as fast."""

    @abstractmethod
    def with_friction_alone(self: Kind) -> Kind:
        """The same without viscosity, of a law that has both."""

    @abstractmethod
    def _as_samples(self: Kind, pick: int | slice, seeds: tuple[int, ...]) -> Kind:
        """Some of several samples; one number picks one. Nothing is checked again."""

    @property
    def strength(self) -> float:
        """Factor that turns a coefficient into a contact force: the normal force where it is the same at all contacts;
        1 for damping, and where normal forces are part of `coefficient`."""
        one = np.ndim(self.normal_force) == 0 and self.law.quantities[0].is_friction
        return float(self.normal_force) if one else 1.0

    @cached_read_only
    def coefficient(self) -> np.ndarray:
        """(R, E), the first coefficient of the law; `strength` times it is a force, or the damping of a viscous law."""
        first = next(iter(self.named_coefficients.values()))
        each = np.ndim(self.normal_force) > 0 and self.law.quantities[0].is_friction
        return first * self.normal_force if each else first

    @property
    def _coefficients(self) -> Coefficients:
        """`coefficient`, and the other coefficients of the law, (R, E) each."""
        _, *beside = self.named_coefficients.values()
        return (self.coefficient, *beside)

    @cached_read_only
    def material(self) -> Coefficients:
        """What the functions of the law take of all contacts, (R, E) each: of a friction coefficient the force that it
        bears. Contacts between two driven spheres take no part in any sum; where such contacts never slip it is 0."""
        held, *beside = self._coefficients
        if self.driving.rubs:
            return (self.strength * held, *beside)
        acts = self.network.has_free_end
        return (self.strength * np.where(acts, held, 0.0), *(np.where(acts, values, 0.0) for values in beside))

    @property
    def is_drawn(self) -> bool:
        """The coefficients are known to be those of the seeds."""
        return bool(self.drawn)

    @property
    def minimum_spin_axes(self) -> tuple[int, ...]:
        """Components of spins that a minimum needs."""
        return self.driving.minimum_spin_axes

    @property
    def driven_speed(self) -> np.ndarray:
        """u = R omega (N, C) of driven spheres, measured from the spins that are taken from all, if any; 0 on free
        spheres; length/time."""
        return self.driving.speed

    @cached_property
    def jump(self) -> float:
        """How far imposed spins differ, as they are carried: the natural unit of their differences; 0 of none."""
        return self.driving.jump

    @cached_property
    def smallest_jump(self) -> float:
        """How far imposed spins differ in the component that a minimum needs and in which they differ least; 0 where
        they do not, or where no box holds a minimum."""
        return float(np.abs(self.box(self.minimum_spin_axes)).max(axis=0).min())

    @property
    def sides(self) -> tuple[float, float]:
        """The largest imposed spins of what a torque would turn, the top, and of all else that is driven."""
        return self.driving.sides

    @property
    def fastest(self) -> float:
        """The largest imposed spin, as spins are carried."""
        return self.driving.fastest

    @property
    def natural_spin(self) -> float | None:
        """The imposed spin in which times and powers are counted, 1/time; None where none stands out."""
        return self.driving.natural_spin

    @property
    def natural_energy(self) -> float | None:
        """F_n R, in which energies are counted, and torques; None without friction or without such a spin."""
        return self.strength * self.slip_radius if self.law.holds and self.natural_spin is not None else None

    @property
    def slip_radius(self) -> float:
        """Length by which a difference of spins, as they are carried, is multiplied to be a slip; 1 where they are
        carried as u = R omega."""
        return self.driving.slip_radius

    @cached_read_only
    def is_cut_off(self) -> np.ndarray:
        """(R,), True where it is known that no contact need slip whatever is imposed: contacts are absent."""
        return self.driving.cut_off(self.coefficient > 0)

    def imposed_spins(self) -> Pair:
        """Spins of all spheres in the laboratory, in the shape of an answer without R, of which those of driven spheres
        are the imposed ones; and what their rounding leaves out; 1/time."""
        return self.driving.spins()

    @property
    def is_driven(self) -> np.ndarray:
        """True for the spheres whose spin is imposed, in the shape that arrays over the spheres have."""
        return self.network.is_driven

    def staggered_spin(self, spin: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Spins as they are carried, (C, R, *N), of those that one sees, (R, *N), of spheres (R, *N, 3); of driven
        spheres the imposed ones."""
        return self.driving.carried(spin, spin_axes)

    def laboratory_spin(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Inverse of :meth:`staggered_spin`, 1/time. Components that are left out slip nowhere."""
        return self.laboratory_pair(staggered, None, spin_axes)[0]

    def laboratory_pair(self, staggered: np.ndarray, rest: np.ndarray | None, spin_axes: tuple[int, ...]) -> Pair:
        """Spins as one sees them in twice the precision: to the nearest doubles, and what their rounding leaves out.

        rest : (C, R, *N), what is to be added to the carried spins, if anything; of driven spheres it is known.
        """
        return self.driving.laboratory(staggered, rest, spin_axes)

    def absolute(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Spins (C, R, *N) with what was taken from all of them: for energies."""
        return self.driving.absolute(staggered, spin_axes)

    def impose_driving(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """The same spins (C, R, *N), changed in place: driven spheres carry their imposed values."""
        return self.driving.impose(staggered, spin_axes)

    def box(self, spin_axes: tuple[int, ...]) -> np.ndarray:
        """(2, C) lower and upper ends of the interval in which a minimiser has each component; 0 where that is none."""
        found = self.driving.box(spin_axes)
        return np.zeros((2, len(spin_axes))) if found is None else found

    def clip_to_box(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Spins (C, R, *N) in that interval, if there is one; it never raises the power (equations.md, 4)."""
        box = self.driving.box(spin_axes)
        if box is None:
            return staggered
        low, high = box.reshape(2, -1, *(1,) * (staggered.ndim - 1))
        return np.clip(staggered, low, high)

    def differences(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Vectors (d, R, E) across all contacts; `slip_radius` times their length is the slip speed."""
        return self.network.differences(staggered, spin_axes)

    def pulls(self, force: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Sums of the contact forces (d, R, E) that pull on each sphere, (C, R, *N)."""
        return self.network.pulls(force, spin_axes)

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
        return self if self.replicas == 1 else self._as_samples(number, self.seeds[number : number + 1])

    def some(self: Kind, pick: slice) -> Kind:
        """Several of the samples, of a bearing with more than one."""
        return self._as_samples(pick, self.seeds[pick])

    def first(self: Kind, count: int) -> Kind:
        """The first so many samples."""
        return self if count == self.replicas else self.sample(0) if count == 1 else self.some(slice(count))

    def arrays(self) -> dict[str, np.ndarray]:
        """What a file holds of one sample whose contacts are in lists, by name."""
        network, given = self.network, self.named_coefficients
        force = np.broadcast_to(np.asarray(self.normal_force, dtype=float), (network.contacts,))
        found = {
            "center": network.center, "contact": network.contact.T, "driven": network.body,
            "spin": self.driving.spin, "radius": network.radius, "normal": network.normal,
            "friction": given["coefficient"][0],
        }  # fmt: skip
        found |= {name: values[0] for name, values in given.items() if name != "coefficient"}
        return found | {"normal_force": force} | ({"schematic": np.array([1])} if self.schematic else {})

    @property
    def replicas(self) -> int:
        """R."""
        return len(self.seeds)

    @cached_read_only
    def acting_coefficient(self) -> np.ndarray:
        """(R, E) the coefficients with 0 for contacts between two driven spheres, which take no part."""
        return np.where(self.network.has_free_end, self.coefficient, 0.0)

    @cached_read_only
    def positive_coefficient(self) -> np.ndarray:
        """(R, E) the coefficients, with ABSENT_COEFFICIENT for absent contacts: for methods whose arithmetic needs each
        sphere held. Answers are judged without them."""
        mean = self.coefficient.mean(axis=1, keepdims=True)
        return np.where(self.coefficient == 0, ABSENT_COEFFICIENT * np.where(mean > 0, mean, 1.0), self.coefficient)

    @cached_read_only
    def idle(self) -> np.ndarray:
        """(R, E) True for contacts that take no part: between two driven spheres, or absent."""
        absent = np.all([values == 0 for values in self._coefficients], axis=0)
        return np.asarray(absent | ~self.network.has_free_end)

    @cached_read_only
    def inverse_limit(self) -> np.ndarray:
        """(R, E) 1 over the friction that contacts bear, 0 for contacts that take no part."""
        return inverse(self.strength * self.acting_coefficient)

    @cached_read_only
    def acting(self) -> np.ndarray:
        """Numbers of the contacts that have a free end and, in some sample, a coefficient."""
        some = np.any([(values > 0).any(axis=0) for values in self._coefficients], axis=0)
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
