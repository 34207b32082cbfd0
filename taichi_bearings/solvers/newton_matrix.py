"""The matrix of a Newton step: a Laplacian over the spins with a d x d stiffness at every contact."""

import numpy as np

from taichi_bearings.cholesky import Cholesky, NotPositiveDefinite, Part
from taichi_bearings.solvers.contact_system import ContactSystem, stacked

SHIFTS = (0.0, 1e-14, 1e-12, 1e-10)  # relative additions to the diagonal, tried one after the other


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
        self._diagonal = np.flatnonzero(pattern.row == pattern.column)

    def factorise(self, stiffness: list[np.ndarray]) -> None:
        """Factorise for symmetric positive stiffnesses, one array (d, d, n) a group.

        Stiffnesses over twenty decades can leave a pivot that rounding made negative; then the diagonal is raised by
        as little as helps, and iterative refinement has to mend the rest.

        Raises NotPositiveDefinite if nothing helps.
        """
        if self._empty:
            return
        values = self._map @ stacked(stiffness)
        diagonal = values[self._diagonal]
        for shift in SHIFTS:
            values[self._diagonal] = diagonal * (1 + shift)
            try:
                return self._cholesky.factorise(values)
            except NotPositiveDefinite:
                if shift == SHIFTS[-1] or not np.isfinite(diagonal).all():
                    raise

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system, (unknowns,)."""
        return right if self._empty else self._cholesky.solve(right)
