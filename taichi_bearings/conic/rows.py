"""The numbers of all contacts of a system as the kernels of a Newton step take them, one a row."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import sparse

from taichi_bearings import runtime
from taichi_bearings.conic.grouped import Arrays, Grouped
from taichi_bearings.kernels import central_path as kernels

SERIAL = 20_000  # contacts up to which one thread is faster than several
ALONE = {kernels.FRICTION: 1.0, kernels.BOUND: 1.0, kernels.SLIP: 1.0, kernels.SMOOTH: 1.0}  # of no contact: no harm


class ContactRows:
    """Memory for one Newton step, and what the spins have to do with it; see kernels/central_path.py.

    change of the slips = operator @ change of the spins, torques = transposed @ forces, where slips and forces are two
    neighbouring rows one after the other, the second of which counts where contacts have two slipping components.
    """

    def __init__(self, operators: Sequence[sparse.csr_matrix], components: Sequence[int]) -> None:
        """operators : (d*n, unknowns) of each group. components : d of each group, 1 or 2."""
        block = kernels.BLOCK
        sizes = [operator.shape[0] // d for operator, d in zip(operators, components, strict=True)]
        starts, end = [0] * len(sizes), 0
        for d in (1, 2):
            for group in (g for g, of_group in enumerate(components) if of_group == d):
                starts[group], end = end, end + -(-sizes[group] // block) * block
            if d == 1:
                self._first_two = end // block
        self.length, self._components = end, components
        self._spans = [slice(start, start + size) for start, size in zip(starts, sizes, strict=True)]
        memory = np.zeros(kernels.ROWS * end + block)
        first = -(memory.ctypes.data // memory.itemsize) % block  # SIMD writes expect whole blocks at such addresses
        self._flat = memory[first : first + kernels.ROWS * end]
        self.values, self._blocks = self._flat.reshape(kernels.ROWS, end), self._flat.reshape(-1, block)
        for row, value in ALONE.items():
            self.values[row] = value
        places = [
            np.arange(s.start, s.stop) + end * np.arange(d)[:, None]
            for s, d in zip(self._spans, components, strict=True)
        ]
        self.operator = _spread(sparse.vstack(operators), np.concatenate([p.ravel() for p in places]), 2 * end)
        self.transposed = self.operator.T.tocsr()

    def run(self, kernel: Callable, slots: tuple[int, int] = (0, 0), *numbers: float) -> None:
        """Walk all contacts. slots : of the step that is read and that is written."""
        serial = self.length < SERIAL or runtime.current().threads == 1
        four = (*numbers, *(0.0,) * (4 - len(numbers)))
        kernel(
            serial, self._flat, self._blocks, self.length, self._first_two, self.length // kernels.BLOCK, *slots, *four
        )

    def put(self, row: int, values: Arrays) -> None:
        """Write numbers (n,) or vectors (d, n) a group from a row on."""
        for span, new in zip(self._spans, values, strict=True):
            self.values[row : row + (len(new) if new.ndim == 2 else 1), span] = new

    def numbers(self, row: int) -> Arrays:
        """The numbers (n,) a group in a row; views."""
        return Grouped(self.values[row, span] for span in self._spans)

    def vectors(self, flat: np.ndarray) -> Arrays:
        """Vectors (d, n) a group of two rows one after the other."""
        both = flat.reshape(2, -1)
        return Grouped(both[:d, span] for d, span in zip(self._components, self._spans, strict=True))

    def two(self, row: int) -> np.ndarray:
        """Two rows from one on, one after the other, as a view."""
        return self._flat[row * self.length : (row + 2) * self.length]

    def flattened(self, vectors: Arrays) -> np.ndarray:
        """Inverse of :meth:`vectors`."""
        both = np.zeros((2, self.length))
        for span, new in zip(self._spans, vectors, strict=True):
            both[: len(new), span] = new
        return both.ravel()

    def upper_stiffness(self) -> np.ndarray:
        """Upper triangles of the stiffnesses, as `stacked` has them."""
        first, rows = kernels.STIFFNESS, {1: 1, 2: 3}
        return np.concatenate(
            [
                self.values[first + k, span]
                for d, span in zip(self._components, self._spans, strict=True)
                for k in range(rows[d])
            ]
        )


def _spread(matrix: sparse.spmatrix, places: np.ndarray, rows: int) -> sparse.csr_matrix:
    """A matrix with its rows at other places among `rows`."""
    found = matrix.tocoo()
    return sparse.csr_matrix((found.data, (places[found.row], found.col)), shape=(rows, matrix.shape[1]))
