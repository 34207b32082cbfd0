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

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.enclosure import Enclosure, length, row_sum
from taichi_bearings.proof.listed import Listed, across, signs
from taichi_bearings.proof.slices import nothing, slices
from taichi_bearings.scene.law import Law


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
    graph: Listed
    rolling: np.ndarray | None = None
    factors: tuple[np.ndarray, ...] = ()

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
        return self.graph.layered and bool(self.free.any() and (self.acts == self.graph.any_end(self.free)).all())

    @cached_property
    def reached(self) -> np.ndarray:
        """(n,) mask of free spheres in parts that touch driven spheres."""
        if self.is_whole:
            return self.free
        first, second = self.graph.contact[:, self._holding]
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
        return self.graph.reach(self.box, self.sign)

    @cached_property
    def mixes(self) -> bool:
        """False where components do not mix: of discs, and of unit normals along the axes."""
        return self.graph.mixes(self.counts)

    @cached_property
    def slips_with(self) -> np.ndarray:
        """(C, m) mask of the components that contacts slip with, where components do not mix."""
        return self.graph.slips_with

    @cached_property
    def feels(self) -> np.ndarray:
        """(C, m) mask of the components that contacts slip with which count, where components do not mix."""
        return self.counts & self.slips_with

    def some(self, pick: slice) -> JudgedNetwork:
        """Some of the samples alone."""

        def of(values: np.ndarray) -> np.ndarray:
            return values.reshape(self.count, -1)[pick].reshape(-1)

        def part(values: Enclosure) -> Enclosure:
            return Enclosure(*map(of, values.parts))

        return replace(
            self,
            count=len(range(*pick.indices(self.count))),
            free=of(self.free),
            spin=list(map(part, self.spin)),
            moment=list(map(part, self.moment)),
            holding=part(self.holding),
            slope=part(self.slope),
            imposed=list(map(part, self.imposed)),
            graph=self.graph.some(pick),
            rolling=None if self.rolling is None else of(self.rolling),
            factors=tuple(map(of, self.factors)),
        )

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
        first, second = self.graph.contact
        return across([part.at(first) + part.at(second) for part in spin], self.graph.normal)

    @cached_property
    def slip(self) -> Enclosure:
        """(m,), its size."""
        return self.motion.slip if self.graph.layered else length(self.slips(self.spin))

    @cached_property
    def still(self) -> np.ndarray:
        """(m,) mask: no slip at all, exactly."""
        return self.graph.still(self.spin)

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
        """n x F by component, (m,) each, of the contacts that count, in the components in which moments may do work."""
        own, all_count = self.graph.working(self.box), bool((self.counts == self.acts).all())
        pairs = zip(self.moment, own, strict=True)  # moments are 0 where nothing acts
        return [part if some and all_count else part.where(self.counts & some) for part, some in pairs]

    @property
    def own_friction(self) -> list[Enclosure]:
        """F by component of the contacts that count; of lattices its moments, which are as long."""
        return self.graph.borne(self.moment, self.counts)

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
        return self.graph.needed(self.box, self._is_needed)

    def signs(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Parts that contacts join in component k: label (n,), mask of those with odd loops, and signs s by which
        neighbours differ in the others."""
        return signs(self.graph.contact[:, self.feels[k]], len(self.free))

    @cached_property
    def sign(self) -> list[np.ndarray]:
        """(n,) by component, signs s by which neighbours differ, but in odd loops."""
        return self.graph.signs(self.feels)

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
        if self.law.holds:
            held = row_sum((self.holding * slip).where(slips).reshaped((self.count, -1)))
        if self.law.flows:
            flowing = row_sum((self.slope * slip * slip).where(slips).reshaped((self.count, -1)))
        return held, flowing


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
        own = network.graph.anchor(k)
        if not self.joins(k):
            return own
        first, second = network.graph.contact[:, self.rests & network.slips_with[k]]
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
        own = network.graph.signed(network.spin[k], network.sign[k])
        if (self.rests & ~network.still).any():
            own = own.at(self._models(k))
        shift = network.graph.shift(k)
        if shift is None or not (shift.high.any() or shift.error.any()):
            return own, None
        return own, shift.at(self._models(k)) if self.joins(k) else shift

    @cached_property
    def slip(self) -> Enclosure:
        """(m,), of all contacts of a lattice; exactly 0 of those that are still."""
        network = self.network
        turns = [self._turns(k) for k in network.components]
        return slices(network.graph).slips([own for own, _ in turns], [shift for _, shift in turns], network.still)

    def difference(self, k: int, some: np.ndarray) -> Enclosure:
        """Of signed spins, of some contacts that feel component k."""
        first, second = self.network.graph.contact[:, some]
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
