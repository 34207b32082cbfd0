"""The central paths of the samples of a packing, for the interior-point method: where they begin, what they lead to.

A contact along an axis couples only the two spin components across it. If the contacts that couple a component form no
odd loop, signs by which neighbours differ turn the sums u_i + u_j into differences, as on a lattice. Networks of such
contacts alone have their contact states settled in the same way as lattices, others by conic/multipliers.py.

Letters: R samples; A contacts of the system of the packing; n contacts of the system on the path (those with a coupled
component); d tangents of a contact; the unknowns are components of u = R omega. The *dual* is minus the contact force.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_bearings.conic.central_path import balance, flowing
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.descent import Sample
from taichi_bearings.conic.iterate import LEAST_GAP, Iterate
from taichi_bearings.conic.multipliers import settled_by_springs
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.resolution import Surroundings
from taichi_bearings.conic.shared import KEPT_UNKNOWNS, is_small, surroundings_of
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.scene import Progress
from taichi_bearings.solvers.part import Found
from taichi_bearings.solvers.paths import Paths
from taichi_bearings.stages import stage

if TYPE_CHECKING:
    from taichi_bearings.solvers.on_system import OnSystem

MOST_STEPS, SLACK = 80, 0.3  # steps of the path; bound of a contact without slip at its start, in mean slips


def viscous_spins(system: ContactSystem, viscosity: np.ndarray) -> np.ndarray:
    """Return the spins u = radius * spin (unknowns,) at which viscous forces are in balance.

    Each tangent of a contact is treated as a contact of its own, as viscosity does not couple them.

    system : the A contacts that take part.
    viscosity : (A,), viscosity of each.
    """
    offset = system.offset.reshape(1, -1)
    rows = ContactSystem(system.unknowns, offset, np.ones(offset.shape, dtype=bool), None, system.operator)
    matrix = NewtonMatrix(rows, order_by_place(rows, system.place))
    return flowing(rows, np.tile(viscosity, len(system.offset)), matrix, np.zeros(system.unknowns))


@dataclass(frozen=True)
class Strengths:
    """Friction limits and viscosities of the A contacts of one sample, scaled so that the largest of them is about 1.

    Forces are divided by `force_unit`. Speeds u = radius * spin are divided by a unit near the fastest imposed one.

    friction : (A,), friction limit over the unit of force.
    viscosity : (A,), force per speed, in units of force over speed.
    force_unit : the unit of forces.
    """

    friction: np.ndarray
    viscosity: np.ndarray
    force_unit: float


class PackingPaths(Paths):
    """The central paths of samples of a packing in which the same A contacts take part. A central path is the curve of
    spins and forces along which Newton steps lead from the spins that viscous friction would give to the minimum.

    numbers : numbers of the samples that are solved.
    strengths : friction and viscosity of the samples that have a path, by the number of the sample. Samples without
        friction have no path: one linear system solves them.
    samples : the state of each of these paths, in the order of `strengths`.
    ends : spins and forces at the minimum, by the number of the sample, once they are found.
    fastest : unit of the spins u on the paths, a power of two near the fastest imposed one, length/time; not set if
        nothing is driven.
    """

    def __init__(
        self,
        contacts: "OnSystem",
        resisting: Mapping[int, tuple[np.ndarray, ...]] | None = None,
        ends_at: float = LEAST_GAP,
    ) -> None:
        """Put each sample at the start of its path: at the spins that would balance if friction were viscous. If
        nothing is driven, all results are known: spins and forces 0.

        contacts : the contacts of the samples, A of which take part.
        resisting : coefficients of the law, arrays (A contacts,), by the number of each sample that is solved; None for
            all samples with their own coefficients.
        ends_at : relative gap at which the paths end. Contact states are settled only if it is LEAST_GAP.
        """
        self.contacts, system, self.ends_at = contacts, contacts.system, ends_at
        if resisting is None:
            resisting = {number: system.of_contacts(sample) for number, sample in enumerate(contacts.samples)}
        self.numbers, self.ends = list(resisting), dict[int, Found]()
        self.strengths: dict[int, Strengths] = {}
        if contacts.is_still:
            self.ends = {number: contacts.at_rest() for number in self.numbers}
        else:
            self.fastest = float(np.exp2(np.round(np.log2(np.abs(system.offset).max()))))  # dividing rounds nothing
            # friction and viscosity in units near 1; None for samples without friction, which get no path
            given = {number: self._strengths(of) for number, of in resisting.items()}
            self.strengths = {number: of for number, of in given.items() if of is not None}
        # `shared` is what all samples have in common: contacts, order of elimination, and Newton matrix
        if self.strengths:
            shared = surroundings_of(system)
            path = shared.system.in_units(self.fastest)
        else:  # no path, so that neither order nor matrix is used
            shared, path = Surroundings(system, np.zeros(0, dtype=int), None), system
        settles, spheres = path.sign is not None and self._states_are_asked, len(np.unique(system.sphere))
        super().__init__(replace(shared, system=path), spheres, is_small(path), settles)
        self.samples = [_begun(system, path, of, shared.matrix) for of in self.strengths.values()]

    @property
    def _states_are_asked(self) -> bool:
        """True if contact states are to be settled, at the ends of the paths; False if a bound on the power will do."""
        return self.ends_at <= LEAST_GAP

    def _strengths(self, coefficients: tuple[np.ndarray, ...]) -> "Strengths | None":
        """Return the friction limits and viscosities of one sample in units in which the largest is about 1; None if no
        contact has friction. The unit of force is a power of two near the largest force, that of speed is `fastest`.

        coefficients : coefficients of the law of the sample, a tuple of arrays (A contacts,).
        """
        law, none = self.contacts.scene.law, np.zeros(len(self.contacts.system.numbers))
        given = law.holding_force(coefficients), law.viscosity(coefficients)
        held, viscosity = (none if values is None else values for values in given)
        if not held.any():
            return None
        largest = max(held.max(), viscosity.max() * float(np.abs(self.contacts.system.offset).max()))
        force = float(np.exp2(np.round(np.log2(largest))))
        return Strengths(held / force, viscosity * self.fastest / force, force)

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next: after the next step, or for small samples, which are
        not read on their way, at the end.

        iteration : the one at which it is read now.
        """
        return iteration + (MOST_STEPS if self.small else 1)

    def advance(self, steps: int) -> None:
        """Take at most `steps` Newton steps along the path of each sample. A central path is the curve of spins and
        forces that leads to the minimum of its sample.

        Once every sample has reached the end of its path, or has made MOST_STEPS steps, the spins, forces and contact
        states at the minimum are computed for each sample, and stored in `ends`.
        """
        going = [sample for sample in self.samples if not sample.done]
        left = MOST_STEPS - max((sample.steps for sample in going), default=0)
        super().advance(min(steps, left))
        if all(sample.done or sample.steps >= MOST_STEPS for sample in self.samples):
            with one_thread():
                for number in self.numbers:
                    if number not in self.ends:
                        self.ends[number] = self._end(number)
            if self.shared.system.unknowns >= KEPT_UNKNOWNS:  # the proof needs as much memory as the large matrix
                self.shared = replace(self.shared, newton=None)

    def _path_of(self, number: int) -> Sample:
        """Return the state on its central path of a sample with friction; ValueError for one without, which has no
        path.

        number : number of the sample, 0 to R - 1.
        """
        return self.samples[list(self.strengths).index(number)]

    def _end(self, number: int) -> Found:
        """Return the spins and forces at the minimum of a sample: the end of its central path. For a sample without
        friction, which has no path, they are those at which its viscous forces balance.

        number : number of the sample.
        """
        if number not in self.strengths:
            return self.contacts.flowing(number)
        path, strengths = self._path_of(number), self.strengths[number]
        if not self._states_are_asked:
            with suppress(NotPositiveDefinite):
                path.iterate = balance(path.iterate, self.shared.springs)
            return self._on_path(path, strengths)
        return _ended(self.contacts.system, path, strengths, self.shared.matrix, self.fastest)

    def found(self) -> list[Found]:
        """Return spins and forces of each sample: at the end of its path, or where it is now."""
        return [self.ends.get(number) or self._reached_now(number) for number in self.numbers]

    def _reached_now(self, number: int) -> Found:
        """Return the spins and forces that a sample has now: those of its point on the central path, those of its
        minimum if the contact states are settled, or 0 if it has no path.

        number : number of the sample.
        """
        if number not in self.strengths:
            return self.contacts.at_rest()
        path = self._path_of(number)
        if path.resolved is not None:
            return self._end(number)
        return self._on_path(path, self.strengths[number])

    def _on_path(self, sample: Sample, strengths: Strengths) -> Found:
        """Return the spins and forces of the point of the central path that a sample has reached, in the units of the
        packing: 1/time and force.

        sample : the sample, with that point, its `iterate`, in units of its own.
        strengths : friction and viscosity of its contacts, with their unit of force.
        """
        point = sample.iterate
        spins, _, force = _in_units_of_packing(
            self.contacts.system, sample, strengths, self.fastest, (point.spins, None), point.whole_dual
        )
        asked = self._states_are_asked
        return Found(spins, force, "interior-point", steps=sample.steps, states_are_asked=asked)

    def progress(self) -> Progress:
        """Return the progress of all samples: their minima with proven bounds, once all are found; before that their
        points on the central paths, where nothing is proven.
        """
        if len(self.ends) == len(self.numbers):
            return self.contacts.at_the_end(self.found(), self.iteration)
        found = self.contacts.on_the_way(self.found(), self.iteration)
        gap = max((sample.gap for sample in self.samples), default=np.inf)
        return replace(found, gap_of_path=gap, falls_to=self.settles_at if self.settles else self.ends_at)


def _begun(system: ContactSystem, contacts: ContactSystem, strengths: Strengths, matrix: NewtonMatrix) -> Sample:
    """Return the start of the central path of one sample: its contacts with their friction, the spins that would
    balance if friction were viscous, and zero forces. The spins are 0 if the matrix of that balance is not positive
    definite.

    On the path friction and viscosity are divided once more, by a power of two near the mean of their sum. The result
    keeps it as `unit`; its forces are in units of `unit` * `strengths.force_unit`.

    system, contacts : the A contacts of the packing, and those of them that are on the path.
    strengths : friction and viscosity (A,) of the A contacts of the packing, scaled to about 1, and the unit of force.
    matrix : Newton matrix of the path.
    """
    own = np.searchsorted(system.numbers, contacts.numbers)
    mean = (strengths.friction + strengths.viscosity).mean()
    unit = float(np.exp2(np.round(np.log2(mean))))  # dividing by it rounds nothing
    # `own`: places of the path's contacts
    strength, viscous = strengths.friction[own] / unit, strengths.viscosity[own] / unit
    spins = np.zeros(contacts.unknowns)
    with suppress(NotPositiveDefinite):
        spins = flowing(contacts, strength + viscous, matrix, spins)
    # bound of the slip of a contact that has none at the start; contacts without friction are `smooth`
    slack = SLACK * float(length(contacts.differences(spins)).mean())
    start = Iterate.start(contacts, spins, strength, slack, viscous if strengths.viscosity.any() else None)
    return Sample(start if (strengths.friction > 0).all() else replace(start, smooth=strength == 0), unit)


def _ended(system: ContactSystem, path: Sample, strengths: Strengths, matrix: NewtonMatrix, fastest: float) -> Found:
    """Return the spins and forces at the end of a central path, in the units of the packing, with the contact states:
    those that the path has settled, or else those found by springs that slip at the friction limit (method of
    multipliers).

    system : the contacts of the packing.
    path : the sample at the end of its path. `path.resolved` is the minimum with settled contact states, None if the
        path ended without. In the first case the result marks contacts that slip at some minima only (`ties`), in the
        second those that stay undecided (`open`).
    strengths : friction and viscosity (A,) of the A contacts, scaled to about 1, and the unit of force.
    matrix : Newton matrix of the path.
    fastest : unit of the products of spin and radius on the path, length/time.
    """
    contacts, settled, ties, open_, rest = path.iterate.system, path.resolved, None, None, None
    if settled is None:
        with stage("settling contact states"):
            (spins, rest), dual, slipping, open_ = settled_by_springs(path.iterate, matrix)
    else:
        spins, rest, dual, slipping = settled.spins, settled.rest, settled.whole_dual, settled.slipping
        ties = settled.known_to_slip_sometimes | settled.at_limit
    # from the contacts of the path to all A, and from its units to those of the packing
    own = np.searchsorted(system.numbers, contacts.numbers)
    slips, opens, tie = (
        None if kind is None else _on_all_contacts(own, kind, len(strengths.friction))
        for kind in (slipping, open_, ties)
    )
    spins, rest, force = _in_units_of_packing(system, path, strengths, fastest, (spins, rest), dual)
    return Found(spins, force, "interior-point", slips, tie, path.steps, open=opens, rest=rest)


def _in_units_of_packing(
    system: ContactSystem, path: Sample, strengths: Strengths, fastest: float,
    spins: tuple[np.ndarray, np.ndarray | None], dual: np.ndarray,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:  # fmt: skip
    """Return spins and forces on a path in the units of the packing, without the signs by which neighbours differ on
    the path: u = radius * spin (unknowns,), length/time, as a sum of two doubles, the second of which may be None; and
    the forces (d tangents, A contacts of the packing).

    system : the contacts of the packing.
    path : the sample on its path, with the n contacts, their signs, and a unit of forces, in units of `force_unit`.
    strengths : the sample's friction and viscosity, of which the unit of force, `force_unit`, is used.
    fastest : unit of u on the path, length/time.
    spins : u on the path, two arrays (unknowns,) whose sum it is, or one and None.
    dual : (components, n), minus the forces on the n contacts of the path.
    """
    contacts = path.iterate.system
    sign = 1.0 if contacts.sign is None else contacts.sign[system.moved >= 0]
    high, low = spins
    force = along_tangents(system, contacts, -path.unit * dual) * strengths.force_unit
    return sign * high * fastest, None if low is None else sign * low * fastest, force


def along_tangents(system: ContactSystem, contacts: ContactSystem, forces: np.ndarray) -> np.ndarray:
    """Return contact forces along the tangents of the packing, (d tangents, A contacts), from those on the central path
    of the interior-point method.

    If no contact mixes spin components, the path is computed with signs that alternate between neighbours, and only on
    the n of the A contacts that some unknown spin makes slip. Its forces are then vectors along the axes; they are
    projected on the tangents here, and the other contacts have no force. Otherwise the forces are returned as they are.

    system : the A contacts of the packing that take part.
    contacts : the n contacts of the path.
    forces : (components, n), forces as the path has them.
    """
    if contacts is system or contacts.sign is None:
        return forces
    found: np.ndarray = np.einsum("tek,ek->te", system.across, contacts.on_contacts(forces)[system.contact])
    return found


def _on_all_contacts(own: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Return an array (A,) over all contacts of a packing with the values of the n contacts on its path. Contacts that
    no unknown spin makes slip are not on the path; they get False or 0.

    own : (n,), numbers of the n contacts among the A.
    values : (n,), their values.
    count : A.
    """
    whole = np.zeros(count, dtype=values.dtype)
    whole[own] = values
    return whole
