"""The matrices of Newton steps of several samples of one lattice, factorised side by side."""

from functools import lru_cache

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem, lattice_system
from taichi_bearings.conic.newton_matrix import SHIFTS
from taichi_bearings.conic.rows import ContactRows, Sums
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky import dissect
from taichi_bearings.numerics.cholesky.side_by_side import CholeskySideBySide, Storage


class NewtonMatrices:
    """As :class:`NewtonMatrix`, for up to LANES samples; what is singular in one of them is no matter to the others."""

    def __init__(self, system: ContactSystem, order: np.ndarray) -> None:
        """order : of elimination of the unknowns of `system`."""
        self._system, self._cholesky = system, CholeskySideBySide(order, *system.couplings())
        pattern = self._cholesky.pattern
        self._map, self._diagonal = system.laplacian_map(pattern.entry, pattern.entries), pattern.diagonal
        self._kept: dict[int, tuple[ContactRows, Sums]] = {}

    def rows(self, samples: int) -> ContactRows:
        """Memory for Newton steps of a single sample or of LANES; right-hand sides and solutions go to its spins."""
        if samples not in self._kept:
            rows = self._system.rows(self._cholesky.storage(samples).solution, self._cholesky.pattern.place)
            self._kept[samples] = rows, rows.stiffness_sums(self._map)
        return self._kept[samples][0]

    def factorise_each(
        self, rows: ContactRows, wanted: np.ndarray, inertia: float = 0.0, viscous: np.ndarray | None = None
    ) -> np.ndarray:
        """With the stiffnesses in the rows, and `viscous` ones (entries, S) to add, as `stacked` gives them.

        True (S,) for `wanted` samples where that succeeds, if need be with a raised diagonal.
        """
        storage = self._cholesky.storage(rows.samples)
        rows.add_stiffnesses(self._kept[rows.samples][1], storage.entries)
        if viscous is not None:
            storage.entries[: self._map.shape[0]] += self._map @ viscous
        if inertia:
            storage.entries[self._diagonal] += inertia
        return self._raised(storage, wanted)

    def factorise_given(self, stiffness: np.ndarray, inertia: np.ndarray) -> np.ndarray:
        """The same with stiffnesses (entries, S), and springs (unknowns, S) at the spins, that are in no rows."""
        samples = stiffness.shape[1]
        storage = self._cholesky.storage(samples)
        values = self._map @ stiffness
        values[self._diagonal] += inertia[self._cholesky.pattern.order]
        storage.entries[: len(values), :samples] = values
        return self._raised(storage, np.arange(storage.entries.shape[1]) < samples)[:samples]

    def _raised(self, storage: Storage, wanted: np.ndarray) -> np.ndarray:
        """Factorise with the diagonal raised as little as helps; True (S,) for `wanted` samples where it does."""
        regular = storage.factorise()
        if (regular | ~wanted).all():
            return regular & wanted
        diagonal, shift = storage.entries[self._diagonal], np.zeros(len(wanted))
        hopeless = ~(wanted & np.isfinite(diagonal).all(axis=0))
        for further in SHIFTS[1:]:
            shift[~regular] = further
            storage.entries[self._diagonal] = diagonal * (1 + shift)
            regular = storage.factorise()
            if (regular | hopeless).all():
                break
        return regular & wanted

    def solve_given(self, right: np.ndarray) -> np.ndarray:
        """Solutions (unknowns, S) after :meth:`factorise_given`."""
        return self._cholesky.solve(right)

    def solve_each(self, rows: ContactRows) -> None:
        """In place."""
        self._cholesky.storage(rows.samples).substitute()


@lru_cache
def compile_eliminations(samples: int) -> None:
    """Compile the kernels of one or of several samples, on a tiny lattice: they are the same for all."""
    lattice, spin_axes = Lattice((2, 2, 3)), (0, 1)
    system = lattice_system(lattice, spin_axes, np.ones(2))
    matrices = NewtonMatrices(system, dissect(lattice.free_shape, spin_axes))
    rows = matrices.rows(samples)
    matrices.factorise_each(rows, np.zeros(samples, dtype=bool))
    matrices.solve_each(rows)
