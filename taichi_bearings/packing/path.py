"""Packings on the central path of lattices, to where their contacts are settled.

A contact along an axis feels the two other components alone. Where they have no odd loop, signs by which neighbours
differ, those of each component its own, make of their sums the differences of a lattice: its settling of contact states
and its ties serve any such network.

Any other one is settled by multipliers (Hestenes 1969; for friction Alart & Curnier 1991): each contact has a stiff
spring that slips where it would bear more than friction does, and begins with the force that the last minimum left in
it. A contact that rests slips the less each time; those beyond their friction slip along it.
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
from taichi_bearings.packing.found import Found
from taichi_bearings.stages import Step, stage

HOLDS = (1e6, 1e8, 1e10, 1e10)  # stiffnesses of the springs, over friction
SETTLED_FORCE = 1e-11  # change of a force, of the mean friction, at which they are settled
LEAST_SLIP = 1e-13  # of the largest imposed one, that is none of rounding
WORSE = 10.0  # times the last change of the forces, by which springs are too stiff
WORSE_POWER = 1e-10  # of what the path has reached, that settling may cost
SMALL_SPINS = 1e-8  # of what is left to settle
MOST_STEPS, SLACK = 80, 0.3  # of the path; of the bounds at its start, in mean slips


def viscous_spins(system: ContactSystem, viscosity: np.ndarray) -> np.ndarray:
    """Spins (unknowns,) at which viscous forces are in balance: both tangents of a contact are contacts of their own,
    as nothing couples them. viscosity : (A,)."""
    offset = system.offset.reshape(1, -1)
    rows = ContactSystem(system.unknowns, offset, np.ones(offset.shape, dtype=bool), None, system.operator)
    matrix = NewtonMatrix(rows, order_by_place(rows, system.place))
    return flowing(rows, np.tile(viscosity, len(system.offset)), matrix, np.zeros(system.unknowns))


@dataclass(frozen=True)
class Strengths:
    """What the contacts of one sample resist with. friction, viscosity : (A,), in units in which the fastest imposed
    spin and the largest of both are about 1. power_unit, force_unit : of these, energy/time and force."""

    friction: np.ndarray
    viscosity: np.ndarray
    power_unit: float = 1.0
    force_unit: float = 1.0


def followed(system: ContactSystem, fastest: float, samples: Sequence[Strengths]) -> list[Found]:
    """Where the central path and the settling of states lead, of each sample.

    Small samples are followed side by side; what becomes of one, bit by bit, does not depend on the others.

    fastest : unit of the spins, near the fastest imposed one.
    """
    shared = surroundings_of(system)
    contacts = shared.system.in_units(fastest)
    settles, spheres = contacts.sign is not None, len(np.unique(system.sphere))
    ways = [_begun(system, contacts, of, shared.matrix) for of in samples]
    of_way = {id(way): strengths for way, strengths in zip(ways, samples, strict=True)}
    with stage("following the central path") as under_way:

        def told(of: Sample, cost: float) -> None:
            aim = descent.settles_at if settles else LEAST_GAP
            power = cost * of.unit * of_way[id(of)].power_unit
            under_way.tell(Step(of.steps, power, of.gap, aim))

        descent = Descent(replace(shared, system=contacts), spheres, is_small(contacts), settles, told=told)
        descent.samples = ways
        for _ in range(MOST_STEPS):
            look_up()
            at_once = settles or descent.small
            descent.advance(MOST_STEPS if at_once else 1)
            if at_once or all(way.done for way in ways):
                break
    return [_ended(system, way, of, shared.matrix, fastest) for way, of in zip(ways, samples, strict=True)]


def _begun(system: ContactSystem, contacts: ContactSystem, of: Strengths, matrix: NewtonMatrix) -> Sample:
    """The start of the path of one sample: spins at which viscous forces alone would be in balance."""
    own = np.searchsorted(system.numbers, contacts.numbers)
    unit = float(np.exp2(np.round(np.log2((of.friction + of.viscosity).mean()))))  # as of lattices
    strength, viscous = of.friction[own] / unit, of.viscosity[own] / unit
    spins = np.zeros(contacts.unknowns)
    with suppress(NotPositiveDefinite):
        spins = flowing(contacts, strength + viscous, matrix, spins)
    slack = SLACK * float(length(contacts.differences(spins)).mean())
    start = Iterate.start(contacts, spins, strength, slack, viscous if of.viscosity.any() else None)
    return Sample(start if (of.friction > 0).all() else replace(start, smooth=strength == 0), unit)


def _ended(system: ContactSystem, way: Sample, of: Strengths, matrix: NewtonMatrix, fastest: float) -> Found:
    """What the end of a path amounts to: its states as they are settled, or else by multipliers."""
    contacts, settled, ties, open_ = way.iterate.system, way.resolved, None, None
    if settled is None:
        with stage("settling contact states"):
            spins, dual, slipping, open_ = _settled(way.iterate, matrix)
    else:
        spins, dual, slipping = settled.spins, settled.whole_dual, settled.slipping
        ties = settled.ties | settled.at_limit
    rest = None if settled is None else settled.rest
    if contacts.sign is not None:
        turned = contacts.sign[system.moved >= 0]
        spins, rest = turned * spins, None if rest is None else turned * rest
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
    """Spins, minus the forces, and, (n,) masks, which contacts slip and which are open, as of Found; None where nothing
    is settled."""
    contacts, spins, held, whole = point.system, point.spins, -point.dual, point.whole_dual
    slipping: Any = None
    open_, last = slipping, np.inf
    firm, rest = np.where(point.friction > 0, point.friction, 1.0), np.zeros(contacts.unknowns)
    for hold in HOLDS:
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
        else:  # rounding moves such stiff springs: of what they change nothing is known
            open_ = open_ | creeps | (end.slips != slipping)
        if change < SETTLED_FORCE and not open_.any():
            break
    powers = (_power(point, of) for of in (point.spins, spins))
    if next(powers) * (1 + WORSE_POWER) < next(powers):  # where many minima tie, springs can lead away from all of them
        with suppress(NotPositiveDefinite):
            point = balance(point, matrix)
        return point.spins, point.whole_dual, None, None
    return spins, whole, slipping, open_


def _power(point: Iterate, spins: np.ndarray) -> float:
    """What spins (unknowns,) dissipate, or with viscosity the potential, to all digits of their slips."""
    slip = length(point.system.to_all_digits(spins))
    damped = 0.0 if point.viscosity is None else float((point.viscosity * slip**2).sum()) / 2
    return float((point.friction * slip).sum()) + damped


def along_tangents(system: ContactSystem, contacts: ContactSystem, forces: np.ndarray) -> np.ndarray:
    """Forces (d, A) along the tangents of a system from those in the rows of its `contacts`."""
    if contacts is system or contacts.sign is None:
        return forces
    return np.einsum("tek,ek->te", system.across, contacts.on_contacts(forces)[system.contact])


def _everywhere(own: np.ndarray, of: np.ndarray, count: int) -> np.ndarray:
    """(A,) from what is known of the contacts `own`, (n,); False for contacts that feel no component which moves."""
    whole = np.zeros(count, dtype=of.dtype)
    whole[own] = of
    return whole
