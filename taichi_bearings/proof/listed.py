"""The contacts of a network that is judged, in lists: where they are, which components make them slip, and all that the
proofs compute from them. `Grid` (slices.py) has the same methods for contacts of a lattice, by slices of arrays.

Letters: R samples, one after the other, with n spheres and m contacts in all; D = 2 or 3 dimensions, C = 1 or 3
components of the spins, each with a number k; n in products such as n x F is the unit normal from the first to the
second sphere; u is spin times radius.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.enclosure import Enclosure, grouped_sum, in_cache, joined, length
from taichi_bearings.scene.network import Network

# Largest difference between a stored normal, which is rounded, and the true unit vector. If minima tie for the true
# normals, a contact at its friction limit may seem to be below it by this share of it. So a proof that a contact rests
# asks for a larger distance from the limit.
ROUNDED_NORMAL = 8 * float(np.finfo(np.float64).eps)


class Listed:
    """Contacts given by the indices of their spheres, for proofs: m contacts and n spheres of R samples in all, with C
    components of spins. An object never changes. Class constants say what is known of such contacts and which proofs
    are tried; they differ in the subclass for lattices (`Grid`)."""

    has_two_planes = False
    """True if the driven spheres are two planes of a lattice: then a state without slip exists if and only if no
    contacts join the planes."""
    still_is_exact = False
    """True if contacts at rest have stored slips of exactly 0, which is only known of lattices."""
    rests_in_parts = True
    """True if contacts with damping are also tried as resting part by part (a part: spheres that contacts connect)."""
    friction_is_at_limit = False
    """True if a minimum is only looked for where the stored friction of slipping contacts hardly misses its limit."""
    friction_is_rounded = True
    """True if the rounding of its components may take the stored friction of a contact beyond its limit."""

    def __init__(self, place: np.ndarray, contact: np.ndarray, normal: np.ndarray, friction: np.ndarray) -> None:
        """Take arrays about n spheres in D dimensions and m contacts.

        place : (n, D), centre of each sphere.
        contact : (2, m), indices of the first and the second sphere of each contact.
        normal : (m, D), unit normals from the first to the second.
        friction : (m, C), friction on the second, by C components."""
        self._arrays = place, contact, normal, friction

    @classmethod
    def of_samples(cls, network: Network, friction: np.ndarray) -> Listed:
        """Return the contacts of R samples on one network, one sample after the other: indices of spheres of sample r
        begin at r N, those of contacts at r E.

        network : N spheres and E contacts.
        friction : (R, E, C), on the second sphere of each contact, C components."""
        count, contacts, components = friction.shape
        if count == 1:
            return cls(network.center, network.contact, network.normal, friction[0])
        first = np.repeat(np.arange(count) * network.spheres, contacts)  # number of the first sphere of each sample
        return cls(
            np.tile(network.center, (count, 1)),
            np.tile(network.contact, count) + first,
            np.tile(network.normal, (count, 1)),
            friction.reshape(-1, components),
        )

    @property
    def place(self) -> np.ndarray:
        """(n, D), centre of each of n spheres in its sample, in D dimensions."""
        return self._arrays[0]

    @property
    def contact(self) -> np.ndarray:
        """(2, m), indices of the first and the second sphere of each of m contacts."""
        return self._arrays[1]

    @property
    def normal(self) -> np.ndarray:
        """(m, D), unit normals of m contacts from the first to the second sphere, in D dimensions."""
        return self._arrays[2]

    @property
    def friction(self) -> np.ndarray:
        """(m, C), friction on the second sphere of each of m contacts by component: C = 1 for discs, 3 for spheres."""
        return self._arrays[3]

    def some(self, pick: slice, count: int) -> Listed:
        """Return the contacts of the samples in the slice `pick` of the R samples alone.

        count : R, the number of all samples."""
        begin, end, _ = pick.indices(count)
        if (begin, end) == (0, count):
            return self
        spheres, contacts = (len(of) // count for of in (self.place, self.normal))
        of_spheres, of_contacts = slice(begin * spheres, end * spheres), slice(begin * contacts, end * contacts)
        ends = self.contact[:, of_contacts] - begin * spheres
        return Listed(self.place[of_spheres], ends, self.normal[of_contacts], self.friction[of_contacts])

    def any_end(self, mask: np.ndarray) -> np.ndarray:
        """Return the mask (m,) of the contacts of which either sphere is in `mask` (n,): m contacts, n spheres."""
        return np.asarray(mask[self.contact].any(axis=0))

    @property
    def slips_with(self) -> np.ndarray:
        """(C components, m) mask, True where a component of the spins makes a contact slip. For discs all are True; for
        spheres it has a meaning only where normals are along the axes: then the two components across the normal do."""
        return self.normal.T == 0 if self.normal.shape[1] == 3 else np.ones((1, len(self.normal)), dtype=bool)

    @cached_property
    def mixing(self) -> np.ndarray:
        """(m,) mask of the contacts at which a component of the slip depends on several components of the spins: those
        with a normal that is not along an axis. All False for discs, which have one component."""
        if self.normal.shape[1] == 2:
            return np.zeros(len(self.normal), dtype=bool)
        found: np.ndarray = ~(np.sort(np.abs(self.normal)) == (0, 0, 1)).all(axis=1)
        return found

    def lengths(self, parts: list[Enclosure]) -> Enclosure:
        """Return the lengths (m,) of m vectors, an enclosure.

        parts : their components, C enclosures (m,)."""
        return length(parts)

    def torques(self, moment: list[Enclosure]) -> list[Enclosure]:
        """Return the sum at each of n spheres of the moments of its contacts, by component, C enclosures (n,).

        moment : n x F of m contacts (n the normal, F the friction), by component, C enclosures (m,). It is added with
            the same sign at both spheres of a contact."""
        return [grouped_sum(joined([part, part]), self.contact.ravel(), len(self.place)) for part in moment]

    def signs(self, feels: np.ndarray) -> list[np.ndarray]:
        """Return for each of C spin components signs (n,) of the n spheres, +1 or -1, opposite at spheres in contact,
        like the spins of spheres that roll on each other. In a connected part with a loop of an odd number of contacts
        there are no such signs, and those returned mean nothing.

        feels : (C, m) mask, for each component which of m contacts connect spheres.
        """
        return [signs(self.contact[:, own], len(self.place))[2] for own in feels]

    def reach(self, largest_imposed: np.ndarray, sign: list[np.ndarray]) -> list[Enclosure]:
        """Return for each of C spin components a bound on the size of u, spin times radius, of each of n spheres at
        some minimum: C enclosures (n,), filled with the largest imposed size. This bound holds where each component of
        a slip depends on one component of the spins.

        largest_imposed : (C,), the largest imposed size of each component.
        sign : not used here."""
        return [Enclosure.exact(np.full(len(self.place), size)) for size in largest_imposed]

    def needed(self, largest_imposed: np.ndarray, differs: Callable[[int], bool]) -> list[int]:
        """Return, in ascending order, the numbers k of the spin components along which contacts may slip at some
        minimum: those along which not all contacts can roll with the imposed spins.

        largest_imposed : (C,), largest absolute imposed value of each of C components; only their number is used here.
        differs : function of k, True if the imposed spins differ along component k, so that not all contacts can roll
            along it.
        """
        return [k for k in range(len(largest_imposed)) if differs(k)]

    def are_whole(self, acts: np.ndarray, free: np.ndarray) -> bool:
        """Return True if it is known without a search that contacts connect every free sphere to driven ones. Here it
        is False, since only lattices (`Grid`) know that.

        acts : (m,) mask of the contacts that take part; not used here.
        free : (n,) mask of the free spheres; not used here."""
        return False

    def slip_speeds(self, spin: list[Enclosure], in_motion: Callable[[], Enclosure]) -> Enclosure:
        """Return the slip speeds of all m contacts, an enclosure (m,): lengths of (u_i + u_j) x n, with the spins times
        radius of both spheres and the normal.

        spin : u, spin times radius of n spheres, by component, C enclosures (n,).
        in_motion : function that returns the slip speeds (m,) in another way, which lattices use; not called here."""
        first, second = self.contact
        return length(across([part.at(first) + part.at(second) for part in spin], self.normal))

    def power_lost(self, torque: Enclosure, reach: Enclosure, mask: np.ndarray) -> Enclosure:
        """Return for each of n spheres the most power that a torque on it may take, an enclosure (n,), if its spin may
        be anything between `reach` and -`reach`: |torque| |reach|.

        torque : (n,), torque over radius along one spin component.
        reach : (n,), bound on the spin times radius.
        mask : (n,) mask of the spheres that count; 0 is returned for others."""
        return largest_work(torque, reach, mask)

    def in_odd_loops(self, k: int, feels: np.ndarray) -> np.ndarray:
        """Return the mask (n,) of the spheres that are connected with a loop of an odd number of contacts.

        k : number of a spin component; not used here.
        feels : (m,) mask of the contacts which that component makes slip; only these connect."""
        return signs(self.contact[:, feels], len(self.place))[1]

    def can_do_work(self, largest_imposed: np.ndarray) -> list[bool]:
        """Return for each of C spin components whether friction can do work along it: here True for all. (On lattices
        False where both planes are driven alike.)

        largest_imposed : (C,), the largest imposed sizes; only its length is used."""
        return [True] * len(largest_imposed)

    def friction_vectors(self, moment: list[Enclosure], counts: np.ndarray) -> list[Enclosure]:
        """Return the stored friction of m contacts by component, C enclosures (m,), set to 0 for contacts that are not
        in the mask `counts` (m,).

        moment : moments of the friction, which lattices return instead; not used here."""
        return [Enclosure.exact(np.where(counts, part, 0.0)) for part in self.friction.T]

    def anchor(self, k: int) -> np.ndarray:
        """Return for each of n spheres the index (n,) of the first sphere that has the same spin component k in every
        motion: here the sphere itself. (On lattices driven spheres of a plane may share the spin of the first.)

        k : number of the spin component, not used here."""
        return np.arange(len(self.place))

    def driven_alike(self, k: int, imposed: Enclosure, driven: np.ndarray) -> np.ndarray:
        """Return for each of q driven spheres a number (q,), 0, 1, ..., equal only for those that have exactly the same
        imposed spin (times radius and sign) in component k.

        k : number of the spin component, not used here.
        imposed : the imposed spins times radius and sign, an enclosure (n,).
        driven : (q,), indices of the driven spheres."""
        high, low, error = (part[driven] + 0.0 for part in imposed.parts)  # + 0.0 makes -0.0 to 0.0
        inexact = np.where(error > 0, driven, -1)  # a spin that is not known exactly equals no other one
        _, found = np.unique(np.stack([high, low, inexact]), axis=1, return_inverse=True)
        return np.asarray(found.reshape(-1))

    def signed(self, spin: Enclosure, sign: np.ndarray) -> Enclosure:
        """Return spins multiplied by the signs `sign`, an enclosure (n,). Signs differ between neighbours, so that
        those which do not slip have equal results.

        spin : (n,), spin times radius of n spheres in one component.
        sign : (n,), +1 or -1."""
        return spin.signed(sign)

    def shift(self, k: int) -> Enclosure | None:
        """Return None: there is nothing to add to stored spins of driven spheres, as they are the imposed ones. (On
        lattices: (n,), imposed less stored spins.)

        k : number of the spin component, not used here."""
        return None

    def still(self, spin: list[Enclosure]) -> np.ndarray:
        """Return the mask (m,) of the contacts whose slip is exactly 0 in the given spins. It has a meaning only for
        discs and for normals along the axes.

        spin : spin times radius of n spheres by component, C enclosures (n,)."""
        (first, second), found = self.contact, np.ones(len(self.normal), dtype=bool)
        for part, feels in zip(spin, self.slips_with, strict=True):
            for of in part.parts[:2]:
                found &= (of[first] == -of[second]) | ~feels
        return found

    def middle(self, indices: np.ndarray) -> np.ndarray:
        """Return the positions (q, D), in D dimensions, of the middles of q contacts: half-way between both centres.

        indices : (q,), indices of the contacts."""
        begin, end = self.place[self.contact[:, indices]]
        return np.asarray(begin + (end - begin) / 2)

    def natural_speed(self, largest_imposed: np.ndarray, speed_unit: float) -> float:
        """Return a speed to compare slips with: the largest imposed spin times radius.

        largest_imposed : (C,), the largest size of each imposed component, spin times radius.
        speed_unit : not used here."""
        return float(largest_imposed.max(initial=0.0))


@in_cache
def largest_work(torque: Enclosure, reach: Enclosure, mask: np.ndarray) -> Enclosure:
    """Return for each of n spheres the most power that a torque can take at spins up to a bound, an enclosure (n,):
    |torque| |reach|.

    torque : (n,), torque over radius along one spin component; its largest possible size is taken.
    reach : (n,), bound on the spin times radius.
    mask : (n,) mask of the spheres that count; the result is 0 for others."""
    return Enclosure.exact(np.where(mask, torque.most, 0.0)) * abs(reach)


def across(vectors: list[Enclosure], normal: np.ndarray) -> list[Enclosure]:
    """Return the cross products v x n of m vectors with unit normals, by component, C enclosures (m,). Discs have one
    component (C = 1), which is returned as it is.

    vectors : v by component, C enclosures (m,).
    normal : n, (m, D dimensions)."""
    if len(vectors) == 1:
        return vectors
    n = normal.T
    turned = [(k + 1) % 3 for k in range(3)], [(k + 2) % 3 for k in range(3)]
    return [vectors[a].times(n[b]) - vectors[b].times(n[a]) for a, b in zip(*turned, strict=True)]


def moments(friction: list[Enclosure], normal: np.ndarray) -> list[Enclosure]:
    """Return the moments n x F of friction F, minus its torque over R on both spheres of a contact: by component, C
    enclosures (m,). For discs, whose friction and moment are one number, friction itself.

    friction : F of m contacts by component, C enclosures (m,).
    normal : (m, D dimensions), unit normals n."""
    return friction if len(friction) == 1 else [-part for part in across(friction, normal)]


def signs(ends: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return three arrays (size,) about the connected parts of a graph, for each of its nodes: the label of its part;
    True if the part has a loop of an odd number of edges; and, in all other parts, a sign +1 or -1 that is opposite for
    nodes which an edge joins.

    ends : (2, q), the two nodes of each of q edges, numbers 0 to size - 1.
    size : number of nodes.

    Each node u has two copies, u+ and u-, and an edge between u and v joins u+ with v- and u- with v+. With an odd loop
    in its part u+ is connected with u-. Else nodes whose + copies are connected have the same sign."""
    first, second = ends
    label = pieces(2 * size, np.append(first, second), np.append(second, first) + size).reshape(2, -1)
    return label.min(axis=0), label[0] == label[1], np.where(label[0] > label[1], -1.0, 1.0)
