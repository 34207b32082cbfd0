"""The interior-point method for packings: the central path, and the settling of contact states at its end.

A contact along an axis couples only the two spin components across it. If the contacts that couple a component form no
odd loop, signs by which neighbours differ turn the sums u_i + u_j into differences, as on a lattice. Networks of such
contacts alone have their contact states settled in the same way as lattices.

Any other network is settled by the method of multipliers (Hestenes 1969; for friction Alart & Curnier 1991). Each
contact gets a stiff spring that slips where it would bear more than friction allows. The minimum with these springs is
found repeatedly, and each time a spring begins with the force that it bore at the last one. So a slipless contact
creeps less each time, and a contact at its friction limit slips along its force.

Letters: A contacts of the system of the packing; n contacts of the system on the path (those with a coupled component);
d tangents of a contact; the unknowns are components of u = R omega. The *dual* is minus the contact force.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taichi_bearings.conic.central_path import balance, flowing
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.descent import Descent, Sample
from taichi_bearings.conic.friction_stage import Friction, FrictionStage
from taichi_bearings.conic.iterate import LEAST_GAP, Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.shared import is_small, surroundings_of
from taichi_bearings.interrupts import look_up
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.solvers.found import Found
from taichi_bearings.stages import Step, stage

HOLDS = (1e6, 1e8, 1e10, 1e10)  # stiffnesses of the springs one after the other, in units of friction
SETTLED_FORCE = 1e-11  # largest change of a force, in units of the mean friction, at which the forces are settled
LEAST_SLIP = 1e-13  # slip, in units of the largest imposed one, that is more than rounding
WORSE = 10.0  # growth of the change of the forces by which springs are too stiff for double precision
WORSE_POWER = 1e-10  # relative growth of the power that settling may cause
SMALL_SPINS = 1e-8  # scale of the spins that are still to be found when the states are settled
MOST_STEPS, SLACK = 80, 0.3  # steps of the path; slack of the bounds over the slips at its start, in mean slips


def viscous_spins(system: ContactSystem, viscosity: np.ndarray) -> np.ndarray:
    """Return the spins (unknowns,) at which viscous forces are in balance.

    Each tangent of a contact is treated as a contact of its own, as viscosity does not couple them.

    system : the A contacts that take part.
    viscosity : (A,), of these contacts.
    """
    offset = system.offset.reshape(1, -1)
    rows = ContactSystem(system.unknowns, offset, np.ones(offset.shape, dtype=bool), None, system.operator)
    matrix = NewtonMatrix(rows, order_by_place(rows, system.place))
    return flowing(rows, np.tile(viscosity, len(system.offset)), matrix, np.zeros(system.unknowns))


@dataclass(frozen=True)
class Strengths:
    """Friction and viscosity of the A contacts of one sample, in units in which the largest of both is about 1.

    The unit of spins is such that the fastest imposed one is about 1.

    friction, viscosity : (A,), in units of force, and of force over spin.
    power_unit, force_unit : the units, energy/time and force.
    """

    friction: np.ndarray
    viscosity: np.ndarray
    power_unit: float = 1.0
    force_unit: float = 1.0


def followed(system: ContactSystem, fastest: float, samples: Sequence[Strengths]) -> list[Found]:
    """Return what the central path, and the settling of contact states at its end, find for each sample.

    Small samples are followed side by side; the bits of each do not depend on the others.

    system : the contacts that take part.
    fastest : unit of the spins, near the fastest imposed one, length/time.
    samples : friction and viscosity of each.
    """
    shared = surroundings_of(system)
    contacts = shared.system.in_units(fastest)
    settles, spheres = contacts.sign is not None, len(np.unique(system.sphere))
    ways = [_begun(system, contacts, of, shared.matrix) for of in samples]
    of_way = {id(way): strengths for way, strengths in zip(ways, samples, strict=True)}
    with stage("following the central path") as under_way:

        def tell(of: Sample, cost: float) -> None:
            """Report the progress of one sample to the user.

            of : the sample.
            cost : its power, in units of the path.
            """
            aim = descent.settles_at if settles else LEAST_GAP
            power = cost * of.unit * of_way[id(of)].power_unit
            under_way.tell(Step(of.steps, power, of.gap, aim))

        descent = Descent(replace(shared, system=contacts), spheres, is_small(contacts), settles, told=tell)
        descent.samples = ways
        for _ in range(MOST_STEPS):
            look_up()
            at_once = settles or descent.small
            descent.advance(MOST_STEPS if at_once else 1)
            if at_once or all(way.done for way in ways):
                break
    return [_ended(system, way, of, shared.matrix, fastest) for way, of in zip(ways, samples, strict=True)]


def _begun(system: ContactSystem, contacts: ContactSystem, of: Strengths, matrix: NewtonMatrix) -> Sample:
    """Return the start of the path of one sample: the spins that would balance if friction were viscous.

    system, contacts : the contacts of the packing, and those of the path.
    of : friction and viscosity.
    matrix : Newton matrix of the path.
    """
    own = np.searchsorted(system.numbers, contacts.numbers)
    unit = float(np.exp2(np.round(np.log2((of.friction + of.viscosity).mean()))))  # dividing by it rounds nothing
    strength, viscous = of.friction[own] / unit, of.viscosity[own] / unit
    spins = np.zeros(contacts.unknowns)
    with suppress(NotPositiveDefinite):
        spins = flowing(contacts, strength + viscous, matrix, spins)
    slack = SLACK * float(length(contacts.differences(spins)).mean())
    start = Iterate.start(contacts, spins, strength, slack, viscous if of.viscosity.any() else None)
    return Sample(start if (of.friction > 0).all() else replace(start, smooth=strength == 0), unit)


def _ended(system: ContactSystem, way: Sample, of: Strengths, matrix: NewtonMatrix, fastest: float) -> Found:
    """Return what a path has found: with the contact states that it has settled, or else settled by multipliers.

    system : the contacts of the packing.
    way : the sample at the end of the path.
    of : friction and viscosity.
    matrix : Newton matrix of the path.
    fastest : unit of the spins, length/time.
    """
    contacts, settled, ties, open_ = way.iterate.system, way.resolved, None, None
    if settled is None:
        with stage("settling contact states"):
            spins, dual, slipping, open_ = _settled(way.iterate, matrix)
    else:
        spins, dual, slipping = settled.spins, settled.whole_dual, settled.slipping
        ties = settled.ties | settled.at_limit
    rest = None if settled is None else settled.rest
    if contacts.sign is not None:
        sign = contacts.sign[system.moved >= 0]
        spins, rest = sign * spins, None if rest is None else sign * rest
    # from the contacts of the path to all A, and from its units to those of the packing
    own = np.searchsorted(system.numbers, contacts.numbers)
    slips, opens, tie = (
        None if kind is None else _everywhere(own, kind, len(of.friction)) for kind in (slipping, open_, ties)
    )
    force = along_tangents(system, contacts, -way.unit * dual) * of.force_unit
    rest = None if rest is None else rest * fastest
    return Found(spins * fastest, force, "interior-point", slips, tie, way.steps, open=opens, rest=rest)


@np.errstate(all="ignore")
def _settled(
    point: Iterate, matrix: NewtonMatrix
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Settle the contact states at the end of a path by the method of multipliers (see the module).

    Returns spins (unknowns,), minus the contact forces (d, n), and masks (n,) of the slipping contacts and of the open
    ones: those that slip by more than rounding, but bear less than the friction limit. The masks are None, and the
    spins those of the path, where nothing is settled.

    point : the end of the path, with n contacts of d tangents.
    matrix : Newton matrix of the path.
    """
    contacts, spins, held, whole = point.system, point.spins, -point.dual, point.whole_dual
    slipping: Any = None
    open_, last = slipping, np.inf
    firm, rest = np.where(point.friction > 0, point.friction, 1.0), np.zeros(contacts.unknowns)
    for hold in HOLDS:
        # the change of the spins is solved for, with slips in twice the precision, and springs that bear `held`
        here = contacts.with_offset(contacts.to_all_digits(spins))
        stage = FrictionStage(here, matrix, 1.0, SMALL_SPINS, 1.0)
        with one_thread():
            end = stage.solve(Friction(point.friction, hold * firm, 0.0, point.viscosity), rest, held, rest)
        if end is None:
            break
        change, slip = length(end.held - held).max(initial=0.0), length(here.differences(end.spins))
        spins, held, whole = spins + end.spins, end.held, -end.force
        creeps = np.where(end.slips, 0.0, slip) >= LEAST_SLIP
        if change < WORSE * last:
            slipping, open_, last = end.slips, creeps, change
        else:  # the springs are so stiff that rounding moves them: what changes its state now is open
            open_ = open_ | creeps | (end.slips != slipping)
        if change < SETTLED_FORCE and not open_.any():
            break
    powers = (_power(point, of) for of in (point.spins, spins))
    if next(powers) * (1 + WORSE_POWER) < next(powers):
        # with many minima of the same power, springs can lead away from all of them: the path itself is returned
        with suppress(NotPositiveDefinite):
            point = balance(point, matrix)
        return point.spins, point.whole_dual, None, None
    return spins, whole, slipping, open_


def _power(point: Iterate, spins: np.ndarray) -> float:
    """Return the power of spins, or with viscosity the potential, from slips in twice the precision.

    point : a point of the path, with friction and viscosity of its contacts.
    spins : (unknowns,).
    """
    slip = length(point.system.to_all_digits(spins))
    damped = 0.0 if point.viscosity is None else float((point.viscosity * slip**2).sum()) / 2
    return float((point.friction * slip).sum()) + damped


def along_tangents(system: ContactSystem, contacts: ContactSystem, forces: np.ndarray) -> np.ndarray:
    """Return contact forces along the tangents of the packing, (d tangents, A contacts), from those of the central
    path.

    On a path with signs of the spins its contacts have other components than along the tangents; otherwise the forces
    are returned as they are.

    system, contacts : the A contacts of the packing, and those of the path.
    forces : forces as the path has them, one row for each component.
    """
    if contacts is system or contacts.sign is None:
        return forces
    return np.einsum("tek,ek->te", system.across, contacts.on_contacts(forces)[system.contact])


def _everywhere(own: np.ndarray, of: np.ndarray, count: int) -> np.ndarray:
    """Return values (A,) of all contacts from those of some; False or 0 for contacts that couple no unknown.

    own : (n,), numbers of the n contacts among the A.
    of : (n,), their values.
    count : A.
    """
    whole = np.zeros(count, dtype=of.dtype)
    whole[own] = of
    return whole
