"""The end of a central path made exact: contacts that rest are held, those that slip obey the law, by Newton's method.

Contacts whose state is clear leave their cones first, and the path of the others goes on to where theirs is clear too.
With all of them known the minimum is a smooth problem with constraints. Each step keeps forces as they are to first
order, so they stay balanced where slips are as small as the rounding of the spins.
"""

from dataclasses import replace

import numpy as np

from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.packing.central_path import TINY, Outside, Point, Settled, stepped
from taichi_bearings.packing.newton import NewtonMatrix, isotropic, resisted
from taichi_bearings.packing.system import System

STEPS, PATH_STEPS = 12, 14  # most steps of Newton's method, and of the path of contacts that are not clear
CLEAR, CLOSER = 1e3, 1e-2  # slip over margin, or inverse, from which a contact is clear; where they should get to
TURNED = 1e-7  # change of the direction of a slip at which it counts as found
OVER = 1e-9  # share by which a resting contact may bear too much
ROUNDING = 1e-14  # of slips, in units of the largest imposed one


def _slip_over_margin(point: Point) -> np.ndarray:
    """(A,), slips in units of the largest imposed one: it goes to 0 or to infinity along the path."""
    held = point.friction > 0
    margin = 1 - np.linalg.norm(point.held, axis=0) / np.where(held, point.friction, 1.0)
    return np.where(held, point.speed / np.maximum(margin, TINY), np.inf)


@np.errstate(all="ignore")  # sets that do not fit lead anywhere
def polished(point: Point, system: System, matrix: NewtonMatrix) -> tuple[Point, np.ndarray] | None:
    """The minimum and which contacts slip there, (A,); None where the sets do not fit each other."""
    try:
        point = _further(point, system, matrix)
        slips = _slip_over_margin(point) > 1
        for _ in range(STEPS):
            after, turned = _newton(point, slips, system, matrix)
            back = slips & (point.friction > 0) & ((after.slip * point.slip).sum(axis=0) <= 0)
            if not after.cost <= 2 * point.cost + TINY:
                return None
            if back.any():
                slips = slips & ~back
                continue
            point = after
            if turned < TURNED and float(after.speed[~slips].max(initial=0.0)) <= ROUNDING:
                over = np.linalg.norm(point.held, axis=0)[~slips] > point.friction[~slips] * (1 + OVER)
                return None if over.any() else (point, slips)
    except NotPositiveDefinite:
        pass
    return None


def _further(point: Point, system: System, matrix: NewtonMatrix) -> Point:
    """On the path with the clear contacts out of their cones, until the others are clear."""
    for _ in range(PATH_STEPS):
        ratio = _slip_over_margin(point)
        settled = Settled(ratio > CLEAR, ratio < 1 / CLEAR)
        if settled.all.all():
            break
        after = stepped(point, system, matrix, settled)
        if not after.cost <= 2 * point.cost + TINY:
            break
        point = after
    return point


def _newton(point: Point, slips: np.ndarray, system: System, matrix: NewtonMatrix) -> tuple[Point, float]:
    """A step, and the largest change of a slip across it over the slip."""
    outside = Outside.of(point, Settled(slips, ~slips))
    matrix.factorise(outside.stiffness + isotropic(point.viscosity, len(point.slip)))
    step = matrix.refined(-system.torques(point.force + outside.pull))
    change = system.change(step)
    pull = point.held + outside.pull + resisted(outside.stiffness, change)
    speed = np.maximum(point.speed, TINY)
    along = point.slip / speed
    across = change - along * (along * change).sum(axis=0)
    turned = np.sqrt((across**2).sum(axis=0)) / speed
    after = replace(point, spins=point.spins + step, slip=point.slip + change, held=pull)
    resolved = slips & (point.friction > 0) & (speed > ROUNDING)
    return after, float(turned[resolved].max(initial=0.0))
