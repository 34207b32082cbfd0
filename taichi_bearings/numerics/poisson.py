"""Torque balance of equal springs on the lattice: a Poisson problem with constant coefficients, in its modes."""

import warnings

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.laplacian import chain_modes, eigenvalues


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
        free = lattice.free_shape
        axes = [axis for axis in range(lattice.dimension) if axis != component]
        self.axes = [axis - lattice.dimension for axis in axes]
        self.modes = [chain_modes(free[axis], axis == lattice.height_axis).astype(dtype) for axis in axes]
        eigenvalue = eigenvalues(free, component, weights)
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


def solve_poisson(source: np.ndarray, dimension: int, component: int) -> np.ndarray:
    """u (R, *free) with -Laplace u = source for one spin component, by cosine and sine transforms.

    The mean of a layer that nothing couples to the driven planes becomes 0.
    """
    with warnings.catch_warnings():  # SciPy adds filters of its own
        from scipy import fft  # a tenth of a second that a planar cut does not need

    first, height = source.ndim - dimension, dimension - 1
    sideways = [first + axis for axis in range(height) if axis != component]
    spectrum = fft.dctn(source, type=2, axes=sideways, norm="ortho")
    if component != height:
        spectrum = fft.dst(spectrum, type=1, axis=-1, norm="ortho")
    eigenvalue = eigenvalues(source.shape[first:], component)
    spectrum = spectrum * np.divide(1.0, eigenvalue, out=np.zeros_like(eigenvalue), where=eigenvalue != 0)
    if component != height:
        spectrum = fft.idst(spectrum, type=1, axis=-1, norm="ortho")
    return fft.idctn(spectrum, type=2, axes=sideways, norm="ortho")
