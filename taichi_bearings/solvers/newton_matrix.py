"""The matrix of a Newton step: a Laplacian over the spins with a d x d stiffness at every contact."""

import numpy as np

from taichi_bearings.cholesky import Cholesky, Part
from taichi_bearings.solvers.contact_system import ContactSystem, stacked


class NewtonMatrix:
    """Factorised weighted Laplacian of a contact system; the pattern is analysed once."""

    def __init__(self, system: ContactSystem, parts: list[Part]) -> None:
        """parts : elimination tree over the unknowns of `system`."""
        self._empty = system.unknowns == 0  # everything is tied to the driven planes
        if self._empty:
            return
        self._cholesky = Cholesky(parts, *system.couplings())
        pattern = self._cholesky.pattern
        self._map = system.laplacian_map(pattern.entry, len(pattern.row))

    def factorise(self, stiffness: list[np.ndarray]) -> None:
        """Factorise for symmetric positive stiffnesses, one array (d, d, n) a group."""
        if not self._empty:
            self._cholesky.factorise(self._map @ stacked(stiffness))

    def solve(self, right: np.ndarray) -> np.ndarray:
        return right if self._empty else self._cholesky.solve(right)
