"""Spins of a packing to start from, as they are carried."""

import numpy as np

from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.initial_spins import initial_spin


def start_of(packing: Bearing, start: str | np.ndarray) -> np.ndarray:
    """u = R omega (C, R, N) at the start, imposed on driven spheres, length/time. start : as of `initial_spin`."""
    return packing.staggered_spin(initial_spin(packing, start, "start"), packing.minimum_spin_axes)
