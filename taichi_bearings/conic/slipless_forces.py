"""Can contacts said to be slipless bear what the slipping ones leave to them? Their forces, or what moves instead.

Slipping contacts have the friction mu F_n along their slip, and so pass torques on. The slipless ones can balance these
with forces inside their friction discs unless some motion u of the spheres gains more from the torques than friction at
the slipless contacts takes from it (Farkas' lemma). So in the least of

    sum over slipless contacts of mu |difference of u| + torques . u + |u|^2 / 2

either nothing moves, and the dual of that problem are forces as wanted; or something does, all over the sample at once,
and the power falls along that motion: the contacts that slip in it were wrongly said not to. The interior-point method
of central_path.py finds the one or the other in some ten steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.central_path import balance, newton_step
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.grouped import Arrays, each, isotropic, one_by_one, side_by_side, where
from taichi_bearings.conic.iterate import Inertia, Iterate
from taichi_bearings.conic.newton_matrix import FORCE_REFINEMENTS, NewtonMatrix

MOST_MOTION_STEPS = 40
FIRST_SLACK = 1e-2  # of the bounds at the start, in units of the motion
# torques, of the mean friction, that may be taken away at once, and that may be left
REMOVABLE_TORQUE, LEFT_TORQUE = 1e-4, 1e-11
# least margin over the sum of all torques left, which no force has to change by more than to end them
MARGIN_PER_TORQUE = 10.0
# contacts outside their discs for whose sake others change their forces, so many contacts away
MOST_REPAIRED, REPAIR_DISTANCE = 100, 6
LIMITED_REFINEMENTS = 8  # of balanced forces where contacts are kept at their limit
# share of its friction by which a contact at its limit counts as having room where forces are balanced
ROOM_AT_LIMIT = 1e-5
# share of the friction by which rounding may take the force of such a contact beyond the limit
ROUNDED_AT_LIMIT = 1e-11
MOTION_RATIO = 1e6  # ratio of slip and margin of a contact that tells motion from rest
ROUNDED_PRODUCT = 1e-10  # mean product of the two from which rounding leaves torques
FINAL_PRODUCT = 1e-22  # mean product of the two at which nothing more can be told


@dataclass(frozen=True)
class Borne:
    """dual : of all contacts, (d, n) a group, balanced and inside the friction discs; None if there is none such.

    motion : (unknowns,), what moves instead. Where contacts are at the limit of their friction and yet need not slip,
    it is one that gains nothing. Neither, if the method fails.
    """

    dual: Arrays | None = None
    motion: np.ndarray | None = None


@np.errstate(all="ignore")  # where double precision ends, numbers that are not finite turn up
def bear(
    system: ContactSystem,
    order: np.ndarray,
    friction: Arrays,
    dual: Arrays,
    slipping: Arrays,
) -> Borne:
    """What slipless contacts do with what slipping ones, as their dual tells, leave to them.

    order : of elimination of the unknowns of `system`. friction (n,), dual (d, n), minus the forces, and slipping
    (n,), a group each; the dual of slipless contacts is not used.
    """
    number, kept = _held(system, slipping), each(np.flatnonzero, ~slipping)
    unknowns, pairs = int((number >= 0).sum()), zip(system.groups, kept, strict=True)
    groups = (g.renamed(keep, number, unknowns, np.zeros_like(g.offset[:, keep])) for g, keep in pairs)
    slipless = ContactSystem(unknowns, tuple(groups))
    matrix = NewtonMatrix(slipless, _free(number[order]))
    at_rest = np.zeros(slipless.unknowns)
    load = -system.torques(where(slipping, dual, 0.0))[number >= 0]
    point = replace(
        Iterate.start(slipless, at_rest, friction[kept], FIRST_SLACK), load=load, inertia=Inertia(1.0, at_rest)
    )
    for _ in range(MOST_MOTION_STEPS):
        point = newton_step(point, matrix)
        if point.complementarity < ROUNDED_PRODUCT and point.unbalanced > LEFT_TORQUE:
            point = balance(point, matrix)
        still = replace(point, inertia=None)
        if still.unbalanced < REMOVABLE_TORQUE:
            still = balance(still, matrix)
        if still.unbalanced < LEFT_TORQUE:
            whole = dual.placed(kept, still.dual)
            if _inside(friction, whole, slipping, system.torques(whole)[:, None])[0]:
                return Borne(dual=whole)
        if point.slip_over_margin.max() > MOTION_RATIO or point.complementarity < FINAL_PRODUCT:
            return Borne(motion=np.append(point.spins, 0.0)[number])
    return Borne()


@np.errstate(all="ignore")
def nearly_borne(
    system: ContactSystem,
    matrix: NewtonMatrix,
    friction: Arrays,
    dual: Arrays,
    slipping: Arrays,
    critical: Arrays,
    heads: Sequence[np.ndarray],
) -> tuple[Arrays, np.ndarray]:
    """The dual of all contacts, the more of a slipless one changed the more room it has, so that it is in balance; and
    the samples (samples,) in which that is enough, as it is most often near the end of the central path.

    system, matrix : of a sample. heads : of each sample, mask (unknowns,) of one spin of each domain that is tied to no
    driven plane. critical : masks (n,) a group, contacts that may bear all their friction. The others as for
    :func:`bear`, of all samples together, the dual of slipless contacts nearly in balance and inside their friction
    discs.
    """
    room = where(
        slipping, 0.0, each(np.maximum, friction - dual.length(), where(critical, ROOM_AT_LIMIT * friction, 0.0))
    )
    side, springs = side_by_side(dual, len(heads)), side_by_side(room**2, len(heads))
    at_limit = side_by_side(where(critical, friction, 0.0), len(heads)) if critical.any() else None
    still = np.stack(heads, axis=1).astype(float)  # a spring for each domain, that nothing stretches
    regular = matrix.factorise_each(isotropic(side, springs), inertia=still)
    for _ in range(FORCE_REFINEMENTS if at_limit is None else LIMITED_REFINEMENTS):  # as in NewtonMatrix.balanced
        if at_limit is not None:  # forces as large as that
            share = each(lambda y, limit: np.where(limit > 0, limit / np.sqrt((y**2).sum(axis=0)), 1.0), side, at_limit)
            side = side * share
        side = side - springs * system.change(matrix.solve(system.torques(side)))
    whole = one_by_one(side)
    within = _within(friction, whole, critical)
    inside = np.all([part.reshape(len(heads), -1).all(axis=1) for part in within], axis=0)
    return whole, regular & inside & _inside(friction, whole, slipping | critical, system.torques(side))


@np.errstate(all="ignore")
def borne_nearby(
    system: ContactSystem, order: np.ndarray, friction: Arrays, dual: Arrays, slipping: Arrays, critical: Arrays
) -> Borne:
    """As :func:`bear`, but only contacts near those that bear too much change their forces.

    dual : of all contacts, in balance, a few of the slipless ones outside their friction discs. That of slipping and of
    critical contacts, (n,) masks a group each, is kept: nothing is found where a critical one is beyond its limit.
    """
    at_limit = slipping | critical
    too_much = ~at_limit & ~(dual.length() < friction)
    if not 0 < too_much.sum() <= MOST_REPAIRED or not _within(friction, dual, critical).all():
        return Borne()
    nearby = system.around(too_much, REPAIR_DISTANCE, ~at_limit)
    found = bear(system, order, friction, dual, ~nearby)
    inside = found.dual is None or _inside(friction, found.dual, at_limit, system.torques(found.dual)[:, None])[0]
    return found if inside else Borne()


@np.errstate(all="ignore")
def _inside(friction: Arrays, dual: Arrays, slipping: Arrays, torques: np.ndarray) -> np.ndarray:
    """Is the dual of each sample, (samples,), in balance, and with room in all friction discs of slipless contacts for
    what is not? torques : (unknowns, samples), of the dual, also on spins that are held."""
    left = np.abs(torques).T.copy()
    total, samples = MARGIN_PER_TORQUE * left.sum(axis=1), len(left)
    surely = slipping | (friction - dual.length() > each(lambda mu: np.repeat(total, len(mu) // samples), friction))
    inside = [part.reshape(samples, -1).all(axis=1) for part in surely]
    return (left.max(axis=1, initial=0.0) < MARGIN_PER_TORQUE * LEFT_TORQUE) & np.all(inside, axis=0)


def _within(friction: Arrays, dual: Arrays, critical: Arrays) -> Arrays:
    """Masks (n,) a group, contacts that are not critical, or bear their friction and no more."""
    return ~critical | (dual.length() < (1 + ROUNDED_AT_LIMIT) * friction)


def _free(numbers: np.ndarray) -> np.ndarray:
    return numbers[numbers >= 0]


def _held(system: ContactSystem, slipping: Arrays) -> np.ndarray:
    """New number of every spin, (unknowns,); -1 for one spin of each domain that no contact ties to a driven plane.

    A domain can turn as a whole: slipless contacts do not notice, and what slipping ones pass on to it adds up to zero.
    """
    driven = np.zeros(system.unknowns, dtype=bool)
    for group, s in zip(system.groups, slipping, strict=True):
        below, above = group.below[:, ~s], group.above[:, ~s]
        driven[_free(np.where((below >= 0) & (above >= 0), -1, np.maximum(below, above)))] = True
    count, domain = system.pieces(~slipping)
    tied = np.zeros(count, dtype=bool)
    tied[domain[driven]] = True
    representative = np.unique(domain, return_index=True)[1]
    free = np.ones(system.unknowns, dtype=bool)
    free[representative[~tied]] = False
    return np.where(free, np.cumsum(free) - 1, -1)
