"""Can contacts said to be slipless bear what the slipping ones leave to them? Their forces, or what moves instead.

Slipping contacts have the friction mu F_n along their slip, and so pass torques on. The slipless ones can balance these
with forces inside their friction discs unless some motion u of the spheres gains more from the torques than friction at
the slipless contacts takes from it (Farkas' lemma). So in the least of

    sum over slipless contacts of mu |difference of u| + torques . u + |u|^2 / 2

either nothing moves, and the dual of that problem are forces as wanted; or something does, all over the sample at once,
and the power falls along that motion: the contacts that slip in it were wrongly said not to. The interior-point method
of central_path.py finds the one or the other in some ten steps.
"""

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.conic.central_path import Inertia, Iterate, balance, newton_step
from taichi_bearings.conic.cone import length, slip_over_margin
from taichi_bearings.conic.contact_system import ContactGroup, ContactSystem, placed
from taichi_bearings.conic.motion import Motion
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import Part

STEPS = 40
SLACK = 1e-2  # of the bounds at the start, in units of the motion
NEARLY, BALANCED = 1e-4, 1e-11  # torques, of the mean friction, that may be taken away at once, and that may be left
SURELY = 10.0  # least margin over the sum of all torques left, which no force has to change by more than to end them
CLEAR = 1e6  # ratio of slip and margin of a contact that tells motion from rest
STIFF = 1e-10  # mean product of the two from which rounding leaves torques
CLOSE = 1e-22  # mean product of the two at which nothing more can be told


@np.errstate(all="ignore")  # where double precision ends, numbers that are not finite turn up
def bear(
    system: ContactSystem,
    parts: list[Part],
    friction: list[np.ndarray],
    dual: list[np.ndarray],
    slipping: list[np.ndarray],
) -> list[np.ndarray] | Motion | None:
    """The dual of all contacts, balanced and inside the friction discs; or a motion, if there is none. Where contacts
    are at the limit of their friction and yet need not slip, it is one that gains nothing. None if the method fails.

    parts : elimination tree over the unknowns of `system`. friction (n,), dual (d, n), minus the forces, and slipping
    (n,), a group each; the dual of slipless contacts is not used.
    """
    number = _held(system, slipping)
    kept = [np.flatnonzero(~s) for s in slipping]
    slipless = _slipless(system, kept, number)
    matrix = NewtonMatrix(slipless, [Part(_free(number[part.unknowns]), part.children) for part in parts])
    at_rest = np.zeros(slipless.unknowns)
    point = Iterate.start(slipless, at_rest, [mu[keep] for mu, keep in zip(friction, kept, strict=True)], SLACK)
    point.load = -system.torques([np.where(s, y, 0.0) for y, s in zip(dual, slipping, strict=True)])[number >= 0]
    point.inertia = Inertia(1.0, at_rest)
    for _ in range(STEPS):
        newton_step(point, matrix)
        if point.complementarity < STIFF and _unbalanced(point) > BALANCED:
            balance(point, matrix)
        still = replace(point.copy(), inertia=None)
        if _unbalanced(still) < NEARLY:
            balance(still, matrix)
        if _unbalanced(still) < BALANCED:
            whole = [placed(y, keep, new) for y, keep, new in zip(dual, kept, still.dual, strict=True)]
            margins = [(mu - length(y))[~s] for mu, y, s in zip(friction, whole, slipping, strict=True)]
            left = np.abs(system.torques(whole))  # also on the spins held
            least = SURELY * float(left.sum())
            if left.max(initial=0.0) < SURELY * BALANCED and min(float(m.min(initial=np.inf)) for m in margins) > least:
                return whole
        ratios = [
            slip_over_margin(mu, z, y) for mu, z, y in zip(point.friction, point.difference, point.dual, strict=True)
        ]
        if max(float(r.max(initial=0.0)) for r in ratios) > CLEAR or point.complementarity < CLOSE:
            moving = [placed(np.zeros_like(s), keep, r > 1) for s, keep, r in zip(slipping, kept, ratios, strict=True)]
            return Motion(np.append(point.spins, 0.0)[number], moving)
    return None


def _unbalanced(point: Iterate) -> float:
    return float(np.abs(point.imbalance(point.spins, point.dual)).max(initial=0.0))


def _free(numbers: np.ndarray) -> np.ndarray:
    return numbers[numbers >= 0]


def _held(system: ContactSystem, slipping: list[np.ndarray]) -> np.ndarray:
    """New number of every spin, (unknowns,); -1 for one spin of each domain that no contact ties to a driven plane.

    A domain can turn as a whole: slipless contacts do not notice, and what slipping ones pass on to it adds up to zero.
    """
    first, second, driven = [], [], np.zeros(system.unknowns, dtype=bool)
    for group, s in zip(system.groups, slipping, strict=True):
        below, above = group.below[:, ~s].ravel(), group.above[:, ~s].ravel()
        both = (below >= 0) & (above >= 0)
        first.append(below[both])
        second.append(above[both])
        ends = np.where(both, -1, np.maximum(below, above))
        driven[_free(ends)] = True
    a, b = np.concatenate(first), np.concatenate(second)
    graph = sparse.coo_matrix((np.ones(len(a), dtype=np.int8), (a, b)), shape=(system.unknowns,) * 2)
    count, domain = connected_components(graph, directed=False)
    tied = np.zeros(count, dtype=bool)
    tied[domain[driven]] = True
    representative = np.unique(domain, return_index=True)[1]
    free = np.ones(system.unknowns, dtype=bool)
    free[representative[~tied]] = False
    return np.where(free, np.cumsum(free) - 1, -1)


def _slipless(system: ContactSystem, kept: list[np.ndarray], number: np.ndarray) -> ContactSystem:
    """The contacts `kept`, at rest, over the spins that have a number."""
    unknowns, renamed = int((number >= 0).sum()), np.append(number, -1)
    groups = [
        ContactGroup(
            group.axis,
            group.acting[keep],
            renamed[group.below[:, keep]],
            renamed[group.above[:, keep]],
            np.zeros_like(group.offset[:, keep]),
            unknowns,
        )
        for group, keep in zip(system.groups, kept, strict=True)
    ]
    return ContactSystem(unknowns, tuple(groups))
