"""The contacts of samples of a lattice. A function of all contacts reads slices of arrays over the spheres, so no list
of contacts is made. `Grid` has the methods of `Listed` (listed.py) and takes less time and memory.

Symbols: R samples with N spheres and E contacts each, n = R N and m = R E in all; *N the sides of the lattice; D = 2 or
3 dimensions; C = 1 or 3 spin components. A *slot* is the place of a component, 0 to C - 1; *felt* are the components of
the spins that make a contact slip, those not along its normal. Signed spins are spins (times radius) times the sign of
their sublattice.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from taichi_bearings.proof.enclosure import UP, Enclosure, in_cache, length
from taichi_bearings.proof.listed import Listed, largest_work
from taichi_bearings.proof.on_lattice import OnLattice

Place = tuple[slice, ...]


class Grid(Listed):
    """The contacts of R samples of a lattice, for the proofs: n spheres and m contacts in all, with C components of
    spins. Results are computed by slices of arrays over the lattice, of shape (R, *N spheres), rather than by lists.

    samples : the samples whose contacts these are, with their spins and friction."""

    # What lattices differ in from contacts in lists; each constant is explained in `Listed`.
    has_two_planes = still_is_exact = friction_is_at_limit = True
    rests_in_parts = friction_is_rounded = False

    def __init__(self, samples: OnLattice) -> None:
        """Take the R samples of a lattice whose contacts these are, with their spins and friction."""
        self.samples = samples

    def some(self, pick: slice, count: int) -> Grid:
        """Return the contacts of the samples in the slice `pick` of the R samples alone.

        count : not used here; the number of samples, which contacts in lists need."""
        return Grid(self.samples.some(pick) if self.samples.count > 1 else self.samples)

    @cached_property
    def pieces(self) -> list[tuple[int, Place, Place, Place]]:
        """Groups of contacts along one axis, each as (axis, own, first, second). `own` is an index of its contacts in
        the array (R, *contacts) of this axis; `first` and `second` are indices of their two spheres in arrays (R, *N),
        for R samples of a lattice of shape *N. Contacts across a periodic side are a group of their own."""
        found, lattice = [], self.samples.lattice
        for axis, side in enumerate(lattice.shape):
            last = side - 1
            found.append(self._group(axis, slice(0, last), slice(0, last), slice(1, last + 1)))
            if axis in lattice.periodic:
                found.append(self._group(axis, slice(last, None), slice(last, None), slice(0, 1)))
        return found

    @staticmethod
    def _group(axis: int, *along: slice) -> tuple[int, Place, Place, Place]:
        """Return one group of contacts along `axis`, as (axis, own, first, second), for R samples of a lattice of shape
        *N: `own` is an index of the contacts in the array (R, *contacts) of their axis; `first` and `second` are
        indices of their two spheres in arrays (R, *N).

        along : three slices along the axis: of the contacts, of their first and of their second spheres.
        """
        own, first, second = ((slice(None),) * (1 + axis) + (part,) for part in along)
        return axis, own, first, second

    @property
    def spheres(self) -> int:
        """The number n of spheres of all samples."""
        return self.samples.count * self.samples.sublattice.size

    @cached_property
    def contacts(self) -> int:
        """The number m of contacts of all samples."""
        return self.samples.count * self.samples.lattice.all_contacts

    def on_spheres(self, values: np.ndarray) -> np.ndarray:
        """Return a view (R, *N) of values (n,) of all spheres: R samples of a lattice of shape *N."""
        return values.reshape(self.samples.count, *self.samples.lattice.shape)

    def by_axis(self, values: np.ndarray) -> list[np.ndarray]:
        """Return for each axis of the lattice a view (R samples, *contacts) of those of the values (m,) that belong to
        its contacts."""
        return list(self.samples.lattice.by_axis(values.reshape(self.samples.count, -1)))

    def across(self, function: np.ufunc, values: np.ndarray, kind: type) -> np.ndarray:
        """Return for each of m contacts the result, (m,), of a function of the values of its two spheres.

        function : the function of two arrays, which works element by element.
        values : (n,), one for each sphere.
        kind : type of the result."""
        found: np.ndarray = np.empty(self.contacts, dtype=kind)
        spheres = self.on_spheres(values)
        by_axis = self.by_axis(found)
        for axis, own, first, second in self.pieces:
            function(spheres[first], spheres[second], out=by_axis[axis][own])
        return found

    def any_end(self, mask: np.ndarray) -> np.ndarray:
        """Return the mask (m,) of the contacts of which either sphere is in `mask` (n,): m contacts, n spheres."""
        return self.across(np.logical_or, mask, bool)

    @cached_property
    def contact(self) -> np.ndarray:
        """(2, m), indices of the first (lower) and the second (upper) sphere of each of m contacts."""
        found, number = np.empty((2, self.contacts), dtype=np.intp), self.on_spheres(np.arange(self.spheres))
        for side, ends in enumerate(found):
            by_axis = self.by_axis(ends)
            for axis, own, *places in self.pieces:
                by_axis[axis][own] = number[places[side]]
        return found

    @cached_property
    def place(self) -> np.ndarray:
        """(n, D), place of each of n spheres in its sample, in lattice sites along each of D axes."""
        lattice = self.samples.lattice
        place = np.indices(lattice.shape).reshape(lattice.dimension, -1).T
        return np.tile(place, (self.samples.count, 1)).astype(float)

    @cached_property
    def normal(self) -> np.ndarray:
        """(m, D), unit vectors of m contacts from the first to the second sphere, each along one of D axes."""
        found = np.zeros((self.contacts, self.samples.lattice.dimension), dtype=np.int8)
        for axis in range(self.samples.lattice.dimension):
            self.by_axis(found[:, axis])[axis][...] = 1
        return found

    @cached_property
    def slips_with(self) -> np.ndarray:
        """(C components, m contacts) mask, True where a component of the spins makes a contact slip: where it is not
        along the normal."""
        found = np.ones((len(self.samples.components), self.contacts), dtype=bool)
        for mask, component in zip(found, self.samples.components, strict=True):
            if component < self.samples.lattice.dimension:
                self.by_axis(mask)[component][...] = False
        return found

    @cached_property
    def friction(self) -> np.ndarray:
        """(m, C), stored friction on the second sphere of each of the m contacts by its C components, in `force_unit`
        of the samples; 0 at contacts that are absent."""
        samples = self.samples
        found = samples.friction.reshape(self.contacts, -1) / samples.force_unit
        found[samples.scene.coefficient.ravel() == 0] = 0.0
        return found

    def moment(self, acts: np.ndarray) -> list[Enclosure]:
        """Return the moments n x F of the stored friction F, minus its torque over R on both spheres of a contact: by
        spin component, C enclosures (m,), in `force_unit` of the samples.

        acts : (m,) mask of the contacts that take part; others get 0."""
        samples, none, shape = self.samples, np.broadcast_to(0.0, self.contacts), self.samples.scene.coefficient.shape
        found, acting = [np.zeros(shape) for _ in samples.components], acts.reshape(samples.count, -1)
        for axis, span in enumerate(samples.lattice.spans):
            friction = samples.friction[:, span]
            # n x F for n along `axis`: with the next axes a and b, component a is -F_b and component b is F_a.
            if samples.lattice.dimension == 2:
                products = [(0, friction, samples.force_unit)]
            else:
                a, b = (axis + 1) % 3, (axis + 2) % 3
                products = [(a, friction[..., b], -samples.force_unit), (b, friction[..., a], samples.force_unit)]
            for slot, values, unit in ((slot, values, unit) for slot, values, unit in products if values.any()):
                np.divide(values, unit, out=found[slot][:, span])
                found[slot][:, span][~acting[:, span]] = 0.0
        return [Enclosure(part.reshape(-1) if part.any() else none, none, none) for part in found]  # takes no memory

    def felt(self, axis: int) -> list[int]:
        """Return the places, 0 to C - 1, of the spin components that make contacts along `axis` slip: all but the one
        about the axis itself."""
        return [slot for slot, k in enumerate(self.samples.components) if k != axis]

    def imposed(self, component: int) -> Enclosure:
        """Return for each of n spheres the imposed spin times radius in one component, measured from the bottom, an
        enclosure (n,). On the top plane it is the jump (imposed spin of the top less that of the bottom, both times the
        sign of the sublattice) times the sphere's sign; elsewhere 0.

        component : axis of the spin component, 0 to 2."""
        jump = self.samples.jump_at(component)
        if not _may_differ_from_0(jump):
            return zeros(self.spheres)
        found = [np.zeros(self.spheres) if part.any() else part for part in jump.parts]
        for whole, part, has_sign in zip(found, jump.parts, (True, True, False), strict=True):  # errors have no sign
            if whole is not part:
                signs = self.samples.sublattice[..., -1] if has_sign else 1.0
                self.on_spheres(whole)[..., -1] = signs * self.on_spheres(part)[..., -1]
        return Enclosure(*found)

    @cached_property
    def mixing(self) -> np.ndarray:
        """(m,) mask, False everywhere: on lattices each component of the slip depends on one component of the spins."""
        return np.broadcast_to(np.False_, self.contacts)  # takes no memory

    def signs(self, feels: np.ndarray) -> list[np.ndarray]:
        """Return for each of C spin components signs (n,) of the n spheres, +1 or -1: those of their sublattices, which
        are opposite at spheres in contact.

        feels : not used here."""
        return [np.tile(self.samples.sublattice.ravel(), self.samples.count)] * len(self.samples.components)

    def reach(self, largest_imposed: np.ndarray, sign: list[np.ndarray]) -> list[Enclosure]:
        """Return for each of C spin components a bound for each of n spheres, C enclosures (n,): at some minimum the
        spin (times radius, measured from the bottom) of each sphere is between 0 and this bound. The bound is the spin
        of the top at the same coordinate along the component, with the sign of the sphere's sublattice.

        largest_imposed : not used here.
        sign : these signs by component, C arrays (n,)."""
        return [self.samples.jump_at(k).signed(s) for k, s in zip(self.samples.components, sign, strict=True)]

    def needed(self, largest_imposed: np.ndarray, differs: Callable[[int], bool]) -> list[int]:
        """Return the places k, 0 to C - 1, of the components along which some minimum may slip: those that are driven
        differently at bottom and top, except the one about the height, as each layer may turn freely about it.

        largest_imposed : (C,), the largest imposed size of each component.
        differs : not used here."""
        samples = self.samples
        return [
            k for k, of in enumerate(samples.components) if largest_imposed[k] > 0 and of != samples.lattice.height_axis
        ]

    def are_whole(self, acts: np.ndarray, free: np.ndarray) -> bool:
        """Return True if it is known without a search that contacts connect every free sphere to both driven planes: if
        all contacts with a free end take part, and no others.

        acts : (m,) mask of the contacts that take part.
        free : (n,) mask of the free spheres."""
        return bool(free.any() and (acts == self.any_end(free)).all())

    def slip_speeds(self, spin: list[Enclosure], in_motion: Callable[[], Enclosure]) -> Enclosure:
        """Return the slip speeds (m,) of all contacts, as `in_motion` computes them: for the imposed spin of the top,
        which differs a little from the stored one; contacts without slip in the stored spins keep the slip 0.

        spin : not used here; contacts in lists need it.
        in_motion : function that returns these slip speeds."""
        return in_motion()

    def power_lost(self, torque: Enclosure, reach: Enclosure, mask: np.ndarray) -> Enclosure:
        """Return for each of n spheres the most power that a torque on it may take, an enclosure (n,), if its spin may
        be anything between 0 and `reach`: |torque| |reach|, but 0 where both surely have the same sign, as the torque
        then adds to the power.

        torque : (n,), torque over radius along one spin component.
        reach : (n,), bound on the spin times radius.
        mask : (n,) mask of the spheres that count; 0 is returned for others."""
        return _largest_work_between(torque, reach, mask)

    def in_odd_loops(self, k: int, feels: np.ndarray) -> np.ndarray:
        """Return the mask (n,) of the spheres that are connected with a loop of an odd number of contacts: none, as
        touching spheres lie on different sublattices.

        k, feels : not used here."""
        return np.broadcast_to(np.False_, self.spheres)

    def can_do_work(self, largest_imposed: np.ndarray) -> list[bool]:
        """Return for each of C spin components whether friction can do work along it: True where the two planes are
        driven differently.

        largest_imposed : (C,), the largest imposed size of each component, measured from the bottom."""
        return [bool(size > 0) for size in largest_imposed]

    def friction_vectors(self, moment: list[Enclosure], counts: np.ndarray) -> list[Enclosure]:
        """Return `moment` itself: vectors as long as the friction F of each of m contacts. The direction is not needed
        on lattices.

        moment : n x F, with the normal n, by component: C enclosures (m,), 0 where contacts take no part.
        counts : not used here."""
        return moment

    def anchor(self, k: int) -> np.ndarray:
        """Return for each of n spheres the index (n,) of the first sphere that has the same spin component k in every
        motion. For free spheres that is the sphere itself; for driven ones the first of their plane with the same
        coordinate along the component, or the first of the plane if all of it is driven alike.

        k : position of the spin component among the C components."""
        return self.samples.anchor(self.samples.components[k])

    def signed(self, spin: Enclosure, sign: np.ndarray) -> Enclosure:
        """Return `spin` (n,) as it is: on lattices spins are already stored times the sign +1 or -1 of the sublattice.

        sign : not used here."""
        return spin

    def shift(self, k: int) -> Enclosure:
        """Return for each of n spheres the imposed spin less the stored one in component k, (n,), both times the sign
        +1 or -1 of the sublattice and measured from the bottom. It is 0 for all spheres but those of the top plane.

        k : position of the spin component among the C components."""
        return self.samples.shift[self.samples.components[k]]

    def middle(self, indices: np.ndarray) -> np.ndarray:
        """Return the positions (q, D) in D dimensions, in lattice sites, of the middles of q contacts; those of
        contacts across a periodic side lie half a site beyond it.

        indices : (q,), their indices."""
        return np.asarray(self.place[self.contact[0, indices]] + self.normal[indices] / 2)

    def natural_speed(self, largest_imposed: np.ndarray, speed_unit: float) -> float:
        """Return a speed to compare slips with, in units of `speed_unit`: the radius times the difference between the
        imposed spins of both planes, or times the spin of the bottom if there is no difference.

        largest_imposed : not used here."""
        scene = self.samples.scene
        speed = scene.exact_driving.jump_size or abs(scene.imposed[0])
        return float(scene.lattice.radius * speed / speed_unit)

    def leader(self, k: int) -> np.ndarray:
        """Return for each of n spheres the indices of two driven spheres, (2, n): the first sphere of the bottom plane
        and the first of the top plane that lie in the same layer as the sphere.

        A layer has all spheres of a sample with the same coordinate along the axis of the spin component; where all
        layers are driven alike, they count as one. The driven spheres of one plane and layer have the same spin in this
        component, so that the first of them stands for all.

        k : position of the spin component among the C components."""
        return self.samples.leader(self.samples.components[k])

    def driven_alike(self, k: int, imposed: Enclosure, driven: np.ndarray) -> np.ndarray:
        """Return for each of q driven spheres a number (q,): 0 if it is in the bottom plane; in the top plane 1, or,
        where its layers across component k are driven differently, 1 plus the number of the layer.

        k : position of the spin component among the C components.
        imposed : imposed spins; not used here.
        driven : (q,), indices of the driven spheres."""
        top = np.zeros(self.spheres, dtype=np.intp)
        layer = self.samples.layer(self.samples.components[k]).reshape(self.samples.lattice.shape)
        self.on_spheres(top)[..., -1] = 1 + layer[..., -1]
        found: np.ndarray = top[driven]
        return found

    def still(self, spin: list[Enclosure]) -> np.ndarray:
        """Return the mask (m,) of the contacts without any slip: the signed spins of both spheres (spin times the sign
        by which neighbours differ) are equal in all components that make the contact slip.

        spin : signed spins of n spheres by component, C enclosures (n,)."""
        found = np.ones(self.contacts, dtype=bool)
        by_axis = self.by_axis(found)
        # The two doubles, high and low, of each component, where they are not all 0.
        doubles = [[self.on_spheres(values) for values in part.parts[:2] if values.any()] for part in spin]
        for axis, own, first, second in self.pieces:
            for values in (values for slot in self.felt(axis) for values in doubles[slot]):
                by_axis[axis][own] &= values[first] == values[second]
        return found

    def slips(self, spin: list[Enclosure], shift: list[Enclosure | None], still: np.ndarray) -> Enclosure:
        """Return the slip speed of each contact, (m,): the length of the difference of the signed spins of its spheres,
        over the components that make it slip. (Signed means times the sign of the sublattice, so equal ones roll.)

        spin : signed spins (times radius) of n spheres by component, C enclosures (n,).
        shift : by component an enclosure (n,) that is to be added to the spins, too small to be stored in one number
            with them; None for nothing.
        still : (m,) mask of contacts that do not slip at all, to which no shift is added."""
        found = nothing(self.contacts)
        by_axis, at_rest = [self.by_axis(part) for part in found.parts], self.by_axis(still)
        shifts = {slot: self.of_spheres(part) for slot, part in enumerate(shift) if part is not None}
        spins = {
            slot: self.of_spheres(part) for slot, part in enumerate(spin) if slot in shifts or _may_differ_from_0(part)
        }
        # For each group of contacts: difference of signed spins by component, then its length.
        for axis, own, first, second in self.pieces:
            differences = []
            for slot in (slot for slot in self.felt(axis) if slot in spins):
                difference = spins[slot][second] - spins[slot][first]
                if slot in shifts:  # add the shifts, only where those of both spheres differ
                    more = shifts[slot]
                    places = np.nonzero((more.high[first] != more.high[second]) & ~at_rest[axis][own])
                    shifted = difference[places] + (more[second][places] - more[first][places])
                    for part, values in zip(difference.parts, shifted.parts, strict=True):
                        part[places] = values
                differences.append(difference)
            if differences:
                for whole, values in zip(by_axis, size_of(differences).parts, strict=True):
                    whole[axis][own] = values
        return found

    def of_spheres(self, values: Enclosure) -> Enclosure:
        """Return an enclosure (n,) of all spheres as views (R, *N): R samples of a lattice of shape *N.

        values : (n,), the enclosure, with a number for each sphere of each sample.
        """
        return Enclosure(*(self.on_spheres(part) for part in values.parts))

    def lengths(self, parts: list[Enclosure]) -> Enclosure:
        """Return the lengths (m,) of m vectors, each at right angles to the normal of its contact; an enclosure.

        parts : their C components, enclosures (m,); the one along the normal is not read."""
        found = nothing(self.contacts)
        lengths = [self.by_axis(part) for part in found.parts]
        components = {
            slot: [self.by_axis(of) for of in part.parts] for slot, part in enumerate(parts) if _may_differ_from_0(part)
        }
        for axis in range(self.samples.lattice.dimension):
            slots = [slot for slot in self.felt(axis) if slot in components]
            vectors = [Enclosure(*(part[axis] for part in components[slot])) for slot in slots]
            if vectors:
                for whole, values in zip(lengths, size_of(vectors).parts, strict=True):
                    whole[axis][...] = values
        return found

    def torques(self, moment: list[Enclosure]) -> list[Enclosure]:
        """Return the sum at each of the n spheres of the moments of its contacts, by component, C enclosures (n,). They
        are added in the same order in every case: axis by axis, first spheres before second ones.

        moment : n x F of m contacts (n the normal, F the friction), by component, C enclosures (m,), whose numbers are
            exact doubles (only `high` is read)."""
        found = []
        for slot, part in enumerate(moment):
            found.append(nothing(self.spheres) if part.high.any() else zeros(self.spheres))
            if not part.high.any():
                continue
            total, moments = self.of_spheres(found[-1]), self.by_axis(part.high)
            for axis in (a for a in range(self.samples.lattice.dimension) if slot in self.felt(a)):
                for end in (2, 3):  # of a piece (axis, own, first, second): the first, then the second spheres
                    for piece in (piece for piece in self.pieces if piece[0] == axis):
                        spheres, more = piece[end], moments[axis][piece[1]]
                        for whole, values in zip(total.parts, total[spheres].plus(more).parts, strict=True):
                            whole[spheres] = values
        return found


def slices(graph: Listed) -> Grid:
    """Return `graph` itself, for type checkers, which then know that it has the methods of a lattice (`Grid`). Contacts
    that are not those of a lattice fail an assertion."""
    assert isinstance(graph, Grid)
    return graph


def nothing(count: int) -> Enclosure:
    """Return an enclosure (count,) of exact zeros."""
    return Enclosure(np.zeros(count), np.zeros(count), np.zeros(count))


def zeros(count: int) -> Enclosure:
    """Return an enclosure (count,) of exact zeros that takes no memory and cannot be changed."""
    none = np.broadcast_to(0.0, count)
    return Enclosure(none, none, none)


def size_of(parts: list[Enclosure]) -> Enclosure:
    """Return the length of vectors, an enclosure of the shape of their components; the absolute value if they have one
    component.

    parts : their one or two components, enclosures of any one shape."""
    return abs(parts[0]) if len(parts) == 1 else _length_of_two(*parts)


@in_cache
def _largest_work_between(torque: Enclosure, reach: Enclosure, mask: np.ndarray) -> Enclosure:
    """Return for each of n spheres the most power that a torque can take at a spin between 0 and `reach`, an enclosure
    (n,): |torque| |reach|, but 0 where both surely have the same sign.

    torque : (n,), torque over radius along one spin component.
    reach : (n,), spin times radius.
    mask : (n,) mask of the spheres that count; 0 is returned for others."""
    gives = np.sign(reach.high) * torque.high >= (torque.error + np.abs(torque.low)) * UP
    return largest_work(torque, reach, mask & ~gives)


@in_cache
def _length_of_two(first: Enclosure, second: Enclosure) -> Enclosure:
    """Return the lengths of vectors with two components, an enclosure in the shape of these.

    first, second : the two components of each vector, enclosures of any one shape.
    """
    shape = first.high.shape
    return length([part.reshaped((-1,)) for part in (first, second)]).reshaped(shape)


def _may_differ_from_0(part: Enclosure) -> bool:
    """Return True if some number of an enclosure may differ from 0; False if all are exactly 0.

    part : the enclosure, any shape.
    """
    return any(bool(of.any()) for of in part.parts)
