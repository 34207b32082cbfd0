"""What is solved, whatever its spheres are: a network, a contact law, coefficients of R samples, and what is imposed.

`Scene`, of a lattice, and `Packing`, of spheres in lists, check what users give and store it in arrays of their own.
All later code takes a `Bearing` and asks that, never which of the two it is.

Letters: R samples, N spheres (*N is the shape of arrays over them: that of the lattice, or (N,)), E contacts, C spin
components, d slip components; omega the spin of a sphere, R in R omega its radius, u = R omega its surface speed.

carried spins : the numbers by which methods represent spins (scene/driving.py): of lattices staggered spins, 1/time,
measured from those of the bottom; of other packings u, length/time. laboratory spins : as one sees them, 1/time.
spin_axes : as an argument, the spin components, 0 to 2, that the first axis of an array of carried spins has.
driven sphere : one whose spin is imposed. present contact : one with a positive coefficient.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.numerics.double_double import Pair
from taichi_bearings.plain_files import Json
from taichi_bearings.read_only import cached_read_only
from taichi_bearings.scene.driving import Driving
from taichi_bearings.scene.law import Coefficients, Law

if TYPE_CHECKING:
    from taichi_bearings.scene.network import Network

Kind = TypeVar("Kind", bound="Bearing")
LENGTHS_IN_CACHE = 16_384  # vectors whose lengths are computed at once: they fit into the second-level cache
# replaces the coefficient of an absent contact, relative to the mean, where a method must divide by it
ABSENT_COEFFICIENT = 1e-12


class Bearing(ABC):
    """R samples of a bearing that differ in their coefficients alone.

    law : the contact law, one for all contacts.
    seeds : (R,), from which the disorder of each sample is drawn.
    normal_force : force, one number for all contacts or (contacts E,).
    drawn : the distributions from which the coefficients are known to be drawn with these seeds, by the name of the
        option of `bearings run`; empty if that is not known.
    schematic : True if centres are for drawings alone, and need not agree with radii and contacts.

    A subclass defines the abstract properties and methods, and says in which arrays users give coefficients and spins.
    """

    law: Law
    seeds: tuple[int, ...]
    normal_force: float | np.ndarray
    drawn: Mapping[str, str] = MappingProxyType({})
    schematic: bool = False

    @property
    @abstractmethod
    def network(self) -> "Network":
        """The spheres, their contacts, and which spheres are driven."""

    @property
    @abstractmethod
    def driving(self) -> Driving:
        """The imposed spins, and how laboratory spins become the numbers that solvers store: on lattices spins with
        signs that alternate between neighbours, less those of the bottom; in other packings radius * spin.
        """

    @property
    @abstractmethod
    def named_coefficients(self) -> dict[str, np.ndarray]:
        """The coefficients of the law, (samples R, contacts E) each, by their names in files.

        They come in the order of the law and in the units of users: friction is a pure number, damping is force *
        time/length.
        """

    @property
    @abstractmethod
    def facts(self) -> Json:
        """Numbers by name that say in tables and summaries what is solved: of a lattice its shape, imposed spins,
        normal force and radius; of another packing how many spheres it has."""

    @property
    @abstractmethod
    def imposed_in_words(self) -> str:
        """What is imposed on driven spheres, in words that end a message."""

    @abstractmethod
    def with_top(self: Kind, strength: float) -> Kind:
        """Return a copy whose top (of packings the driven body with the largest number) has its imposed spins
        multiplied by `strength`, a pure number.
        """

    @abstractmethod
    def with_friction_alone(self: Kind) -> Kind:
        """Return a copy with friction but without viscosity, for a law that has both."""

    @abstractmethod
    def _as_samples(self: Kind, pick: int | slice, seeds: tuple[int, ...]) -> Kind:
        """Return a copy with some of the samples, which are not checked again.

        pick : number of one sample, or a slice of several.
        seeds : seeds of the samples that are picked.
        """

    @property
    def strength(self) -> float:
        """Factor that turns `coefficient` into a force, or for a viscous law into a damping.

        With friction and one normal force for all contacts it is that force. It is 1 for damping, and where each
        contact has a normal force of its own, which `coefficient` then includes.
        """
        one = np.ndim(self.normal_force) == 0 and self.law.quantities[0].is_friction
        return float(self.normal_force) if one else 1.0

    @cached_read_only
    def coefficient(self) -> np.ndarray:
        """(samples R, contacts E) first coefficient of the law: `strength` times it is the friction force, or the
        damping. If each contact has a normal force of its own, friction is multiplied by it here.
        """
        first = next(iter(self.named_coefficients.values()))
        has_own_forces = np.ndim(self.normal_force) > 0 and self.law.quantities[0].is_friction
        return first * self.normal_force if has_own_forces else first

    @property
    def _coefficients(self) -> Coefficients:
        """All coefficients of the law, a tuple of arrays (samples R, contacts E): first `coefficient`, then the second
        one if the law has two.
        """
        _, *others = self.named_coefficients.values()
        return (self.coefficient, *others)

    @cached_read_only
    def material(self) -> Coefficients:
        """The coefficients as the functions of the law take them, a tuple of arrays (samples R, contacts E): friction
        multiplied by the normal force, so a force; damping in force * time/length.

        On lattices they are 0 at contacts between two driven spheres, which never slip there.
        """
        held, *beside = self._coefficients
        if self.driving.driven_contacts_slip:
            return (self.strength * held, *beside)
        acts = self.network.has_free_end
        return (self.strength * np.where(acts, held, 0.0), *(np.where(acts, values, 0.0) for values in beside))

    @property
    def is_drawn(self) -> bool:
        """True if the coefficients are known to be drawn from the seeds."""
        return bool(self.drawn)

    @property
    def minimum_spin_axes(self) -> tuple[int, ...]:
        """Numbers of the spin components that have to be solved for; some minimum has no slip from the others."""
        return self.driving.minimum_spin_axes

    @property
    def driven_speed(self) -> np.ndarray:
        """(spheres N, components C) imposed surface speeds u = radius * spin, length/time; 0 on free spheres. On
        lattices they are measured from those of the bottom plane.
        """
        return self.driving.speed

    @cached_property
    def jump(self) -> float:
        """Size of the difference between the imposed spins, which serves as unit of spin differences; 0 where all
        agree. On lattices it is of spins, 1/time; in other packings of radius * spin, length/time.
        """
        return self.driving.jump

    @cached_property
    def smallest_jump(self) -> float:
        """The smallest of C numbers, one for each component in `minimum_spin_axes`: the largest size of an imposed
        spin in this component.

        Spins are in the form that solvers store: on lattices 1/time, measured from the bottom. The number is 0 if top
        and bottom agree in a component, and if :meth:`box` knows no bounds.
        """
        return float(np.abs(self.box(self.minimum_spin_axes)).max(axis=0).min())

    @property
    def top_and_bottom(self) -> tuple[float, float]:
        """Two speeds, (top, bottom). Of a lattice they are the imposed spins of its planes, 1/time. Of another packing
        they are the largest imposed radius * spin of the top, the driven body with the largest number, and of all other
        driven spheres, length/time."""
        return self.driving.top_and_bottom

    @property
    def fastest(self) -> float:
        """Size of the largest imposed spin: 1/time on lattices, else radius * spin, length/time."""
        return self.driving.fastest

    @property
    def natural_spin(self) -> float | None:
        """The imposed spin that serves as unit of times and powers, 1/time; None for packings, which have several."""
        return self.driving.natural_spin

    @property
    def natural_energy(self) -> float | None:
        """Normal force times radius, the unit of energies and torques; None without friction or `natural_spin`."""
        return self.strength * self.slip_radius if self.law.has_friction and self.natural_spin is not None else None

    @property
    def slip_radius(self) -> float:
        """Factor that turns a difference of stored spins into a slip: the radius on lattices; 1 elsewhere, where radius
        * spin is stored.
        """
        return self.driving.slip_radius

    @cached_read_only
    def is_cut_off(self) -> np.ndarray:
        """(samples R,) mask: True if contacts with positive coefficients do not connect bottom and top, so that no
        contact has to slip; False otherwise, and if it is not known.
        """
        return self.driving.cut_off(self.coefficient > 0)

    def drawn_again(self) -> Iterator[tuple[str, int, np.ndarray, float]]:
        """Yield the coefficients that the seeds give, where they are known to be drawn: the name of a coefficient as in
        files, the number of the sample, the coefficients (contacts E,), and by how much, relatively, they may differ
        between machines. Nothing is known to be drawn here.
        """
        yield from ()

    def imposed_spins(self) -> Pair:
        """Return laboratory spins, 1/time, (spheres *N) of discs or (*N, 3) of spheres, in twice the precision:
        doubles, and an array of the same shape with what their rounding leaves out. Driven spheres have their imposed
        spins; the spins of free spheres mean nothing.
        """
        return self.driving.spins()

    @property
    def is_driven(self) -> np.ndarray:
        """(spheres *N) mask of the spheres whose spin is imposed."""
        return self.network.is_driven

    def staggered_spin(self, spin: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return laboratory spins as solvers store them, (components C, samples R, spheres *N): on lattices times the
        sign of the sublattice, less those of the bottom, 1/time; in other packings times the radius, length/time.
        Driven spheres get their imposed ones.

        spin : laboratory spins, 1/time, (R, *N) of discs or (R, *N, 3) of spheres.
        spin_axes : numbers of the C components to return, each 0, 1 or 2.
        """
        return self.driving.carried(spin, spin_axes)

    def laboratory_spin(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return laboratory spins, 1/time, (samples R, spheres *N) of discs or (R, *N, 3) of spheres: the inverse of
        :meth:`staggered_spin`.

        staggered : spins as solvers store them, (components C, samples R, spheres *N): on lattices times the sign of
            the sublattice, less those of the bottom, 1/time; in other packings times the radius, length/time.
        spin_axes : numbers of their C components.

        Other components get values at which no contact slips by them, where there are such values.
        """
        return self.laboratory_pair(staggered, None, spin_axes)[0]

    def laboratory_pair(self, staggered: np.ndarray, rest: np.ndarray | None, spin_axes: tuple[int, ...]) -> Pair:
        """Return laboratory spins, 1/time, in twice the precision: the nearest doubles, and an array of what their
        rounding leaves out.

        staggered : spins as solvers store them, (components C, samples R, spheres *N): on lattices times the sign of
            the sublattice, less those of the bottom, 1/time; in other packings times the radius, length/time.
        rest : (C, R, *N), small numbers to add to these, or None for nothing.
        spin_axes : numbers of the C components.
        """
        return self.driving.laboratory(staggered, rest, spin_axes)

    def absolute(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return spins measured from 0, as kinetic energies need them, (components C, samples R, spheres *N).

        staggered : spins as solvers store them, of the same shape: on lattices times the sign of the sublattice, less
            those of the bottom, which are added here; in other packings times the radius, measured from 0 already.
        spin_axes : numbers of the C components.
        """
        return self.driving.absolute(staggered, spin_axes)

    def impose_driving(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Give driven spheres their imposed values in an array of spins, in place; return the same array.

        staggered : spins as solvers store them, (components C, samples R, spheres *N): on lattices times the sign of
            the sublattice, less those of the bottom, 1/time; in other packings times the radius, length/time.
        spin_axes : numbers of their C components.
        """
        return self.driving.impose(staggered, spin_axes)

    def box(self, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return two bounds for each of C components, (2, C), the lower and the upper ones: some minimum has all its
        spins between them. Spins are meant as solvers store them. Both bounds are 0 if none are known.

        spin_axes : axes of the C components, as numbers from 0 to 2.
        """
        found = self.driving.box(spin_axes)
        return np.zeros((2, len(spin_axes))) if found is None else found

    def clip_to_box(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return spins clipped to an interval of each component: at least one minimum is known to have all its spins in
        these intervals. Where no such intervals are known, return the spins unchanged. On lattices an interval reaches
        from the smallest to the largest imposed spin, in the form in which solvers store spins.

        staggered : spins as solvers store them, (components C, samples R, spheres *N): on lattices times the sign of
            the sublattice, less those of the bottom, 1/time; in other packings times the radius, length/time.
        spin_axes : numbers of their C components.

        Clipping never raises the power (shown in docs/equations.md, 4).
        """
        box = self.driving.box(spin_axes)
        if box is None:
            return staggered
        low, high = box.reshape(2, -1, *(1,) * (staggered.ndim - 1))
        found: np.ndarray = np.clip(staggered, low, high)
        return found

    def differences(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return the vectors (d, samples R, contacts E) from which the slips of all contacts follow: the slip speed is
        `slip_radius` times the length of the vector. On lattices they are differences of the spins, 1/time, with d spin
        components; in other packings slips, length/time, with d tangents.

        staggered : spins as solvers store them, (components C, samples R, spheres *N): on lattices times the sign of
            the sublattice, less those of the bottom, 1/time; in other packings times the radius, length/time.
        spin_axes : numbers of their C components.
        """
        return self.network.differences(staggered, spin_axes)

    def pulls(self, force: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return for each sphere the sum (components C, samples R, spheres *N) of the forces of its contacts, by spin
        component; times the radius it is the torque.

        force : (d, R, contacts E), contact forces along the d components of a slip: on lattices the spin components, in
            other packings two tangents (of discs one).
        spin_axes : numbers of the C components.
        """
        return self.network.pulls(force, spin_axes)

    def torques_left(self, force: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return the largest torque (samples R,), force * length, that contact forces leave on a free sphere of a
        packing. (proof/certificate.py has a quicker way for lattices.)

        force : (d, R, contacts E), contact forces along the d tangents.
        spin_axes : numbers of the spin components.
        """
        torque = np.abs(self.pulls(force, spin_axes)) * self.network.radius
        found: np.ndarray = torque[..., ~self.is_driven].max(axis=(0, 2), initial=0.0)
        return found

    def slips(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return the slip speed (samples R, contacts E) of every contact (paper, Eq. 2), length/time.

        staggered : spins as solvers store them, (components C, samples R, spheres *N): on lattices times the sign of
            the sublattice, less those of the bottom, 1/time; in other packings times the radius, length/time.
        spin_axes : numbers of their C components.
        """
        return self.slip_radius * vector_length(self.differences(staggered, spin_axes))

    def power(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return the dissipated power (samples R,), energy/time (paper, Eq. 4, with each contact counted once).

        staggered : spins as solvers store them, (components C, samples R, spheres *N): on lattices times the sign of
            the sublattice, less those of the bottom, 1/time; in other packings times the radius, length/time.
        spin_axes : numbers of their C components.
        """
        found: np.ndarray = self.law.power(self.material, self.slips(staggered, spin_axes)).sum(axis=1)
        return found

    def objective(self, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return the value (samples R,), energy/time, of the function that the stationary state minimises.

        It is the power, or the dissipation potential for a law whose power is no multiple of that. At any spins it is
        an upper bound on the minimum.

        staggered : spins as solvers store them, (components C, samples R, spheres *N): on lattices times the sign of
            the sublattice, less those of the bottom, 1/time; in other packings times the radius, length/time.
        spin_axes : numbers of their C components.
        """
        found: np.ndarray = self.law.objective(self.material, self.slips(staggered, spin_axes)).sum(axis=1)
        return found

    def sample(self: Kind, number: int) -> Kind:
        """Return a bearing with one of the R samples alone.

        number : number of the sample, from 0.
        """
        return self if self.replicas == 1 else self._as_samples(number, self.seeds[number : number + 1])

    def some(self: Kind, pick: slice) -> Kind:
        """Return a bearing with several of the samples.

        pick : slice of their numbers. This bearing must have more than one sample.
        """
        return self._as_samples(pick, self.seeds[pick])

    def first(self: Kind, count: int) -> Kind:
        """Return a bearing with the first `count` samples.

        count : number of samples, from 1 to R.
        """
        return self if count == self.replicas else self.sample(0) if count == 1 else self.some(slice(count))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays that a file of a packing holds, such as center and friction, by name. There must be one
        sample only.
        """
        network, coefficients = self.network, self.named_coefficients
        force = np.broadcast_to(np.asarray(self.normal_force, dtype=float), (network.contacts,))
        found = {
            "center": network.center, "contact": network.contact.T, "driven": network.body,
            "spin": self.driving.spin, "radius": network.radius, "normal": network.normal,
            "friction": coefficients["coefficient"][0],
        }  # fmt: skip
        found |= {name: values[0] for name, values in coefficients.items() if name != "coefficient"}
        return found | {"normal_force": force} | ({"schematic": np.array([1])} if self.schematic else {})

    @property
    def replicas(self) -> int:
        """Number R of samples, called replicas where they are solved together."""
        return len(self.seeds)

    @cached_read_only
    def acting_coefficient(self) -> np.ndarray:
        """(samples R, contacts E) copy of `coefficient` with 0 at contacts between two driven spheres."""
        return np.where(self.network.has_free_end, self.coefficient, 0.0)

    @cached_read_only
    def positive_coefficient(self) -> np.ndarray:
        """(samples R, contacts E) copy of `coefficient` in which absent contacts have ABSENT_COEFFICIENT times the mean
        instead of 0.

        It is for methods that cannot handle spheres without a present contact. Bounds are computed with `coefficient`.
        """
        mean = self.coefficient.mean(axis=1, keepdims=True)
        return np.where(self.coefficient == 0, ABSENT_COEFFICIENT * np.where(mean > 0, mean, 1.0), self.coefficient)

    @cached_read_only
    def idle(self) -> np.ndarray:
        """(samples R, contacts E) mask of the contacts that take no part: absent ones, and those between two driven
        spheres.
        """
        absent = np.all([values == 0 for values in self._coefficients], axis=0)
        return np.asarray(absent | ~self.network.has_free_end)

    @cached_read_only
    def inverse_limit(self) -> np.ndarray:
        """(samples R, contacts E) one over `strength` times the coefficient, with friction one over the largest
        friction force; 0 for contacts that are absent or between two driven spheres.
        """
        return inverse(self.strength * self.acting_coefficient)

    @cached_read_only
    def acting(self) -> np.ndarray:
        """(n,) numbers of the contacts that have a free sphere and, in some sample, a positive coefficient."""
        some = np.any([(values > 0).any(axis=0) for values in self._coefficients], axis=0)
        return np.flatnonzero(some & self.network.has_free_end)

    @property
    def viscosities(self) -> np.ndarray | None:
        """(samples R, contacts E) viscous force over slip of every contact, force * time/length; None for friction
        alone."""
        return self.law.viscosity(self.material)

    @property
    def viscosity_beside_friction(self) -> np.ndarray | None:
        """(samples R, contacts E) viscous force over slip of every contact, force * time/length, for laws that have
        friction as well; None for other laws."""
        return self.viscosities if self.law.has_friction else None

    def steepest(self, fastest: float) -> np.ndarray | None:
        """Return the largest slope (samples R, contacts E) of the force of each contact over its slip, force *
        time/length, without the jump of friction at slip 0; None for friction alone.

        fastest : largest slip speed of any contact, length/time, which limits the slope of a law of one's own.

        Raises InputError for a law of one's own that is infinitely steep.
        """
        if self.law.is_sum:
            return self.viscosities
        slopes = self.law.steepest(self.material, fastest)
        if not np.isfinite(slopes).all():
            raise InputError(
                f"law is {self.law.name!r}, whose force is infinitely steep at some slip; gradient-descent and "
                "cundall-strack need a finite slope, so take another method"
            )
        return slopes


def inverse(values: np.ndarray) -> np.ndarray:
    """Return 1 / values, an array of their shape, with 0 where a value is 0."""
    found: np.ndarray = np.divide(1.0, values, out=np.zeros_like(values), where=values != 0)
    return found


def vector_length(components: np.ndarray) -> np.ndarray:
    """Return the Euclidean lengths, (...), of vectors whose components are along the first axis, (d, ...): 0 if d = 0,
    and exactly the absolute values of the component if d = 1.
    """
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
    """Return the lengths (...) of vectors (d, ...) of one to three components.

    Components that are 0 everywhere are left out of the sum, which saves time: along each axis of a lattice one
    component of the slips is 0 at all contacts.
    """
    size, *others = [part for part in components if part.any()] or components[:1]
    size = np.hypot(size, others[0]) if others else np.abs(size)
    found: np.ndarray = size if len(others) < 2 else np.hypot(size, others[1])
    return found
