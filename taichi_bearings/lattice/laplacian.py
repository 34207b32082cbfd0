"""Eigenvalues and modes of the lattice Laplacian, driven planes held at zero.

A spin component is coupled only by the contacts that are not along it, and along each axis the Laplacian is that of a
chain: with free ends sideways or closed to a ring, between two resting neighbours along the height.
"""

import numpy as np

from taichi_bearings.lattice.grid import Lattice


def chain_modes(side: int, is_held: bool) -> np.ndarray:
    """Orthonormal modes (side, side) in columns: cosines of a chain with free ends, sines of one with held ends."""
    order = np.arange(side)
    if is_held:
        modes = np.sin(np.pi * np.outer(order + 1, order + 1) / (side + 1))
    else:
        modes = np.cos(np.pi * np.outer(order + 0.5, order) / side)
    return modes / np.linalg.norm(modes, axis=0)


def chain_eigenvalues(side: int, is_held: bool) -> np.ndarray:
    """Of these modes, (side,), rising."""
    return 2 - 2 * np.cos(np.pi * (np.arange(1, side + 1) / (side + 1) if is_held else np.arange(side) / side))


def ring_eigenvalues(side: int) -> np.ndarray:
    """Of the waves around a ring of so many spheres, (side,), in the order of a discrete Fourier transform."""
    return 2 - 2 * np.cos(2 * np.pi * np.arange(side) / side)


def eigenvalues(lattice: Lattice, component: int) -> np.ndarray:
    """Of the Laplacian of one spin component, by modes: as many as there are free spheres, 1 along the component."""
    free = lattice.free_shape
    total = np.zeros((1,) * len(free))
    for axis, side in enumerate(free):
        if axis != component:
            is_ring, is_held = axis in lattice.periodic, axis == lattice.height_axis
            values = ring_eigenvalues(side) if is_ring else chain_eigenvalues(side, is_held)
            total = total + values.reshape([-1 if a == axis else 1 for a in range(len(free))])
    return total


def chain_factors(side: int, held: np.ndarray, weight: float) -> np.ndarray:
    """Inverse pivots g (side, len(held)) of a chain of springs `weight`, each of its spheres held by a spring `held`.

    With them the balance of a chain is x_s = y_s + weight g_s x_s+1 with y_s = g_s (pull_s + weight y_s-1).
    """
    factors = np.empty((side, len(held)))
    for s in range(side):
        springs = held + weight * (2 if 0 < s < side - 1 else 1)
        factors[s] = 1 / (springs - (weight**2 * factors[s - 1] if s else 0.0))
    return factors


def ring_closures(side: int, held: np.ndarray, weight: float) -> np.ndarray:
    """z (side, len(held)): one more spring from end to end of such a chain changes its balance y to y - z (z . pull).

    Sherman and Morrison's formula with the solution for a pull at both ends, from q + 1/q = 2 + held / weight.
    """
    decay, s = np.exp(-2 * np.arcsinh(np.sqrt(held / weight) / 2)), np.arange(side)[:, None]
    return (decay ** (s + 1) - decay ** (side - s)) / np.sqrt(weight * (1 - decay**2) * (1 - decay ** (2 * side)))
