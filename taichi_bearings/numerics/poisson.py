"""Torque balance of equal springs on the lattice: a Poisson problem with constant coefficients, in its modes."""

import warnings

import numpy as np

from taichi_bearings.lattice.laplacian import eigenvalues


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
