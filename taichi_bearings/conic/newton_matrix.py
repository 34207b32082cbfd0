"""The matrix of a Newton step: a Laplacian over the spins with a d x d stiffness at every contact."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import numpy as np
from scipy import sparse

from taichi_bearings.conic.contact_system import ContactSystem, lattice_system, stacked
from taichi_bearings.conic.rows import ContactRows
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky import Cholesky, Engine, Factor, Memory, NotPositiveDefinite, dissect

MOST_NEWTON_STEPS = 60  # of Newton's method or of a search along its step: what succeeds takes some 10 to 30
REFINEMENTS = 4  # of solutions; two do where the springs are of one size
DIAGONAL_SHIFTS = (1e-14, 1e-12, 1e-10)  # relative additions to the diagonal, tried one after the other
INVERSE_ITERATIONS, SURELY_REGULAR = 3, 1e-8  # steps to the least eigenvalue, and what is surely not 0
Order = np.ndarray | Callable[[int], np.ndarray]


class NewtonMatrix:
    """Factorised weighted Laplacians of a contact system in one sample or in several; patterns are analysed once.

    Several samples are alike, their numbers side by side, up to LANES of them, or they are parts of the system that no
    contact joins. What becomes of one, bit by bit, does not depend on the others.

    Stiffnesses over twenty decades can leave a pivot that rounding made negative; then the diagonal is raised by as
    little as helps, and iterative refinement has to mend the rest.
    """

    def __init__(
        self,
        system: ContactSystem,
        order: Order,
        memory: Memory | None = None,
        engine: Engine | None = None,
        parts: Sequence[slice] | None = None,
    ) -> None:
        """order : of elimination of the unknowns of `system`, or of those of a part, counted from its first.

        memory : of a matrix that is not needed as long as this one. engine : LAUNCH if there are to be several alike
        samples, else the quickest. parts : unknowns of each sample; those of a single one if None.
        """
        self.memory, self._system, self._parts = memory or Memory(), system, parts or [slice(0, system.unknowns)]
        own_memory = self.memory if len(self._parts) == 1 else None
        first, second, source, sign = system.terms()
        part_of = np.searchsorted([part.start for part in self._parts], first, side="right") - 1
        places, self._choleskys, end = np.empty_like(first), list[Cholesky](), 0
        self._entries = list[tuple[slice | np.ndarray, slice]]()  # that change, of each part, and where of all
        for number, part in enumerate(self._parts):
            own = np.flatnonzero(part_of == number) if parts else slice(None)
            pairs = first[own] - part.start, second[own] - part.start
            of_part = partial(order, number) if callable(order) else partial(np.asarray, order)
            cholesky = Cholesky(part.stop - part.start, of_part, pairs, own_memory, engine)
            entry, pattern = cholesky.pattern.entry(*pairs), cholesky.pattern
            written: slice | np.ndarray = slice(pattern.entries)
            count = pattern.entries
            if parts and cholesky.engine is Engine.BLOCK:  # hardly any entries of a dense block are not 0
                written, entry = np.unique(np.append(pattern.diagonal, entry), return_inverse=True)
                entry, count = entry.reshape(-1)[pattern.size :], len(written)
            places[own] = end + entry
            self._choleskys.append(cholesky)
            self._entries.append((written, slice(end, end + count)))
            end += count
        columns = (len(system.offset) + 1) * system.offset.size // 2
        self._map = sparse.csr_matrix((sign, (places, source)), shape=(end, columns))  # from `stacked` stiffnesses
        self._kept = dict[int, ContactRows]()

    def compile(self, samples: int = 1) -> None:
        """Compile what so many alike samples need, and smaller systems, before the clock starts."""
        _compile(self._choleskys[0].engine, samples)
        _compile(Engine.LAUNCH, 1)

    def factorise(self, stiffness: np.ndarray, inertia: float | np.ndarray = 0.0) -> None:
        """As :meth:`factorise_each`, of all samples. Raises NotPositiveDefinite if one of them is singular."""
        if not self.factorise_each(stiffness, None, inertia).all():
            raise NotPositiveDefinite

    def factorise_each(
        self, stiffness: np.ndarray, wanted: np.ndarray | None = None, inertia: float | np.ndarray = 0.0
    ) -> np.ndarray:
        """Factorise for symmetric positive stiffnesses, (d, d, n), or (d, d, n, S) of alike samples, and a
        spring at every spin, (unknowns,) or (unknowns, S).

        True (S,) for `wanted` samples, all if None, where that succeeds, if need be with a raised diagonal.
        """
        values = _side_by_side(self._map @ stacked(stiffness))
        samples = values.shape[1]
        regular = np.ones(max(samples, len(self._parts)), dtype=bool) if wanted is None else wanted.copy()
        for number, (part, cholesky, (entries, among)) in enumerate(
            zip(self._parts, self._choleskys, self._entries, strict=True)
        ):
            own = slice(None) if len(self._parts) == 1 else slice(number, number + 1)
            if not regular[own].any():
                continue
            factor, pattern = cholesky.factor(samples), cholesky.pattern
            factor.entries[entries, :samples] = values[among]
            springs = _side_by_side(inertia[part])[pattern.order] if isinstance(inertia, np.ndarray) else inertia
            factor.entries[pattern.diagonal, :samples] += springs
            of_lanes = np.append(regular[own], np.zeros(factor.entries.shape[1] - samples, dtype=bool))
            regular[own] = _raised(factor, pattern.diagonal, of_lanes)[:samples]
        return regular

    def is_regular(self, stiffness: np.ndarray) -> bool:
        """True where no change of the spins surely goes without any force. stiffness : (d, d, n), of size 1 or 0.

        The least eigenvalue, by inverse iteration from a drawn vector, is then far above what rounding makes of 0, and
        above the most by which a diagonal is raised.
        """
        if not self.factorise_each(stiffness).all():
            return False
        vector = np.random.default_rng(0).standard_normal(self._system.unknowns)
        for _ in range(INVERSE_ITERATIONS):
            vector = self.solve(vector / np.linalg.norm(vector))
        return bool(np.linalg.norm(vector) < 1 / SURELY_REGULAR)  # False for NaN

    def solve(self, right: np.ndarray, wanted: np.ndarray | None = None) -> np.ndarray:
        """Solutions, (unknowns,) or (unknowns, S), of the factorised systems; 0 in parts that are not `wanted`."""
        columns = _side_by_side(right)
        found = np.zeros(columns.shape)
        for number, (part, cholesky) in enumerate(zip(self._parts, self._choleskys, strict=True)):
            if wanted is None or wanted[number]:
                found[part] = cholesky.solve(columns[part])
        return found.reshape(right.shape)

    def rows(self, samples: int = 1) -> ContactRows:
        """Memory for Newton steps of a single sample or of LANES; right-hand sides and solutions go to its spins."""
        if samples not in self._kept:
            cholesky = self._choleskys[0]
            solution, place = cholesky.factor(samples).solution, cholesky.pattern.place
            self._kept[samples] = ContactRows(self._system, solution, place, self._map)
        return self._kept[samples]

    def factorise_rows(
        self, rows: ContactRows, wanted: np.ndarray, inertia: float = 0.0, viscous: np.ndarray | None = None
    ) -> np.ndarray:
        """As :meth:`factorise_each`, for the stiffnesses in the rows, and `viscous` ones to add, as `stacked` gives
        them, (entries, S)."""
        factor, diagonal = self._choleskys[0].factor(rows.samples), self._choleskys[0].pattern.diagonal
        rows.add_stiffnesses(factor.entries)
        if viscous is not None:
            factor.entries[: self._map.shape[0]] += self._map @ viscous
        if inertia:
            factor.entries[diagonal] += inertia
        return _raised(factor, diagonal, wanted)

    def solve_rows(self, rows: ContactRows) -> None:
        """In place."""
        self._choleskys[0].factor(rows.samples).substitute()

    def forget(self) -> None:
        """Give the memory of a large factor back, until it is factorised anew."""
        for cholesky in self._choleskys:
            cholesky.forget()

    def balanced(self, dual: np.ndarray, stiffness: np.ndarray, load: np.ndarray | float = 0.0) -> np.ndarray:
        """The dual (d, n) with its torques taken away by springs of these stiffnesses (d, d, n), refined.

        load : torques (unknowns,) that are to stay. Raises NotPositiveDefinite if the springs do not hold every spin.
        """
        self.factorise(stiffness)
        # each from the forces of the last: what a stretch rounds falls with the stretch
        for _ in range(REFINEMENTS):
            spins = self.solve(self._system.torques(dual) - load)
            dual = dual - resisted(stiffness, self._system.change(spins))
        return dual


def _side_by_side(values: np.ndarray) -> np.ndarray:
    """Numbers (n, S) from (n,) of one sample, or from themselves."""
    return values if values.ndim == 2 else values[:, None]


def _raised(factor: Factor, diagonal: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Factorise with the diagonal raised as little as helps; True (S,) for `wanted` matrices where it does."""
    regular = factor.factorise()
    if (regular | ~wanted).all():
        return regular & wanted
    numbers, shift = factor.entries[diagonal], np.zeros(len(wanted))
    hopeless = ~(wanted & np.isfinite(numbers).all(axis=0))
    for further in DIAGONAL_SHIFTS:
        shift[~regular] = further
        factor.entries[diagonal] = numbers * (1 + shift)
        regular = factor.factorise()
        if (regular | hopeless).all():
            break
    return regular & wanted


@lru_cache
def _compile(engine: Engine, samples: int) -> None:
    """Compile the kernels of one or of several samples, on a tiny lattice: they are the same for all."""
    lattice, spin_axes = Lattice((2, 2, 3)), (0, 1)
    system = lattice_system(lattice, spin_axes, np.ones(2))
    matrix = NewtonMatrix(system, dissect(lattice, spin_axes), engine=engine)
    rows = matrix.rows(samples)
    matrix.factorise_rows(rows, np.zeros(samples, dtype=bool))
    matrix.solve_rows(rows)


def resisted(stiffness: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Forces (d, n) that stiffnesses (d, d, n) put up against a change (d, n) of the differences."""
    return np.einsum("ijn,jn->in", stiffness, change)
