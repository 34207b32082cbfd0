"""Contact systems in which the spins across some contacts are tied together, as one unknown.

A contact that does not slip makes the spin components across it equal. Near the minimum tying them leaves about one
unknown in six at 32^3, and a contact system without huge stiffnesses: there the last digits can be computed.

Several samples of one lattice are parts of one system that no contact joins. Letters: n contacts with up to d slip
components; D dimensions; a Pair is a sum of two doubles (high, low).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.dissection import dissected
from taichi_bearings.numerics.cholesky.fronts import coupled
from taichi_bearings.numerics.double_double import Pair, add, subtract, two_sum
from taichi_bearings.scene.network import Network

# number of unknowns from which a sample has an order of its own, and of a region that then is not divided
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
    """Return a mask (samples,) of the samples that own something, and for each of these the index of the first that it
    owns.

    samples : number of samples.
    owner : (k,), number of the sample that owns each of k things, ascending.
    """
    begins = np.searchsorted(owner, np.arange(samples + 1))
    some = begins[1:] > begins[:-1]
    return some, begins[:-1][some]


def _reduced(reduce: np.ufunc, values: np.ndarray, begins: tuple[np.ndarray, np.ndarray], nothing: float) -> np.ndarray:
    """Return for each sample the largest or smallest of its values, (samples,).

    reduce : `np.maximum` or `np.minimum`.
    values : (k,), in the order of their samples.
    begins : a mask (samples,) of the samples that have values, and the index of the first value of each of these.
    nothing : the number that a sample without values gets.
    """
    some, first = begins
    found = np.full(len(some), nothing)
    if len(first):
        found[some] = reduce.reduceat(values, first)
    return found


class Contraction:
    """The contacts that are left when some contacts are tied, over one unknown for each set of spins that are tied
    together.

    whole : the system in which no contact is tied; its unknowns are single spins ("spins" below).
    system : the contacts that are not tied, with one unknown for each set of tied spins.
    kept : (contacts left,), the index in `whole` of each contact of `system`. Contacts that cannot slip, because tied
        ones make their two ends equal, are left out as well.
    unknowns : number of sets.
    number : (spins,), index of the set of each spin, -1 if the set is tied to a driven plane.
    imposed : (spins,), spin of the driven plane where `number` is -1, else 0; a sum of two doubles.
    owners : the sample of each new unknown and of each contact left.
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
        # `kept` : numbers in `whole` of the contacts that are left; `system` : these contacts over the new unknowns
        self.whole, self._order, self._suits = whole, order, suits
        self._found = dict[int, np.ndarray]()  # by sample, orders of its own
        self._label(whole, tied, samples)
        self.kept, self.system = self._system_left(whole, np.flatnonzero(~tied))
        self.owners = Owners(samples, self._owner, self.kept // max(len(tied) // samples, 1))

    def _label(self, whole: ContactSystem, tied: np.ndarray, samples: int) -> None:
        """Number the sets of spins that tied contacts join, and set these fields:

        unknowns : number of sets without an imposed spin.
        number : (spins,), number of the set of each spin among these, -1 if the set is imposed.
        imposed : two arrays (spins,), the imposed value of the set of each spin and what it lacks; 0 if none is.
        contradicts : (samples,) mask of samples with a set that has two different imposed values.
        _owner : (unknowns,), sample of each set.

        whole : contacts of all samples.
        tied : (n,) mask of the tied ones, which make the spins at both ends equal.
        samples : number of samples, of equal size.
        """
        assert whole.ends is not None
        (below, above), offsets = whole.ends[:, :, tied], [part[:, tied] for part in _offset(whole)]
        # a difference of zero with one end imposed: spin below = offset, or spin above = -offset
        up, down = (below >= 0) & (above < 0), (above >= 0) & (below < 0)
        imposed, values = np.append(below[up], above[down]), [np.append(of[up], -of[down]) for of in offsets]
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
        """Return the contacts that can still slip after others were tied: their indices (q,) in the system `whole`, and
        a system of these contacts alone, whose unknowns are the sets of spins that tied contacts join.

        whole : the system before any contact was tied.
        places : (p,), indices in it of the contacts that are not tied. Of these, contacts between spins of one set
            without an imposed slip are left out.
        """
        assert whole.ends is not None
        ends = whole.ends[:, :, places]  # -1 where a spin was imposed before
        (below, above), imposed = np.append(self.number, -1)[ends], [np.append(of, 0.0)[ends] for of in self.imposed]
        offset, rest = _offset(whole)
        offset, rest, same = offset[:, places], rest[:, places], below == above
        of_driven = np.nonzero((imposed[0] != 0).any(axis=0))
        (low, low_rest), (high, high_rest) = ([of[end][of_driven] for of in imposed] for end in range(2))
        jump = subtract((high, high_rest), (low, low_rest))
        offset[of_driven], rest[of_driven] = add((offset[of_driven], rest[of_driven]), jump)
        left = np.flatnonzero((~same | (offset != 0)).any(axis=0))
        ends = np.where(same, -1, np.stack([below, above]))[:, :, left]
        kept = places[left]
        offset_rest = None if whole.offset_rest is None else rest[:, left]
        return kept, ContactSystem(self.unknowns, offset[:, left], whole.felt[:, kept], ends, offset_rest=offset_rest)

    @property
    def heads(self) -> np.ndarray:
        """(unknowns before,) mask of one spin, the first, of each set that is tied to no driven plane."""
        free = np.flatnonzero(self.number >= 0)
        first, found = np.empty(self.unknowns, dtype=np.int64), np.zeros(len(self.number), dtype=bool)
        first[self.number[free[::-1]]] = free[::-1]
        found[first] = True
        return found

    def span(self, sample: int) -> slice:
        """Return the range of the new unknowns, one for each set of tied spins, that belong to a sample, its number."""
        return slice(*np.searchsorted(self._owner, [sample, sample + 1]).tolist())

    def order(self, sample: int) -> np.ndarray:
        """Return the order in which the new unknowns of a sample are eliminated: (unknowns,), their numbers counted
        from its first. A new unknown stands for a set of spins that contacts tie together.

        In small samples a set is eliminated when the last of its spins would be. In large ones (OWN_ORDER_UNKNOWNS) the
        sets, which extend across any plane, are dissected anew by their places, unless the given order suits them.
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
        """The order (unknowns before,) of the single spins of one sample in which sets of tied spins are eliminated,
        those of a set one after the other; None in small samples, whose sets have no order of their own. It suits
        systems in which a few more contacts are tied, or a few less."""
        if self.unknowns < OWN_ORDER_UNKNOWNS:
            return None
        place = np.empty(self.unknowns + 1, dtype=np.int64)
        place[self.order(0)], place[-1] = np.arange(self.unknowns), -1  # first the spins tied to a driven plane
        return np.argsort(place[self.number], kind="stable")

    def _dissected(self, own: slice, place: np.ndarray) -> np.ndarray:
        """Return the unknowns of one sample, (unknowns of the sample,), counted from its first, in an order of nested
        dissection. An unknown stands for a set of spins that are tied together and is placed at their mean.

        own : range of the sample's unknowns among those of all samples.
        place : (D, spins), coordinates in D dimensions of each spin of the system in which no contact is tied.
        """
        free = self.number >= 0
        number = self.number[free]
        centre = np.stack([np.bincount(number, weights=along[free]) for along in place]) / np.bincount(number)
        return order_by_place(self.system, centre, own)

    def contracted(self, spins: Pair) -> Pair:
        """Return for each set of tied spins their mean, (unknowns,), as a sum of two doubles: one of the spins, plus
        the mean difference of all from it.

        spins : (unknowns before,), the single spins, as sums of two doubles.
        """
        free = self.number >= 0
        number, one = self.number[free], np.zeros(self.unknowns)
        one[number] = spins[0][free]
        more = np.bincount(number, weights=spins[0][free] - one[number] + spins[1][free], minlength=self.unknowns)
        return two_sum(one, more / np.bincount(number, minlength=self.unknowns))

    def expanded(self, spins: Pair) -> Pair:
        """Return the spins (unknowns before,) of the system before any contact was tied: equal within each set of tied
        spins, imposed where a set is tied to a driven plane.

        spins : (unknowns,), one for each set; sums of two doubles, as is the result.
        """
        high, low = (np.append(part, 0.0)[self.number] for part in spins)  # number is -1 where a spin is imposed
        return high + self.imposed[0], low + self.imposed[1]

    def differences(self, spins: Pair) -> np.ndarray:
        """Return the slips (d, contacts left) of the contacts that are not tied, so exactly that even the smallest one
        has all its digits.

        spins : (unknowns,), one for each set of tied spins, as a sum of two doubles.

        Slips are computed anew from the spins each time. So they add up to 0 round every loop of contacts, up to the
        rounding of the low parts. If the slips themselves were updated step by step, their rounding errors would add
        up, and contacts at rest would seem to slip.
        """
        return self.system.precise_differences(spins)


def _offset(system: ContactSystem) -> Pair:
    """Return what imposed spins contribute to the slips of a system, (d, n) of n contacts with up to d slip components,
    as a sum of two doubles."""
    rest = np.zeros_like(system.offset) if system.offset_rest is None else system.offset_rest
    return system.offset, rest


def order_by_place(system: ContactSystem, place: np.ndarray | None = None, own: slice | None = None) -> np.ndarray:
    """Return the order in which the unknowns of a system are eliminated, by nested dissection of where they are.

    system : the contacts; unknowns that a contact joins are coupled.
    place : (D, unknowns), where each unknown is; None for the places that the system has.
    own : range of the unknowns to order, None for all; they are counted from its first.

    Where contacts mix spin components, all components of a sphere are coupled alike. There the spheres are ordered,
    which takes a fifth of the time.

    Letters: D dimensions.
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
