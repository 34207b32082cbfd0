"""The contacts of samples of a lattice, by slices: functions of all contacts read arrays over the spheres where they
lie, and write no list of contacts. `Grid` answers the questions of `Listed` (listed.py) with less time and memory.

Symbols: R samples with N spheres and E contacts each, n = R N and m = R E in all; *N the sides of the lattice; D = 2 or
3 dimensions; C = 1 or 3 spin components. A *slot* is the place of a component, 0 to C - 1; *felt* are the components of
the spins that make a contact slip, those not along its normal. Signed spins are spins (times radius) times the sign of
their sublattice.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from taichi_bearings.proof.enclosure import Enclosure, in_cache, length
from taichi_bearings.proof.listed import Listed
from taichi_bearings.proof.on_lattice import OnLattice

Place = tuple[slice, ...]


class Grid(Listed):
    """The contacts of R samples of a lattice, for the proofs: n spheres and m contacts in all, with C components of
    spins.

    samples : the samples whose contacts these are.
    """

    layered = True
    normal_rounding = 0.0

    def __init__(self, samples: OnLattice) -> None:
        """Take the samples whose contacts these are."""
        self.samples = samples

    def some(self, pick: slice, count: int) -> Grid:
        """Return the contacts of the samples in the slice `pick` alone. count : R, the number of samples with which the
        slice is taken."""
        return Grid(self.samples.some(pick) if self.samples.count > 1 else self.samples)

    @cached_property
    def pieces(self) -> list[tuple[int, Place, Place, Place]]:
        """Groups of contacts along one axis, each as (axis, own, first, second): `own` selects the contacts in the
        array (R, *contacts) of their axis, `first` and `second` select their two spheres in arrays (R, *N). Contacts
        across a periodic side are a group of their own."""
        found, lattice = [], self.samples.lattice
        for axis, side in enumerate(lattice.shape):
            last = side - 1
            found.append(self._group(axis, slice(0, last), slice(0, last), slice(1, last + 1)))
            if axis in lattice.periodic:
                found.append(self._group(axis, slice(last, None), slice(last, None), slice(0, 1)))
        return found

    @staticmethod
    def _group(axis: int, *along: slice) -> tuple[int, Place, Place, Place]:
        """Return one group of :attr:`pieces`. along : slices along `axis` for the contacts, their first and their
        second spheres."""
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
        """Return a view (R, *N) of values (n,)."""
        return values.reshape(self.samples.count, *self.samples.lattice.shape)

    def by_axis(self, values: np.ndarray) -> list[np.ndarray]:
        """Return views (R, *contacts), one for each axis, of values (m,)."""
        return list(self.samples.lattice.by_axis(values.reshape(self.samples.count, -1)))

    def across(self, made: np.ufunc, values: np.ndarray, kind: type) -> np.ndarray:
        """Return the function `made` of the values (n,) of both spheres of each contact, (m,). kind : type of the
        result."""
        found: np.ndarray = np.empty(self.contacts, dtype=kind)
        spheres = self.on_spheres(values)
        by_axis = self.by_axis(found)
        for axis, own, first, second in self.pieces:
            made(spheres[first], spheres[second], out=by_axis[axis][own])
        return found

    def any_end(self, mask: np.ndarray) -> np.ndarray:
        """Return the mask (m,) of contacts of which either sphere is in the mask (n,)."""
        return self.across(np.logical_or, mask, bool)

    @cached_property
    def contact(self) -> np.ndarray:
        """(2, m), indices of the first and the second sphere of each contact."""
        found, number = np.empty((2, self.contacts), dtype=np.intp), self.on_spheres(np.arange(self.spheres))
        for side, ends in enumerate(found):
            by_axis = self.by_axis(ends)
            for axis, own, *places in self.pieces:
                by_axis[axis][own] = number[places[side]]
        return found

    @cached_property
    def place(self) -> np.ndarray:
        """(n, D), place of each sphere in its sample, in lattice sites."""
        lattice = self.samples.lattice
        place = np.indices(lattice.shape).reshape(lattice.dimension, -1).T
        return np.tile(place, (self.samples.count, 1)).astype(float)

    @cached_property
    def normal(self) -> np.ndarray:
        """(m, D), unit vectors from the first to the second sphere."""
        found = np.zeros((self.contacts, self.samples.lattice.dimension), dtype=np.int8)
        for axis in range(self.samples.lattice.dimension):
            self.by_axis(found[:, axis])[axis][...] = 1
        return found

    @cached_property
    def slips_with(self) -> np.ndarray:
        """(C, m) mask, True where a component of the spins makes a contact slip."""
        found = np.ones((len(self.samples.components), self.contacts), dtype=bool)
        for mask, component in zip(found, self.samples.components, strict=True):
            if component < self.samples.lattice.dimension:
                self.by_axis(mask)[component][...] = False
        return found

    @cached_property
    def friction(self) -> np.ndarray:
        """(m, C), friction on the second sphere of each of the m contacts by its C components, in `force_unit`; 0 at
        contacts that are absent."""
        samples = self.samples
        found = samples.friction.reshape(self.contacts, -1) / samples.force_unit
        found[samples.scene.coefficient.ravel() == 0] = 0.0
        return found

    def moment(self, acts: np.ndarray) -> list[Enclosure]:
        """Return the moments n x F by component, C enclosures (m,), for the contacts of the mask `acts` (m,), and 0 for
        others."""
        samples, nothing = self.samples, np.broadcast_to(0.0, self.contacts)  # takes no memory
        found, acting = (
            np.zeros((len(samples.components), *samples.scene.coefficient.shape)),
            acts.reshape(samples.count, -1),
        )
        for axis, span in enumerate(samples.lattice.spans):
            friction = samples.friction[:, span]
            if samples.lattice.dimension == 2:
                turned = [(0, friction, samples.force_unit)]
            else:
                before, after = (axis + 1) % 3, (axis + 2) % 3
                turned = [(before, friction[..., after], -samples.force_unit)]
                turned += [(after, friction[..., before], samples.force_unit)]
            for slot, values, unit in turned:
                np.divide(values, unit, out=found[slot][:, span])
                found[slot][:, span][~acting[:, span]] = 0.0
        return [Enclosure(part.reshape(-1), nothing, nothing) for part in found]

    def felt(self, axis: int) -> list[int]:
        """Return the slots (0 to C - 1) of the components of the spins that make contacts along `axis` slip."""
        return [slot for slot, k in enumerate(self.samples.components) if k != axis]

    def imposed(self, component: int) -> Enclosure:
        """Return the imposed spin times radius (n,) of a component, measured from the bottom: 0 except on the top."""
        found, jump = nothing(self.spheres), self.samples.jump_at(component)
        for whole, part, sign in zip(found.parts, jump.parts, (1, 1, 0), strict=True):
            signs = self.samples.sublattice[..., -1] if sign else 1.0
            self.on_spheres(whole)[..., -1] = signs * self.on_spheres(part)[..., -1]
        return found

    @cached_property
    def mixing(self) -> np.ndarray:
        """(m,) mask, False everywhere: on lattices each component of the slip depends on one component of the spins."""
        return np.broadcast_to(np.False_, self.contacts)  # takes no memory

    def signs(self, feels: np.ndarray) -> list[np.ndarray]:
        """Return the signs of the sublattice by component, C arrays (n,): neighbours always differ. feels : not
        used."""
        return [np.tile(self.samples.sublattice.ravel(), self.samples.count)] * len(self.samples.components)

    def reach(self, box: np.ndarray, sign: list[np.ndarray]) -> list[Enclosure]:
        """Return by component a bound (n,): some minimum has the spin (times radius) of each sphere between 0 and it,
        the jump in its layer. box : not used. sign : signs by component, C arrays (n,)."""
        return [self.samples.jump_at(k).signed(s) for k, s in zip(self.samples.components, sign, strict=True)]

    def needed(self, box: np.ndarray, differs: Callable[[int], bool]) -> list[int]:
        """Return the slots of the components along which some minimum may slip: those with a jump, except the one about
        the height, as each layer may turn freely about it. box : (C,), largest imposed size. differs : not used."""
        samples = self.samples
        return [k for k, of in enumerate(samples.components) if box[k] > 0 and of != samples.lattice.height_axis]

    def working(self, box: np.ndarray) -> list[bool]:
        """Return by component whether its moments do any work: where the planes are driven differently. box : (C,),
        largest imposed size."""
        return [bool(size > 0) for size in box]

    def borne(self, moment: list[Enclosure], counts: np.ndarray) -> list[Enclosure]:
        """Return vectors as long as the friction of each contact, by component: the moments themselves. counts : not
        used."""
        return moment

    def anchor(self, k: int) -> np.ndarray:
        """Return for each sphere (n,) the index of the sphere that has its spin in component k: for driven ones the
        first of their plane and layer, else itself."""
        return self.samples.anchor(self.samples.components[k])

    def signed(self, spin: Enclosure, sign: np.ndarray) -> Enclosure:
        """Return the spins as they are: on lattices they are stored with their signs. sign : not used."""
        return spin

    def shift(self, k: int) -> Enclosure:
        """Return for each sphere (n,) the imposed spin less the stored one in component k; not 0 on the top alone."""
        return self.samples.shift[self.samples.components[k]]

    def middle(self, some: np.ndarray) -> np.ndarray:
        """Return the positions (q, D) of the middles of the contacts with the indices `some` (q,); those across a
        periodic side lie half a site beyond it."""
        return np.asarray(self.place[self.contact[0, some]] + self.normal[some] / 2)

    def natural_speed(self, box: np.ndarray, speed_unit: float) -> float:
        """Return the surface speed of the jump, or of the bottom's spin if there is no jump, in units of `speed_unit`.
        box : not used."""
        scene = self.samples.scene
        speed = scene.exact_driving.jump_size or abs(scene.imposed[0])
        return float(scene.lattice.radius * speed / speed_unit)

    def leader(self, k: int) -> np.ndarray:
        """Return for each sphere the indices (2, n) of the first spheres of the bottom and of the top in its layer; all
        driven spheres there turn as these in component k."""
        return self.samples.leader(self.samples.components[k])

    def still(self, spin: list[Enclosure]) -> np.ndarray:
        """Return the mask (m,) of contacts without any slip: the signed spins of both spheres are equal in all
        components that make the contact slip. spin : signed spins by component, C enclosures (n,)."""
        found = np.ones(self.contacts, dtype=bool)
        into = self.by_axis(found)
        parts = [[self.on_spheres(of) for of in part.parts[:2] if of.any()] for part in spin]
        for axis, own, first, second in self.pieces:
            for of in (of for slot in self.felt(axis) for of in parts[slot]):
                into[axis][own] &= of[first] == of[second]
        return found

    def slips(self, spin: list[Enclosure], shift: list[Enclosure | None], still: np.ndarray) -> Enclosure:
        """Return slip speeds (m,) of all contacts: lengths of the differences of signed spins over the components that
        make each contact slip. (A signed spin has the sign of its sublattice, so equal ones roll.)

        spin : signed spins by component, C enclosures (n,) for the n spheres.
        shift : by component, (n,), what is added to the spins, known to twice the precision; None for nothing.
        still : (m,) mask of contacts that do not slip at all.
        """
        found = nothing(self.contacts)
        into, at_rest = [self.by_axis(part) for part in found.parts], self.by_axis(still)
        added = {slot: self.of_spheres(part) for slot, part in enumerate(shift) if part is not None}
        turning = {
            slot: self.of_spheres(part) for slot, part in enumerate(spin) if slot in added or _may_differ_from_0(part)
        }
        # For each group of contacts: difference of signed spins by component; the shift is added only where it differs.
        for axis, own, first, second in self.pieces:
            parts = []
            for slot in (slot for slot in self.felt(axis) if slot in turning):
                part = turning[slot][second] - turning[slot][first]
                if slot in added:
                    more = added[slot]
                    places = np.nonzero((more.high[first] != more.high[second]) & ~at_rest[axis][own])
                    moved = part[places] + (more[second][places] - more[first][places])
                    for of, values in zip(part.parts, moved.parts, strict=True):
                        of[places] = values
                parts.append(part)
            if parts:
                for whole, values in zip(into, size_of(parts).parts, strict=True):
                    whole[axis][own] = values
        return found

    def of_spheres(self, values: Enclosure) -> Enclosure:
        """Return views (R, *N) of an enclosure (n,)."""
        return Enclosure(*(self.on_spheres(part) for part in values.parts))

    def lengths(self, parts: list[Enclosure]) -> Enclosure:
        """Return the lengths (m,) of vectors across the normals of contacts. parts : by component, C enclosures
        (m,)."""
        found = nothing(self.contacts)
        into = [self.by_axis(part) for part in found.parts]
        there = {
            slot: [self.by_axis(of) for of in part.parts] for slot, part in enumerate(parts) if _may_differ_from_0(part)
        }
        for axis in range(self.samples.lattice.dimension):
            felt = [Enclosure(*(of[axis] for of in there[slot])) for slot in self.felt(axis) if slot in there]
            if felt:
                for whole, values in zip(into, size_of(felt).parts, strict=True):
                    whole[axis][...] = values
        return found

    def torques(self, moment: list[Enclosure]) -> list[Enclosure]:
        """Return the sums at each of the n spheres of exact moments at the m contacts, by component, C enclosures (n,);
        always added in the same order, axis by axis, first spheres before second ones. moment : by component, C
        enclosures (m,)."""
        found = []
        for slot, part in enumerate(moment):
            found.append(nothing(self.spheres))
            if not part.high.any():
                continue
            total, pulls = self.of_spheres(found[-1]), self.by_axis(part.high)
            for axis in (a for a in range(self.samples.lattice.dimension) if slot in self.felt(a)):
                for end in (2, 3):
                    for piece in (piece for piece in self.pieces if piece[0] == axis):
                        at = piece[end]
                        for whole, values in zip(total.parts, total[at].plus(pulls[axis][piece[1]]).parts, strict=True):
                            whole[at] = values
        return found


def slices(graph: Listed) -> Grid:
    """Return the same object, known to type checkers to be a Grid. Only code for lattices alone calls this."""
    assert isinstance(graph, Grid)
    return graph


def nothing(count: int) -> Enclosure:
    """Return an enclosure (count,) of exact zeros."""
    return Enclosure(np.zeros(count), np.zeros(count), np.zeros(count))


def size_of(parts: list[Enclosure]) -> Enclosure:
    """Return the length of vectors given by one or two components, of any shape."""
    return abs(parts[0]) if len(parts) == 1 else _length_of_two(*parts)


@in_cache
def _length_of_two(first: Enclosure, second: Enclosure) -> Enclosure:
    """Return the length of vectors given by two components, of any shape."""
    shape = first.high.shape
    return length([part.reshaped((-1,)) for part in (first, second)]).reshaped(shape)


def _may_differ_from_0(part: Enclosure) -> bool:
    """Return True if any number of the enclosure may differ from 0."""
    return any(bool(of.any()) for of in part.parts)
