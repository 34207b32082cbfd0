"""Eigenvalues and modes of the lattice Laplacian, driven planes held at zero.

A spin component is coupled only by the contacts that are not along it. Along each axis the Laplacian is that of a
chain: sideways with free ends, or closed to a ring; along the height between two neighbours at rest.
"""

import numpy as np

from taichi_bearings.lattice.grid import Lattice


def chain_modes(side: int, is_held: bool) -> np.ndarray:
    """Return orthonormal modes (side, side) in columns: cosines of a chain with free ends, sines of one with held
    ends.
    """
    order = np.arange(side)
    if is_held:
        modes = np.sin(np.pi * np.outer(order + 1, order + 1) / (side + 1))
    else:
        modes = np.cos(np.pi * np.outer(order + 0.5, order) / side)
    return modes / np.linalg.norm(modes, axis=0)


def chain_eigenvalues(side: int, is_held: bool) -> np.ndarray:
    """Return the eigenvalues (side,) of the modes of a chain, rising."""
    return 2 - 2 * np.cos(np.pi * (np.arange(1, side + 1) / (side + 1) if is_held else np.arange(side) / side))


def ring_eigenvalues(side: int) -> np.ndarray:
    """Return the eigenvalues (side,) of the waves around a ring, in the order of a discrete Fourier transform."""
    return 2 - 2 * np.cos(2 * np.pi * np.arange(side) / side)


def eigenvalues(lattice: Lattice, component: int) -> np.ndarray:
    """Return the eigenvalues of the Laplacian of one spin component, in an array with one axis for each of the lattice.

    Its sides are the numbers of free spheres, but 1 along the component.
    """
    free = lattice.free_shape
    total = np.zeros((1,) * len(free))
    for axis, side in enumerate(free):
        if axis != component:
            is_ring, is_held = axis in lattice.periodic, axis == lattice.height_axis
            values = ring_eigenvalues(side) if is_ring else chain_eigenvalues(side, is_held)
            total = total + values.reshape([-1 if a == axis else 1 for a in range(len(free))])
    return total


def chain_factors(side: int, held: np.ndarray, weight: float) -> np.ndarray:
    """Return inverse pivots g (side, len(held)) of a chain of springs.

    With them the balance of a chain is x_s = y_s + weight g_s x_s+1 with y_s = g_s (pull_s + weight y_s-1).

    weight : of the springs along the chain. held : of the spring that holds each of its spheres, one value for each
        chain.
    """
    factors = np.empty((side, len(held)))
    for s in range(side):
        springs = held + weight * (2 if 0 < s < side - 1 else 1)
        factors[s] = 1 / (springs - (weight**2 * factors[s - 1] if s else 0.0))
    return factors


def ring_closures(side: int, held: np.ndarray, weight: float) -> np.ndarray:
    """Return z (side, len(held)): one more spring from end to end of a chain changes its balance y to y - z (z . pull).

    That is Sherman and Morrison's formula with the solution for a pull at both ends, a sum of q^s and q^-s with
    q + 1/q = 2 + held / weight. weight, held : see :func:`chain_factors`.
    """
    decay, s = np.exp(-2 * np.arcsinh(np.sqrt(held / weight) / 2)), np.arange(side)[:, None]
    return (decay ** (s + 1) - decay ** (side - s)) / np.sqrt(weight * (1 - decay**2) * (1 - decay ** (2 * side)))
