"""Spins from which methods start. The stationary power does not depend on the choice.

Letters: R samples, *N the shape of arrays over the N spheres. Spins are those of the laboratory, 1/time, (R, *N) of
discs and (R, *N, 3) of spheres. Where they miss the imposed spins of driven spheres, methods put these in.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.errors import InputError
from taichi_bearings.numerics.double_double import add
from taichi_bearings.scene.array_files import own_array, read_arrays
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.interface import spins_of_two_domains
from taichi_bearings.scene.scene import Scene
from taichi_bearings.words import meant, shown


def random_spin(bearing: Bearing) -> np.ndarray:
    """Return random laboratory spins, 1/time: each component uniform in [-w, w], with w the largest imposed spin.

    bearing : what the spins are for.

    Their shape is (samples R, spheres *N) for discs, (R, *N, 3) for spheres. Each sample is drawn from
    ``default_rng([seed, 1])`` with its seed.
    """
    largest, shape = bearing.driving.largest_spin, zero_spin(bearing).shape[1:]
    draws = [np.random.default_rng([seed, 1]).uniform(-largest, largest, shape) for seed in bearing.seeds]
    return np.stack(draws)


def linear_spin(bearing: Bearing) -> np.ndarray:
    """Return the laboratory spins, 1/time, that would have the least power if all contacts had the same viscosity.

    bearing : what the spins are for.

    On a lattice they change linearly with the height. Their shape is (samples R, spheres *N) for discs, (R, *N, 3) for
    spheres.
    """
    even, every = bearing.driving.of_equal_viscosity(), bearing.driving.every
    full = np.broadcast_to(even, (len(every), bearing.replicas, *even.shape[2:]))
    return bearing.laboratory_spin(full, every)


def staggered_linear_spin(scene: Scene, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return :func:`linear_spin` of a lattice in the form that solvers store, (components C, samples R, spheres *N),
    1/time: the bits of ``scene.staggered_spin(linear_spin(scene), spin_axes)``, without the laboratory spins.

    scene : what the spins are for.
    spin_axes : numbers of the C components.
    """
    driving, found = scene.driving, []
    even, (high, low) = driving.of_equal_viscosity(), driving.origin(driving.every)
    for slot in map(driving.every.index, spin_axes):
        # axes along which the arrays are constant have length 1
        whole, _ = add((even[slot], np.zeros_like(even[slot])), (high[slot], low[slot]))
        found.append(np.broadcast_to(whole - high[slot], (scene.replicas, *scene.lattice.shape)))
    return driving.impose(np.stack(found), spin_axes)


def zero_spin(bearing: Bearing) -> np.ndarray:
    """Return laboratory spins that are 0, (samples R, spheres *N) of discs or (R, *N, 3) of spheres.

    bearing : what the spins are for.
    """
    shape = (bearing.replicas, *bearing.network.shape)
    return np.zeros(shape if bearing.network.components == 1 else (*shape, 3))


def minimum_cut_spin(bearing: Bearing) -> np.ndarray:
    """Return the laboratory spins, (R samples, *N spheres, 3) or of discs (R, *N), 1/time, at which all spheres belong
    to two rigid domains: one in the state of the bottom, one in that of the top.

    bearing : what the spins are for.

    Of all such pairs of domains these have the least objective, which is the power, or what else the stationary state
    minimises. Raises InputError for packings that have no such pair.
    """
    carried = spins_of_two_domains(bearing)
    if carried is None:
        raise InputError(
            "start is 'minimum-cut', but this packing has no minimum cut: that needs a packing without odd loops "
            "(closed chains of an odd number of contacts) and two driven bodies in different motions; choose another "
            "start"
        )
    return bearing.laboratory_spin(carried, bearing.minimum_spin_axes)


STARTS: dict[str, Callable[[Bearing], np.ndarray]] = {
    "random": random_spin, "zero": zero_spin, "linear": linear_spin, "minimum-cut": minimum_cut_spin,
}  # fmt: skip
"""Functions that make the initial spins of a bearing, by the names that users give."""


def initial_spin(bearing: Bearing, start: str | np.ndarray, called: str = "initial") -> np.ndarray:
    """Return laboratory spins, (samples R, spheres *N) of discs or (R, *N, 3) of spheres, 1/time.

    bearing : what the spins are for.
    start : "random", "zero", "linear" or "minimum-cut"; or the path of a file with an array or data set ``spin`` (npy,
        npz, or HDF5 such as run.h5); or such an array. An array without the axis R serves all samples.
    called : name of the argument in messages.
    """
    if not isinstance(start, str):
        return _fitting(bearing, start, "start")
    if start in STARTS:
        return STARTS[start](bearing)
    if not Path(start).exists():
        allowed = f"{', '.join(STARTS)} or a file with an array `spin`"
        raise InputError(f"{called} is {shown(start)}; allowed are {allowed}{meant(start, STARTS)}")
    return _fitting(bearing, read_arrays(Path(start), ["spin"])["spin"], start)


def _fitting(bearing: Bearing, given: ArrayLike, source: str) -> np.ndarray:
    """Return the spins of a user with an axis for the samples; raise InputError for a wrong shape or a value that is
    not finite.

    bearing : what the spins are for.
    given : array of spins, 1/time, with or without that axis.
    source : where they come from, for messages.
    """
    spin = own_array(f"the spins in {source}", given)
    expected = zero_spin(bearing).shape
    if spin.shape == expected[1:]:
        spin = np.broadcast_to(spin, expected)
    if spin.shape != expected:
        raise InputError(f"spin in {source} has shape {spin.shape}; it must be {expected[1:]} or {expected}")
    if not np.isfinite(spin).all():
        raise InputError(f"spin in {source} holds a value that is infinite or not a number")
    return spin
