"""Cholesky factorisation of a matrix so small that an elimination tree costs more calls than it saves arithmetic."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from taichi_bearings.interrupts import look_up
from taichi_bearings.numerics.cholesky.factor import NotPositiveDefinite

FEW = 400  # unknowns


@dataclass(frozen=True)
class WholePattern:
    """All entries of a matrix of this size are stored, unknowns in their order; the lower triangle counts."""

    size: int

    @property
    def order(self) -> slice:
        return slice(None)

    @property
    def entries(self) -> int:
        return self.size**2

    @property
    def diagonal(self) -> slice:
        return slice(None, None, self.size + 1)

    def entry(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Where the entries that couple the unknowns `first` and `second` are stored."""
        return np.minimum(first, second) * self.size + np.maximum(first, second)


class WholeCholesky:
    """Like Cholesky, of a matrix with `size` unknowns, as one dense block."""

    def __init__(self, size: int) -> None:
        self.pattern = WholePattern(size)
        self._factor = np.zeros((size, size), order="F")

    def factorise(self, values: np.ndarray) -> None:
        """Factorise the matrix with these values at the entries of the pattern.

        Raises NotPositiveDefinite if a pivot is not positive.
        """
        look_up()
        size = self.pattern.size
        self._factor, fault = dpotrf(values.reshape(size, size, order="F"), lower=True, clean=False)
        if fault:
            raise NotPositiveDefinite

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system for one right-hand side, (size,)."""
        return dpotrs(self._factor, right, lower=True)[0]

    def forget(self) -> None:
        """Nothing: it is small."""
