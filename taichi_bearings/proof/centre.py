"""Spins near which the minimum of a packing is to be proven: steps 2 and 3 of theorem 7 for contacts in any direction,
with the symbols of oblique.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from scipy import sparse

from taichi_bearings.dissection import Part
from taichi_bearings.proof.curvature import MOST_RELATIVE_CHANGE, Floor, Form, largest_eigenvalue
from taichi_bearings.proof.enclosure import UP, Enclosure, length
from taichi_bearings.proof.exact_motions import ExactMotions
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.listed import ROUNDED_NORMAL, moments
from taichi_bearings.proof.rounded_elimination import EPS, Samples
from taichi_bearings.proof.springs import slip_rows

Kind = TypeVar("Kind", bound="Centre")
TINY = 1e-290  # added to bounds that might underflow
LOST_STEPS = 6  # power iterations that improve the bound on the curvature that is lost as slips turn
# The numbers below belong to Newton's method, of which nothing has to be proven.
FIRM, STIFFER, NEARBY = 1e4, 1e4, 3  # how stiff the springs at resting contacts are, see `_stiffness_of_springs`
NEGLIGIBLE = 1e-20  # leftover torque, in units of the largest friction, that no proof notices


@dataclass(frozen=True)
class LooseFloor:
    """Two proven bounds about the *loose* contacts of a packing, those that rest, but need not roll exactly, and the
    loose spheres, free ones that no exactly rolling contact touches:

    * any slips y of loose contacts are those of some spins of loose spheres with a norm of at most |unit y| / floor;
    * friction on loose contacts that exerts torques r is at most unit |r| / floor at a contact.

    floor : (R,), for each of R samples; infinite if there is no such contact, 0 if nothing is proven.
    unit : (E,), a number for each contact.
    """

    floor: np.ndarray
    unit: np.ndarray


@dataclass(frozen=True)
class Coordinates:
    """Coordinates in which the distance of a minimum is bounded: m numbers from which the changes of the n unknown spin
    components follow. In this class they are these unknowns themselves, m = n.

    form : the curvature of the potential, a quadratic form |B x|^2 of the coordinates x.
    """

    form: Form

    def along(self, values: np.ndarray) -> np.ndarray:
        """Return the slope (m,) of the potential along the coordinates, from torques `values` (n,) along the unknown
        spin components."""
        return values

    def bounded_along(self, values: np.ndarray, inexact: np.ndarray) -> np.ndarray:
        """Return bounds (m,) on how far `along(values)` is from the exact slope of torques within `inexact` of
        `values`.

        values, inexact : (n,) each.
        """
        return inexact

    def changes_of_slips(self, rows: sparse.csr_array, scale: np.ndarray) -> tuple[sparse.csr_array, np.ndarray]:
        """Return two things about the matrix (3 S, m) that gives the changes of the slips of S contacts from the
        coordinates, x components of all contacts first, then y, then z:

        1. a matrix of its shape with bounds on the sizes of its entries,
        2. bounds (S,) on the length of the change of each slip, over that of the vector of all coordinates.

        rows : (3 S, n), the matrix that gives these changes from the unknown spin components.
        scale : (m,), the units in which the coordinates are meant.
        """
        contact = np.repeat(np.arange(rows.shape[0]) % max(rows.shape[0] // 3, 1), np.diff(rows.indptr))
        largest = np.zeros(rows.shape[0] // 3)  # unit of the spin components that change a slip
        np.maximum.at(largest, contact, scale[rows.indices])
        # two spheres change a slip by up to 2^1/2 times that
        return sparse.csr_array(abs(rows) @ sparse.diags_array(scale * UP)), np.sqrt(2) * UP * largest


@dataclass(frozen=True)
class Centre:
    """Spins near which a minimum is to be proven, the stored ones or improved ones, with the friction that resting
    contacts bear at them. Units are those of the network; all values are exact sums of two doubles.

    There are N spheres and E contacts, S of them slipping and T resting; K is the matrix that gives slips from the n
    unknown components of free spins.

    network : R samples of a packing, with N spheres and E contacts in all.
    exact : motions of spheres in which some resting contacts roll exactly.
    loose : bounds about the *loose* contacts, resting ones that need not roll exactly.
    number : (N, 3), the index of each spin component among the n unknowns; -1 for those that are none.
    slipping, resting : (S,) and (T,), indices of the contacts.
    spin : spins times radius by component, 3 enclosures (N,).
    resting_friction : friction of the resting contacts by component, 3 enclosures (E,); 0 at contacts that cannot
        dissipate. Entries of slipping contacts are not used.
    """

    network: JudgedNetwork
    exact: ExactMotions
    loose: LooseFloor
    number: np.ndarray
    slipping: np.ndarray
    resting: np.ndarray
    spin: list[Enclosure]
    resting_friction: list[Enclosure]

    @cached_property
    def slips(self) -> list[Enclosure]:
        """Slips of all E contacts by component, 3 enclosures (E,), after the spins are changed so little that all
        resting contacts which can roll exactly do so."""
        return self.network.slips(self.exact.rolling(self.spin))

    @cached_property
    def size(self) -> Enclosure:
        """Slip speeds of the S slipping contacts, (S,)."""
        return length([part.at(self.slipping) for part in self.slips])

    @property
    def slowest(self) -> float:
        """Least slip speed of the slipping contacts with friction; infinite if there is none."""
        return float(self.size.value[self.with_friction].min(initial=np.inf))

    @cached_property
    def strength(self) -> Enclosure:
        """Friction limits mu F_n of the S slipping contacts, (S,)."""
        return self.network.friction_limit.at(self.slipping)

    @cached_property
    def damping(self) -> Enclosure:
        """Damping eta of the S slipping contacts, an enclosure (S,); 0 where a contact has none."""
        return self.network.damping.at(self.slipping)

    @cached_property
    def with_friction(self) -> np.ndarray:
        """Positions (k,), among the S slipping contacts, of those with a friction limit above 0. The direction of their
        force turns with the slip; the other slipping contacts have damping alone."""
        return np.flatnonzero(self.strength.high > 0)

    @cached_property
    def friction_by_law(self) -> list[Enclosure]:
        """Friction that the contact law gives to the S slipping contacts, mu F_n y / |y| + eta y for the slip y: by
        component, 3 enclosures (S,)."""
        found, some = [], self.with_friction
        for part in self.slips:
            slip = part.at(self.slipping)
            found.append(
                self.damping * slip if self.network.law.has_viscosity else Enclosure.exact(np.zeros(len(self.slipping)))
            )
            found[-1].put(some, found[-1].at(some) + self.strength.at(some) * (slip.at(some) / self.size.at(some)))
        return found

    @cached_property
    def friction(self) -> list[Enclosure]:
        """The friction from which everything is proven, for all E contacts by component, 3 enclosures (E,) without
        errors: `resting_friction` for resting contacts, and for slipping ones the numbers of `friction_by_law`, with
        its error bounds dropped."""
        found = []
        for part, slipping in zip(self.resting_friction, self.friction_by_law, strict=True):
            found.append(_without_error(part))
            found[-1].put(self.slipping, _without_error(slipping))
        return found

    @cached_property
    def torques(self) -> list[Enclosure]:
        """Torques over radius that `friction` leaves over on each of the N spheres: by component, 3 enclosures (N,)."""
        return self.network.torques(moments(self.friction, self.network.graph.normal))

    @property
    def torque_values(self) -> np.ndarray:
        """The doubles (N, 3) nearest to `torques`."""
        return np.stack([part.value for part in self.torques], axis=1)

    @cached_property
    def rows(self) -> sparse.csr_array:
        """The matrix K, (3 E, n), of the slips of all E contacts from the n unknown spin components: first the x
        components of all slips, then y, then z."""
        return slip_rows(self.network, self.number)

    def rows_of(self, contacts: np.ndarray) -> np.ndarray:
        """Return which rows (3 q,) of the matrix of slips belong to the contacts with the indices `contacts` (q,): x
        components first, then y, then z."""
        return np.concatenate([k * len(self.network.graph.normal) + contacts for k in range(3)])

    @property
    def place(self) -> np.ndarray:
        """Positions (3, n) of the spheres to which the n unknown spin components belong; each sphere stands there once
        for each of its unknowns."""
        return np.asarray(self.network.graph.place[np.nonzero(self.number >= 0)[0]].T)

    @cached_property
    def parts(self) -> list[Part]:
        """The n unknown spin components in groups, in the order in which they are eliminated from a matrix."""
        return self.network.parts_of(np.nonzero(self.number >= 0)[0])

    @property
    def samples(self) -> Samples:
        """The sample, one of R, to which each of the n unknown spin components belongs."""
        return self.network.samples_of(np.nonzero(self.number >= 0)[0])

    def curvature(self, stiffness: np.ndarray | None = None) -> Form | None:
        """Return the curvature of the potential at these spins, as a quadratic form |B x|^2 of the changes x of the n
        unknowns; None if some unknown changes no slip. Fictitious springs at the T resting contacts are included, so
        that the matrix of all unknowns can be eliminated. Motions in which these contacts rest do not stretch them.

        stiffness : (T,), of these springs, force over slip speed; None for mu F_n / median |y|.
        """
        if stiffness is None:
            stiffness = self.usual_stiffness(self.resting)
        rows, doubt = self.rows_of_curvature(self.resting, stiffness)
        return Form.of(rows, doubt, self.place, parts=self.parts, samples=self.samples)

    def usual_stiffness(self, contacts: np.ndarray) -> np.ndarray:
        """Return stiffnesses (q,) of springs at the contacts with the indices `contacts` (q,), force over slip speed:
        mu F_n / |y| with the median |y| of slipping contacts."""
        limit: np.ndarray = self.network.friction_limit.value[contacts]
        return limit / (np.median(self.size.value[self.with_friction]) if len(self.with_friction) else 1.0)

    def rows_of_curvature(
        self, springs: np.ndarray, stiffness: np.ndarray
    ) -> tuple[sparse.csr_array, sparse.csr_array]:
        """Return the matrix B (rows, n), and a matrix of the same shape with bounds on the errors of its entries and on
        the rounding of two further products with each.

        springs : (q,), indices of resting contacts that get fictitious springs.
        stiffness : (q,), of these springs, force over slip speed.

        The rows of B are, for a contact with slip y,
        * if it slips and has friction, one: the change of the slip across y, times (mu F_n / |y|)^1/2,
        * if it slips and has damping, three: the components of the change of the slip, times eta^1/2,
        * if it has a spring, three: the components of its slip, times the root of the stiffness.
        """
        slipping, some, strength = self.slipping, self.with_friction, self.network.friction_limit.value
        rubbing, damped = slipping[some], slipping[self.damping.high > 0]  # indices of contacts, as `springs` are
        across = np.cross(
            self.network.graph.normal[rubbing], np.stack([part.value[rubbing] for part in self.slips], axis=1)
        )
        across /= np.linalg.norm(across, axis=1)[:, None]  # unit vectors across the slip and the normal
        friction_root = np.sqrt(strength[rubbing] / self.size.value[some])
        # B = (a sparse matrix of weights) K. A row of friction combines three rows of K, any other row has one.
        column = np.concatenate([self.rows_of(rubbing), self.rows_of(damped), self.rows_of(springs)])
        further = 3 * (len(damped) + len(springs))  # number of rows after those of friction
        row = np.append(np.tile(np.arange(len(some)), 3), len(some) + np.arange(further))
        shape = (len(some) + further, self.rows.shape[0])
        damping_root = np.sqrt(self.network.damping.value[damped])
        root = np.concatenate([np.tile(friction_root, 3), np.tile(damping_root, 3), np.tile(np.sqrt(stiffness), 3)])
        unit = np.append(across.T.ravel(), np.ones(further))
        rows = sparse.csr_array(sparse.csr_array((root * unit, (row, column)), shape=shape) @ self.rows)
        # A component of a unit vector is off by a few roundings of the vector: those of slip, products and difference.
        # An error e of the slip y turns it by up to 2 e / |y|, and changes the root by less. Roots, divisions, the
        # product and the sum of two products are rounded by a share of each entry: six roundings, and 12 EPS are 24.
        error = np.sqrt(sum(part.error[rubbing] ** 2 for part in self.slips))
        off = np.zeros(len(root))
        off[: 3 * len(some)] = np.tile(4 * EPS + 4 * error / self.size.least[some], 3)
        unsure = root * (off + 12 * EPS * np.abs(unit))
        return rows, sparse.csr_array(sparse.csr_array((unsure, (row, column)), shape=shape) @ abs(self.rows))

    def improved(self) -> Centre:
        """Return a copy with spins closer to the minimum among those at which the resting contacts do not slip, and
        with the friction of these contacts there. Nothing about the result is proven.

        The method is Newton's, with stiff springs at the resting contacts (an augmented Lagrangian). One matrix, the
        curvature of slipping contacts and of springs, is factorised once. After each step the force of a spring is
        added to the friction of its contact. So a step reduces slips of resting contacts, and torques, by the ratio of
        the stiffness of slipping contacts to that of springs. Steps end once one does not halve the norm of the
        leftover torques, or these are negligible."""
        stiffness = self._stiffness_of_springs()
        curvature = self.curvature(stiffness)
        factor = None if curvature is None else curvature.elimination.factorised()
        if curvature is None or factor is None:
            return self
        # The last rows of the curvature are those of the springs: their slips times the root of the stiffness.
        is_unknown, last = self.number >= 0, slice(curvature.rows.shape[0] - 3 * len(self.resting), None)
        spring_rows, root = curvature.rows[last], np.tile(np.sqrt(stiffness), 3)
        best, least, found = self, np.inf, self
        while True:
            torque = found.torque_values[is_unknown]
            if not (left := float(np.linalg.norm(curvature.scale * torque))) < least / 2:
                return best
            best, least = found, left
            if np.abs(torque).max() < NEGLIGIBLE:
                return best
            # A Newton step; the forces of the springs in it are added to the friction of the resting contacts.
            stretch = root * np.concatenate([part.value[self.resting] for part in best.slips])
            step = -factor.solve(curvature.scale * torque + spring_rows.T @ stretch)
            spring_force = root * (stretch + spring_rows @ step)
            found = best.moved(curvature.scale * step, -spring_force.reshape(3, -1))

    def _stiffness_of_springs(self) -> np.ndarray:
        """Return the stiffness (T,), force over slip speed, of the spring at each of the T resting contacts in Newton's
        method. The stiffness of a slipping contact is mu F_n / |y| + eta. A spring has at least FIRM times the median
        of these, and STIFFER times that of each slipping contact at most NEARBY contacts away through free spheres."""
        stiffness = np.zeros(len(self.network.counts))
        stiffness[self.slipping] = self.damping.value
        stiffness[self.slipping[self.with_friction]] += (self.strength.value / self.size.value)[self.with_friction]
        median = float(np.median(stiffness[self.slipping])) if len(self.slipping) else 1.0
        # Each pass takes the largest stiffness over to neighbouring contacts, those that share a free sphere.
        for _ in range(NEARBY):
            largest = np.zeros(len(self.network.free))
            for end in self.network.graph.contact:
                np.maximum.at(largest, end, stiffness)
            largest[~self.network.free] = 0.0
            stiffness = np.maximum(stiffness, largest[self.network.graph.contact].max(axis=0))
        found: np.ndarray = np.maximum(FIRM * median, STIFFER * stiffness[self.resting])
        return found

    def moved(self: Kind, step: np.ndarray, less_friction: np.ndarray) -> Kind:
        """Return a copy with other spins and friction, after one step of Newton's method.

        step : (n,), added to the unknown spins (times radius).
        less_friction : (3, T), subtracted from the friction of the T resting contacts, by component."""
        of_spin, of_friction = np.zeros(self.number.shape), np.zeros((3, len(self.network.graph.normal)))
        of_spin[self.number >= 0], of_friction[:, self.resting] = step, -less_friction
        spin, resting = (
            [_without_error(part + Enclosure.exact(by)) for part, by in zip(parts, change, strict=True)]
            for parts, change in ((self.spin, of_spin.T), (self.resting_friction, of_friction))
        )
        return replace(self, spin=spin, resting_friction=resting)

    def proven_distance(self) -> tuple[np.ndarray, np.ndarray]:
        """Return how far the slips at the minimum may be from those at these spins: for each of the S slipping contacts
        of all R samples a bound (S,) on the length of the difference. Return also the mask (R,) of the samples in which
        the bounds are proven (elsewhere they mean nothing), together with two statements:

        * among spins at which no resting contact slips there is one minimum, and it is within this bound;
        * at this minimum friction of the resting contacts, below their limits, can balance the torques of the slipping
          ones.

        Then it is a minimum over all spins, and all minima have its slips.
        """
        none = np.zeros(len(self.slipping))
        if not self._resting_contacts_can_bear(none, none).any():  # a quick check, as if the minimum were here
            return np.full(len(self.slipping), np.inf), np.zeros(self.network.count, dtype=bool)
        distance, turned, proven = self._distance_of_minimum()
        return distance, proven & self._resting_contacts_can_bear(distance, turned) if proven.any() else proven

    @cached_property
    def _sample(self) -> np.ndarray:
        """(S,), the number, 0 to R - 1, of the sample of each of the S slipping contacts."""
        return self.network.sample_of(self.slipping)

    def _norms(self, values: np.ndarray, sample: np.ndarray) -> np.ndarray:
        """Return for each of R samples the Euclidean norm (R,) of the values (q,) that belong to it.

        values : (q,), the values.
        sample : (q,), the number of the sample of each value.
        """
        return np.sqrt(np.bincount(sample, values**2, self.network.count))

    def _norms_on_spheres(self, values: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Return for each of R samples the Euclidean norm (R,) of the values (N spheres, 3) at its spheres in
        `mask`.

        values : (N, 3), the values, three for each sphere.
        mask : (N,) mask of the spheres that count.
        """
        squares = np.where(mask[:, None], values, 0.0) ** 2
        found: np.ndarray = np.sqrt(squares.reshape(self.network.count, -1).sum(axis=1))
        return found

    def _samples_where_all(self, mask: np.ndarray, sample: np.ndarray) -> np.ndarray:
        """Return the mask (R,) of the samples for which all entries of `mask` are True, or that have no entry.

        mask : (q,) mask.
        sample : (q,), the sample of each entry.
        """
        found: np.ndarray = np.bincount(sample, ~mask, self.network.count) == 0
        return found

    @property
    def _loose_spheres(self) -> np.ndarray:
        """(N,) mask of the free spheres that no exactly rolling contact touches, so that they are not in `exact`."""
        return np.asarray(self.network.free & ~self.exact.spheres)

    @cached_property
    def _distance_from_law(self) -> np.ndarray:
        """(S,), for each of S slipping contacts a bound on the difference between two frictions: its `friction`, whose
        doubles are taken as exact, and mu F_n y / |y| + eta y, which the law gives at its slip y. It is as small as
        rounding."""
        return length(
            [f.at(self.slipping) - slipping for f, slipping in zip(self.friction, self.friction_by_law, strict=True)]
        ).most

    def relative_to_slip(self, change: np.ndarray) -> np.ndarray:
        """Return `change` (S,) divided by the slip speeds of the S slipping contacts, rounded up, (S,). It is 0 for
        contacts without a friction limit, as no friction turns with their slip."""
        found = np.zeros(len(self.slipping))
        found[self.with_friction] = (change / self.size.least)[self.with_friction] * UP
        return found

    def _largest_torques(self, unsure: np.ndarray, less: np.ndarray | None = None) -> np.ndarray:
        """Return bounds (N spheres, 3) on the size of each component of the torque over radius that friction leaves
        over on each sphere, if the friction of contacts may differ from `friction`. The bound is 0 for spin components
        that are no unknowns.

        unsure : (E,), bound on that difference, a force, for each contact.
        less : (N, 3), torques that are subtracted from those of `friction` first; None for none.
        """
        less = np.zeros(self.number.shape) if less is None else less
        torques = [part - Enclosure.exact(taken) for part, taken in zip(self.torques, less.T, strict=True)]
        found = np.stack([part.most for part in torques], axis=1)
        for end in self.network.graph.contact:
            np.add.at(found, end, unsure[:, None] * UP)
        return np.where(self.number >= 0, found * UP, 0.0)

    @cached_property
    def distance_to_v(self) -> np.ndarray:
        """(S,), for each of S slipping contacts a bound on the distance of its slip from that at some spins in V. V are
        all spins at which no resting contact slips.

        Let y be the slips of the loose contacts (those that rest, but need not roll exactly). Some change of the spins
        of loose spheres (those without an exactly rolling contact) brings y to 0. Its norm is at most |unit y| / floor
        by `LooseFloor`. It changes the slips of contacts at loose spheres by at most twice its norm, and no others."""
        loose = np.setdiff1d(self.resting, np.flatnonzero(self.exact.contacts))  # they need not roll exactly
        unit, sample = self.loose.unit[loose], self.network.sample_of(loose)
        scaled_slip = np.sqrt(sum(self._norms(unit * part.most[loose], sample) ** 2 for part in self.slips))
        change_of_spins = np.where(scaled_slip > 0, scaled_slip / self.loose.floor * UP, 0.0)
        ends = self.network.graph.contact[:, self.slipping]
        return np.where(self._loose_spheres[ends].any(axis=0), 2 * change_of_spins[self._sample] * UP, 0.0)

    def coordinates(self) -> Coordinates | None:
        """Return the coordinates in which the minimum is bounded, with the curvature in them: here the n unknowns
        themselves. None if some of them changes no slip."""
        curvature = self.curvature()
        return None if curvature is None else Coordinates(curvature)

    def _distance_of_minimum(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bound how far the minimum in V is; V are all spins at which no resting contact slips. Return three arrays:

        1. for each of the S slipping contacts a bound (S,) on |slip at the minimum - slip at these spins|,
        2. for each a bound (S,) on the difference between the unit vectors along both, 0 without friction,
        3. the mask (R,) of the samples for which this is proven, and that V has just one minimum.

        Proof. |B x|^2 is the curvature of the potential for a change x of the coordinates, each in its own unit, and
        tau its floor: |B x|^2 >= tau |x|^2. The slope is small; rho and z are those of `_radius`. Let x be the change
        to the minimum. Then

            |x| <= 8.4 rho    and    |B x| <= 9 tau^1/2 rho.

        The factors are products, below 8.34, of three numbers:
        1 / 0.72 : friction resists a change by at least 0.72 of its curvature.
        3 : the curvature at spins of V is at least |B x|^2 / 3. Slips that are a quarter longer there leave 0.8 of it,
            and other directions take away at most tau |x|^2 / 8 (`_curvature_lost`), that is |B x|^2 / 8, which leaves
            (1 - 8^-1/2)^2: in all 0.334 |B x|^2.
        2 : |B z| and |B x| are taken of B as doubles have it. Its error has a norm d below 0.71 tau^1/2: the proof of
            tau asks for 2 d m < tau, with m^2 >= tau above all eigenvalues, or for a number above 2 d^2 that is below
            tau (`_floor_by_guess`).

        There is just one minimum. Two would differ by a motion that changes all slips along their directions alone. Its
        curvature would come from the turning of slips only, so it would be below tau / 8; but it is tau or more.
        """
        sample, with_friction = self._sample, self.with_friction
        can_be_tried = self._samples_where_all(self.size.least[with_friction] > 0, sample[with_friction])
        can_be_tried &= self.loose.floor > 0
        coordinates = self.coordinates() if can_be_tried.any() else None
        if coordinates is None:
            return np.full(len(sample), np.inf), np.full(len(sample), np.inf), np.zeros_like(can_be_tried)
        floor, samples = coordinates.form.floor_in_units(), coordinates.form.elimination.samples
        rows = sparse.csr_array(self.rows[self.rows_of(self.slipping)])
        changes, lengths = coordinates.changes_of_slips(rows, coordinates.form.scale * floor.unit)
        radius = self._radius(coordinates, floor)[sample]  # rho
        distance = (self.distance_to_v + 8.4 * lengths * radius * UP**2 + TINY) * UP
        turned = self._turned(distance, floor.tau[sample], radius)
        changes_little = self._samples_where_all(self.relative_to_slip(distance) <= MOST_RELATIVE_CHANGE, sample)
        one_minimum = self._curvature_lost(turned, changes, samples) * UP < floor.tau / 8
        return distance, turned, can_be_tried & (floor.tau > 0) & changes_little & one_minimum

    def _turned(self, distance: np.ndarray, tau: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Return for each of the S slipping contacts a bound (S,) on the difference between the unit vectors along its
        slip y at the minimum and at these spins; 0 without friction.

        No row of B x exceeds |B x|, so the change of y across itself is at most |B x| / (mu F_n / |y|)^1/2. A change d,
        |d| <= |y| / 4, with a part d_a across y turns it by an angle with a sine of at most |d_a| / (|y| - |d|). Unit
        vectors at an angle below asin 1/4 differ by at most 1.01 times its sine: in all by less than 1.4 |d_a| / |y|.
        They differ by no more than 2 |d| / |y|, too.

        distance : (S,), bounds on |d|.
        tau, radius : (S,), tau and rho of the sample of each contact; |B x| <= 9 tau^1/2 rho.
        """
        strength, to_v = self.strength.least, self.distance_to_v
        root = np.sqrt(tau * self.size.most / np.maximum(strength, TINY))
        across = np.where(strength > 0, 9 * root * radius, np.inf)
        # fmin: the second bound holds alone where the first one is no number, as without any unknown
        found: np.ndarray = np.fmin(1.4 * self.relative_to_slip(to_v + across), 2 * self.relative_to_slip(distance))
        return found * UP**2

    def _curvature_lost(self, turned: np.ndarray, changes: sparse.csr_array, samples: Samples) -> np.ndarray:
        """Return for each of R samples a bound (R,), a factor of |x|^2, on the curvature that comes from the turning of
        slips: turned^2 mu F_n / |y| from each slipping contact.

        turned : (S,), bounds on the differences between unit vectors along slips.
        changes : (3 S, m), bounds on how the m coordinates x change the slips, components x of all contacts first.
        samples : the sample of each coordinate.
        """
        root = np.sqrt(turned * self.relative_to_slip(turned * self.strength.most)) * UP
        weighted = sparse.csr_array(sparse.diags_array(np.tile(root, 3)) @ changes)
        return largest_eigenvalue(weighted, LOST_STEPS, samples)

    def _radius(self, coordinates: Coordinates, floor: Floor) -> np.ndarray:
        """Return for each of R samples the number rho (R,) that bounds the distance of the minimum,

            rho = (|B z| + |r - B^T B z| / tau^1/2 + |a|) / tau^1/2,

        in coordinates each of which has its own unit. |B x|^2 is the curvature for a change x, tau its floor, and z the
        motion of :func:`newton_step`. The slope of the potential along x is r . x + a . B x while no resting contact
        slips. It has two parts:
        r : the torques that friction leaves over; the error of the size of friction at slipping contacts is added.
        a : for the angle between friction F and slip y. F has a component F angle across y. Divided by the root of the
            curvature F / |y| (of friction and damping together) it is angle (F |y|)^1/2, an entry of a. Along y this F
            is shorter by F angle^2 / 2 at most, which is added to r.

        coordinates : the coordinates, with the matrix B.
        floor : tau, the units, and a factor of B^T B.
        """
        form, is_unknown, values = coordinates.form, self.number >= 0, self.torque_values
        angle, size_error, size_by_law = self._distance_from_slip_direction(self.distance_to_v)
        unsure = np.zeros(len(self.network.counts))
        unsure[self.slipping] = size_error + size_by_law * angle**2 * UP
        slope, inexact = coordinates.along(values[is_unknown]), self._largest_torques(unsure, values)
        size_of_step, balanced, rounded = newton_step(form, floor, slope)  # |B z|, B^T B z, rounding of the latter
        left = (
            np.abs(slope - balanced) * UP + rounded + coordinates.bounded_along(values[is_unknown], inexact[is_unknown])
        )
        left = form.elimination.samples.norms(form.scale * floor.unit * left)
        squares = size_by_law * self.size.most * angle**2 + self.damping.most * self.distance_to_v**2
        size_of_a = np.sqrt(np.bincount(self._sample, squares, len(floor.tau)))
        found: np.ndarray = left / floor.tau + (size_of_step + size_of_a) / np.sqrt(floor.tau)
        return found

    def _distance_from_slip_direction(self, to_v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compare the friction F of the S slipping contacts with the friction that the contact law demands for slips
        nearby. Return three arrays (S,):

        1. a bound on the size of the difference between the unit vectors along F and along the slip; 0 for contacts
           without friction,
        2. a bound on the difference between |F| and the size that the law demands; for contacts without friction on the
           length of the difference between both vectors,
        3. an upper bound on the size that the law demands.

        to_v : (S,), a speed: the slips in V may differ from the stored ones by up to this.
        """
        some, angle, size_error = self.with_friction, np.zeros(len(self.slipping)), self._distance_from_law.copy()
        size_by_law = self.strength + self.damping * self.size if self.network.law.has_viscosity else self.strength
        angle[some] = (2 * (self._distance_from_law / size_by_law.least + to_v / self.size.least) * UP)[some]
        size_error[some] = (length([part.at(self.slipping) for part in self.friction]) - size_by_law).most[some]
        return angle, size_error, size_by_law.most

    def _resting_contacts_can_bear(self, distance: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Return the mask (R,) of the samples in which it is proven that the T resting contacts can balance the torques
        of the S slipping contacts, with friction below the limit of each.

        These are the torques at the constrained minimum: the spins of least potential among those at which no resting
        contact slips. The given spins are near it.

        distance : (S,), bound on |slip at the constrained minimum - given slip| of each slipping contact.
        turned : (S,), bound on the difference between the unit vectors along these two slips.
        """
        network, exact = self.network, self.exact
        # The proof holds for the stored normals. True ones differ from them by rounding, which must not decide whether
        # a contact at its limit slips. So contacts have to bear such changes of the given torques as well.
        unsure = np.where(network.counts, ROUNDED_NORMAL * length(self.friction).most, 0.0)
        unsure[self.slipping] += self._distance_from_law + turned * self.strength.most + self.damping.most * distance
        torque = self._largest_torques(unsure)
        # The friction of resting contacts is corrected in two steps: first at the loose contacts (those that need not
        # roll exactly), which balances the loose spheres; then at the exactly rolling ones. The size of a correction is
        # at most that of its torques over a proven floor. The first one also exerts torques on exactly rolling spheres,
        # at each contact no more than its size.
        sample, rolls = network.sample_of(self.resting), exact.contacts[self.resting]
        left = self._norms_on_spheres(torque, self._loose_spheres) / self.loose.floor * UP
        change = np.where(rolls, 0.0, self.loose.unit[self.resting] * left[sample] * UP)
        for end in network.graph.contact[:, self.resting]:
            np.add.at(torque, end, change[:, None] * UP)
        by_exact = self._norms_on_spheres(exact.unit * torque, exact.spheres) / exact.floor * UP**2
        margin = (network.friction_limit - length(self.friction)).lower() - ROUNDED_NORMAL * network.friction_limit.most
        change = np.where(rolls, by_exact[sample], change)
        return self._samples_where_all(margin[self.resting] > change * UP, sample)


def _without_error(values: Enclosure) -> Enclosure:
    """Return the enclosures `values` with their error bounds dropped: sums of two doubles that are taken as exact."""
    return Enclosure.exact(values.high, values.low)


def newton_step(curvature: Form, floor: Floor, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find a motion z with torques B^T B z close to given ones, about one step of Newton's method. Return three arrays:

    1. a bound on |B z| for each of R samples, (R,);
    2. the torques B^T B z along the unknowns, (m,);
    3. a bound on their rounding, (m,).

    The proofs may use any z. The entries of B are taken as the doubles that they are.

    curvature : the matrix B for m unknowns in units `scale`.
    floor : its proven floor, with the Cholesky factor of B^T B.
    torque : (m,), the torques along the unknowns.
    """
    rows, scale, samples = curvature.rows, curvature.scale, curvature.elimination.samples
    scaled = scale * torque
    z = floor.factor.solve(scaled)
    z += floor.factor.solve(scaled - rows.T @ (rows @ z))
    z = np.where(np.isfinite(z) & ~floor.factor.failed[samples.of], z, 0.0)
    # A sum of products has as many roundings as terms; those of all terms are allowed for, with their full sizes.
    product, sizes = rows.T @ (rows @ z), abs(rows).T @ (abs(rows) @ np.abs(z))
    terms = np.diff(rows.indptr).max(initial=0) + np.bincount(rows.indices).max(initial=0) + 8
    inexact, sum_of_sample = terms * EPS * sizes, partial(np.bincount, samples.of, minlength=samples.count)
    # |B z|^2 = z . B^T B z, with bounds on the rounding of both products
    square = sum_of_sample(np.abs(z) * (inexact + len(z) * EPS * sizes)) + sum_of_sample(z * product)
    return np.sqrt(np.maximum(square, 0.0)) * UP + TINY, product / scale, inexact / scale * UP
