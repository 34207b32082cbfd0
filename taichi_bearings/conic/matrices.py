"""The matrices of Newton steps of several samples of one lattice, factorised side by side."""

from functools import lru_cache

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem, lattice_system, stacked
from taichi_bearings.conic.grouped import isotropic
from taichi_bearings.conic.newton_matrix import SHIFTS
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky import Part, dissect
from taichi_bearings.numerics.cholesky.side_by_side import CholeskySideBySide


class NewtonMatrices:
    """As :class:`NewtonMatrix`, for up to LANES samples; what is singular in one of them is no matter to the others."""

    def __init__(self, system: ContactSystem, parts: list[Part]) -> None:
        """parts : elimination tree over the unknowns of `system`."""
        self._cholesky = CholeskySideBySide(parts, *system.couplings())
        pattern = self._cholesky.pattern
        self._map, self._diagonal = system.laplacian_map(pattern.entry, pattern.entries), pattern.diagonal

    def factorise_each(self, stiffness: np.ndarray, inertia: float | np.ndarray = 0.0) -> np.ndarray:
        """stiffness : (entries, S), upper triangles as `stacked` gives them. True (S,) where that succeeds, if need be
        with a raised diagonal."""
        values = self._map @ stiffness
        diagonal = values[self._diagonal] + inertia
        shift = np.zeros(values.shape[1])
        for further in (*SHIFTS[1:], None):
            values[self._diagonal] = diagonal * (1 + shift)
            regular = self._cholesky.factorise(values)
            hopeless = ~np.isfinite(diagonal).all(axis=0)
            if further is None or (regular | hopeless).all():
                break
            shift[~regular] = further
        return regular

    def solve_each(self, right: np.ndarray) -> np.ndarray:
        """Solutions of the factorised systems, (unknowns, S)."""
        return self._cholesky.solve(right)


@lru_cache
def compile_eliminations(samples: int) -> None:
    """Compile the kernels of one or of several samples, on a tiny lattice: they are the same for all."""
    lattice, spin_axes = Lattice((2, 2, 3)), (0, 1)
    system = lattice_system(lattice, spin_axes, np.ones(2))
    matrices, stiffness = NewtonMatrices(system, dissect(lattice.free_shape, spin_axes)), isotropic(system.offset)
    matrices.factorise_each(np.repeat(stacked(stiffness)[:, None], samples, axis=1))
    matrices.solve_each(np.zeros((system.unknowns, samples)))
