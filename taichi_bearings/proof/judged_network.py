"""Contact networks of any kind whose spins and friction are to be judged: samples of a lattice or of a packing, as one
graph in which no contact joins two samples.

Letters: R samples of N spheres and E contacts each, n = R N and m = R E in all; D = 2 or 3 dimensions, C = 1 (discs) or
3 components of the spins, each with a number k; i and j the first and the second sphere of a contact, n (as a vector)
its unit normal from i to j.

With u = R omega (here R is the radius) the surface of sphere j slips past that of i with v = -(u_i + u_j) x n. Friction
F on j has the *moment* n x F, minus its torque over radius on both spheres. It takes the power (u_i + u_j) . (n x F) =
-F . v from the motion, at most |F| |v|. A disc has one component: u about z, v and F along z x n. Slips of packings are
those of the normals as they are stored, bit by bit, even where their length is not quite 1.

On a lattice u = s U, with the sign s = 1 or -1 of the sublattice, and U is measured from the state of the bottom, in
which nothing slips.

Words that are names here
    acts : a contact that has a coefficient and a free end.
    reached : a free sphere that is connected to a driven one by contacts that act, through free spheres.
    counts : a contact that acts at a reached sphere. Only these can dissipate at a minimum; other spheres can rest.
    feels k : a contact counts, and component k of the spins makes it slip.
    still : a contact whose slip is exactly 0 in the stored spins.
    domain : spheres that resting contacts join in one component, so that they turn as one.
    components mix : a component of some slip depends on more than one component of the spins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.dissection import Part, dissected, restricted
from taichi_bearings.numerics.double_double import two_product
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.enclosure import Enclosure, in_cache, row_sum
from taichi_bearings.proof.listed import Listed, across, signs
from taichi_bearings.proof.rounded_elimination import REGION_UNKNOWNS, Samples
from taichi_bearings.proof.slices import nothing, slices, zeros
from taichi_bearings.scene.law import Law

LEAST_EXACT = 1e-250  # size of a product above which two doubles hold all of it


@dataclass(frozen=True)
class JudgedNetwork:
    """Spins, friction and contacts of R samples, one after the other, as enclosures in the units `speed_unit` and
    `force_unit`.

    There are n spheres and m contacts in all samples together, and C = 1 (discs) or 3 components. u is spin times
    radius, F the friction on the second sphere of a contact.

    law : the contact law.
    count : R, the number of samples.
    free : (n,) mask of the spheres that are not driven.
    speed_unit : a power of two; on lattices a power of two times the radius.
    force_unit : (R,), powers of two.
    spin : u by component, C enclosures (n,); on lattices times the sign of the sublattice, so that equal u roll.
    moment : unit normal x F by component, C enclosures (m,). Its negative is the torque over radius on both spheres of
        a contact. 0 where a contact takes no part.
    friction_limit, damping : mu F_n and damping eta, enclosures (m,), 0 where a law has none.
    imposed : by component, C enclosures (n,), u of driven spheres, 0 for free ones; on lattices measured from the
        bottom.
    graph : where the contacts are, and the friction that they bear.
    rolling : (n,) mask of free spheres whose contacts can all roll, whatever the other spheres do; None for none.
    factors : arrays (m,) whose product is in exact proportion to mu F_n within a sample, to compare friction exactly.
    as_oblique : True to use the proofs for normals in any direction, though all are along the axes. These proofs are
        valid for loops with an odd number of contacts, too.
    """

    law: Law
    count: int
    free: np.ndarray
    speed_unit: float
    force_unit: np.ndarray
    spin: list[Enclosure]
    moment: list[Enclosure]
    friction_limit: Enclosure
    damping: Enclosure
    imposed: list[Enclosure]
    graph: Listed
    rolling: np.ndarray | None = None
    factors: tuple[np.ndarray, ...] = ()
    as_oblique: bool = False

    @property
    def power_unit(self) -> np.ndarray:
        """(R,), the unit of power of each of the R samples: speed_unit times force_unit."""
        return self.speed_unit * self.force_unit

    @property
    def components(self) -> range:
        """The numbers k of the components of the spins, 0 to C - 1."""
        return range(len(self.spin))

    @cached_property
    def acts(self) -> np.ndarray:
        """(m,) mask of the contacts with a free end and a coefficient, of friction or of viscosity."""
        found: np.ndarray = ((self.friction_limit.high > 0) | (self.damping.high > 0)) & self.graph.any_end(self.free)
        return found

    @cached_property
    def is_whole(self) -> bool:
        """True for lattices if all contacts with a free end have a coefficient: then every sphere is connected to both
        planes."""
        return self.graph.are_whole(self.acts, self.free)

    @cached_property
    def reached(self) -> np.ndarray:
        """(n,) mask of the free spheres that contacts connect to driven ones through free spheres, without those in
        `rolling` (spheres whose contacts can all roll whatever the others do)."""
        if self.is_whole:
            return self.free
        first, second = self.graph.contact[:, self._act_outside_rolling]
        inner, count = self.free[first] & self.free[second], len(self.free)
        part = pieces(count, first[inner], second[inner])  # what contacts connect through free spheres
        touches_driven = np.zeros(count, dtype=bool)
        for end, other in ((first, second), (second, first)):
            touches_driven[part[end[self.free[end] & ~self.free[other]]]] = True
        rolling = self.rolling if self.rolling is not None else np.zeros(count, dtype=bool)
        found: np.ndarray = self.free & touches_driven[part] & ~rolling
        return found

    @cached_property
    def counts(self) -> np.ndarray:
        """(m,) mask of the contacts that can dissipate at a minimum: they have a coefficient and a free sphere,
        contacts connect them to a driven sphere, and neither sphere is in `rolling` (spheres whose contacts can all
        roll whatever the others do). All other contacts dissipate nothing at any minimum."""
        return self.acts if self.is_whole else self._act_outside_rolling & self.graph.any_end(self.reached)

    @cached_property
    def _act_outside_rolling(self) -> np.ndarray:
        """(m,) mask of the contacts that have a coefficient and a free end (`acts`), but touch no sphere in `rolling`
        (spheres whose contacts can all roll whatever the others do)."""
        return self.acts if self.rolling is None else self.acts & ~self.graph.any_end(self.rolling)

    @cached_property
    def largest_imposed(self) -> np.ndarray:
        """(C,), for each spin component the largest size of it among driven spheres: of their spins times radius (on
        lattices measured from the bottom)."""
        return np.array([part.most.max(initial=0.0) for part in self.imposed])

    @property
    def reach(self) -> list[Enclosure]:
        """For each of C spin components a bound for each of n spheres, C enclosures (n,): at some minimum the spin
        (times radius) of each sphere is between the bound and its negative. On lattices, where spins are multiplied by
        the sign of the sublattice and measured from the bottom, it is between the bound and 0. The bounds hold if each
        component of a slip depends on one component of the spins."""
        return self.graph.reach(self.largest_imposed, self.sign)

    @cached_property
    def mixes(self) -> bool:
        """True if some slip component depends on several components of the spins, or is treated so (`as_oblique`).
        Otherwise False for discs, and where all normals are along the axes."""
        return bool(self.samples_that_mix.any())

    @property
    def samples_that_mix(self) -> np.ndarray:
        """(R,) mask of the samples in which a component of some slip depends on several components of the spins, or is
        treated so (`as_oblique`)."""
        mixing = self.counts if self.as_oblique else self.graph.mixing & self.counts
        return np.asarray(mixing.reshape(self.count, -1).any(axis=1))

    @cached_property
    def slips_with(self) -> np.ndarray:
        """(C, m) mask, True where one of C spin components makes one of m contacts slip. It has a meaning only where
        each component of a slip depends on one component of the spins: discs, and normals along the axes."""
        return self.graph.slips_with

    @cached_property
    def feels(self) -> np.ndarray:
        """(C, m) mask, True where one of m contacts can dissipate at a minimum (`counts`) and one of C spin components
        makes it slip. It has a meaning only for discs and for normals along the axes."""
        found: np.ndarray = self.counts & self.slips_with
        return found

    @cached_property
    def division(self) -> list[Part]:
        """All n spheres in groups, in the order in which their unknowns are eliminated from a matrix: by nested
        dissection of the graph whose edges are the contacts between free spheres."""
        first, second = self.graph.contact[:, self.acts]
        inner, count = self.free[first] & self.free[second], len(self.free)
        ends = np.append(first[inner], second[inner]), np.append(second[inner], first[inner])
        graph = sparse.csr_array((np.ones(2 * int(inner.sum())), ends), shape=(count, count))
        return dissected(graph, self.graph.place.T, REGION_UNKNOWNS // len(self.spin))

    def parts_of(self, sphere: np.ndarray) -> list[Part]:
        """Return q unknowns in groups, in the order in which they are eliminated from a matrix. The matrix may couple
        two unknowns only if contacts join their spheres.

        sphere : (q,), the sphere to which each unknown belongs."""
        return restricted(self.division, sphere, REGION_UNKNOWNS)

    def samples_of(self, sphere: np.ndarray) -> Samples:
        """Return to which of the R samples each of q unknowns belongs, as an object for eliminations.

        sphere : (q,), the sphere to which each unknown belongs."""
        return Samples(sphere // (len(self.free) // self.count), self.count)

    def some(self, pick: slice) -> JudgedNetwork:
        """Return the network of those of the R samples that are in the slice `pick`; the network itself if these are
        all."""

        if len(range(*pick.indices(self.count))) == self.count:
            return self

        def of(values: np.ndarray) -> np.ndarray:
            """Return the entries of `values` (n,) or (m,), over all spheres or contacts, of the samples in `pick`."""
            return values.reshape(self.count, -1)[pick].reshape(-1)

        def part(values: Enclosure) -> Enclosure:
            """Return the entries of the enclosure `values`, (n,) or (m,), that belong to the samples in `pick`."""
            return Enclosure(*map(of, values.parts))

        return replace(
            self,
            count=len(range(*pick.indices(self.count))),
            free=of(self.free),
            spin=list(map(part, self.spin)),
            moment=list(map(part, self.moment)),
            friction_limit=part(self.friction_limit),
            damping=part(self.damping),
            imposed=list(map(part, self.imposed)),
            force_unit=self.force_unit[pick],
            graph=self.graph.some(pick, self.count),
            rolling=None if self.rolling is None else of(self.rolling),
            factors=tuple(map(of, self.factors)),
        )

    def sample_of(self, contacts: np.ndarray) -> np.ndarray:
        """Return for each of q contacts the number (q,), 0 to R - 1, of its sample.

        contacts : (q,), their indices."""
        return contacts // (len(self.acts) // self.count)

    @cached_property
    def kept(self) -> dict[bytes, object]:
        """Results of proofs about this network that may be asked for again, empty at first; the key of each is made of
        the bytes of the arguments."""
        return {}

    @cached_property
    def exact_limits(self) -> np.ndarray | None:
        """(m, p), friction limits, each as the exact sum of p doubles, in a unit that may differ between samples. They
        are the products of the arrays `factors`; None if some product is too small or large for doubles to hold it."""
        if len(self.factors) == 1:
            return self.factors[0][:, None]
        found = np.stack(two_product(*self.factors), axis=1)
        sizes = np.abs(found[:, 0])[np.all(self.factors, axis=0)]
        return found if np.isfinite(found).all() and (sizes > LEAST_EXACT).all() else None

    def on_contacts(self, values: np.ndarray) -> np.ndarray:
        """Return for each of the m contacts the value (m,) of its sample.

        values : (R,), a value for each sample."""
        return (
            np.broadcast_to(values, len(self.acts))
            if self.count == 1
            else np.repeat(values, len(self.acts) // self.count)
        )

    def by_sample(self, values: Enclosure, contacts: np.ndarray) -> Enclosure:
        """Return for each of R samples the sum (R,) of those `values` that belong to its contacts.

        values : an enclosure (q,), one for each of q contacts.
        contacts : (q,), their indices."""
        if not len(contacts):
            return nothing(self.count)
        whole = nothing(len(self.acts))
        whole.put(contacts, values)
        return row_sum(whole.reshaped((self.count, -1)))

    def slips(self, spin: list[Enclosure]) -> list[Enclosure]:
        """Return (u_i + u_j) x n, the slip up to its sign, of all m contacts by component, C enclosures (m,). Here u is
        spin times radius of the spheres i and j of a contact, n its normal.

        spin : u by component, C enclosures (n,) for the n spheres.
        """
        first, second = self.graph.contact
        return across([part.at(first) + part.at(second) for part in spin], self.graph.normal)

    @cached_property
    def slip(self) -> Enclosure:
        """(m,), slip speeds of m contacts in the stored spins, an enclosure in `speed_unit`."""
        return self.graph.slip_speeds(self.spin, lambda: self.motion.slip)

    @cached_property
    def still(self) -> np.ndarray:
        """(m,) mask of the contacts whose slip is exactly 0 in the stored spins. Only for discs, and normals along the
        axes."""
        return self.graph.still(self.spin)

    @cached_property
    def motion(self) -> Motion:
        """The stored spins as a motion in which those contacts are marked as resting that have a coefficient and a free
        end, and whose slip is exactly 0. Only for lattices."""
        return Motion(self, self.still & self.acts)

    @cached_property
    def impossible(self) -> np.ndarray:
        """(R,) mask of the samples whose stored spins no motion can have: contacts without slip join driven spheres for
        which different spins are imposed. All False where stored spins of driven spheres are the imposed ones."""
        if all(self.graph.shift(k) is None for k in self.components):
            return np.zeros(self.count, dtype=bool)
        return self.motion.cannot_rest

    @cached_property
    def own_torques(self) -> list[Enclosure]:
        """Torques over radius that the stored friction leaves over on each of the n spheres, by component: C enclosures
        (n,), in units of force."""
        return self.torques(self.own_moment)

    @cached_property
    def own_moment(self) -> list[Enclosure]:
        """The stored moments (`moment`) by component, C enclosures (m,), but 0 for contacts that dissipate at no
        minimum, and along components in which no driven sphere does work."""
        can_work = self.graph.can_do_work(self.largest_imposed)
        all_count = bool((self.counts == self.acts).all())  # moments are 0 where nothing acts
        return [
            (part if all_count else part.where(self.counts)) if works else zeros(len(self.acts))
            for part, works in zip(self.moment, can_work, strict=True)
        ]

    @property
    def own_friction(self) -> list[Enclosure]:
        """Stored friction F of the contacts that can dissipate, 0 for others, by component: C enclosures (m,). On
        lattices vectors of the same size, the moments n x F, stand for it."""
        return self.graph.friction_vectors(self.moment, self.counts)

    @cached_property
    def own_size(self) -> Enclosure:
        """(m,), sizes of the stored friction `own_friction` of the m contacts, an enclosure in units of force."""
        return self.graph.lengths(self.own_friction)

    @property
    def must_slip(self) -> np.ndarray:
        """(R,) mask of the samples of a lattice in which some contact has to slip: in some spin component bottom and
        top are driven differently, and contacts which that component makes slip connect both planes."""
        if self.is_whole:
            return np.full(self.count, bool(self.needed))
        return Motion(self, self.acts).cannot_rest

    def torques(self, moment: list[Enclosure]) -> list[Enclosure]:
        """Return the sum at each of the n spheres of the moments of its contacts, by component, C enclosures (n,).

        moment : the moments of m contacts by component, C enclosures (m,). They are added with the same sign at both
            spheres of a contact."""
        return self.graph.torques(moment)

    @cached_property
    def needed(self) -> list[int]:
        """The numbers k of the spin components, 0 to C - 1, along which contacts may slip at some minimum; along all
        others no contact slips at any minimum. On a lattice the component about the height is never among them, as each
        layer may turn freely about it."""
        return self.graph.needed(self.largest_imposed, self._is_needed)

    def signs(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return three arrays (n,) about the connected parts of a graph. Its nodes are the n spheres, its edges the
        contacts that spin component k makes slip:

        1. the label of the part of each sphere;
        2. True for spheres in parts with a loop of an odd number of contacts;
        3. in all other parts signs +1 and -1, opposite at spheres in contact."""
        return signs(self.graph.contact[:, self.feels[k]], len(self.free))

    @cached_property
    def sign(self) -> list[np.ndarray]:
        """Signs by spin component, C arrays (n,): +1 or -1, opposite at spheres in contact, like the spins of spheres
        that roll on each other. In parts with a loop of an odd number of contacts that cannot be, and signs mean
        nothing."""
        return self.graph.signs(self.feels)

    def _is_needed(self, k: int) -> bool:
        """Return True if contacts may slip along spin component k at some minimum; False if free spheres can turn such
        that, with the imposed spins, none slips along it, since any such slip would only cost power."""
        label, odd, sign = self.signs(k)
        driven = np.flatnonzero(~self.free)
        # Nothing slips if all driven spheres of a part have one imposed spin but for the signs, 0 where loops are odd.
        signed = self.imposed[k].signed(sign).at(driven)
        first, part = np.unique(label[driven], return_index=True, return_inverse=True)[1:]
        differ = any((values != values[first][part]).any() for values in signed.parts[:2])
        return bool(differ or (odd[driven] & (signed.high != 0)).any())

    def dissipated(self, of_slope: float, mask: np.ndarray | None = None) -> Enclosure:
        """Return for each of R samples the sum over contacts of mu F_n slip + `of_slope` eta slip^2 at the stored
        spins, an enclosure (R,) in units of the network.

        of_slope : 1 for the power, 1/2 for the potential.
        mask : (m,) mask of the contacts that are summed; None for all with a coefficient and a free end."""
        of_friction, of_damping = self._dissipated if mask is None else self._sums(mask)
        return of_friction + of_damping.signed(of_slope)

    @cached_property
    def _dissipated(self) -> tuple[Enclosure, Enclosure]:
        """The sums of mu F_n slip and of eta slip^2 over all contacts with a coefficient and a free end: two enclosures
        (R,)."""
        return self._sums(self.acts)

    def _sums(self, mask: np.ndarray) -> tuple[Enclosure, Enclosure]:
        """Return for each of R samples two sums over the contacts in `mask` (m,), at the stored spins: of
        mu F_n slip, and of eta slip^2. Both are enclosures (R,) in units of the network."""
        slips, slip = mask & ((self.slip.high != 0) | (self.slip.error != 0)), self.slip
        of_friction, of_damping = nothing(self.count), nothing(self.count)
        if self.law.has_friction:
            of_friction = row_sum(_product_in(self.friction_limit, slip, slips).reshaped((self.count, -1)))
        if self.law.has_viscosity:
            of_damping = row_sum((self.damping * slip * slip).where(slips).reshaped((self.count, -1)))
        return of_friction, of_damping


@in_cache
def _product_in(first: Enclosure, second: Enclosure, mask: np.ndarray) -> Enclosure:
    """Return the product of two enclosures (m,) where `mask` (m,) is True, and exactly 0 elsewhere.

    first, second : the enclosures.
    """
    return (first * second).where(mask)


@dataclass(frozen=True)
class Motion:
    """A motion of a network in which some contacts are taken to rest. Spheres that these join, in one component of the
    spins, form a *domain*: they turn exactly as one of them does, even where their stored spins are not quite equal.

    network : n spheres and m contacts, with their stored spins; each component of a slip depends on one component of
        the spins.
    rests : (m,) mask of the contacts that are taken to rest.

    On a lattice the driven spheres of a plane that have the same coordinate along the component, and so the same spin,
    are of one domain. The imposed spin of the top differs from the stored one by a *shift*, far below the rounding of
    spins, yet it may exceed the smallest slips."""

    network: JudgedNetwork
    rests: np.ndarray

    @cached_property
    def domain(self) -> Domains:
        """By spin component k, the number (n,) of the domain of each sphere: spheres that resting contacts join share a
        number. Computed for each k on first use."""
        return Domains(self)

    def joins(self, k: int) -> bool:
        """Return True if spin component k makes any of the resting contacts slip when their spheres turn differently.
        Then these contacts join spheres in this component, which turn as one."""
        return bool((self.rests & self.network.slips_with[k]).any())

    def domains(self, k: int) -> np.ndarray:
        """Return for each of n spheres the number (n,) of its domain in component k. A domain is a group of spheres
        that turn as one: those that resting contacts join, and on lattices also the driven spheres of a plane that
        always have the same spin."""
        network, size = self.network, len(self.network.free)
        anchor = network.graph.anchor(k)  # the sphere itself, or the first of those that are driven like it
        if not self.joins(k):
            return anchor
        first, second = network.graph.contact.compress(self.rests & network.slips_with[k], 1)
        others = np.flatnonzero(anchor != np.arange(size))
        return pieces(size, np.append(first, others), np.append(second, anchor[others]))

    def _leaders(self, k: int) -> np.ndarray:
        """Return for each sphere (n,) the index of the sphere whose spin it takes in component k: among those that
        resting contacts join with it the last driven one, or, if none is driven, the first one."""
        domain = self.domain[k]
        leader = np.empty(domain.max(initial=-1) + 1, dtype=np.intp)
        for spheres in (np.arange(len(domain))[::-1], np.flatnonzero(~self.network.free)):
            leader[domain[spheres]] = spheres  # the last that is written stays
        found: np.ndarray = leader[domain]
        return found

    @cached_property
    def cannot_rest(self) -> np.ndarray:
        """(R,) mask of the samples in which the resting contacts cannot all be at rest, since they join driven spheres
        with different imposed spins."""
        network, found = self.network, np.zeros(self.network.count, dtype=bool)
        driven = np.flatnonzero(~network.free)
        for k in (k for k in network.components if network.imposed[k].high.any() and self.joins(k)):
            signed, leader = network.imposed[k].signed(network.sign[k]), self._leaders(k)[driven]
            differs = np.any([part[driven] != part[leader] for part in signed.parts[:2]], axis=0)
            found[driven[differs] // (len(network.free) // network.count)] = True
        return found

    @cached_property
    def _signed_spins(self) -> dict[int, tuple[Enclosure, Enclosure | None]]:
        """Results of :meth:`_signed_spin` by component k, empty at first: spins with the sign by which neighbours
        differ; and how much the imposed spin of the top exceeds the stored one, or None."""
        return {}

    def _signed_spin(self, k: int) -> tuple[Enclosure, Enclosure | None]:
        """Return a pair for component k, computed by :meth:`_find_signed_spin` on first use: enclosures (n,) of signed
        spins (times radius, and times the sign +1 or -1 by which neighbours differ); and how much the imposed spin of
        the top exceeds the stored one, (n,) or None."""
        if k not in self._signed_spins:
            self._signed_spins[k] = self._find_signed_spin(k)
        return self._signed_spins[k]

    def _find_signed_spin(self, k: int) -> tuple[Enclosure, Enclosure | None]:
        """Compute a pair for component k:

        1. enclosures (n,): spins times radius, times the sign +1 or -1 by which neighbours differ. They are exactly
           equal for spheres that resting contacts join.
        2. enclosures (n,): for spheres that turn with the top of a lattice the imposed less the stored spin, 0 for
           others; None if it is 0 everywhere."""
        network = self.network
        signed = network.graph.signed(network.spin[k], network.sign[k])
        if (self.rests & ~network.still).any():
            signed = signed.at(self._leaders(k))
        shift = network.graph.shift(k)
        if shift is None or not (shift.high.any() or shift.error.any()):
            return signed, None
        return signed, shift.at(self._leaders(k)) if self.joins(k) else shift

    @cached_property
    def slip(self) -> Enclosure:
        """(m,), slip speeds of all contacts of a lattice in this motion; exactly 0 where the stored spins have no slip
        at all."""
        network = self.network
        pairs = [self._signed_spin(k) for k in network.components]
        signed, shifts = [spin for spin, _ in pairs], [shift for _, shift in pairs]
        return slices(network.graph).slips(signed, shifts, network.still)

    def difference(self, k: int, contacts: np.ndarray) -> Enclosure:
        """Return for q contacts s_j u_j - s_i u_i, an enclosure (q,): the difference of the spins (times radius) of the
        second and the first sphere in component k, with the signs s = +1 or -1 that differ between neighbours. Its size
        is that of the slip along this component; it is exactly 0 if contacts at rest join both spheres.

        contacts : (q,), indices of the contacts; this component must make all of them slip."""
        first, second = self.network.graph.contact.take(contacts, 1)
        signed, shift = self._signed_spin(k)
        domain, found = self.domain[k], nothing(len(contacts))
        differ = np.flatnonzero(domain[first] != domain[second])
        found.put(differ, signed.at(second[differ]) - signed.at(first[differ]))
        if shift is not None:  # add the imposed less the stored spin of the top
            at_top = np.flatnonzero(shift.high[first] != shift.high[second])
            found.put(at_top, found.at(at_top) + (shift.at(second[at_top]) - shift.at(first[at_top])))
        return found


class Domains(dict[int, np.ndarray]):
    """A dictionary by component k of arrays (n,): the number of the domain of each sphere, shared by spheres that
    resting contacts join. Each is computed when it is first asked for."""

    def __init__(self, motion: Motion) -> None:
        """Make an empty dictionary.

        motion : the spins; they say which contacts do not slip, and find the spheres that these join (`domains`)."""
        self.motion = motion

    def __missing__(self, k: int) -> np.ndarray:
        """Return (n,), for each of n spheres the number of its domain in component k, and keep the array. Python calls
        this when k is asked for first."""
        self[k] = found = self.motion.domains(k)
        return found
