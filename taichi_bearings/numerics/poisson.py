"""Torque balance of equal springs on the lattice: one Poisson problem, solved again and again by matrix products."""

import numpy as np

from taichi_bearings.lattice import Lattice


class PlanePoisson:
    """Solves sum over axes a of weight_a (-Laplace_a) u = source for one spin component, u = 0 on the driven planes.

    A component is coupled only across the axes other than its own: two of them, so that a cubic lattice falls apart
    into planes. Along an axis the Laplacian has cosines (free sides) or sines (between the driven planes) as its modes.
    Transforming planes of n x n spheres with dense matrices costs 8 n flops a sphere, but at the speed of matrix
    products, and up to some two hundred spheres a side that beats fast transforms. The mean of a layer that nothing
    couples to the driven planes (component z of a cubic lattice) becomes 0.

    weights : one an axis.
    """

    def __init__(
        self, lattice: Lattice, component: int, weights: tuple[float, ...], replicas: int, dtype: np.typing.DTypeLike
    ) -> None:
        height, free = lattice.height_axis, (*lattice.shape[:-1], lattice.shape[-1] - 2)
        axes = [axis for axis in range(lattice.dimension) if axis != component]
        self.axes = [axis - lattice.dimension for axis in axes]
        eigenvalue = np.zeros((1,) * lattice.dimension)
        self.modes = []
        for axis in axes:
            modes, values = _held_modes(free[axis]) if axis == height else _free_modes(free[axis])
            self.modes.append(modes.astype(dtype))
            sides = [-1 if a == axis else 1 for a in range(lattice.dimension)]
            eigenvalue = eigenvalue + weights[axis] * values.reshape(sides)
        coupled = eigenvalue > 1e-12 * eigenvalue.max()
        self.inverse = np.divide(1.0, eigenvalue, out=np.zeros_like(eigenvalue), where=coupled).astype(dtype)
        self.work = np.empty((2, replicas, *free), dtype)

    def solve(self, source: np.ndarray, out: np.ndarray) -> None:
        """source, out : (R, *free spheres)."""
        (first, second), (a, b) = self.modes, self.work
        _apply(first.T, source, self.axes[0], a)
        _apply(second.T, a, self.axes[1], b)
        b *= self.inverse
        _apply(second, b, self.axes[1], a)
        _apply(first, a, self.axes[0], out)


def _apply(matrix: np.ndarray, values: np.ndarray, axis: int, out: np.ndarray) -> None:
    """out = matrix applied along `axis`, counted from the last. Planes that lie well in memory stay where they are."""
    if axis == -1:
        np.matmul(values, matrix.T, out=out)
    else:
        np.matmul(matrix, np.moveaxis(values, axis, -2), out=np.moveaxis(out, axis, -2))


def _free_modes(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal modes (side, side) in columns and eigenvalues of the Laplacian of a chain with free ends."""
    order = np.arange(side)
    modes = np.cos(np.pi * np.outer(order + 0.5, order) / side)
    return modes / np.linalg.norm(modes, axis=0), 2 - 2 * np.cos(np.pi * order / side)


def _held_modes(side: int) -> tuple[np.ndarray, np.ndarray]:
    """The same for a chain whose ends are tied to resting neighbours."""
    order = np.arange(1, side + 1)
    modes = np.sin(np.pi * np.outer(order, order) / (side + 1))
    return modes / np.linalg.norm(modes, axis=0), 2 - 2 * np.cos(np.pi * order / (side + 1))
