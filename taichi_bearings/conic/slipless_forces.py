"""Can contacts said to be slipless bear what the slipping ones leave to them?

Slipping contacts have the friction mu F_n along their slip, and so pass torques on. The slipless ones can balance these
with forces inside their friction discs unless some motion of the spheres gains more from the torques than friction at
the slipless contacts takes from it (Farkas' lemma). Near the end of the central path its forces are nearly such ones,
and a little of the room that each contact has puts them in balance. Where that does not do, the path is followed on.
"""

from collections.abc import Sequence

import numpy as np

from taichi_bearings.conic.cones import isotropic, length
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.newton_matrix import REFINEMENTS, NewtonMatrix

LEFT_TORQUE = 1e-10  # torque, of the mean friction, that may be left
# least margin over the sum of all torques left, which no force has to change by more than to end them
MARGIN_PER_TORQUE = 10.0
# share of its friction by which a contact at its limit counts as having room where forces are balanced
ROOM_AT_LIMIT = 1e-5
# share of the friction by which rounding may take the force of such a contact beyond the limit
ROUNDED_AT_LIMIT = 1e-11


@np.errstate(all="ignore")
def nearly_borne(
    system: ContactSystem,
    matrix: NewtonMatrix,
    friction: np.ndarray,
    dual: np.ndarray,
    slipping: np.ndarray,
    critical: np.ndarray,
    heads: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """The dual of all contacts, the more of a slipless one changed the more room it has, so that it is in balance; and
    the samples (samples,) in which that is enough, as it is most often near the end of the central path.

    system, matrix : of a sample. heads : of each sample, mask (unknowns,) of one spin of each domain that is tied to no
    driven plane. Of all samples, one after the other: friction (n,), dual (d, n), minus the forces, of slipless
    contacts nearly in balance and inside their friction discs, and masks (n,), the slipping contacts and the critical
    ones, which may bear all their friction.
    """
    least = np.where(critical, ROOM_AT_LIMIT * friction, 0.0)
    room = np.where(slipping, 0.0, np.maximum(friction - length(dual), least))
    side, springs = _side_by_side(dual, len(heads)), _side_by_side(room**2, len(heads))
    at_limit = _side_by_side(np.where(critical, friction, 0.0), len(heads)) if critical.any() else None
    still = np.stack(heads, axis=1).astype(float)  # a spring for each domain, that nothing stretches
    regular = matrix.factorise_each(isotropic(side, springs), inertia=still)
    for _ in range(REFINEMENTS if at_limit is None else 2 * REFINEMENTS):  # as in NewtonMatrix.balanced
        if at_limit is not None:  # forces as large as that
            side = side * np.where(at_limit > 0, at_limit / np.sqrt((side**2).sum(axis=0)), 1.0)
        side = side - springs * system.change(matrix.solve(system.torques(side)))
    whole = np.swapaxes(side, -2, -1).reshape(len(side), -1)
    within = ~critical | (length(whole) < (1 + ROUNDED_AT_LIMIT) * friction)  # no critical one bears more
    inside = within.reshape(len(heads), -1).all(axis=1)
    return whole, regular & inside & _inside(friction, whole, slipping | critical, system.torques(side))


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
