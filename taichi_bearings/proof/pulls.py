"""Contacts whose friction is at its limit, with the groups of spheres that move together from one minimum to another
(theorem 9; tied_minima.py has the proof and a drawing of the groups).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.numerics.graphs import pieces

EPS = np.finfo(np.float64).eps  # distance from 1 to the next double


@dataclass(frozen=True)
class Pulls:
    """The n contacts of one sample whose friction is at its limit mu F_n, with the direction of the force (*pull*) of
    each: first the contacts that slip (the set S), then those that do not slip (C). T are the contacts below their
    limit.

    Two spin components make contacts slip. They are numbered 0 and 1, in arguments `slot` and on the first axis of
    arrays (2, ...). A *domain* is a group of spheres that a set of contacts joins in one component: they turn as one.

    own : (n,), indices of the contacts among all of the network.
    lower, upper : (n,), indices of their two spheres.
    felt : (2, n) mask, True where a component of the spins makes the contact slip.
    sign : (2, n), sign of the slip along each component: of the spin at `upper` less that at `lower`, times signs that
        differ between neighbours. For C it is the sign of the slip that its friction would go with, and 0 along a
        component in which it has no friction.
    oblique : (n,) mask of those contacts of C that have friction along both components. Only the balance of forces
        says in which direction they would begin to slip (oblique_limits.py).
    coefficient : (n, p), friction limits in exact proportions: that of a contact is the exact sum of its p numbers.
    in_s : (n,) mask of the contacts of S.
    slipless_domain : (2, spheres), by component the label of the domain that T and C make of each sphere and others.
        Domains with a driven sphere, whose spin is imposed, have the smallest labels, 0, 1, ...
    firm_domain : (2, spheres), labels of the domains that T alone makes, in this order as well.
    locked_domain : (2, spheres), labels of the domains that T makes with the contacts of C without friction along the
        component.
    driven : (spheres,) mask of the driven spheres."""

    own: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    felt: np.ndarray
    sign: np.ndarray
    coefficient: np.ndarray
    in_s: np.ndarray
    oblique: np.ndarray
    slipless_domain: np.ndarray
    firm_domain: np.ndarray
    locked_domain: np.ndarray
    driven: np.ndarray

    def imposed_labels(self, label: np.ndarray, slot: int) -> int:
        """Return the number of domains with a driven sphere in component `slot` (0 or 1). These have the labels 0, 1,
        ... up to this number less 1.

        label : (2, spheres), the label of the domain of each sphere: one of the fields `slipless_domain`, `firm_domain`
            and `locked_domain`.
        """
        return int(label[slot][self.driven].max()) + 1

    def apart(self, label: np.ndarray, slot: int) -> np.ndarray:
        """Return the mask (n,) of the contacts whose two spheres have different labels in component `slot` (0 or 1).

        label : (2, spheres), a label of each sphere for either component, such as that of its domain."""
        found: np.ndarray = label[slot, self.lower] != label[slot, self.upper]
        return found

    def touches(self, label: np.ndarray, value: int) -> np.ndarray:
        """Return the mask (n,) of the contacts whose slip may change when one domain moves: slipping contacts with
        exactly one sphere in it, and contacts without slip with any sphere in it.

        label : (spheres,), the label of the domain (group of spheres that move together) of each sphere.
        value : the label of the domain that moves."""
        ends = label[self.lower] == value, label[self.upper] == value
        found: np.ndarray = np.where(self.in_s, ends[0] != ends[1], ends[0] | ends[1])
        return found

    @cached_property
    def turned_by(self) -> np.ndarray:
        """(2, n) mask, for either component True for a *turning* contact: it slips along the other component, or would
        begin to, so that its slip changes its direction as soon as one of its spheres moves in this component."""
        both = self.felt.all(axis=0)
        slips_along_other = [both & self.apart(self.slipless_domain, 1), both & self.apart(self.slipless_domain, 0)]
        found: np.ndarray = np.array(slips_along_other) | self.oblique
        return found

    @cached_property
    def uncertain(self) -> np.ndarray:
        """(2, n) mask, for either component True for a contact whose friction along it is not exactly known: that of
        slipping contacts whose slip has both components, and of `oblique` ones."""
        slips = [self.in_s & self.turned_by[slot] & self.apart(self.slipless_domain, slot) for slot in range(2)]
        found: np.ndarray = np.array(slips) | self.oblique
        return found

    def crossing(self, label: np.ndarray, value: int) -> np.ndarray:
        """Return the mask (n,) of the contacts of which exactly one sphere is in a domain.

        label : (spheres,), the label of the domain (group of spheres that move together) of each sphere.
        value : the label of this domain."""
        found: np.ndarray = (label[self.lower] == value) != (label[self.upper] == value)
        return found

    def turned_at(self, domain: int, slot: int) -> np.ndarray:
        """Return the mask (n,) of the contacts between a domain and others whose slips change their direction if it
        moves, as they slip along both components.

        domain : label of the domain in `slipless_domain`, for component `slot` (0 or 1)."""
        found: np.ndarray = self.in_s & self.turned_by[slot] & self.crossing(self.slipless_domain[slot], domain)
        return found

    @cached_property
    def welded_slipless(self) -> np.ndarray:
        """(2, spheres), for either component the number of the welded domain of each sphere: slipless domains (joined
        by contacts without slip) that have to move together from one minimum to another, since otherwise the slip of a
        contact would change its direction. It is 0 for a welded domain with a driven sphere, then 1, 2, ..."""
        return np.array([self._welded_domains(self.slipless_domain, slot) for slot in range(2)])

    @cached_property
    def welded_locked(self) -> np.ndarray:
        """(2, spheres), for both spin components the number of the welded domain of each sphere, made of locked domains
        (`locked_domain`). Several of these are welded if they can only move together from one minimum to another: else
        the slip of a contact between them would change its direction, which is the same at all minima. Number 0 has a
        driven sphere; the others are 1, 2, ..."""
        return np.array([self._welded_domains(self.locked_domain, slot) for slot in range(2)])

    def _welded_domains(self, label: np.ndarray, slot: int) -> np.ndarray:
        """Return the number (spheres,) of the welded domain of each sphere in component `slot` (0 or 1): 0 for those
        that contain a driven sphere, then 1, 2, ...

        A domain is a group of spheres that turn as one in a component. Some domains have to move together from one
        minimum of the power to another, since otherwise the slip of a contact between them would change its direction.
        Such domains together are a welded domain.

        label : (2, spheres), labels of the domains of which welded ones are made: `slipless_domain` or `locked_domain`.
        """
        domain = label[slot]
        joins = self.turned_by[slot] & self.apart(label, slot)
        first, second = domain[self.lower[joins]], domain[self.upper[joins]]
        # all domains with a driven sphere count as joined, as none of them can move; label 0 is one of them
        imposed = np.arange(self.imposed_labels(label, slot))
        first, second = np.append(first, 0 * imposed), np.append(second, imposed)
        welded = pieces(int(domain.max()) + 1, first, second)
        # number those that occur from 0
        occurs = np.zeros(int(welded.max()) + 1, dtype=bool)
        occurs[0], occurs[welded[domain]] = True, True
        of_spheres: np.ndarray = (np.cumsum(occurs) - 1)[welded][domain]
        return of_spheres

    @cached_property
    def same_in_both(self) -> np.ndarray:
        """(spheres,), a label of each sphere. Two spheres have equal labels if they turn as one in both spin
        components: if they have equal `slipless_domain`, since contacts that do not slip join them, directly or through
        others."""
        return np.unique(self.slipless_domain, axis=1, return_inverse=True)[1].reshape(-1)

    def known_pulls_cancel_at(self, owner: np.ndarray, slot: int) -> np.ndarray:
        """Return a mask (labels,): for each label True if the exactly known forces along component `slot` (0 or 1) add
        up to 0 on the spheres with this label. It is True for labels without any such force.

        The force of a contact is known, plus or minus mu F_n, if it slips along this component alone (or does not slip,
        but is at its limit along it alone). Contacts within one domain are left out, as their two forces cancel.

        owner : (spheres,), the label of each sphere, such as the number of its domain.
        """
        exact = self.felt[slot] & ~self.turned_by[slot] & np.where(
            self.in_s, self.apart(self.slipless_domain, slot), self.apart(self.firm_domain, slot)
        )  # fmt: skip
        pull = self.sign[slot, exact, None] * self.coefficient[exact]
        label_of = np.repeat(np.concatenate([owner[self.upper[exact]], owner[self.lower[exact]]]), pull.shape[1])
        values, size = np.concatenate([pull, -pull]).ravel(), int(owner.max()) + 1
        total, sizes, terms = (np.bincount(label_of, v, size) for v in (values, np.abs(values), np.ones_like(values)))
        # The error of a sum in doubles is below the number of terms times EPS times the sum of their sizes. So only
        # sums that are no larger need an exact sum.
        found: np.ndarray = np.abs(total) <= terms * EPS * sizes
        for label in np.flatnonzero(found & (terms > 0)).tolist():
            found[label] = math.fsum(values[label_of == label].tolist()) == 0.0
        return found
