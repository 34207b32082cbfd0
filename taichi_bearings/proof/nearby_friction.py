"""Friction on contacts near a loop that balances the torques of friction along the loop: step 2 of borne.py.

What comes out. Friction is sought that exerts given torques, and stays below the friction limit at every contact.
Nothing about it has to be proven, as borne.py computes its torques and sizes anew.

Symbols
    q : number of contacts near the loop, with two components of friction each, along two tangents.
    n : number of unknown spin components of their spheres.
    M : (2 q, n), slips of these contacts along the tangents. G : (q, 2), friction. w : (q,), friction limits.
    s : (q,), the barrier variables t^2 w^2 - |G|^2 of a given ratio t.

The method is an interior-point method. The sum over contacts of -log s is finite where |G| < t w everywhere. It is
lowered by one step of Newton's method at a time, in which the torques M^T G stay as they are; then t is lowered towards
the largest |G| / w. So G moves away from the limits that it is close to. That ends when the largest |G| / w is below 1.

Example. A sphere has two contacts with w = 3 and 1, which both can bear a torque of 2 in the same direction. Equal
friction, G = 1 and 1, is at the limit of the second one. The barrier leads towards G = 1.5 and 0.5, where both bear
half of their limits.
"""

from __future__ import annotations

import numpy as np

from taichi_bearings.numerics.blas import DENSE

MOST_BARRIER_STEPS, ENOUGH = 60, 0.999  # Newton steps; largest friction over limit at which they end
# factor by which t - (largest |G| / w) falls from step to step, and t over the largest |G| / w at the start
CLOSER, START = 0.7, 1.05
RAISED = 1e-12  # relative addition to diagonals, so that matrices that are nearly singular can be factorised
SHORTER, SHORTEST = (
    0.8,
    1e-4,
)  # factor by which a step is shortened until it is allowed, and shortest step over the whole


def spheres_nearby(ends: np.ndarray, inside: np.ndarray, start: np.ndarray, most: int) -> np.ndarray:
    """Return the mask (N,) of the spheres in `start` and of spheres near them: neighbours over contacts are added, then
    their neighbours, and so on, as long as there are at most `most` spheres in all.

    ends : (2, q), indices of both spheres of each contact.
    inside : (N,) mask of the spheres that may be taken.
    start : (N,) mask of the spheres to begin with.
    most : number of spheres; `start` alone may have more.
    """
    found: np.ndarray = start & inside
    while True:
        wider = found.copy()
        wider[ends[:, found[ends].any(axis=0)]] = True
        wider &= inside
        if wider.sum() > most or (wider == found).all():
            return found
        found = wider


@np.errstate(all="ignore")  # a step that is not finite ends the search
def friction_within_limits(rows: np.ndarray, friction: np.ndarray, limit: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Return friction G, (q, 2), with M^T (G - F) = -load, that is below the limit of every contact if such friction is
    found; else the last G of the search. Steps of Newton's method lower the sum over contacts of -log s, with s = t^2 -
    |G / w|^2 and a ratio t that falls towards the largest |G / w|.

    rows : M, (2 q, n), slips of q contacts along two tangents from n unknown spin components.
    friction : F, (q, 2), components along the tangents, force.
    limit : (q,), friction limits w, above 0.
    load : (n,), torques that the change of friction is to balance.
    """
    matrix = rows * np.repeat(limit, 2)[:, None]  # G / w is sought, so that all limits are 1
    found = friction / limit[:, None]
    # First the smallest change that balances the load; then steps that keep these torques. `ratio` is t.
    found = found + _step(matrix, np.broadcast_to(np.eye(2), (len(limit), 2, 2)), np.zeros_like(found), load)
    largest = float(np.linalg.norm(found, axis=1).max(initial=0.0))
    ratio, length = START * largest, 1.0
    for _ in range(MOST_BARRIER_STEPS):
        if not (ENOUGH < largest < np.inf and length > SHORTEST):
            break
        size = (found**2).sum(axis=1)
        barrier = ratio**2 - size
        # Gradient 2 G / s, and the inverse of the Hessian 2 / s + 4 G G^T / s^2 of each contact; s is `barrier`.
        slope = 2 * found / barrier[:, None]
        outer = found[:, :, None] * found[:, None, :] / (barrier + 2 * size)[:, None, None]
        step = _step(matrix, barrier[:, None, None] * (np.eye(2) / 2 - outer), slope, np.zeros_like(load))
        length = 1.0
        while length > SHORTEST and not (((found + length * step) ** 2).sum(axis=1) < ratio**2).all():
            length *= SHORTER
        if length > SHORTEST:
            found = found + length * step
            largest = float(np.linalg.norm(found, axis=1).max())
            ratio = largest + CLOSER * (ratio - largest)
    result: np.ndarray = found * limit[:, None]
    return result


def _step(matrix: np.ndarray, compliance: np.ndarray, slope: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Return the change d (q, 2) of friction with M^T d = -load that makes slope . d + d . C^-1 d / 2 least; NaN if the
    matrix M^T C M is singular.

    matrix : M, (2 q, n).
    compliance : C, (q, 2, 2), symmetric and positive, of each contact.
    slope : (q, 2), gradient.
    load : (n,), torques.
    """
    # d = C (M x - slope), with multipliers x such that M^T d = -load.
    count = len(compliance)
    product = np.einsum("eab,ebn->ean", compliance, matrix.reshape(count, 2, -1)).reshape(2 * count, -1)
    free_step = -np.einsum("eab,eb->ea", compliance, slope)
    normal = matrix.T @ product
    normal[np.diag_indices(len(load))] *= 1 + RAISED
    try:
        multipliers = DENSE.cho_solve(DENSE.cho_factor(normal), -load - matrix.T @ free_step.ravel())
    except (np.linalg.LinAlgError, ValueError):
        return np.full_like(slope, np.nan)
    found: np.ndarray = free_step + (product @ multipliers).reshape(count, 2)
    return found
