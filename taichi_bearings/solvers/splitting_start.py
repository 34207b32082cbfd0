"""Starts of central paths near the minimum, made of what a few hundred iterations of operator splitting reach.

On large lattices these iterations take as long as a fraction of one Newton step, and the path begins at a relative gap
of about 1e-3 instead of 1. Splitting gives slips and forces of every contact. Both are moved inside their cones, so far
that slip bound times friction margin is about the same for all contacts, as on the central path. Then springs at the
contacts, the stiffer the larger the friction margin, take away most of the torques that are left; Newton steps do the
rest.

Letters: R samples, n contacts with up to d slip components.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from taichi_bearings.conic.central_path import balance
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.scene import Progress, Scene
from taichi_bearings.solvers.table import OperatorSplitting

START_GAP, LONGEST_START = 1e-3, 600  # relative gap at which splitting ends, and most of its iterations
PRODUCT_FACTOR = 10.0  # product at the start of the path over the mean product of splitting
# number of balances by springs; share of the way to the first friction limit that each goes
START_BALANCES, START_SHARE = 10, 0.7
MOST_TORQUE = 0.5  # torque over the mean friction that may be left on a sphere at the start
TINY = np.finfo(np.float64).tiny


def splitting(scene: Scene, spin: np.ndarray) -> Callable[[], Progress]:
    """Prepare operator splitting, and return a function that returns spins and friction forces of all samples, reached
    once each has a relative gap of START_GAP, or after LONGEST_START iterations. It may be called once.

    scene : the lattice with its R samples.
    spin : (R, *N spheres, 3), in 2D (R, *N), laboratory spins to start from, 1/time.

    Raises MemoryError if the memory does not suffice.
    """
    method = OperatorSplitting().build()
    method.begin(scene, spin)

    def split() -> Progress:
        """Return what splitting reaches, and give its memory back."""
        progress = method.progress()
        while method.iteration < LONGEST_START and (progress.lower_bound < (1 - START_GAP) * progress.objective).any():
            method.advance(method.next_check(method.iteration) - method.iteration)
            progress = method.progress()
        method.give_back()
        return progress

    return split


def centred(start: Iterate, spins: np.ndarray, dual: np.ndarray, matrix: NewtonMatrix) -> Iterate:
    """Return a point near the central path with given spins and nearly the given forces. If no such point with nearly
    balanced forces is found, return `start`.

    start : any point of the sample; its system and its friction are those of the result.
    spins : (unknowns,), spins of the result.
    dual : (d, n), minus the forces on n contacts with up to d slip components; at most as large as friction, up to
        rounding.
    matrix : matrix of springs at the contacts (`Surroundings.springs`), which is factorised anew.
    """
    friction, difference = start.friction, start.system.differences(spins)
    slip, size = length(difference), length(dual)
    # power less work of the forces, 0 at the minimum for each contact; on the path it is the same for all
    excess = friction * slip + (difference * dual).sum(axis=0)
    product = PRODUCT_FACTOR * max(float(excess.mean()), TINY)
    # slip bounds with bound - slip^2 / bound = product / friction; forces with bound * margin >= product / 2
    bound = (product / friction + np.hypot(product / friction, 2 * slip)) / 2
    inside = 1 - product / (2 * friction * bound)
    dual = dual * np.minimum(1.0, inside * friction / np.maximum(size, TINY))
    point = replace(start, spins=spins, bound=bound, difference=difference, dual=dual)
    with suppress(NotPositiveDefinite):
        point = balance(point, matrix, START_SHARE, START_BALANCES, solves=1)
    return point if point.unbalanced < MOST_TORQUE else start
