"""Can contacts said to be slipless bear what the slipping ones leave to them?

Slipping contacts have the friction mu F_n along their slip, and so pass torques on. The slipless ones can balance these
with forces inside their friction discs unless some motion of the spheres gains more from the torques than friction at
the slipless contacts takes from it (Farkas' lemma). Near the end of the central path its forces are nearly such ones,
and a little of the room that each contact has puts them in balance. Where that does not do, the path is followed on.
"""

from collections.abc import Sequence

import numpy as np

from taichi_bearings.conic.cones import determinant, inner, isotropic, length
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.newton_matrix import REFINEMENTS, NewtonMatrix

LEFT_TORQUE = 1e-10  # torque, of the mean friction, that may be left
# least margin over the sum of all torques left, which no force has to change by more than to end them
MARGIN_PER_TORQUE = 10.0
# share of its friction by which a contact at its limit counts as having room where forces are balanced, and by which it
# can be below the limit and is still held there
ROOM_AT_LIMIT, HELD_AT_LIMIT = 1e-5, 1e-9
NOISE_ACROSS = 5e-5  # part of a force at its limit, of the other one, that can be noise: the root of HELD_AT_LIMIT
# balances of forces; how far towards the first limit all but the last go; share of the way that is too short to go on
MOST_BALANCES, SHARE_OF_WAY, LEAST_REACH = 20, 0.9, 1e-2
MOST_CUTS = 60  # at the limits, after the last one
BALANCED_TORQUE = 1e-14  # torque, of the mean friction, that needs no further cut
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
    """The dual of all contacts, the more of a slipless one changed the more room it has, so that it is in balance; and
    the samples (samples,) in which that is found, as it is most often near the end of the central path. Where minima
    may tie, a change that would take a contact beyond its limit goes a part of the way, and on from there with the room
    that is left.

    system, matrix : of a sample. heads : of each sample, mask (unknowns,) of one spin of each domain that is tied to no
    driven plane. Of all samples, one after the other: friction (n,), dual (d, n), minus the forces, of slipless
    contacts nearly in balance and inside their friction discs, and masks (n,), those that slip and those that may rest
    at their limit, bearing all their friction.
    """
    samples, side = len(heads), _side_by_side(dual, len(heads))
    limit = _side_by_side(np.where(at_limit, friction, np.inf), samples) if at_limit.any() else None
    side = side if limit is None else _without_noise(side, limit)
    still = np.stack(heads, axis=1).astype(float)  # a spring for each domain, that nothing stretches
    found, going = np.zeros(samples, dtype=bool), np.ones(samples, dtype=bool)
    held = at_limit.reshape(samples, -1).any(axis=1)
    for _ in range(MOST_BALANCES):
        here = _one_by_one(side)
        least = np.where(at_limit, ROOM_AT_LIMIT * friction, 0.0)
        room = np.where(slipping, 0.0, np.maximum(friction - length(here), least))
        springs = _side_by_side(room**2, samples)
        going = going & matrix.factorise_each(isotropic(side, springs), inertia=still)
        balanced = side
        for _ in range(REFINEMENTS):  # as in NewtonMatrix.balanced
            balanced = _balanced(system, matrix, _cut(balanced, limit), springs, going)[0]
        reach = _reach(friction, here, _one_by_one(balanced), slipping | at_limit, samples)
        ended = going & (reach > 1)
        going = going & (reach > LEAST_REACH)
        if (going & ~ended).any():
            of_each = zip(np.split(friction, samples), np.split(at_limit, samples), strict=True)
            going = going & (ended | [may_tie(*of) for of in of_each])
        if limit is not None and (cut := ended & held).any():
            balanced = _cut_and_balanced(system, matrix, balanced, springs, limit, cut)
        found |= ended
        share = np.where(going & (reach <= 1), SHARE_OF_WAY * reach, 1.0)
        side, going = np.where(going, _towards(side, balanced, share), side), going & ~found
        if not going.any():
            break
    whole = _one_by_one(side)
    return whole, found & _inside(friction, whole, slipping | at_limit, system.torques(side))


def may_tie(friction: np.ndarray, at_limit: np.ndarray) -> bool:
    """True where contacts rest at their limit, or most share their friction: sums of these can be equal by chance."""
    return bool(at_limit.any()) or len(np.unique(friction)) < len(friction) / 2


def _towards(here: np.ndarray, there: np.ndarray, share: np.ndarray) -> np.ndarray:
    """A share (samples,) of the way, to the last bit where that is 1."""
    return np.where(share == 1, there, here + share * (there - here))


def _without_noise(dual: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """The dual (d, n, samples) of contacts at their limit along one component alone where that is nearly so: what is
    left across it falls like a root of what is left of the margin."""
    along = np.abs(dual) > NOISE_ACROSS * np.abs(dual).max(axis=0)
    return np.where(along | ~_at_limit(dual, limit), dual, 0.0)


def _at_limit(dual: np.ndarray, limit: np.ndarray) -> np.ndarray:
    return np.sqrt((dual**2).sum(axis=0)) > (1 - HELD_AT_LIMIT) * limit


def _balanced(
    system: ContactSystem, matrix: NewtonMatrix, side: np.ndarray, springs: np.ndarray, going: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The dual (d, n, samples) with its torques taken away by the springs in samples that are `going`; and the
    largest torque before, (samples,)."""
    torques = system.torques(side)
    nearer = side - springs * system.change(matrix.solve(torques))
    return np.where(going, nearer, side), np.abs(torques).max(axis=0, initial=0.0)


def _cut_and_balanced(
    system: ContactSystem,
    matrix: NewtonMatrix,
    side: np.ndarray,
    springs: np.ndarray,
    limit: np.ndarray,
    going: np.ndarray,
) -> np.ndarray:
    """The same with no force beyond its limit, (n, samples), as long as cuts and balances in turn help."""
    last = np.full(len(going), np.inf)
    for _ in range(MOST_CUTS):
        cut = _cut(side, limit)
        nearer, left = _balanced(system, matrix, cut, springs, going)
        going = going & (left < last) & (left > BALANCED_TORQUE)
        if not going.any():
            break
        side, last = np.where(going, nearer, side), left
    return _cut(side, limit)


def _cut(dual: np.ndarray, limit: np.ndarray | None) -> np.ndarray:
    """The dual (d, n, samples), with forces beyond the limit (n, samples), or next to it, just as large; None where no
    contact rests at its limit."""
    if limit is None:
        return dual
    size = np.maximum(np.sqrt((dual**2).sum(axis=0)), TINY)
    return np.where(_at_limit(dual, limit), dual * (limit / size), dual)


def _reach(friction: np.ndarray, here: np.ndarray, there: np.ndarray, free: np.ndarray, samples: int) -> np.ndarray:
    """How far, (samples,), of the way the dual (d, n) may go until a contact that is not `free` comes to its limit."""
    change = there - here
    square, slope, room = inner(change, change), inner(here, change), determinant((friction, here))
    found = room / np.maximum(slope + np.sqrt(np.maximum(slope**2 + square * room, 0.0)), TINY)
    return np.where(free, np.inf, found).reshape(samples, -1).min(axis=1, initial=np.inf)


def _inside(friction: np.ndarray, dual: np.ndarray, slipping: np.ndarray, torques: np.ndarray) -> np.ndarray:
    """Is the dual of each sample, (samples,), in balance, and with room in all friction discs of slipless contacts for
    what is not? torques : (unknowns, samples), of the dual, also on spins that are held."""
    left = np.abs(torques).T.copy()
    total, samples = MARGIN_PER_TORQUE * left.sum(axis=1), len(left)
    margin = (friction - length(dual)).reshape(samples, -1)
    surely = slipping.reshape(samples, -1) | (margin > total[:, None])
    return (left.max(axis=1, initial=0.0) < LEFT_TORQUE) & surely.all(axis=1)


def _side_by_side(values: np.ndarray, samples: int) -> np.ndarray:
    """(..., n, samples) from values (..., samples * n) of alike samples one after the other."""
    return np.ascontiguousarray(np.swapaxes(values.reshape(*values.shape[:-1], samples, -1), -2, -1))


def _one_by_one(values: np.ndarray) -> np.ndarray:
    """Inverse of :func:`_side_by_side`."""
    return np.swapaxes(values, -2, -1).reshape(*values.shape[:-2], -1)
