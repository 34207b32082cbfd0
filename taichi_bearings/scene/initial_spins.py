"""Spins to start from. Every start obeys the driving; the stationary power does not depend on the choice."""

from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.numerics.exact_cuts import with_exact_ties
from taichi_bearings.numerics.minimum_cut import WEIGHT_ROUNDING, MinimumCut, minimum_cut
from taichi_bearings.scene.array_files import own_array, read_arrays
from taichi_bearings.scene.scene import Scene, vector_length
from taichi_bearings.words import meant


def random_spin(scene: Scene) -> np.ndarray:
    """Free spheres uniform in [-w, w] for each component, w the larger imposed spin; drawn from [seed, 1]."""
    largest, shape = scene.fastest, zero_spin(scene).shape[1:]
    draws = [np.random.default_rng([seed, 1]).uniform(-largest, largest, shape) for seed in scene.seeds]
    return np.stack(draws)


def linear_spin(scene: Scene) -> np.ndarray:
    """Staggered spin linear in the height: the viscous answer without disorder."""
    height = np.linspace(0.0, 1.0, scene.lattice.shape[-1])
    axes = scene.lattice.all_spin_axes
    staggered = scene.top_spin(axes)[:, None, ..., None] * height
    full = np.broadcast_to(staggered, (len(axes), scene.replicas, *scene.lattice.shape))
    return scene.laboratory_spin(full, axes)


def zero_spin(scene: Scene) -> np.ndarray:
    shape = (scene.replicas, *scene.lattice.shape)
    return np.zeros(shape if scene.lattice.dimension == 2 else (*shape, 3))


def cut_of(scene: Scene) -> MinimumCut:
    """The lightest interface between spheres that turn with the bottom and spheres that turn with the top."""
    weight, rounding = scene.lattice.by_axis(cut_weights(scene)), cut_rounding(scene)
    cut = minimum_cut(weight, rounding)
    return with_exact_ties(cut, weight, rounding) if rounding or scene.periodic else cut


def cut_rounding(scene: Scene) -> float:
    """Share by which the weights of :func:`cut_weights` may miss the exact ones; 0 of discs with one coefficient, which
    is the weight."""
    return 0.0 if scene.lattice.dimension == 2 and len(scene.law.quantities) == 1 else WEIGHT_ROUNDING


def _cut_speed(scene: Scene) -> float:
    """Unit of the jump, 1/time: of discs the jump itself, if there is one."""
    if scene.lattice.dimension == 2 and scene.jump:
        return scene.jump
    return float(scene.driving.unit[0][0])


def cut_weights(scene: Scene) -> np.ndarray:
    """Share of each contact in the objective of such an interface, over :func:`cut_unit`; (R, E).

    A contact of the interface slips by R |J x n|, J the jump of the imposed states at its place and n its axis. Of J
    only the components that a minimum needs count: the one along the height can change from bottom to top layer by
    layer, where no contact feels it. Viscous contacts weigh by the square of their slip, and viscosities beside a
    friction by their share in it. How far rounding takes them from the exact ones says :func:`cut_rounding`.
    """
    unit = _cut_speed(scene)
    units = (1.0, scene.lattice.radius * unit / scene.normal_force)
    coefficients = tuple(unit * values for unit, values in zip(units, scene.named_coefficients.values(), strict=False))
    axes = scene.minimum_spin_axes
    jump = scene.driving.top_in_units(axes)[0].reshape(len(axes), -1)[:, scene.lattice.column]
    if scene.lattice.dimension == 2:
        jump = np.where(jump != 0, 1.0, 0.0)
    across = vector_length(np.where(scene.lattice.tangential_mask(axes), jump, 0.0))
    return scene.law.objective(coefficients, across)


def cut_unit(scene: Scene) -> float:
    """Objective of an interface over its weight: strength * R unit with friction, else (R unit)^2; energy/time."""
    speed = scene.lattice.radius * _cut_speed(scene)
    return scene.strength * (speed if scene.law.holds else speed**2)


def minimum_cut_spin(scene: Scene) -> np.ndarray:
    """Every sphere turns with the bottom or with the top, in the components that a minimum needs: of all such states
    the one of least power, or what else the stationary state minimises. The other components slip nowhere."""
    axes = scene.minimum_spin_axes
    top = scene.top_spin(axes)[:, None, ..., None]
    return scene.laboratory_spin(np.where(cut_of(scene).above, top, 0.0), axes)


STARTS = {"random": random_spin, "zero": zero_spin, "linear": linear_spin, "minimum-cut": minimum_cut_spin}


def initial_spin(scene: Scene, start: str | np.ndarray, called: str = "initial") -> np.ndarray:
    """Laboratory spins (R, *N) or (R, *N, 3), 1/time.

    start : "random", "zero", "linear", "minimum-cut", a file with an array or data set ``spin`` (npy, npz, or HDF5
        such as run.h5), or such an array; that of a single sample serves all. called : its name in an InputError.
    """
    if not isinstance(start, str):
        return _fitting(scene, start, "start")
    if start in STARTS:
        return STARTS[start](scene)
    if not Path(start).exists():
        allowed = f"{', '.join(STARTS)} or a file with an array `spin`"
        raise InputError(f"{called} is {start!r}; allowed are {allowed}{meant(start, STARTS)}")
    return _fitting(scene, read_arrays(Path(start), ["spin"])["spin"], start)


def _fitting(scene: Scene, given: Any, source: str) -> np.ndarray:
    """Spins that users bring, checked. source : where they are from, for people."""
    spin = own_array(f"the spins in {source}", given)
    expected = zero_spin(scene).shape
    if spin.shape == expected[1:]:
        spin = np.broadcast_to(spin, expected)
    if spin.shape != expected:
        raise InputError(f"spin in {source} has shape {spin.shape}; this scene needs {expected[1:]} or {expected}")
    if not np.isfinite(spin).all():
        raise InputError(f"spin in {source} holds a value that is not finite")
    return spin
