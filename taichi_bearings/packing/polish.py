"""The end of a central path made exact: contacts that rest are held, those that slip obey the law, by Newton's method.

With the sets of resting and slipping contacts known, the minimum is a smooth problem with constraints. Each step keeps
forces as they are to first order, so they stay balanced where slips are as small as the rounding of the spins.
"""

from dataclasses import replace

import numpy as np

from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.packing.central_path import TINY, Point
from taichi_bearings.packing.newton import NewtonMatrix, isotropic, resisted
from taichi_bearings.packing.system import System

STEPS, ALONG = 12, 1e-7  # most steps; springs along slips over w
HOLD, MOST_HOLD, STIFFER = 1e5, 1e11, 100.0  # springs of resting contacts over w, and over the stiffest that slip
TURNED = 1e-7  # change of the direction of a slip at which it counts as found
OVER = 1e-9  # share by which a resting contact may bear too much
ROUNDING = 1e-14  # of slips, in units of the largest imposed one


def slipping_of(point: Point) -> np.ndarray:
    """True (A,) for contacts that slip, as far as a point near the end of the path tells: in units of the largest
    imposed slip more slip than margin, whose product goes to 0 along the path."""
    held = point.friction > 0
    margin = 1 - np.linalg.norm(point.held, axis=0) / np.where(held, point.friction, 1.0)
    return ~held | (point.speed > margin)


@np.errstate(all="ignore")  # sets that do not fit lead anywhere
def polished(point: Point, system: System, matrix: NewtonMatrix) -> tuple[Point, np.ndarray] | None:
    """The minimum and which contacts slip there, (A,); None where the sets do not fit each other."""
    slips = slipping_of(point)
    for _ in range(STEPS):
        try:
            after, turned = _stepped(point, slips, system, matrix)
        except NotPositiveDefinite:
            return None
        back = slips & (point.friction > 0) & ((after.slip * point.slip).sum(axis=0) <= 0)
        if not after.cost <= 2 * point.cost + TINY:
            return None
        if back.any():
            slips = slips & ~back
            continue
        still = float(after.speed[~slips].max(initial=0.0)) <= ROUNDING
        point = after
        if turned < TURNED and still:
            over = np.linalg.norm(point.held, axis=0)[~slips] > point.friction[~slips] * (1 + OVER)
            return None if over.any() else (point, slips)
    return None


def _stepped(point: Point, slips: np.ndarray, system: System, matrix: NewtonMatrix) -> tuple[Point, float]:
    """A step, and the largest change of a slip over the slip across it."""
    d, w = len(point.slip), point.friction
    speed = np.maximum(point.speed, TINY)
    along = point.slip / speed
    curved = np.where(slips, w / speed, 0.0)
    outer = along[:, None] * along[None]
    stiffest = float(np.divide(curved, w, out=np.zeros_like(w), where=w > 0).max(initial=0.0))
    springs = np.where(slips, 0.0, min(max(HOLD, STIFFER * stiffest), MOST_HOLD) * w)
    weak = np.where(slips, ALONG * w, 0.0)
    stiffness = curved * (np.eye(d)[:, :, None] - outer) + weak * outer + isotropic(springs, d)
    held = np.where(slips, w * along, point.held + springs * point.slip)
    matrix.factorise(stiffness + isotropic(point.viscosity, d))
    step = matrix.refined(-system.torques(held + point.viscosity * point.slip))
    change = system.change(step)
    slip = point.slip + change
    pull = held + resisted(stiffness, change)
    across = change - along * (along * change).sum(axis=0)
    turned = np.sqrt((across**2).sum(axis=0)) / speed
    after = replace(point, spins=point.spins + step, slip=slip, held=pull)
    resolved = slips & (w > 0) & (speed > ROUNDING)
    return after, float(turned[resolved].max(initial=0.0))
