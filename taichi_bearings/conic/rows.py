"""The numbers of all contacts as the kernels of a Newton step take them, of one sample or of several side by side."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from scipy import sparse

from taichi_bearings import runtime
from taichi_bearings.conic.grouped import Arrays, Grouped
from taichi_bearings.kernels import central_path as kernels
from taichi_bearings.memory import aligned_zeros

ALONE = {kernels.FRICTION: 1.0, kernels.BOUND: 1.0, kernels.SLIP: 1.0, kernels.SMOOTH: 1.0}  # of no contact: no harm


class ContactRows:
    """Memory for one Newton step of S samples, and what the spins have to do with it; see kernels/central_path.py.

    A row holds the numbers of a contact in all samples one after the other, contact by contact. Two rows one after the
    other, (2*contacts, S), hold slips or forces; the second counts where contacts have two slipping components:

        change of the slips = operator @ change of the spins,   torques = transposed @ forces
    """

    def __init__(self, operators: Sequence[sparse.csr_matrix], components: Sequence[int], samples: int = 1) -> None:
        """operators : (d*n, unknowns) of each group. components : d of each group, 1 or 2. samples : S, at most 8."""
        self.samples, self._components, block = samples, components, kernels.BLOCK // samples
        sizes = [operator.shape[0] // d for operator, d in zip(operators, components, strict=True)]
        starts, contacts = [0] * len(sizes), 0
        for d in (1, 2):
            for group in (g for g, of_group in enumerate(components) if of_group == d):
                starts[group], contacts = contacts, contacts + -(-sizes[group] // block) * block
            if d == 1:
                self._first_two = contacts // block
        self._spans = [slice(start, start + size) for start, size in zip(starts, sizes, strict=True)]
        self._length, rows = contacts * samples, kernels.ROWS
        self._flat = aligned_zeros(rows * self._length, kernels.BLOCK)
        self._blocks, self._numbers = self._flat.reshape(-1, kernels.BLOCK), np.zeros((4, block, samples))
        self.values = self._flat.reshape(rows, contacts, samples)
        for row, value in ALONE.items():
            self.values[row] = value
        places = [
            np.arange(span.start, span.stop) + contacts * np.arange(d)[:, None]
            for span, d in zip(self._spans, components, strict=True)
        ]
        self.operator = _spread(sparse.vstack(operators), np.concatenate([p.ravel() for p in places]), 2 * contacts)
        self.transposed = self.operator.T.tocsr()

    def run(self, kernel: Callable, slots: tuple[int, int] = (0, 0), *numbers: float | np.ndarray) -> None:
        """Walk all contacts. slots : of the step that is read and that is written. numbers : of each sample, or all."""
        for own, number in zip(self._numbers, numbers, strict=False):
            own[:] = number
        blocks = len(self.values[0]) * self.samples // kernels.BLOCK
        runtime.current()  # starts it
        kernel(self._flat, self._blocks, self._numbers.ravel(), self._length, self._first_two, blocks, *slots)

    def put(self, row: int, sample: int, values: Arrays) -> None:
        """Write numbers (n,) or vectors (d, n) a group from a row on."""
        for span, new in zip(self._spans, values, strict=True):
            self.values[row : row + (len(new) if new.ndim == 2 else 1), span, sample] = new

    def numbers(self, values: np.ndarray, sample: int) -> Arrays:
        """Numbers (n,) a group of a sample from those of all, (contacts, S)."""
        return Grouped(values[span, sample].copy() for span in self._spans)

    def vectors(self, two: np.ndarray, sample: int) -> Arrays:
        """Vectors (d, n) a group of a sample from two rows one after the other."""
        both = two.reshape(2, -1, self.samples)
        return Grouped(both[:d, span, sample].copy() for d, span in zip(self._components, self._spans, strict=True))

    def total(self, row: int) -> np.ndarray:
        """Sum over the contacts, (S,), in the same order however many samples there are."""
        return np.concatenate([self.values[row, span].T for span in self._spans], axis=1).copy().sum(axis=1)

    def two(self, row: int) -> np.ndarray:
        """Two rows from one on, one after the other, (2*contacts, S), as a view."""
        return self._flat[row * self._length : (row + 2) * self._length].reshape(-1, self.samples)

    def flattened(self, vectors: Sequence[Arrays]) -> np.ndarray:
        """Inverse of :meth:`vectors`, for all samples."""
        both = np.zeros((2, self.values.shape[1], self.samples))
        for sample, of_sample in enumerate(vectors):
            for span, new in zip(self._spans, of_sample, strict=True):
                both[: len(new), span, sample] = new
        return both.reshape(-1, self.samples)

    def upper_stiffness(self) -> np.ndarray:
        """Upper triangles of the stiffnesses (entries, S), as `stacked` has them."""
        rows = {1: 1, 2: 3}
        return np.concatenate(
            [
                self.values[kernels.STIFFNESS + k, span]
                for d, span in zip(self._components, self._spans, strict=True)
                for k in range(rows[d])
            ]
        )


@lru_cache
def compile_passes() -> None:
    """Compile the passes, on next to nothing: they are the same for all systems and numbers of samples."""
    rows = ContactRows([sparse.csr_matrix(np.ones((1, 1))), sparse.csr_matrix(np.ones((2, 1)))], [1, 2])
    for kernel in (kernels.prepare, kernels.expand, kernels.multiply, kernels.correct, kernels.recentre):
        rows.run(kernel)


def _spread(matrix: sparse.spmatrix, places: np.ndarray, rows: int) -> sparse.csr_matrix:
    """A matrix with its rows at other places among `rows`."""
    found = matrix.tocoo()
    return sparse.csr_matrix((found.data, (places[found.row], found.col)), shape=(rows, matrix.shape[1]))
