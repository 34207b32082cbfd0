"""Contact networks of any kind, their spins and their friction, as they are to be judged: samples of a lattice side by
side, or a packing.

With u = R omega the surface of the second sphere of a contact slips past the first with v = -(u_i + u_j) x n, friction
F on the second one turns both with n x F, its moment, and what it takes from the motion is (u_i + u_j) . (n x F) =
-F . v, at most |F| |v|. A disc has one component, u and v about z, F along z x n. Normals of packings are taken bit by
bit as they are stored: they say what slips, also where their length is not quite 1.

On a lattice u = s U, with the sign s of the sublattice, and U is measured from the state of the bottom, which slips
nowhere. A part is what contacts between free spheres join. Where it touches nothing that is driven, it rests at some
minimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.enclosure import Enclosure, grouped_sum, joined, length, row_sum
from taichi_bearings.proof.grid import Grid, nothing
from taichi_bearings.proof.on_lattice import LEAST_SCALE, MOST_SCALE, OnLattice
from taichi_bearings.scene import Bearing
from taichi_bearings.scene.exact_driving import power_of_two
from taichi_bearings.scene.law import Law
from taichi_bearings.scene.scene import of_lattice

LEAST_SPEED = 1e-100  # of the fastest surface that is imposed
ONE_SPEED = 4  # units in the last place, up to which imposed speeds are one


@dataclass(frozen=True)
class Listed:
    """The contacts of a packing: place (n, D) of its spheres, contact (2, m), normal (m, D), friction (m, C)."""

    place: np.ndarray
    contact: np.ndarray
    normal: np.ndarray
    friction: np.ndarray

    def any_end(self, mask: np.ndarray) -> np.ndarray:
        """(m,), is the mask (n,) true of either sphere?"""
        return np.asarray(mask[self.contact].any(axis=0))

    @property
    def slips_with(self) -> np.ndarray:
        """(C, m) mask of the components that contacts slip with, where components do not mix."""
        return self.normal.T == 0 if self.normal.shape[1] == 3 else np.ones((1, len(self.normal)), dtype=bool)

    def lengths(self, parts: list[Enclosure]) -> Enclosure:
        """(m,), of vectors given by component."""
        return length(parts)

    def torques(self, moment: list[Enclosure]) -> list[Enclosure]:
        """Their sums at each sphere, (n,) by component."""
        return [grouped_sum(joined([part, part]), self.contact.ravel(), len(self.place)) for part in moment]


@dataclass(frozen=True)
class JudgedNetwork:
    """R samples of N spheres and E contacts each, n = R N and m = R E in all; D = 2 or 3, and C = 1 or 3 components.

    free : (n,). speed_unit, force_unit : a power of two, but for the radius in the speeds of
    lattices. spin : u by component, C enclosures (n,), on lattices with the sign s. moment : n x F by component, C
    enclosures (m,), 0 where nothing acts. holding : mu F_n; slope : eta, (m,) enclosures, 0 where there is none.
    imposed : u of driven spheres by component, 0 for free ones, and on lattices measured from the bottom.
    graph : where its contacts are, and what they bear. rolling : (n,) mask of free spheres whose contacts can all roll,
    whatever the others do. factors : (m,) numbers each, whose products are in the proportions of mu F_n, exactly.
    """

    law: Law
    count: int
    free: np.ndarray
    speed_unit: float
    force_unit: float
    spin: list[Enclosure]
    moment: list[Enclosure]
    holding: Enclosure
    slope: Enclosure
    imposed: list[Enclosure]
    graph: Grid | Listed
    rolling: np.ndarray | None = None
    factors: tuple[np.ndarray, ...] = ()

    @property
    def lattice(self) -> OnLattice | None:
        """Where the contacts are those of a lattice: its planes, layers and signs, as its samples have them."""
        return self.graph.samples if isinstance(self.graph, Grid) else None

    @property
    def place(self) -> np.ndarray:
        """(n, D)."""
        return self.graph.place

    @property
    def contact(self) -> np.ndarray:
        """(2, m), numbers of the first and the second sphere."""
        return self.graph.contact

    @property
    def normal(self) -> np.ndarray:
        """(m, D)."""
        return self.graph.normal

    @property
    def friction(self) -> np.ndarray:
        """F on the second sphere, (m, C)."""
        return self.graph.friction

    @property
    def holds(self) -> bool:
        """True if a contact bears a force without slipping."""
        return self.law.holds

    @property
    def flows(self) -> bool:
        """True if the force grows with the slip."""
        return self.law.flows

    @classmethod
    def of(
        cls, scene: Bearing, spin: np.ndarray, spin_rounding: np.ndarray, friction: np.ndarray
    ) -> JudgedNetwork | None:
        """None for numbers that are not finite, or of scales for which no arithmetic here is made. Arrays : as of
        :class:`Judgement`."""
        if scene.network.lattice is not None:
            samples = OnLattice(of_lattice(scene), spin, spin_rounding, friction)
            return cls.of_lattice(samples) if samples.can_be_judged else None
        return cls._of_packing(scene, spin, spin_rounding, friction)

    @classmethod
    def of_lattice(cls, samples: OnLattice) -> JudgedNetwork:
        scene, grid, force = samples.scene, Grid(samples), samples.force_unit
        strength, radius, law = scene.strength, scene.lattice.radius, scene.law
        coefficient, free = scene.coefficient.ravel(), np.ones(grid.spheres, dtype=bool)
        for plane in (0, -1):
            grid.on_spheres(free)[..., plane] = False
        acts, none = grid.any_end(free) & (coefficient != 0), np.broadcast_to(0.0, grid.contacts)  # takes no memory
        zero = Enclosure(none, none, none)
        unit, speed = power_of_two(strength), radius * (samples.spin_unit / force)
        holding = Enclosure.exact(coefficient / (force / unit)).times(np.array([strength / unit]))
        viscosity = scene.named_coefficients.get("viscosity", coefficient).ravel()
        return cls(
            law, samples.count, free, radius * samples.spin_unit, force,
            list(samples.signed_spin.values()), grid.moment(acts), holding if law.holds else zero,
            Enclosure.exact(viscosity).times(np.array([speed])) if law.flows else zero,
            [grid.imposed(k) for k in samples.components], grid, factors=(coefficient,),
        )  # fmt: skip

    @classmethod
    def _of_packing(
        cls, packing: Bearing, spin: np.ndarray, rounding: np.ndarray, friction: np.ndarray
    ) -> JudgedNetwork | None:
        contacts, law = packing.network, packing.law
        free, radius = contacts.free, contacts.radius
        spin, rounding, imposed = (
            of.reshape(contacts.spheres, -1) for of in (spin, rounding, packing.imposed_spins()[0])
        )
        friction = friction.reshape(contacts.contacts, contacts.components)
        spin = np.where(free[:, None], spin, imposed)
        rounding = np.where(free[:, None], rounding, 0.0)
        # where all radii are the same, speeds are measured in it, and none is rounded
        unit, radius = (float(radius[0]), np.ones(len(radius))) if (radius == radius[0]).all() else (1.0, radius)
        fastest = float(np.abs(spin * radius[:, None])[~free].max(initial=0.0)) or 1.0
        given, *beside = (of[0] for of in packing.named_coefficients.values())
        pressed = packing.normal_force if law.holds else 1.0
        first, slope = given * pressed, np.zeros(contacts.contacts)
        if law.flows:
            slope = beside[0] if law.holds else given
        largest = float(slope.max(initial=0.0)) * unit * fastest
        largest = max(float(first.max(initial=0.0)) if law.holds else 0.0, largest)
        if not all(LEAST_SPEED < fast < MOST_SCALE for fast in (fastest, fastest * unit)):
            return None
        if largest and not LEAST_SCALE < largest < MOST_SCALE:
            return None
        speed, force = power_of_two(fastest), power_of_two(largest)
        acts = ((first > 0) | (slope > 0)) & contacts.has_free_end
        with np.errstate(over="ignore"):
            spin, rounding, friction = spin / speed, rounding / speed, friction / force
        sizes = (spin, rounding, spin * radius[:, None], rounding * radius[:, None], friction)
        if not all((np.abs(values) < MOST_SCALE).all() for values in sizes):
            return None
        zero = Enclosure.exact(np.zeros(contacts.contacts))
        moving = [Enclosure.exact(*part) for part in zip(spin.T, rounding.T, strict=True)]
        moving = moving if (radius == 1).all() else [part.times(radius) for part in moving]
        for part in moving:
            _drive_as_one(part, np.flatnonzero(~free))
        moment = moments([Enclosure.exact(np.where(acts, part, 0.0)) for part in friction.T], contacts.normal)
        return cls(
            law, 1, free, speed * unit, force, moving, moment,
            Enclosure.exact(given / force).times(np.broadcast_to(pressed, given.shape)) if law.holds else zero,
            Enclosure.exact(slope * (speed / force)).times(np.array([unit])) if law.flows else zero,
            [part.where(~free) for part in moving],
            Listed(contacts.center, contacts.contact, contacts.normal, friction),
            factors=(given, np.broadcast_to(packing.normal_force, given.shape)),
        )  # fmt: skip

    @property
    def power_unit(self) -> float:
        return self.speed_unit * self.force_unit

    @property
    def components(self) -> range:
        return range(len(self.spin))

    @cached_property
    def acts(self) -> np.ndarray:
        """(m,) mask of contacts with a coefficient and a free end."""
        return ((self.holding.high > 0) | (self.slope.high > 0)) & self.graph.any_end(self.free)

    @cached_property
    def is_whole(self) -> bool:
        """True for lattices all of whose contacts with a free end act: every column reaches from bottom to top."""
        return self.lattice is not None and bool(self.free.any() and (self.acts == self.graph.any_end(self.free)).all())

    @cached_property
    def reached(self) -> np.ndarray:
        """(n,) mask of free spheres in parts that touch driven spheres."""
        if self.is_whole:
            return self.free
        first, second = self.contact[:, self._holding]
        inner, count = self.free[first] & self.free[second], len(self.free)
        label = pieces(count, first[inner], second[inner])
        touched = np.zeros(count, dtype=bool)
        for end, other in ((first, second), (second, first)):
            touched[label[end[self.free[end] & ~self.free[other]]]] = True
        return self.free & touched[label] & ~(self.rolling if self.rolling is not None else np.zeros(count, dtype=bool))

    @cached_property
    def counts(self) -> np.ndarray:
        """(m,) mask of the contacts that act there: others dissipate nothing at any minimum."""
        return self.acts if self.is_whole else self._holding & self.graph.any_end(self.reached)

    @cached_property
    def _holding(self) -> np.ndarray:
        """(m,) mask of those that act and do not belong to rolling spheres."""
        return self.acts if self.rolling is None else self.acts & ~self.graph.any_end(self.rolling)

    @cached_property
    def box(self) -> np.ndarray:
        """(C,), largest size of each component of what is imposed."""
        return np.array([part.most.max(initial=0.0) for part in self.imposed])

    @property
    def reach(self) -> list[Enclosure]:
        """By component, (n,): some minimum has u of a free sphere between 0 and this, or that and its negative, where
        components do not mix."""
        if self.lattice is None:
            return [Enclosure.exact(np.full(len(self.free), size)) for size in self.box]
        return [self.lattice.jump_at(k).signed(s) for k, s in zip(self.lattice.components, self.sign, strict=True)]

    @cached_property
    def mixes(self) -> bool:
        """False where components do not mix: of discs, and of unit normals along the axes."""
        return self.lattice is None and not self._along_axes

    @property
    def _along_axes(self) -> bool:
        return self.normal.shape[1] == 2 or bool((np.sort(np.abs(self.normal[self.counts])) == (0, 0, 1)).all())

    @cached_property
    def slips_with(self) -> np.ndarray:
        """(C, m) mask of the components that contacts slip with, where components do not mix."""
        return self.graph.slips_with

    @cached_property
    def feels(self) -> np.ndarray:
        """(C, m) mask of the components that contacts slip with which count, where components do not mix."""
        return self.counts & self.slips_with

    def sample_of(self, contacts: np.ndarray) -> np.ndarray:
        """The numbers of the samples of some contacts."""
        return contacts // (len(self.acts) // self.count)

    def on_contacts(self, values: np.ndarray) -> np.ndarray:
        """(m,), what each contact has of a number (R,) a sample."""
        return (
            np.broadcast_to(values, len(self.acts))
            if self.count == 1
            else np.repeat(values, len(self.acts) // self.count)
        )

    def by_sample(self, values: Enclosure, contacts: np.ndarray) -> Enclosure:
        """(R,), sums over some contacts."""
        if not len(contacts):
            return nothing(self.count)
        whole = nothing(len(self.acts))
        whole.put(contacts, values)
        return row_sum(whole.reshaped((self.count, -1)))

    def slips(self, spin: list[Enclosure]) -> list[Enclosure]:
        """(u_i + u_j) x n by component, (m,) each."""
        first, second = self.contact
        return across([part.at(first) + part.at(second) for part in spin], self.normal)

    @cached_property
    def slip(self) -> Enclosure:
        """(m,), its size."""
        return self.motion.slip if isinstance(self.graph, Grid) else length(self.slips(self.spin))

    @cached_property
    def still(self) -> np.ndarray:
        """(m,) mask: no slip at all, exactly."""
        if isinstance(self.graph, Grid):
            return self.graph.alike(self.spin)
        (first, second), found = self.contact, np.ones(len(self.acts), dtype=bool)
        for part, feels in zip(self.spin, self.slips_with, strict=True):
            for of in part.parts[:2]:
                found &= (of[first] == -of[second]) | ~feels
        return found

    @cached_property
    def motion(self) -> Motion:
        """That of the spins of a lattice, in which contacts rest that do not slip at all."""
        return Motion(self, self.still & self.acts)

    @cached_property
    def own_torques(self) -> list[Enclosure]:
        """Sums of the following at each sphere, (n,) by component."""
        return self.torques(self.own_moment)

    @cached_property
    def own_moment(self) -> list[Enclosure]:
        """Of the contacts that count; of lattices in components that differ between the planes: others do no work."""
        own, all_count = (
            [size > 0 or self.lattice is None for size in self.box],
            bool((self.counts == self.acts).all()),
        )
        pairs = zip(self.moment, own, strict=True)  # moments are 0 where nothing acts
        return [part if some and all_count else part.where(self.counts & some) for part, some in pairs]

    @property
    def own_friction(self) -> list[Enclosure]:
        """Of the contacts that count F by component; of lattices its moments, which are as long."""
        if self.lattice is not None:
            return self.moment
        return [Enclosure.exact(np.where(self.counts, part, 0.0)) for part in self.friction.T]

    @property
    def joins(self) -> np.ndarray:
        """(R,), True if contacts lead from the bottom of a lattice to its top in a component in which both differ."""
        if self.is_whole:
            return np.full(self.count, bool(self.needed))
        return Motion(self, self.acts).torn

    def torques(self, moment: list[Enclosure]) -> list[Enclosure]:
        """Their sums at each sphere, (n,) by component."""
        return self.graph.torques(moment)

    @cached_property
    def needed(self) -> list[int]:
        """Components that some minimum needs: along the others nothing slips at any minimum. On a lattice layers turn
        about the height as they like."""
        if (samples := self.lattice) is not None:
            return [
                k for k in self.components if self.box[k] > 0 and samples.components[k] != samples.lattice.height_axis
            ]
        return [k for k in self.components if self._is_needed(k)]

    def signs(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Parts that contacts join in component k: label (n,), mask of those with odd loops, and signs s by which
        neighbours differ in the others."""
        return signs(self.contact[:, self.feels[k]], len(self.free))

    @cached_property
    def sign(self) -> list[np.ndarray]:
        """(n,) by component, signs s by which neighbours differ, but in odd loops."""
        if self.lattice is not None:
            return [np.tile(self.lattice.sublattice.ravel(), self.count)] * len(self.spin)
        return [self.signs(k)[2] for k in self.components]

    def _is_needed(self, k: int) -> bool:
        """False if component k can be such that nothing slips along it: then that is so at every minimum."""
        label, odd, sign = self.signs(k)
        held = np.flatnonzero(~self.free)
        own = self.imposed[k].signed(sign).at(held)
        first, part = np.unique(label[held], return_index=True, return_inverse=True)[1:]
        several = any((values != values[first][part]).any() for values in own.parts[:2])
        return bool(several or (odd[held] & (own.high != 0)).any())

    def dissipated(self, of_slope: float, some: np.ndarray | None = None) -> Enclosure:
        """(R,), friction times slip plus `of_slope`, a power of two, times damping times its square, of what acts."""
        held, flows = self._dissipated if some is None else self._sums(some)
        return held + flows.signed(of_slope)

    @cached_property
    def _dissipated(self) -> tuple[Enclosure, Enclosure]:
        return self._sums(self.acts)

    def _sums(self, some: np.ndarray) -> tuple[Enclosure, Enclosure]:
        """(R,) each, of friction times slip and of damping times its square."""
        slips, slip = some & ((self.slip.high != 0) | (self.slip.error != 0)), self.slip
        held, flowing = nothing(self.count), nothing(self.count)
        if self.holds:
            held = row_sum((self.holding * slip).where(slips).reshaped((self.count, -1)))
        if self.flows:
            flowing = row_sum((self.slope * slip * slip).where(slips).reshaped((self.count, -1)))
        return held, flowing


def _drive_as_one(u: Enclosure, driven: np.ndarray) -> None:
    """Give driven spheres (numbers) of which a component u, (N,), has sizes that differ by no more than 4 units in the
    last place the least of these sizes, as a double; in place. A spin that is a speed over a radius, rounded, makes
    several of one driving. What differs from nothing else stays as it is, with all its digits."""
    own = driven[u.high[driven] != 0]
    sign = np.sign(u.high[own])
    (size, _), place = np.unique(np.stack([sign * u.high[own], sign * u.low[own]]), axis=1, return_inverse=True)
    group = np.arange(len(size))
    for number in range(1, len(size)):
        least = size[group[number - 1]]
        if size[number] - least <= ONE_SPEED * np.spacing(size[number]):
            group[number] = group[number - 1]
    several = np.bincount(group, minlength=len(size)) > 1
    found = group[place.reshape(-1)]
    some = several[found]
    u.put(own[some], Enclosure.exact(sign[some] * size[found[some]]))


def across(vectors: list[Enclosure], normal: np.ndarray) -> list[Enclosure]:
    """Vectors (m,) x n; those of discs as they are."""
    if len(vectors) == 1:
        return vectors
    n = normal.T
    turned = [(k + 1) % 3 for k in range(3)], [(k + 2) % 3 for k in range(3)]
    return [vectors[a].times(n[b]) - vectors[b].times(n[a]) for a, b in zip(*turned, strict=True)]


def moments(friction: list[Enclosure], normal: np.ndarray) -> list[Enclosure]:
    """n x F by component, (m,) each."""
    return friction if len(friction) == 1 else [-part for part in across(friction, normal)]


def signs(ends: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts that edges (2, n) make of nodes: label (size,), mask of those with odd loops, and signs s by which
    neighbours differ in the others."""
    first, second = ends
    copy = pieces(2 * size, np.append(first, second), np.append(second, first) + size).reshape(2, -1)
    return copy.min(axis=0), copy[0] == copy[1], np.where(copy[0] > copy[1], -1.0, 1.0)


@dataclass(frozen=True)
class Motion:
    """The spins of a network whose components do not mix, as unknowns: spheres that contacts without slip join are a
    domain of a component, and turn as one sphere of it does where the stored spins are not quite the same. rests : (m,)
    mask of these contacts.

    On a lattice driven spheres of one plane and layer are of one domain. There stored spins are exact, and what is
    imposed on the top is not quite what is stored: it is far below the rounding of the spins and yet not of the
    smallest slips.
    """

    network: JudgedNetwork
    rests: np.ndarray

    @cached_property
    def domain(self) -> Domains:
        """By component, (n,), number of the domain of each sphere; found when it is asked for."""
        return Domains(self)

    def joins(self, k: int) -> bool:
        """True if any contact joins spheres to a domain of a component."""
        return bool((self.rests & self.network.slips_with[k]).any())

    def domains(self, k: int) -> np.ndarray:
        """(n,), number of the domain of each sphere."""
        network, size = self.network, len(self.network.free)
        own = np.arange(size) if network.lattice is None else network.lattice.anchor(network.lattice.components[k])
        if not self.joins(k):
            return own
        first, second = network.contact[:, self.rests & network.slips_with[k]]
        held = np.flatnonzero(own != np.arange(size))
        return pieces(size, np.append(first, held), np.append(second, own[held]))

    def _models(self, k: int) -> np.ndarray:
        """(n,), the sphere as which each turns: of those of its domain a driven one if there is any, else the first."""
        domain = self.domain[k]
        model = np.empty(domain.max(initial=-1) + 1, dtype=np.intp)
        for spheres in (np.arange(len(domain))[::-1], np.flatnonzero(~self.network.free)):
            model[domain[spheres]] = spheres  # the last that is written stays
        return model[domain]

    @cached_property
    def torn(self) -> np.ndarray:
        """(R,), True if contacts without slip join driven spheres that turn otherwise: impossible."""
        network, found = self.network, np.zeros(self.network.count, dtype=bool)
        held = np.flatnonzero(~network.free)
        for k in (k for k in network.components if network.imposed[k].high.any() and self.joins(k)):
            own, model = network.imposed[k].signed(network.sign[k]), self._models(k)[held]
            differs = np.any([part[held] != part[model] for part in own.parts[:2]], axis=0)
            found[held[differs] // (len(network.free) // network.count)] = True
        return found

    @cached_property
    def _turning(self) -> dict[int, tuple[Enclosure, Enclosure | None]]:
        """By component what :meth:`_turns` has found."""
        return {}

    def _turns(self, k: int) -> tuple[Enclosure, Enclosure | None]:
        """Signed spins (n,), and what those that turn with the top of a lattice lack, if they lack anything."""
        if k not in self._turning:
            self._turning[k] = self._turns_of(k)
        return self._turning[k]

    def _turns_of(self, k: int) -> tuple[Enclosure, Enclosure | None]:
        network = self.network
        own = network.spin[k] if network.lattice is not None else network.spin[k].signed(network.sign[k])
        if (self.rests & ~network.still).any():
            own = own.at(self._models(k))
        shift = None if network.lattice is None else network.lattice.shift[network.lattice.components[k]]
        if shift is None or not (shift.high.any() or shift.error.any()):
            return own, None
        return own, shift.at(self._models(k)) if self.joins(k) else shift

    @cached_property
    def slip(self) -> Enclosure:
        """(m,), of all contacts of a lattice; exactly 0 of those that are still."""
        network = self.network
        assert isinstance(network.graph, Grid)
        turns = [self._turns(k) for k in network.components]
        return network.graph.slips([own for own, _ in turns], [shift for _, shift in turns], network.still)

    def difference(self, k: int, some: np.ndarray) -> Enclosure:
        """Of signed spins, of some contacts that feel component k."""
        first, second = self.network.contact[:, some]
        own, shift = self._turns(k)
        domain, found = self.domain[k], nothing(len(some))
        differ = np.flatnonzero(domain[first] != domain[second])
        found.put(differ, own.at(second[differ]) - own.at(first[differ]))
        if shift is not None:  # the top turns as it should
            at_top = np.flatnonzero(shift.high[first] != shift.high[second])
            found.put(at_top, found.at(at_top) + (shift.at(second[at_top]) - shift.at(first[at_top])))
        return found


class Domains(dict[int, np.ndarray]):
    """By component, found when it is asked for."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion

    def __missing__(self, k: int) -> np.ndarray:
        self[k] = found = self.motion.domains(k)
        return found
