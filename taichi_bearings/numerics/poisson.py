"""Solves the torque balance of equal springs on the lattice: a Poisson problem with constant coefficients."""

import warnings

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.laplacian import eigenvalues


def solve_poisson(source: np.ndarray, lattice: Lattice, component: int) -> np.ndarray:
    """Return the spins u (R, *free) at which equal springs balance given torques: -Laplace u = source, for one spin
    component.

    source : (R, *free) torques in R samples on the free spheres of the lattice, in units of the springs' stiffness.
    lattice : its bottom and top plane are held at 0.
    component : axis of the spin component; contacts along it have no spring.

    The Laplacian is diagonal in waves: cosine transforms along open axes, Fourier transforms along periodic ones, sine
    transforms along the height. If nothing couples a layer to the driven planes, its mean becomes 0.
    """
    with warnings.catch_warnings():  # SciPy adds filters of its own
        from scipy import fft  # a tenth of a second that a planar cut does not need

    first, height = source.ndim - lattice.dimension, lattice.height_axis
    sideways = [axis for axis in range(height) if axis != component]
    rings = [first + axis for axis in sideways if axis in lattice.periodic]
    chains = [first + axis for axis in sideways if axis not in lattice.periodic]
    spectrum = fft.dctn(source, type=2, axes=chains, norm="ortho")
    if component != height:
        spectrum = fft.dst(spectrum, type=1, axis=-1, norm="ortho")
    if rings:
        spectrum = fft.fftn(spectrum, axes=rings)
    eigenvalue = eigenvalues(lattice, component)
    spectrum = spectrum * np.divide(1.0, eigenvalue, out=np.zeros_like(eigenvalue), where=eigenvalue != 0)
    if rings:
        spectrum = fft.ifftn(spectrum, axes=rings).real
    if component != height:
        spectrum = fft.idst(spectrum, type=1, axis=-1, norm="ortho")
    found: np.ndarray = fft.idctn(spectrum, type=2, axes=chains, norm="ortho")
    return found
