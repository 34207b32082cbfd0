"""Eigenvalues and modes of the lattice Laplacian, driven planes held at zero.

A spin component is coupled only by the contacts that are not along it. Along each axis the Laplacian is that of a
chain: sideways with free ends, or closed to a ring; along the height between two neighbours at rest.
"""

import numpy as np

from taichi_bearings.lattice.grid import Lattice


def chain_modes(side: int, is_held: bool) -> np.ndarray:
    """Return the modes of a chain of `side` nodes joined by equal springs, orthonormal, in the columns of an array
    (side, side).

    is_held : True if both ends are joined to fixed walls, for sines; else the ends are free, for cosines.
    """
    order = np.arange(side)
    if is_held:
        modes = np.sin(np.pi * np.outer(order + 1, order + 1) / (side + 1))
    else:
        modes = np.cos(np.pi * np.outer(order + 0.5, order) / side)
    found: np.ndarray = modes / np.linalg.norm(modes, axis=0)
    return found


def chain_eigenvalues(side: int, is_held: bool) -> np.ndarray:
    """Return the eigenvalues (side,), rising, of the Laplacian of a chain of `side` nodes with springs of stiffness 1.

    is_held : True if both ends are joined to fixed walls; else the ends are free.
    """
    return 2 - 2 * np.cos(np.pi * (np.arange(1, side + 1) / (side + 1) if is_held else np.arange(side) / side))


def ring_eigenvalues(side: int) -> np.ndarray:
    """Return the eigenvalues (side,) of the Laplacian of a ring of `side` nodes with springs of stiffness 1, in the
    order of a discrete Fourier transform."""
    return 2 - 2 * np.cos(2 * np.pi * np.arange(side) / side)


def eigenvalues(lattice: Lattice, component: int) -> np.ndarray:
    """Return the eigenvalues of the Laplacian of one spin component of a lattice, in which contacts are springs of
    stiffness 1, except those along the component, which it does not make slip. They are an array with an axis for each
    axis of the lattice: its sides are the numbers of free spheres, and 1 along the component.

    lattice : the lattice.
    component : number of the axis of the spin component.
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
    """Return the inverse pivots g (side, chains) of Gauss elimination for chains of nodes joined by springs. From them
    follow the displacements x of a chain whose nodes s = 0, 1, ... are pulled by forces `pull`, in two sweeps:

        y_s = g_s (pull_s + weight y_(s-1)) from the first node to the last;
        x_s = y_s + weight g_s x_(s+1) from the last node to the first.

    side : number of nodes of a chain.
    held : (chains,), stiffness of the spring that ties each node of a chain to its place.
    weight : stiffness of the springs between the nodes of a chain.
    """
    factors = np.empty((side, len(held)))
    for s in range(side):
        springs = held + weight * (2 if 0 < s < side - 1 else 1)
        factors[s] = 1 / (springs - (weight**2 * factors[s - 1] if s else 0.0))
    return factors


def ring_closures(side: int, held: np.ndarray, weight: float) -> np.ndarray:
    """Return vectors z (side, chains) that turn solutions for chains of springs into solutions for rings. A ring is a
    chain with one more spring, between its two ends. If forces `pull` displace the nodes of the chain by y, they
    displace those of the ring by y - z (z . pull).

    side : number of nodes of a chain.
    held : (chains,), stiffness of the spring that ties each node of a chain to its place.
    weight : stiffness of the springs between the nodes of a chain.

    That is Sherman and Morrison's formula. It needs the motion under opposite pulls at both ends of the chain, which is
    a sum of q^s and q^-s with q + 1/q = 2 + held / weight.
    """
    decay, s = np.exp(-2 * np.arcsinh(np.sqrt(held / weight) / 2)), np.arange(side)[:, None]
    found: np.ndarray = (decay ** (s + 1) - decay ** (side - s)) / np.sqrt(
        weight * (1 - decay**2) * (1 - decay ** (2 * side))
    )
    return found
