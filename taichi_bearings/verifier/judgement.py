"""Power, lower bound and contact states of samples: what is rigorously true of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.verifier.bounds import Work, lower_bound, slip_bounds, work_of
from taichi_bearings.verifier.enclosure import Enclosure
from taichi_bearings.verifier.motion import Motion
from taichi_bearings.verifier.packing_judgement import PackingJudgement
from taichi_bearings.verifier.samples import OfLaw, Samples
from taichi_bearings.verifier.states import States, proven_states
from taichi_bearings.verifier.stored_run import StoredPacking

EPS = np.finfo(np.float64).eps


def judgement_of(samples: Samples | StoredPacking) -> Judgement | PackingJudgement | None:
    """None for numbers that no arithmetic can judge."""
    if isinstance(samples, Samples):
        return Judgement(samples) if samples.can_be_judged else None
    return PackingJudgement.of(samples.law, samples.arrays, samples.spin, samples.friction)


@dataclass(frozen=True)
class Judgement(OfLaw):
    """Of the spins and the friction of samples, energy/time. Bounds are rounded outwards."""

    samples: Samples
    proof = "proven"

    @property
    def law(self) -> str:  # type: ignore[override]
        return self.samples.law

    @property
    def acts(self) -> np.ndarray:
        """(R, E) mask of the contacts that take part."""
        return ~self.samples.flat(map(self.samples.idle, range(self.samples.dimension)))

    @property
    def limit(self) -> np.ndarray:
        """(R, E), friction that a contact bears, or without friction its damping."""
        return self.samples.flat(self.samples.coefficient) * (self.samples.normal_force if self.holds else 1.0)

    @property
    def damping(self) -> np.ndarray | None:
        """(R, E), beside friction."""
        return self.samples.flat(self.samples.viscosity) if self.samples.viscosity else None

    @property
    def force_unit(self) -> float:
        return self.samples.force_unit

    @property
    def friction_size(self) -> np.ndarray:
        """(R, E), of the friction as stored, but of absent contacts."""
        sizes = (np.sqrt(sum(part**2 for part in turning.values())) for turning in self.samples.turning)
        return self.samples.flat(sizes) * self.force_unit

    @property
    def friction_along(self) -> np.ndarray:
        """(R, E) mask of the contacts along which friction acts."""
        samples = self.samples
        along = (f[..., axis] if samples.dimension == 3 else 0 * f for axis, f in enumerate(samples.friction))
        return samples.flat(along) != 0

    def one(self, number: int) -> Judgement:
        """Of one of the samples alone."""
        return Judgement(self.samples.one(number))

    @cached_property
    def motion(self) -> Motion:
        return Motion(self.samples)

    @cached_property
    def work(self) -> Work:
        return work_of(self.samples)

    @property
    def _unit(self) -> float:
        """Of power. Powers of two but for the radius; what multiplying by it rounds is seen to in the bounds."""
        return self.samples.force_unit * (self._speed if self.samples.holds else self._speed**2)

    @cached_property
    def _objective(self) -> Enclosure:
        return self.motion.objective()

    @cached_property
    def _lower_bound(self) -> np.ndarray:
        return lower_bound(self.samples, self.work)

    @property
    def _speed(self) -> float:
        """Of slips."""
        return self.samples.radius * self.samples.spin_unit

    @cached_property
    def slip(self) -> np.ndarray:
        """(R, E), speeds of the slips of these spins, to the nearest doubles."""
        found = [np.zeros(still.shape) for still in self.motion.still]
        for of_axes in (zip(self.motion.slips, self.motion.size, strict=True), self.motion.loose):
            for values, (slips, size) in zip(found, of_axes, strict=False):
                values.put(slips.own, size.value * self._speed)
        return self.samples.flat(found)

    @cached_property
    def slip_bound(self) -> np.ndarray | None:
        """(R, E), speeds that no slip of any minimum exceeds, of contacts with friction."""
        if not self.samples.holds:
            return None
        bounds = slip_bounds(self.samples, self.work, self._objective.upper())
        return self.samples.flat(bounds) * self._speed * (1 + 2.0**-50)

    @property
    def saturation(self) -> np.ndarray:
        """(R,), largest |F| / (mu F_n), rounded up; 0 without hard contacts."""
        return self.work.saturation

    @property
    def largest_torque(self) -> np.ndarray:
        """(R,), that the friction leaves on a free sphere, force * length, rounded up."""
        return _in_units(self.work.largest_torque, self.samples.force_unit * self.samples.radius, np.inf)

    @property
    def power(self) -> np.ndarray:
        """(R,), what these spins dissipate, to the nearest doubles."""
        power = self.motion.power() if self.samples.holds and self.samples.flows else self._objective
        return np.asarray(power.value * self._unit)

    @property
    def objective(self) -> np.ndarray:
        """(R,), what is least at rest: the power, or with friction and viscosity the potential; nearest doubles."""
        return np.asarray(self._objective.value * self._unit)

    @property
    def upper_bound(self) -> np.ndarray:
        """(R,), not below that, and so not below the least one."""
        return _in_units(self._objective.upper(), self._unit, np.inf)

    @property
    def lower_bound(self) -> np.ndarray:
        """(R,), not above the least objective."""
        return np.maximum(_in_units(self._lower_bound, self._unit, -np.inf), 0.0)

    @cached_property
    def gap(self) -> np.ndarray:
        """(R,), (upper bound - lower bound) / upper bound, rounded up; NaN without an upper bound.

        Where the least objective is 0, of no jump or of planes that nothing joins, a part of nothing says nothing: then
        it is a part of the natural power, if that is larger.
        """
        upper, lower = self.upper_bound, self.lower_bound
        unit = np.maximum(upper, natural_power(self.samples))
        with np.errstate(invalid="ignore"):
            gap = np.divide(upper - lower, unit, out=np.zeros_like(unit), where=unit > 0)
        return np.where(np.isfinite(upper), _outwards(gap, np.inf), np.nan)

    @property
    def price(self) -> np.ndarray:
        """(R,), what torques left over on free spheres take from the lower bound, over the objective."""
        price, objective = self.work.price.upper(), self._objective.value
        return np.divide(price, objective, out=np.zeros_like(price), where=objective > 0)

    @cached_property
    def states(self) -> list[States]:
        """Contact states at every minimum, sample by sample."""
        proven = self._lower_bound
        if not self.samples.flows:  # what the friction does as it is: below 0, and beyond its discs, if need be
            proven = (self.work.work - self.work.price).lower()
        return proven_states(self.motion, (self._objective.upper() - proven) * (1 + 2.0**-50))


def _in_units(values: np.ndarray, unit: float, towards: float) -> np.ndarray:
    """Values times a unit, rounded that way: nothing is lost by a power of two."""
    return values * unit if np.frexp(unit)[0] == 0.5 else _outwards(values * unit, towards)


def _outwards(values: np.ndarray, towards: float) -> np.ndarray:
    """By two roundings, which a unit and the product with it have at most; 0 stays as it is."""
    for _ in range(2):
        values = np.where(values != 0, np.nextafter(values, towards), values)
    return values


def natural_power(samples: Samples) -> np.ndarray:
    """(R,), of all contacts with the imposed jump for slip, where nothing joins bottom and top; with the imposed spin
    where there is no jump; else 0."""
    speed = samples.radius * (samples.jump_size or abs(samples.spin_top))
    unit = samples.normal_force * speed if samples.holds else speed**2
    total = np.zeros(samples.count)
    for coefficients, weight in ((samples.coefficient, unit), (samples.viscosity, speed**2 / 2)):
        for axis, values in enumerate(coefficients):
            acting = np.where(samples.between_driven(axis), 0.0, values)
            total += weight * acting.reshape(samples.count, -1).sum(axis=1)
    return np.where(_cut_off(samples) | (samples.jump_size == 0), total, 0.0)


def _cut_off(samples: Samples) -> np.ndarray:
    """(R,), True where absent contacts leave bottom and top unconnected in every component in which they differ."""
    if all((values > 0).all() for values in samples.coefficient):
        return np.zeros(samples.count, dtype=bool)
    return np.array([not any(_joined(samples, number, k) for k in samples.needed) for number in range(samples.count)])


def _joined(samples: Samples, number: int, component: int) -> bool:
    """True if contacts that feel a component lead from the bottom of a sample to its top, in a layer with a jump."""
    reached, before = np.zeros(samples.shape, dtype=bool), -1
    reached[..., 0] = samples.jump_over(component, samples.dimension - 1).most[0] > 0
    while int(reached.sum()) > before:
        before = int(reached.sum())
        for axis in range(samples.dimension):
            if component in samples.felt(axis):
                low, high = (end[1:] for end in samples.ends(axis))
                there = samples.coefficient[axis][number] > 0
                reached[low] |= there & reached[high]
                reached[high] |= there & reached[low]
    return bool(reached[..., -1].any())
