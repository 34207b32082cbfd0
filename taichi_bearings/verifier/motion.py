"""The spins of samples as exact unknowns: which contacts do not slip at all, what moves as one, and the slips."""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.verifier.enclosure import Enclosure, grouped_sum, joined
from taichi_bearings.verifier.samples import DIGITS, Samples

LEAST_LENGTH = 2.0**-400  # length below which squares lose digits
LEAST_ROUNDING = 2.0**-1072  # twice what scaling back into the smallest doubles can round


@dataclass(frozen=True)
class Slips:
    """The n contacts of an axis that slip, as flat numbers: own, among all contacts of the axis; lower and upper, their
    spheres among those of all samples. sample : whose each is."""

    own: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    sample: np.ndarray


@dataclass(frozen=True)
class Motion:
    """The spins of samples, exactly: what the file says of the free spheres, and exactly what is imposed on the others.

    Spheres that contacts without slip join are a domain of a component; those joined to a driven plane turn with it, as
    it turns in their layer.
    """

    samples: Samples

    @cached_property
    def still(self) -> tuple[np.ndarray, ...]:
        """Masks (R, *contacts) an axis: no difference of signed spins at all, of contacts that are not absent."""
        return tuple(even & ~absent for even, absent in zip(self._even, self.samples.absent, strict=True))

    @cached_property
    def moving(self) -> tuple[np.ndarray, ...]:
        """The same of those with a difference."""
        return tuple(~(even | absent) for even, absent in zip(self._even, self.samples.absent, strict=True))

    @cached_property
    def _even(self) -> tuple[np.ndarray, ...]:
        """Those without a difference, absent or not."""
        found = []
        for axis, coefficient in enumerate(self.samples.coefficient):
            low, high = self.samples.ends(axis)
            mask = np.ones(coefficient.shape, dtype=bool)
            for k in self.samples.felt(axis):
                for part in self.samples.signed_spin[k]:
                    mask &= part[low] == part[high]
            found.append(mask)
        return tuple(found)

    @cached_property
    def slips(self) -> tuple[Slips, ...]:
        """Those that are `moving`, an entry an axis."""
        return self._of(self.moving)

    @cached_property
    def loose(self) -> tuple[tuple[Slips, Enclosure], ...]:
        """Absent contacts with a difference, and its length, an entry an axis; empty where none is absent."""
        if not self.samples.lacks:
            return ()
        of_all = self._of(tuple(~even & absent for even, absent in zip(self._even, self.samples.absent, strict=True)))
        felt = map(self.samples.felt, range(self.samples.dimension))
        return tuple((s, length([self._differences(k, s) for k in of])) for s, of in zip(of_all, felt, strict=True))

    def _of(self, some: tuple[np.ndarray, ...]) -> tuple[Slips, ...]:
        """Contacts by their masks (R, *contacts) an axis."""
        sphere, found = numbers_of(self.samples), []
        for axis, mask in enumerate(some):
            low, high = self.samples.ends(axis)
            own = np.flatnonzero(mask)
            lower, step = sphere[low].ravel()[own], math.prod(self.samples.shape[axis + 1 :])
            upper = sphere[high].ravel()[own] if axis in self.samples.periodic else lower + step
            found.append(Slips(own, lower, upper, lower // self.samples.sublattice.size))
        return tuple(found)

    @cached_property
    def domain(self) -> dict[int, np.ndarray]:
        """Number (R, *N) of the domain of each sphere, component by component: 0 and 1 for all that turns with the
        bottom and with the top, 2 and more for the others, of all samples together. Of components that differ between
        the planes, or seem to; nobody asks for others."""
        some = (k for k in self.samples.components if self.samples.jumps(k) or self.shift[k].most.any())
        return {k: self.domains(k, self.still) for k in some}

    def domains(self, component: int, joined_by: tuple[np.ndarray, ...]) -> np.ndarray:
        """The same of one component, of spheres that these contacts join, masks (R, *contacts) an axis."""
        samples, sphere = self.samples, numbers_of(self.samples)
        felt = [axis for axis in range(samples.dimension) if component in samples.felt(axis)]
        joins = np.zeros((*sphere.shape, len(felt) + 1), dtype=bool)  # to the next sphere along each axis
        ahead = np.empty(joins.shape, dtype=np.int32)
        for slot, axis in enumerate(felt):
            low, high = samples.ends(axis)
            joins[..., slot][low] = joined_by[axis]
            ahead[..., slot][low] = sphere[high]
        joins[..., [0, -1], -1] = True  # and to the first of its plane and layer
        ahead[..., [0, -1], -1] = samples.first_in_layers(sphere, component)[..., [0, -1]]
        degree = sum(joins[..., slot].ravel() for slot in range(len(felt) + 1))
        begin = np.append(0, np.cumsum(degree))
        graph = sparse.csr_array((np.ones(begin[-1]), ahead[joins], begin), shape=(sphere.size,) * 2)
        label = connected_components(graph, directed=False)[1].reshape(sphere.shape)
        first = samples.first_in_layers(label, component)
        return np.where(label == first[..., :1], 0, np.where(label == first[..., -1:], 1, label + 2))

    @cached_property
    def torn(self) -> np.ndarray:
        """(R,), True if contacts without slip join bottom and top in a component in which they differ: impossible."""
        samples, found = self.samples, np.zeros(self.samples.count, dtype=bool)
        for k in (k for k in samples.components if samples.jumps(k)):
            differs = samples.jump_over(k, samples.dimension - 1).most > 0
            found |= ((self.domain[k][..., -1] == 0) & differs).reshape(samples.count, -1).any(axis=1)
        return found

    @cached_property
    def shift(self) -> dict[int, Enclosure]:
        """(R * layers,) or (R,), what the signed spin of the top, as stored, lacks of the imposed one, measured from
        the bottom; one a layer along the component where the jump varies.

        It is far below the rounding of the spins and yet not of the smallest slips.
        """
        found = {}
        with localcontext() as context:
            context.prec = DIGITS
            for k, stored in self.samples.signed_spin.items():
                jump = self.samples.exact_jump[k]
                first = [self.samples.first_in_layers(part, k).reshape(self.samples.count, -1, part.shape[-1])
                         for part in stored]  # fmt: skip
                corners = np.stack([part[:, : len(jump), end] for part in first for end in (0, -1)], axis=-1)
                missing = [
                    jump[layer] - sum(sign * Decimal(float(v)) for sign, v in zip((-1, 1, -1, 1), of_one, strict=True))
                    for of_sample in corners
                    for layer, of_one in enumerate(of_sample)
                ]
                found[k] = Enclosure.of_decimals(missing)
        return found

    @cached_property
    def difference(self) -> tuple[dict[int, Enclosure], ...]:
        """Differences of signed spins by component, of `slips`; (n,) each, an entry an axis."""
        return tuple(
            {k: self._differences(k, slips) for k in self.samples.felt(axis)} for axis, slips in enumerate(self.slips)
        )

    def _differences(self, component: int, slips: Slips) -> Enclosure:
        ends = [
            [part.ravel().take(end) for part in self.samples.signed_spin[component]]
            for end in (slips.upper, slips.lower)
        ]
        if component not in self.domain and all((a == b).all() for a, b in zip(*ends, strict=True)):
            return Enclosure.exact(np.zeros(len(slips.own)))
        upper, lower = (Enclosure(high, low, np.zeros_like(high)) for high, low in ends)
        found = upper - lower
        if component in self.domain:  # the top turns as it should
            at_top = (self.domain[component] == 1).ravel()
            sign = at_top[slips.upper].astype(float) - at_top[slips.lower]
            some = np.flatnonzero(sign)
            found.put(some, found.at(some) + self._shift_at(component, slips, some).signed(sign[some]))
        return found

    def _shift_at(self, component: int, slips: Slips, some: np.ndarray) -> Enclosure:
        """What the top lacks in the layers of some of these contacts."""
        layers, place = len(self.samples.exact_jump[component]), slips.sample[some]
        if layers > 1:
            sphere = slips.lower[some] % self.samples.sublattice.size
            place = place * layers + np.unravel_index(sphere, self.samples.shape)[component]
        return self.shift[component].at(place)

    @cached_property
    def size(self) -> tuple[Enclosure, ...]:
        """Length of these differences, (n,) an axis."""
        return tuple(length(list(parts.values())) for parts in self.difference)

    @cached_property
    def strength(self) -> tuple[Enclosure, ...]:
        """Of these contacts, (n,) an axis: `Samples.strength`."""
        return tuple(values.at(slips.own) for values, slips in zip(self.samples.strength, self.slips, strict=True))

    def power(self) -> Enclosure:
        """(R,), power that these spins dissipate in units of force unit * R spin unit (viscous: times R spin unit).

        Infinite where the motion is torn: what is stored then has no jump at all.
        """
        return self._sum_of_slips(1.0)

    def objective(self) -> Enclosure:
        """(R,), what is least at rest, in the same units: `Samples.share` times the potential."""
        return self._sum_of_slips(self.samples.share / 2)

    def _sum_of_slips(self, of_slope: float) -> Enclosure:
        """Friction times slip, plus `of_slope`, a power of two, times viscous force times slip."""
        samples, cost = self.samples, []
        for axis, (slips, size) in enumerate(zip(self.slips, self.size, strict=True)):
            parts = [self.strength[axis] * size] if samples.holds else []
            parts += [samples.slope[axis].at(slips.own).signed(of_slope) * size * size] if samples.flows else []
            cost.append(parts[0] if len(parts) == 1 else parts[0] + parts[1])
        total = grouped_sum(joined(cost), np.concatenate([slips.sample for slips in self.slips]), samples.count)
        return Enclosure(np.where(self.torn, np.inf, total.high), total.low, total.error)


def numbers_of(samples: Samples) -> np.ndarray:
    """Numbers (R, *N) of all spheres."""
    return np.arange(samples.count * math.prod(samples.shape)).reshape(samples.count, *samples.shape)


def whole_planes(samples: Samples, component: int) -> np.ndarray:
    """The same, one for all spheres of a driven plane in a layer along the component."""
    number = numbers_of(samples)
    number[..., [0, -1]] = samples.first_in_layers(number, component)[..., [0, -1]]
    return number


def spread(one: Enclosure, count: int) -> Enclosure:
    """One number `count` times."""
    return Enclosure(*(np.repeat(part, count) for part in one.parts))


def length(parts: list[Enclosure]) -> Enclosure:
    """Length of vectors given by their parts, (n,) each."""
    parts = [part for part in parts if part.high.any() or part.error.any()] or parts[:1]  # but those that are exactly 0
    if len(parts) == 1:
        return abs(parts[0])
    # the squares of faint ones would be lost
    sizes = np.max([part.most for part in parts], axis=0)
    scale = np.ldexp(1.0, -np.where(sizes < LEAST_LENGTH, np.maximum(np.frexp(sizes)[1], -1000), 0))
    squares = [part.signed(scale).squared() for part in parts]
    root = sum(squares[1:], squares[0]).sqrt().signed(1 / scale)
    root.error[scale > 1] += LEAST_ROUNDING
    # along an axis the length is exactly the size of the one part, whose square may be too small a number
    nothing = np.array([(part.high == 0) & (part.error == 0) for part in parts])
    for part, one in zip(parts, nothing, strict=True):
        alone = np.flatnonzero(nothing.sum(axis=0) - one == len(parts) - 1)
        root.put(alone, abs(part.at(alone)))
    return root
