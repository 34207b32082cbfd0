"""What is solved, whatever its spheres are: a network, a contact law, coefficients of R samples, and what is imposed.

`Scene`, of a lattice, and `Packing`, of spheres in lists, are two front doors: they check what users give and say how
it lies in arrays. What is behind the doors takes a `Bearing` and asks it, never which door was taken.

Letters: R samples, N spheres, E contacts, C spin components.
"""

from typing import TypeVar

import numpy as np

from taichi_bearings.numerics.double_double import Pair
from taichi_bearings.read_only import cached_read_only
from taichi_bearings.scene.law import Coefficients, Law
from taichi_bearings.scene.network import Network

Kind = TypeVar("Kind", bound="Bearing")
SAME_DRIVING = 4  # units in the last place, up to which imposed speeds are one


class Bearing:
    """R samples that differ in their coefficients alone.

    law : of all contacts. seeds : (R,), of the disorder. normal_force : of all contacts, one or (E,), force.
    """

    law: Law
    seeds: tuple[int, ...]
    normal_force: float | np.ndarray

    @property
    def network(self) -> Network:
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

    def sample(self: Kind, number: int) -> Kind:
        """One of the samples alone."""
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
