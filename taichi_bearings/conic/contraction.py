"""Contact systems in which the spins across some contacts are tied together, as one unknown.

A contact that does not slip makes the spin components at its two ends equal; so they can be replaced by one unknown.
Near the minimum this leaves one unknown in six at 32^3, and no huge stiffnesses, so that the last digits of slips can
be computed.

Several samples of one lattice form one system, in which no contact joins two samples. Letters: n contacts with up to d
slip components; D dimensions; a Pair is a sum of two doubles (high, low).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.dissection import dissected
from taichi_bearings.numerics.cholesky.fronts import coupled
from taichi_bearings.numerics.double_double import Pair, add, subtract, two_sum
from taichi_bearings.scene.network import Network

# A sample with so many sets of tied spins gets an elimination order of its own; nested dissection then divides no
# region with fewer unknowns than the second number.
OWN_ORDER_UNKNOWNS, OWN_LEAF_UNKNOWNS = 2_000, 20


@dataclass(frozen=True)
class Owners:
    """The sample (0 to samples - 1) to which each spin and each contact of a system of several samples belongs.

    samples : number of samples.
    spins : (unknowns,), sample of each unknown, ascending.
    contacts : (n,), sample of each contact, ascending.
    """

    samples: int
    spins: np.ndarray
    contacts: np.ndarray

    @cached_property
    def _of_contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Mask (samples,) of the samples that have contacts, and index of the first contact of each of these."""
        return _begins(self.samples, self.contacts)

    @cached_property
    def _of_spins(self) -> tuple[np.ndarray, np.ndarray]:
        """Mask (samples,) of the samples that have spins, and index of the first spin of each of these."""
        return _begins(self.samples, self.spins)

    def largest(self, values: np.ndarray) -> np.ndarray:
        """Return for each sample the largest of the values that belong to its contacts, (samples,); 0 for a sample
        without contacts.

        values : numbers (n,), or vectors (d, n) with up to d components, on n contacts; none negative."""
        return _reduced(np.maximum, values if values.ndim == 1 else values.max(axis=0), self._of_contacts, 0.0)

    def largest_of_spins(self, values: np.ndarray) -> np.ndarray:
        """Return for each sample the largest of the values that belong to its spins, (samples,); 0 if it has none.

        values : (unknowns,), none negative."""
        return _reduced(np.maximum, values, self._of_spins, 0.0)

    def smallest(self, values: np.ndarray) -> np.ndarray:
        """Return for each sample the smallest of the values that belong to its contacts, (samples,); infinite for a
        sample without contacts.

        values : (n,), numbers on n contacts."""
        return _reduced(np.minimum, values, self._of_contacts, np.inf)

    def any(self, chosen: np.ndarray) -> np.ndarray:
        """Return a mask (samples,), True for samples with at least one contact in the mask `chosen` (n,)."""
        return self.largest(chosen) > 0


def _begins(samples: int, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a mask (samples,) of the samples to which some items of a list belong, and for each of these the index of
    its first item.

    samples : number of samples.
    owner : (items,), number of the sample to which each item belongs, ascending.
    """
    begins = np.searchsorted(owner, np.arange(samples + 1))
    some = begins[1:] > begins[:-1]
    return some, begins[:-1][some]


def _reduced(reduce: np.ufunc, values: np.ndarray, begins: tuple[np.ndarray, np.ndarray], nothing: float) -> np.ndarray:
    """Return for each sample the largest or smallest of its values, (samples,).

    reduce : `np.maximum` or `np.minimum`.
    values : (items,), in the order of their samples.
    begins : a mask (samples,) of the samples that have values, and the index of the first value of each of these.
    nothing : the number for a sample without values.
    """
    some, first = begins
    found = np.full(len(some), nothing)
    if len(first):
        found[some] = reduce.reduceat(values, first)
    return found


class Contraction:
    """A contact system in which some contacts are tied: the spins that tied contacts join form a set and have one value
    in common, which is one unknown.

    whole : the system in which no contact is tied; its unknowns are single spins ("spins" below).
    system : the contacts that are left, with one unknown for each set of spins.
    kept : (contacts left,), the index in `whole` of each contact of `system`. Left out are the tied contacts, and those
        that cannot slip because both ends are in one set.
    unknowns : number of sets without a driven plane.
    number : (spins,), index of the set of each spin, -1 if the set is tied to a driven plane.
    imposed : (spins,), spin of the driven plane where `number` is -1, else 0; a sum of two doubles.
    owners : the sample of each unknown and of each contact left.
    contradicts : (samples,) mask, True where tied contacts join driven planes that turn differently, which cannot be.
    """

    def __init__(
        self, whole: ContactSystem, order: np.ndarray, tied: np.ndarray, samples: int = 1, suits: bool = False
    ) -> None:
        """Tie some contacts of a system: make the spins at the two ends of each equal.

        whole : the n contacts of all samples.
        order : (unknowns of a sample,), order in which the unknowns of one sample are eliminated.
        tied : (n,) mask of the contacts to tie.
        samples : number of samples, of equal size.
        suits : True if the order was made for a system in which nearly the same contacts are tied (`order_of_spins`).
        """
        self.whole, self._order, self._suits = whole, order, suits
        self._found = dict[int, np.ndarray]()  # by sample, the order that `_dissected` has found for it
        self._label(whole, tied, samples)
        self.kept, self.system = self._system_left(whole, np.flatnonzero(~tied))
        self.owners = Owners(samples, self._owner, self.kept // max(len(tied) // samples, 1))

    def _label(self, whole: ContactSystem, tied: np.ndarray, samples: int) -> None:
        """Number the sets of spins that tied contacts join. Set the fields `unknowns`, `number`, `imposed` and
        `contradicts` of the class, and `_owner` (unknowns,), the sample of each set.

        whole : the n contacts of all samples.
        tied : (n,) mask of the tied contacts.
        samples : number of samples, of equal size.
        """
        assert whole.ends is not None
        (below, above), offsets = whole.ends.compress(tied, 2), [part.compress(tied, 1) for part in _offset(whole)]
        # A tied contact with one imposed end fixes the spin at the other one: slip 0 = above - below + offset gives
        # spin below = offset, or spin above = -offset.
        up, down = (below >= 0) & (above < 0), (above >= 0) & (below < 0)
        imposed, values = np.append(below[up], above[down]), [np.append(of[up], -of[down]) for of in offsets]
        # The value of such a spin is that of its whole set; two values of one set contradict each other.
        count, label = whole.pieces(tied)
        imposed_values, owner = np.zeros((2, count)), np.zeros(count, dtype=np.int64)
        owner[label] = np.arange(whole.unknowns) // max(whole.unknowns // samples, 1)
        held, is_free = label[imposed], np.ones(count, dtype=bool)
        is_free[held], self.contradicts = False, np.zeros(samples, dtype=bool)
        for of_sets, value in zip(imposed_values, values, strict=True):
            of_sets[held] = value
            self.contradicts[owner[held[of_sets[held] != value]]] = True
        number = np.where(is_free, np.cumsum(is_free) - 1, -1)
        self.unknowns, self._owner, self.number = int(is_free.sum()), owner[is_free], number[label]
        self.imposed: Pair = (imposed_values[0][label], imposed_values[1][label])

    def _system_left(self, whole: ContactSystem, places: np.ndarray) -> tuple[np.ndarray, ContactSystem]:
        """Return the contacts that can still slip after others were tied: their indices (contacts left,) in the system
        `whole`, and the system of these contacts, whose unknowns are the sets of spins that tied contacts join.

        whole : the system before any contact was tied.
        places : (contacts,), indices in it of the contacts that are not tied.
        """
        assert whole.ends is not None
        # The two sets that each contact joins, -1 for an imposed spin; `same` where it joins spins of one set.
        ends = whole.ends.take(places, 2)  # unlike an index, keeps the order in memory: numbers of a row side by side
        (below, above), imposed = np.append(self.number, -1)[ends], [np.append(of, 0.0)[ends] for of in self.imposed]
        offset, rest = _offset(whole)
        offset, rest, same = offset.take(places, 1), rest.take(places, 1), below == above
        # Spins of sets that are tied to a driven plane are imposed now; their differences are added to the offset.
        of_driven = np.nonzero((imposed[0] != 0).any(axis=0))
        (low, low_rest), (high, high_rest) = ([of[end][of_driven] for of in imposed] for end in range(2))
        jump = subtract((high, high_rest), (low, low_rest))
        offset[of_driven], rest[of_driven] = add((offset[of_driven], rest[of_driven]), jump)
        # Contacts can slip if they join two sets in some component, or if imposed spins make them slip.
        left = np.flatnonzero((~same | (offset != 0)).any(axis=0))
        ends = np.where(same, -1, np.stack([below, above])).take(left, 2)
        kept = places[left]
        offset, felt = offset.take(left, 1), whole.felt.take(kept, 1)
        offset_rest = None if whole.offset_rest is None else rest.take(left, 1)
        return kept, ContactSystem(self.unknowns, offset, felt, ends, offset_rest=offset_rest)

    @property
    def heads(self) -> np.ndarray:
        """(spins,) mask of the first spin of each set that is tied to no driven plane."""
        free = np.flatnonzero(self.number >= 0)
        first, found = np.empty(self.unknowns, dtype=np.int64), np.zeros(len(self.number), dtype=bool)
        first[self.number[free[::-1]]] = free[::-1]  # of several spins of a set the last that is written stays
        found[first] = True
        return found

    def span(self, sample: int) -> slice:
        """Return the range of the unknowns, one for each set of tied spins, that belong to sample number `sample`."""
        return slice(*np.searchsorted(self._owner, [sample, sample + 1]).tolist())

    def order(self, sample: int) -> np.ndarray:
        """Return the order in which the unknowns of a sample, one for each set of tied spins, are eliminated: their
        numbers, counted from the first unknown of the sample.

        In small samples a set is eliminated when the last of its spins would be. In large ones (OWN_ORDER_UNKNOWNS) the
        given order of spins does not divide the sets, which extend far; so nested dissection is repeated for the sets,
        unless the order was made for nearly these sets.
        """
        own = self.span(sample)
        if self.whole.place is not None and own.stop - own.start >= OWN_ORDER_UNKNOWNS and not self._suits:
            if sample not in self._found:
                self._found[sample] = self._dissected(own, self.whole.place)
            return self._found[sample]
        number = np.split(self.number, self.owners.samples)[sample][self._order]
        number = number[number >= 0] - own.start
        last = np.empty(own.stop - own.start, dtype=np.int64)
        last[number] = np.arange(len(number))
        return np.argsort(last)

    @property
    def order_of_spins(self) -> np.ndarray | None:
        """The order (spins,) of the single spins of one sample that corresponds to the order of their sets, the spins
        of a set one after the other; None in small samples, whose sets have no order of their own. It suits systems in
        which a few more contacts are tied, or a few less."""
        if self.unknowns < OWN_ORDER_UNKNOWNS:
            return None
        place = np.empty(self.unknowns + 1, dtype=np.int64)
        place[self.order(0)], place[-1] = np.arange(self.unknowns), -1  # first the spins tied to a driven plane
        return np.argsort(place[self.number], kind="stable")

    def _dissected(self, own: slice, place: np.ndarray) -> np.ndarray:
        """Return the unknowns of one sample, counted from its first, in an order of nested dissection. An unknown is a
        set of tied spins; it is placed at the mean of their places.

        own : range of the sample's unknowns among those of all samples.
        place : (D, spins), coordinates in D dimensions of each spin of the system in which no contact is tied.
        """
        free = self.number >= 0
        number = self.number[free]
        centre = np.stack([np.bincount(number, weights=along[free]) for along in place]) / np.bincount(number)
        return order_by_place(self.system, centre, own)

    def contracted(self, spins: Pair) -> Pair:
        """Return the mean of each set of tied spins, (unknowns,), as a sum of two doubles. It is one of the spins plus
        the mean of the differences from it, which are small.

        spins : (spins,), the single spins, as sums of two doubles.
        """
        free = self.number >= 0
        number, one = self.number[free], np.zeros(self.unknowns)
        one[number] = spins[0][free]
        more = np.bincount(number, weights=spins[0][free] - one[number] + spins[1][free], minlength=self.unknowns)
        return two_sum(one, more / np.bincount(number, minlength=self.unknowns))

    def expanded(self, spins: Pair) -> Pair:
        """Return the spins (spins,) of the system before any contact was tied: equal within each set of tied spins,
        imposed where a set is tied to a driven plane.

        spins : (unknowns,), one for each set; sums of two doubles, as is the result.
        """
        high, low = (np.append(part, 0.0)[self.number] for part in spins)  # number is -1 where a spin is imposed
        return high + self.imposed[0], low + self.imposed[1]

    def differences(self, spins: Pair) -> np.ndarray:
        """Return the slips (d, contacts left) of the contacts that are left, with all digits even of the smallest one.

        spins : (unknowns,), one for each set of tied spins, as a sum of two doubles.

        Slips are computed from the spins each time, not updated from step to step. So their rounding errors do not add
        up: round every loop of contacts slips sum to 0, up to the rounding of the low parts of the spins.
        """
        return self.system.precise_differences(spins)


def _offset(system: ContactSystem) -> Pair:
    """Return what imposed spins contribute to the slips of a system, (d, n) of n contacts with up to d slip components,
    as a sum of two doubles."""
    rest = np.zeros_like(system.offset) if system.offset_rest is None else system.offset_rest
    return system.offset, rest


def order_by_place(system: ContactSystem, place: np.ndarray | None = None, own: slice | None = None) -> np.ndarray:
    """Return the order in which the unknowns of a system are eliminated, by nested dissection of their places.

    system : the contacts; unknowns that a contact joins are coupled.
    place : (D dimensions, unknowns), where each unknown is; None for the places that the system has.
    own : range of the unknowns to order, None for all; they are counted from its first.

    Where contacts mix spin components, all components of a sphere are coupled to the same spheres. So spheres are
    ordered instead of unknowns, which takes a fifth of the time.
    """
    if place is None and own is None and system.whole is not None and not system.whole.along_axes(system.numbers):
        return _by_spheres(system, system.whole)
    own, place = own or slice(0, system.unknowns), system.place if place is None else place
    assert place is not None
    first, second = (end - own.start for end in system.terms()[:2])
    inside = (first >= 0) & (first < own.stop - own.start)
    graph = coupled(np.arange(own.stop - own.start), first[inside], second[inside])
    parts = dissected(graph, place[:, own], OWN_LEAF_UNKNOWNS) if graph.shape[0] else []
    return np.concatenate([np.zeros(0, dtype=np.int64), *(part.nodes for part in parts)])


def _by_spheres(system: ContactSystem, network: Network) -> np.ndarray:
    """Return the order in which the unknowns of a system are eliminated, those of a sphere one after the other, by
    nested dissection of the graph of its spheres.

    system : the contacts.
    network : the spheres, and all their contacts.
    """
    parts = network.order(system.numbers, np.any(system.moved >= 0, axis=1))
    place = np.empty(network.spheres, dtype=np.int64)
    place[np.concatenate([spheres for spheres, _ in parts])] = np.arange(network.spheres)
    return np.argsort(place[system.sphere], kind="stable")
