"""Spins to start from. Every start obeys the driving; the stationary power does not depend on the choice."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.scene.array_files import own_array, read_arrays
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.interface import spins_of_two_domains
from taichi_bearings.words import meant, shown


def random_spin(bearing: Bearing) -> np.ndarray:
    """Free spheres uniform in [-w, w] for each component, w the largest imposed spin; drawn from [seed, 1]."""
    largest, shape = bearing.driving.largest_spin, zero_spin(bearing).shape[1:]
    draws = [np.random.default_rng([seed, 1]).uniform(-largest, largest, shape) for seed in bearing.seeds]
    return np.stack(draws)


def linear_spin(bearing: Bearing) -> np.ndarray:
    """The viscous answer if all contacts had the same viscosity: on a lattice linear in the height."""
    even, every = bearing.driving.evenly(), bearing.driving.every
    full = np.broadcast_to(even, (len(every), bearing.replicas, *even.shape[2:]))
    return bearing.laboratory_spin(full, every)


def zero_spin(bearing: Bearing) -> np.ndarray:
    """No sphere turns but those that are driven."""
    shape = (bearing.replicas, *bearing.network.shape)
    return np.zeros(shape if bearing.network.components == 1 else (*shape, 3))


def minimum_cut_spin(bearing: Bearing) -> np.ndarray:
    """Every sphere turns with the bottom or with the top, in the components that a minimum needs: of all such states
    the one of least power, or what else the stationary state minimises. The other components slip nowhere."""
    carried = spins_of_two_domains(bearing)
    if carried is None:
        raise InputError(
            "start is 'minimum-cut', but this packing has none: that needs no odd loops, and a jump between two driven "
            "bodies, each in a bearing state"
        )
    return bearing.laboratory_spin(carried, bearing.minimum_spin_axes)


STARTS: dict[str, Callable[[Bearing], np.ndarray]] = {
    "random": random_spin, "zero": zero_spin, "linear": linear_spin, "minimum-cut": minimum_cut_spin,
}  # fmt: skip


def initial_spin(bearing: Bearing, start: str | np.ndarray, called: str = "initial") -> np.ndarray:
    """Laboratory spins (R, *N), of spheres (R, *N, 3), 1/time.

    start : "random", "zero", "linear", "minimum-cut", a file with an array or data set ``spin`` (npy, npz, or HDF5
        such as run.h5), or such an array; that of a single sample serves all. called : its name in an InputError.
    """
    if not isinstance(start, str):
        return _fitting(bearing, start, "start")
    if start in STARTS:
        return STARTS[start](bearing)
    if not Path(start).exists():
        allowed = f"{', '.join(STARTS)} or a file with an array `spin`"
        raise InputError(f"{called} is {shown(start)}; allowed are {allowed}{meant(start, STARTS)}")
    return _fitting(bearing, read_arrays(Path(start), ["spin"])["spin"], start)


def _fitting(bearing: Bearing, given: Any, source: str) -> np.ndarray:
    """Spins that users bring, checked. source : where they are from, for people."""
    spin = own_array(f"the spins in {source}", given)
    expected = zero_spin(bearing).shape
    if spin.shape == expected[1:]:
        spin = np.broadcast_to(spin, expected)
    if spin.shape != expected:
        raise InputError(f"spin in {source} has shape {spin.shape}; it must be {expected[1:]} or {expected}")
    if not np.isfinite(spin).all():
        raise InputError(f"spin in {source} holds a value that is not finite")
    return spin
