"""Spins of a packing to start from, by the names that starts of lattices have."""

import numpy as np
from scipy.sparse.linalg import cg

from taichi_bearings.errors import InputError
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.scene.array_files import own_array
from taichi_bearings.scene.initial_spins import STARTS
from taichi_bearings.scene.interface import Interface
from taichi_bearings.scene.packing import Packing
from taichi_bearings.words import meant, shown

START_RESIDUAL = 1e-12  # of the torques at the start, relative


def start_of(packing: Packing, start: str | np.ndarray) -> np.ndarray:
    """u = R omega (C, 1, N) at the start, imposed on driven spheres, length/time.

    start : "zero", "random", "minimum-cut" and "linear", the viscous answer for even contacts, as of lattices; or omega
        (N, 3), of discs (N,), 1/time.
    """
    network = packing.network
    shape = (network.spheres, network.components)[: network.components]
    if not isinstance(start, str):
        given = own_array("the spins in start", start)
        if given.shape != shape or not np.isfinite(given).all():
            raise InputError(f"start has shape {given.shape}; it must be {shape} and finite")
        return packing.staggered_spin(given[None], packing.minimum_spin_axes)
    if start not in STARTS:
        raise InputError(f"start is {shown(start)}; it can be {', '.join(STARTS)} or spins{meant(start, STARTS)}")
    if start == "linear":
        return _viscous(packing)
    if start == "minimum-cut":
        return _of_minimum_cut(packing)
    given = np.zeros((1, *shape))
    if start == "random":
        spin = packing.spin.reshape(network.spheres, -1)[~network.free]
        largest = float(np.linalg.norm(spin, axis=1).max(initial=0.0)) or 1.0
        given[0] = np.random.default_rng([packing.seed, 1]).uniform(-largest, largest, shape)
    return packing.staggered_spin(given, packing.minimum_spin_axes)


def _viscous(packing: Packing) -> np.ndarray:
    """u (C, 1, N) of least power with the same viscosity in all contacts that act, by conjugate gradients: no factor of
    a matrix, which a GPU has not, and which is large."""
    network = packing.network
    every = np.arange(network.spheres * network.components).reshape(-1, network.components)
    moved, whole = np.repeat(network.free, network.components), network.operator(packing.acting, every)
    matrix, given = whole[:, moved], np.where(moved, 0.0, packing.driven_speed.ravel())
    found = given.copy()
    with one_thread():  # sums do not depend on the number of threads
        found[moved], _ = cg(matrix.T @ matrix, -(matrix.T @ (whole @ given)), rtol=START_RESIDUAL)
    spins = found.reshape(-1, network.components).T[:, None].copy()
    return packing.impose_driving(spins, packing.minimum_spin_axes)


def _of_minimum_cut(packing: Packing) -> np.ndarray:
    """u (C, 1, N) of the two rigid domains beside the lightest interface."""
    cut = Interface.of(packing)
    if cut is None:
        raise InputError(
            "start is 'minimum-cut', but this packing has none: that needs no odd loops, and a jump between two driven "
            "bodies, each in a bearing state"
        )
    return packing.impose_driving(cut.spins.T[:, None].copy(), packing.minimum_spin_axes)
