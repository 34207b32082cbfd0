"""Finds forces of the contacts that do not slip, within friction, that balance the friction of the slipping ones.

Slipping contacts have all their friction mu F_n along their slip, and so exert torques. Slipless contacts can balance
these with forces |f| <= mu F_n, unless in some motion of the spheres the torques do more work than friction at the
slipless contacts can take up (Farkas' lemma). Near the end of the central path its forces nearly balance. They are
changed by the forces of fictitious springs at the contacts, whose stiffness is the square of the *room* mu F_n - |f|,
until all torques balance. If a force would exceed its limit, then in samples that may have several minima the change
goes part of the way and is computed anew. If that fails, small samples try springs with the stiffness of a barrier at
the friction limits, with which a change goes further. Where no forces are found, the caller follows the path on.

Letters: n contacts with up to d slip components. "dual" is minus the force.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from taichi_bearings.conic.cones import determinant, inner, isotropic, length
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.newton_matrix import REFINEMENTS, NewtonMatrix, resisted
from taichi_bearings.numerics.cholesky import Engine
from taichi_bearings.numerics.graphs import pieces

LEFT_TORQUE = 1e-10  # torque over the mean friction that may be left: some 1e6 roundings of a force
# least room over the sum of all torques left; no force has to change by more than that sum to balance them
MARGIN_PER_TORQUE = 10.0
# For contacts at their limit, over the friction: least room by which the stiffness of their springs is computed; and
# the distance from the limit within which a force is set to the limit, at first and later.
ROOM_AT_LIMIT, NEAR_LIMIT, HELD_AT_LIMIT = 1e-5, 1e-5, 1e-9
NOISE_ACROSS = 5e-5  # component of a force at its limit, over the other, that may be noise: above HELD_AT_LIMIT ** 0.5
# Most balances, each a change of all forces to balance. If a force would exceed its limit, a balance goes SHARE_OF_WAY
# of the way to the first limit; below the share LEAST_REACH of the whole way the search ends (found by trial).
MOST_BALANCES, SHARE_OF_WAY, LEAST_REACH = 20, 0.9, 1e-2
MOST_CUTS = 60  # times that forces are reduced to their limits and balanced again, after the last balance
BALANCED_TORQUE = 1e-14  # torque over the mean friction at which that ends
MOST_INSIDE_STEPS = 20  # most steps of the search for balanced forces with a barrier; at 32^3 they take 3 to 5
# Share of the whole way of such a step below which a sample is given up: at 10^3 spheres 14 samples in which the search
# succeeded had no smaller share than 0.39, 6 others came below 0.15.
LEAST_REACH_INSIDE = 0.2
TINY = np.finfo(np.float64).tiny


@np.errstate(all="ignore")
def nearly_borne(
    system: ContactSystem,
    matrix: NewtonMatrix,
    friction: np.ndarray,
    dual: np.ndarray,
    slipping: np.ndarray,
    at_limit: np.ndarray,
    heads: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Return forces near the given ones that balance all torques. Forces of slipping contacts stay; those of slipless
    contacts change, and have to stay within friction.

    system : the contacts of one sample.
    matrix : matrix of springs at them (`Surroundings.springs`), which is factorised anew.
    friction : (samples * n,), friction limits, one sample after the other, as in the following arrays.
    dual : (d, samples * n), minus the forces; those of slipless contacts nearly balance the others.
    slipping : (samples * n,) mask of contacts that slip.
    at_limit : (samples * n,) mask of contacts that rest and yet may bear all their friction.
    heads : for each sample a mask (unknowns,) of one spin of each set of spins that slipless contacts join to each
        other, but to no driven plane. It is held by a further spring, so that the matrix is regular.
    returns : minus the forces (d, samples * n), in balance; mask (samples,) of the samples in which none of them
        exceeds friction.
    """
    samples, duals = len(heads), _samples_last(dual, len(heads))
    limit = _samples_last(np.where(at_limit, friction, np.inf), samples) if at_limit.any() else None
    duals = duals if limit is None else _without_noise(duals, limit)
    held_spins = np.stack(heads, axis=1).astype(float)  # springs at the heads; none is stretched
    found, going = np.zeros(samples, dtype=bool), np.ones(samples, dtype=bool)  # masks of samples
    with_limit = at_limit.reshape(samples, -1).any(axis=1)
    for _ in range(MOST_BALANCES):
        # Balance the torques by springs as stiff as the room squared.
        here = _samples_joined(duals)
        least = np.where(at_limit, ROOM_AT_LIMIT * friction, 0.0)
        room = np.where(slipping, 0.0, np.maximum(friction - length(here), least))
        springs = _samples_last(room**2, samples)
        going = going & matrix.factorise_springs(springs, held_spins)
        balanced = duals
        for _ in range(REFINEMENTS):  # as in NewtonMatrix.balanced
            balanced = _balanced(system, matrix, _cut(balanced, limit), springs, going)[0]
        # The share of that change at which a first limit is reached: above 1 forces are found, below LEAST_REACH none.
        reach = _reach(friction, here, _samples_joined(balanced), slipping | at_limit, samples)
        ended = going & (reach > 1)
        going = going & (reach > LEAST_REACH)
        if (going & ~ended).any():  # only part of the way: not worth it if the minimum is unique
            of_each = zip(np.split(friction, samples), np.split(at_limit, samples), strict=True)
            going = going & (ended | [may_have_several_minima(*of) for of in of_each])
        if limit is not None and (cut := ended & with_limit).any():
            balanced = _cut_and_balanced(system, matrix, balanced, springs, limit, cut)
        found |= ended
        # Forces change by all of that, or go most of the way to the first limit.
        share = np.where(going & (reach <= 1), SHARE_OF_WAY * reach, 1.0)
        duals, going = np.where(going, _towards(duals, balanced, share), duals), going & ~found
        if not going.any():
            break
    whole = _samples_joined(duals)
    return whole, found & _inside(friction, whole, slipping | at_limit, system.torques(duals))


@np.errstate(all="ignore")
def balanced_by_barrier(
    system: ContactSystem,
    matrix: NewtonMatrix,
    friction: np.ndarray,
    dual: np.ndarray,
    slipping: np.ndarray,
    heads: Sequence[np.ndarray],
    going: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return forces near the given ones that balance all torques. Forces of slipping contacts stay; those of slipless
    contacts change, and have to stay within friction; none may be at its limit.

    The stiffness of the spring at each contact is the inverse second derivative of the barrier -log(friction^2 -
    |force|^2). With it a step goes further than with the springs of :func:`nearly_borne`.

    system : the contacts of one sample.
    matrix : their Newton matrix, which is factorised anew.
    friction : (samples * n,), friction limits, one sample after the other, as in the following arrays.
    dual : (d, samples * n), minus the forces; those of slipless contacts are within friction and nearly balance the
        others.
    slipping : (samples * n,) mask of contacts that slip.
    heads : for each sample a mask (unknowns,) of spins that are held, as in :func:`nearly_borne`.
    going : (samples,) mask of the samples whose forces are sought.
    returns : minus the forces (d, samples * n); mask (samples,) of the samples in which all torques balance and none of
        the forces exceeds friction.
    """
    samples, duals = len(heads), _samples_last(dual, len(heads))
    limit, slips = (_samples_last(of, samples).ravel() for of in (friction, slipping))
    held_spins, found = np.stack(heads, axis=1).astype(float), np.zeros(samples, dtype=bool)
    for _ in range(MOST_INSIDE_STEPS):
        here = duals.reshape(len(duals), -1)
        stiffness = np.where(slips, 0.0, _stiffness_inside(limit, here))
        going = going & matrix.factorise_each(stiffness.reshape(*stiffness.shape[:2], -1, samples), going, held_spins)
        balanced = duals
        for _ in range(REFINEMENTS):  # as in NewtonMatrix.stretched
            change = system.change(matrix.solve(system.torques(balanced))).reshape(here.shape)
            balanced = balanced - resisted(stiffness, change).reshape(duals.shape)
        reach = _reach(friction, _samples_joined(duals), _samples_joined(balanced), slipping, samples)
        share = np.where(reach > 1, 1.0, SHARE_OF_WAY * reach)
        duals = np.where(going, _towards(duals, balanced, share), duals)
        found |= going & (reach > 1)
        going = going & (reach <= 1) & (reach > LEAST_REACH_INSIDE)
        if not going.any():
            break
    whole = _samples_joined(duals)
    return whole, found & _inside(friction, whole, slipping, system.torques(duals))


def _stiffness_inside(limit: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return the stiffness matrices (d, d, n) of springs at n contacts: inverse second derivatives of the barrier
    -log(limit^2 - |force|^2) with respect to the force.

    limit : (n,), friction limits.
    inside : (d, n), minus the forces, within friction, with up to d slip components.
    """
    room = determinant((limit, inside))
    along = room / (room + 2 * inner(inside, inside)) * inside
    found: np.ndarray = isotropic(inside, room / 2) - along[:, None] * inside[None, :]
    return found


@np.errstate(all="ignore")
def balanced_inside(
    system: ContactSystem,
    order: np.ndarray,
    friction: np.ndarray,
    dual: np.ndarray,
    slipping: np.ndarray,
    heads: np.ndarray,
) -> tuple[np.ndarray | None, np.ndarray]:
    """Return forces of one sample that balance all torques, if such are found. Forces of slipping contacts stay; those
    of slipless contacts change, and are within friction.

    Spheres that slipless contacts join form *clusters*. Each is balanced by itself, by springs as in
    :func:`balanced_by_barrier`: along a force close to its limit they are far softer than across it, so that steps go
    far. Their matrix falls apart into clusters. A factorisation takes a thousandth of the operations of a Newton step,
    0.06 instead of 108 billion at 48^3.

    system : the n contacts, whose slips are differences of two unknowns.
    order : (unknowns,), order in which the unknowns are eliminated.
    friction : (n,), friction limits.
    dual : (d, n), minus the forces to begin with; those of slipless contacts are within friction.
    slipping : (n,) mask of contacts that slip.
    heads : (unknowns,) mask of spins that are held, as in :func:`nearly_borne`.
    returns : minus the forces (d, n), None if none are found; and the multiple (n,) of the last step at which the force
        of each contact reaches its limit, infinite except in clusters in which no forces balance.

    Raises NotPositiveDefinite if the matrix is singular to working precision.
    """
    # The system of the slipless contacts, and the torques that their forces have to balance.
    own, fixed = np.flatnonzero(~slipping), system.torques(np.where(slipping, dual, 0.0))
    part, joined = _of_contacts(system, own)
    number = np.cumsum(joined) - 1
    matrix = NewtonMatrix(part, number[order[joined[order]]], engine=Engine.LAUNCH)  # many small fronts
    limit, inside, load, held = friction[own], dual[:, own], -fixed[joined], heads[joined].astype(float)
    cluster, factors, reach = _clusters(part), np.zeros(len(own)), np.ones(len(own))
    for _ in range(MOST_INSIDE_STEPS):
        # The whole step to balance, and the share `reach` of it that all contacts of a cluster allow.
        stiffness = _stiffness_inside(limit, inside)
        matrix.factorise(stiffness, held)
        balanced = matrix.stretched(inside, partial(resisted, stiffness), load)
        factors = _factors(limit, inside, balanced)
        of_clusters, last = np.full(len(factors), np.inf), reach
        np.minimum.at(of_clusters, cluster, factors)
        reach = of_clusters[cluster]
        # A cluster takes the whole step and is balanced, or most of the share. It stays if the share was tiny twice.
        goes_on = (reach <= 1) & (np.maximum(reach, last) > LEAST_REACH)
        inside = _towards(inside, balanced, np.where(reach > 1, 1.0, np.where(goes_on, SHARE_OF_WAY * reach, 0.0)))
        if not goes_on.any():
            break
    found, allowed = dual.copy(), np.full(len(friction), np.inf)
    found[:, own] = inside
    if _inside(friction, found, slipping, system.torques(found)[:, None])[0]:
        return found, allowed
    allowed[own] = np.where(reach <= 1, factors, np.inf)
    return None, allowed


def _of_contacts(system: ContactSystem, own: np.ndarray) -> tuple[ContactSystem, np.ndarray]:
    """Return the system of some contacts alone, over the unknowns that they join; and the mask (unknowns,) of these
    among all unknowns.

    system : contacts whose slips are differences of two unknowns.
    own : numbers of the contacts that are kept.
    """
    assert system.ends is not None
    ends, joined = system.ends[:, :, own], np.zeros(system.unknowns + 1, dtype=bool)
    joined[ends] = True
    joined[-1] = False  # -1 stands for an imposed spin
    number = np.where(joined, np.cumsum(joined) - 1, -1)
    part = ContactSystem(int(joined.sum()), system.offset[:, own], system.felt[:, own], number[ends])
    return part, joined[:-1]


def _clusters(system: ContactSystem) -> np.ndarray:
    """Return for each contact the number (n,) of its cluster: no contact joins unknowns of two clusters.

    system : n contacts, each with an unknown, whose slips are differences of two unknowns.
    """
    assert system.ends is not None
    ends = system.ends.reshape(-1, system.ends.shape[-1])
    first = ends[np.argmax(ends >= 0, axis=0), np.arange(ends.shape[1])]
    end, contact = np.nonzero(ends >= 0)
    found: np.ndarray = pieces(system.unknowns, ends[end, contact], first[contact])[first]
    return found


def may_have_several_minima(friction: np.ndarray, at_limit: np.ndarray) -> bool:
    """Return True if there may be several minima: if contacts rest at their limit, or if frictions repeat, so that
    fewer than half of them are different and sums of them can be equal.

    friction : (n,), largest friction force of each contact.
    at_limit : (n,) mask of contacts that rest and may bear all their friction.
    """
    different = 1 + np.count_nonzero(np.diff(np.sort(friction)))
    return bool(at_limit.any()) or different < len(friction) / 2


def _towards(here: np.ndarray, there: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return here + share * (there - here), an array (..., k) for k samples, or contacts; exactly `there` where the
    share is 1.

    here, there : (..., k), the begin and the end of the way.
    share : (k,), share of the way to go.
    """
    return np.where(share == 1, there, here + share * (there - here))


def _without_noise(dual: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return minus the forces (d, n, samples), without noise at contacts that bear all their friction. If such a force
    is nearly along one component, the other component is set to 0. (That component falls only like the root of the
    friction that is left, so it is still large when the force is practically at its limit.) Then the force is set to
    the limit.

    dual : (d, n, samples), minus the forces.
    limit : (n, samples), friction of the contacts that may rest at their limit, infinite for others.
    """
    along = np.abs(dual) > NOISE_ACROSS * np.abs(dual).max(axis=0)
    near = _at_limit(dual, limit, NEAR_LIMIT)
    return _cut(np.where(along | ~near, dual, 0.0), limit, NEAR_LIMIT)


def _at_limit(dual: np.ndarray, limit: np.ndarray, tolerance: float) -> np.ndarray:
    """Return a mask (n, samples) of the contacts whose force is above (1 - tolerance) times its limit.

    dual : (d, n, samples), minus the forces, with up to d slip components.
    limit : (n, samples), friction of the n contacts that may rest at their limit, infinite for others.
    tolerance : a number far below 1.
    """
    found: np.ndarray = np.sqrt((dual**2).sum(axis=0)) > (1 - tolerance) * limit
    return found


def _balanced(
    system: ContactSystem, matrix: NewtonMatrix, duals: np.ndarray, springs: np.ndarray, going: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return minus the forces, (d, n, samples), with forces of fictitious springs at the contacts added that balance
    all torques; and the largest torque (samples,) before that.

    system : the contacts of one sample.
    matrix : their Newton matrix with the stiffnesses of the springs, factorised.
    duals : minus the forces before, (d, n, samples).
    springs : (n, samples), stiffnesses of the springs.
    going : (samples,) mask of samples to change.
    """
    torques = system.torques(duals)
    nearer = duals - springs * system.change(matrix.solve(torques))
    return np.where(going, nearer, duals), np.abs(torques).max(axis=0, initial=0.0)


def _cut_and_balanced(
    system: ContactSystem,
    matrix: NewtonMatrix,
    duals: np.ndarray,
    springs: np.ndarray,
    limit: np.ndarray,
    going: np.ndarray,
) -> np.ndarray:
    """Return minus the forces (d, n, samples), none beyond its limit. Forces are alternately reduced to their limits
    and balanced by fictitious springs at the contacts, as long as that reduces the torques.

    system : the contacts of one sample.
    matrix : their Newton matrix with the stiffnesses of the springs, factorised.
    duals : minus the forces (d, n, samples), with up to d slip components.
    springs : (n, samples), stiffnesses of the springs.
    limit : (n, samples), friction of the n contacts that may rest at their limit, infinite for others.
    going : (samples,) mask of samples to change.
    """
    last = np.full(len(going), np.inf)
    for _ in range(MOST_CUTS):
        cut = _cut(duals, limit)
        nearer, left = _balanced(system, matrix, cut, springs, going)
        going = going & (left < last) & (left > BALANCED_TORQUE)
        if not going.any():
            break
        duals, last = np.where(going, nearer, duals), left
    return _cut(duals, limit)


def _cut(dual: np.ndarray, limit: np.ndarray | None, tolerance: float = HELD_AT_LIMIT) -> np.ndarray:
    """Return minus the forces, (d, n, samples), after all that are above (1 - tolerance) times their limit are set to
    the limit; their directions stay.

    dual : (d, n, samples), minus the forces on n contacts with up to d slip components.
    limit : (n, samples), friction of the contacts that may rest at their limit, infinite for others; None if no contact
        may, then nothing changes.
    tolerance : a number far below 1.
    """
    if limit is None:
        return dual
    size = np.maximum(np.sqrt((dual**2).sum(axis=0)), TINY)
    return np.where(_at_limit(dual, limit, tolerance), dual * (limit / size), dual)


def _reach(friction: np.ndarray, here: np.ndarray, there: np.ndarray, free: np.ndarray, samples: int) -> np.ndarray:
    """Return for each sample the largest factor (samples,) such that here + factor * (there - here) exceeds the
    friction limit of no contact.

    friction : (samples * n,), friction limits, sample after sample.
    here, there : (d, samples * n), minus the forces at both ends of the way.
    free : (samples * n,) mask of contacts whose limit does not matter.
    samples : number of samples.
    """
    found = np.where(free, np.inf, _factors(friction, here, there))
    result: np.ndarray = found.reshape(samples, -1).min(axis=1, initial=np.inf)
    return result


def _factors(friction: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return for each contact the factor (n,) at which here + factor * (there - here) reaches its friction limit.

    friction : (n,), friction limits.
    here, there : (d, n), minus the forces at both ends of the way, with up to d components.
    """
    # the positive root x of square * x^2 + 2 slope * x = room, where room = friction^2 - |here|^2
    change = there - here
    square, slope, room = inner(change, change), inner(here, change), determinant((friction, here))
    found: np.ndarray = room / np.maximum(slope + np.sqrt(np.maximum(slope**2 + square * room, 0.0)), TINY)
    return found


def _inside(friction: np.ndarray, dual: np.ndarray, slipping: np.ndarray, torques: np.ndarray) -> np.ndarray:
    """Return a mask (samples,), True where forces within friction surely exist near the given ones that balance
    exactly: the torques that are left are small, and at all slipless contacts friction exceeds the force by more than
    MARGIN_PER_TORQUE times the sum of all torques.

    friction : (samples * n,), friction limit of each of n contacts, sample after sample.
    dual : (d, samples * n), minus the forces, with up to d components.
    slipping : (samples * n,) mask of contacts that do not count: those that slip or may be at their limit.
    torques : (unknowns, samples), torques that the forces leave.
    """
    left = np.abs(torques).T.copy()
    total, samples = MARGIN_PER_TORQUE * left.sum(axis=1), len(left)
    margin = (friction - length(dual)).reshape(samples, -1)
    surely = slipping.reshape(samples, -1) | (margin > total[:, None])
    found: np.ndarray = (left.max(axis=1, initial=0.0) < LEFT_TORQUE) & surely.all(axis=1)
    return found


def _samples_last(values: np.ndarray, samples: int) -> np.ndarray:
    """Return values (..., samples * n) of n contacts, sample after sample, as an array (..., n, samples)."""
    return np.ascontiguousarray(np.swapaxes(values.reshape(*values.shape[:-1], samples, -1), -2, -1))


def _samples_joined(values: np.ndarray) -> np.ndarray:
    """Return values (..., n, samples) of n contacts as an array (..., samples * n), sample after sample: the inverse of
    :func:`_samples_last`."""
    return np.swapaxes(values, -2, -1).reshape(*values.shape[:-2], -1)
