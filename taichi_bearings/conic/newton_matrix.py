"""The matrix of a Newton step, K^T S K: a Laplacian over the spins. K is the matrix from spins to slips; the block
diagonal matrix S has a stiffness matrix (d, d) for each contact.

Letters: n contacts with up to d slip components. Several samples with one pattern of entries are on the last axis of
arrays, (..., S).
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import numpy as np
from scipy import sparse

from taichi_bearings.conic.contact_system import ContactSystem, lattice_system, stacked
from taichi_bearings.conic.rows import ContactRows, are_shared
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky import Cholesky, Engine, Factor, Memory, NotPositiveDefinite, dissect

MOST_NEWTON_STEPS = 60  # of Newton's method, and of a search along a step; where it converges, 10 to 30 are enough
REFINEMENTS = 4  # refinements of a solution; two are enough where stiffnesses are of one size
DIAGONAL_SHIFTS = (0.0, 1e-14, 1e-12, 1e-10)  # relative additions to the diagonal, tried one after the other
INVERSE_ITERATIONS, SURELY_REGULAR = 3, 1e-8  # inverse iterations, and a least eigenvalue that is surely not 0
Order = np.ndarray | Callable[[int], np.ndarray]


class NewtonMatrix:
    """Factorised matrices K^T S K of a contact system, for one sample or several. K is the matrix from spins to slips;
    the block diagonal matrix S holds the stiffnesses of the n contacts.

    There are two ways to treat several samples. Up to LANES of them can be on the last axis of arrays (..., S), with
    one pattern of entries for all. Or they can be separate parts of one system, each with a pattern of its own. The
    result for a sample, bit by bit, does not depend on the others. Patterns are analysed once, when the object is made.

    If stiffnesses span twenty decades, rounding can make a pivot negative. Then the diagonal is raised by the smallest
    of DIAGONAL_SHIFTS that helps, and the caller has to refine solutions.

    memory : work space that another matrix can share.
    raised : index in DIAGONAL_SHIFTS of the largest addition that the last call of :meth:`factorise_rows` tried.
    shared_passes : True if threads share the passes over the contacts of a single sample.
    """

    def __init__(
        self,
        system: ContactSystem,
        order: Order,
        memory: Memory | None = None,
        engine: Engine | None = None,
        parts: Sequence[slice] | None = None,
        shared_passes: bool | None = None,
    ) -> None:
        """Analyse the pattern of a system.

        system : the contacts.
        order : (unknowns,), order in which unknowns are eliminated; or, with `parts`, a function that returns the order
            within the part of a given number, where unknowns are counted from the first one of the part.
        memory : memory of another matrix that is not needed as long as this one is; None for its own.
        engine : way to factorise: Engine.LAUNCH for several samples on the last axis of arrays; None for the quickest
            way for one sample.
        parts : for each sample the range of its unknowns, if samples are parts of the system; None for one pattern.
        shared_passes : True to let threads share the passes over the contacts of a single sample, as those of another
            matrix whose kernels are loaded; None to do so if there are many contacts.
        """
        self.memory, self._system, self._parts = memory or Memory(), system, parts or [slice(0, system.unknowns)]
        self.raised, many = 0, are_shared(system.offset.shape[1])
        self.shared_passes = many if shared_passes is None else shared_passes
        own_memory = self.memory if len(self._parts) == 1 else None
        # Each term of the matrix belongs to the sample of its first unknown.
        first, second, source, sign = system.terms()
        part_of = np.searchsorted([part.start for part in self._parts], first, side="right") - 1
        places, end = np.empty_like(first), 0  # place of each term among the entries of all parts; end of the last part
        self._choleskys = list[Cholesky]()  # for each part
        self._entries = list[tuple[slice | np.ndarray, slice]]()  # for each part: entries that change, and their places
        for number, part in enumerate(self._parts):
            own = np.flatnonzero(part_of == number) if parts else slice(None)
            pairs = first[own] - part.start, second[own] - part.start
            # The pattern of one sample, and the entry to which each of its terms is added.
            of_part = partial(order, number) if callable(order) else partial(np.asarray, order)
            cholesky = Cholesky(part.stop - part.start, of_part, pairs, own_memory, engine)
            entry, pattern = cholesky.entry(*pairs), cholesky.pattern
            written: slice | np.ndarray = slice(pattern.entries)
            count = pattern.entries
            if parts and cholesky.engine is Engine.BLOCK:  # hardly any entries of a dense block are not 0
                is_written = np.zeros(count, dtype=bool)
                is_written[pattern.diagonal] = is_written[entry] = True
                written, number_of = np.flatnonzero(is_written), np.empty(count, dtype=np.int64)
                number_of[written] = np.arange(len(written))
                entry, count = number_of[entry], len(written)
            places[own] = end + entry
            self._choleskys.append(cholesky)
            self._entries.append((written, slice(end, end + count)))
            end += count
        # The sparse matrix that turns `stacked` stiffnesses into the entries of all parts.
        columns, signs = (len(system.offset) + 1) * system.offset.size // 2, sign.astype(np.int8)
        sign = signs if self.is_costly and (signs == sign).all() else sign  # a byte each instead of eight
        self._map = sparse.csr_matrix((sign, (places, source)), shape=(end, columns))
        self._kept = dict[int, ContactRows]()  # by number of samples, the memory of their Newton steps

    @property
    def engine(self) -> Engine:
        """The way in which the matrix is factorised; of several parts that of the first."""
        return self._choleskys[0].engine

    @property
    def is_costly(self) -> bool:
        """True if a factorisation takes as long as ten solutions or more, as those of large lattices do."""
        return self.engine is Engine.CALLS

    @property
    def operations_per_number(self) -> float:
        """How many operations a factorisation takes for each number of the factor; infinite where that is not known."""
        pattern = self._choleskys[0].pattern
        return pattern.operations / max(pattern.factor_entries, 1)

    def compile(self, samples: int = 1) -> None:
        """Compile the kernels that factorise, before the time of a run is measured. For one sample these are also the
        kernels for smaller systems.

        samples : number of samples factorised together.
        """
        _compile(self._choleskys[0].engine, samples)
        if samples == 1:
            _compile(Engine.LAUNCH, 1)

    def reserve(self) -> None:
        """Reserve the memory of a large factor before it is needed. Another thread may do so while this one prepares
        other things."""
        for cholesky in self._choleskys:
            cholesky.reserve()

    def factorise(self, stiffness: np.ndarray, inertia: float | np.ndarray = 0.0) -> None:
        """Factorise the matrices of all samples. Raises NotPositiveDefinite if one is singular to working precision.

        stiffness : (d, d, n), or (d, d, n, S) of S samples.
        inertia : number added to the diagonal, as by a spring at every spin: one number, (unknowns,) or (unknowns, S).
        """
        if not self.factorise_each(stiffness, None, inertia).all():
            raise NotPositiveDefinite

    def factorise_springs(self, springs: np.ndarray, inertia: float | np.ndarray = 0.0) -> np.ndarray:
        """Factorise the matrices of S samples in which a spring at each contact resists every slip component alike.
        Return a mask (S,) of the samples in which that succeeds, if need be with a raised diagonal.

        springs : (n, S), stiffness of the spring at each contact. If the system has each slip component as a contact of
            its own (`ContactSystem.by_rows`), n counts the contacts before that.
        inertia : number added to the diagonal, as by a spring at every spin: one number, or (unknowns, S).
        """
        rows = self._system.offset
        each = np.tile(springs, (rows.shape[1] // max(len(springs), 1), 1))
        # with one component no copy is made
        stiffness = each[None, None] if len(rows) == 1 else np.multiply.outer(np.eye(len(rows)), each)
        return self.factorise_each(stiffness, inertia=inertia)

    def factorise_each(
        self, stiffness: np.ndarray, wanted: np.ndarray | None = None, inertia: float | np.ndarray = 0.0
    ) -> np.ndarray:
        """Factorise the matrices of some samples. Return a mask (S,) of the `wanted` samples in which that succeeds, if
        need be with a raised diagonal.

        stiffness : (d, d, n), a symmetric positive matrix for each contact; or (d, d, n, S) of S samples.
        wanted : (S,) mask, None for all.
        inertia : number added to the diagonal, as by a spring at every spin: one number, (unknowns,) or (unknowns, S).
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
            # Entries of this sample, plus springs on the diagonal; then its factorisation.
            factor, pattern = cholesky.factor(samples), cholesky.pattern
            factor.entries[entries, :samples] = values[among]
            springs = _side_by_side(inertia[part])[pattern.order] if isinstance(inertia, np.ndarray) else inertia
            factor.entries[pattern.diagonal, :samples] += springs
            of_lanes = np.append(regular[own], np.zeros(factor.entries.shape[1] - samples, dtype=bool))
            regular[own] = _factorise_raising(factor, pattern.diagonal, of_lanes)[0][:samples]
        return regular

    def is_regular(self, stiffness: np.ndarray) -> bool:
        """Return True if the matrix surely is regular: then every change of the spins makes some contact slip.

        The least eigenvalue, found by inverse iteration from a random vector, has to be above SURELY_REGULAR. That is
        far above what rounding makes of 0, and above the largest amount by which a diagonal is raised.

        stiffness : (d, d, n), stiffness of n contacts with up to d slip components, of size 1, or 0 for contacts that
            do not count.
        """
        if not self.factorise_each(stiffness).all():
            return False
        vector = np.random.default_rng(0).standard_normal(self._system.unknowns)
        for _ in range(INVERSE_ITERATIONS):
            vector = self.solve(vector / np.linalg.norm(vector))
        return bool(np.linalg.norm(vector) < 1 / SURELY_REGULAR)  # False for NaN

    def solve(self, right: np.ndarray, wanted: np.ndarray | None = None) -> np.ndarray:
        """Return the solutions of the factorised systems, in the shape of the right-hand sides.

        right : (unknowns,), right-hand side; (unknowns, S) of S samples.
        wanted : (S,) mask, where samples are parts of one system; the solutions of the others are 0. None for all.
        """
        columns = _side_by_side(right)
        found = np.zeros(columns.shape)
        for number, (part, cholesky) in enumerate(zip(self._parts, self._choleskys, strict=True)):
            if wanted is None or wanted[number]:
                found[part] = cholesky.solve(columns[part])
        return found.reshape(right.shape)

    def rows(self, samples: int = 1) -> ContactRows:
        """Return the memory in which Newton steps of `samples` samples are made together. Its array `spins` (unknowns
        or more, samples) gets the right-hand sides; :meth:`solve_rows` replaces them by the solutions.

        samples : 1 or LANES.
        """
        if samples not in self._kept:
            cholesky = self._choleskys[0]
            solution, place = cholesky.factor(samples).solution, cholesky.pattern.place
            self._kept[samples] = ContactRows(self._system, solution, place, self._map, self.shared_passes)
        return self._kept[samples]

    def is_ready_for(self, samples: int) -> bool:
        """Return True if Newton steps of so many samples together (1 or LANES) have been made before, so that their
        memory is there, and their kernels are loaded."""
        return samples in self._kept

    def factorise_rows(
        self,
        rows: ContactRows,
        wanted: np.ndarray,
        inertia: float = 0.0,
        viscous: np.ndarray | None = None,
        raised: int = 0,
    ) -> np.ndarray:
        """Factorise the matrices of the stiffnesses stored in `rows`, of S samples. Return a mask (S,) of the wanted
        samples in which that succeeds, if need be with a raised diagonal.

        rows : numbers of all contacts, one row for each kind.
        wanted : (S,) mask of the samples that are wanted.
        inertia : number added to the diagonal, as by a spring at every spin.
        viscous : stiffnesses to add, (d (d + 1) / 2 * n, S), `stacked`: upper triangles of the contacts' matrices (d,
            d), all entries [0, 0], then all [0, 1], and so on.
        raised : index in DIAGONAL_SHIFTS of the first addition to the diagonals to try: 0 for none. If an earlier
            matrix of the path needed one, to begin there saves factorisations that would fail.
        """
        factor, diagonal = self._choleskys[0].factor(rows.samples), self._choleskys[0].pattern.diagonal
        rows.add_stiffnesses(factor.entries)
        if viscous is not None:
            factor.entries[: self._map.shape[0]] += self._map @ viscous
        if inertia:
            factor.entries[diagonal] += inertia
        regular, self.raised = _factorise_raising(factor, diagonal, wanted, raised)
        return regular

    def solve_rows(self, rows: ContactRows) -> None:
        """Solve the factorised systems: replace the right-hand sides in `rows.spins` by the solutions."""
        self._choleskys[0].factor(rows.samples).substitute()

    def forget(self) -> None:
        """Give back the memory of large factors until they are factorised anew."""
        for cholesky in self._choleskys:
            cholesky.forget()

    def balanced(
        self, dual: np.ndarray, springs: np.ndarray, load: np.ndarray | float = 0.0, solves: int = REFINEMENTS
    ) -> np.ndarray:
        """Return forces (d, n) close to `dual` that exert the torques `load`, but for rounding.

        They are `dual` plus the forces of fictitious springs at the contacts. A linear solve finds the change of the
        spins that stretches these springs as much as is needed.

        dual : (d, n), forces to begin with, of n contacts with d slip components.
        springs : (n,), stiffness of the spring at each contact, the same for every slip component.
        load : (unknowns,), torque wanted for each unknown spin component; 0 for none.
        solves : number of solves; those after the first correct the rounding.

        Raises NotPositiveDefinite if there are too few springs, so that their matrix is singular.
        """
        if not self.factorise_springs(springs[:, None]).all():
            raise NotPositiveDefinite
        return self.stretched(dual, lambda change: springs * change, load, solves)

    def stretched(
        self,
        dual: np.ndarray,
        resisting: Callable[[np.ndarray], np.ndarray],
        load: np.ndarray | float,
        solves: int = REFINEMENTS,
    ) -> np.ndarray:
        """Return forces (d, n) with the torques `load`, up to rounding: `dual` plus the forces of springs whose matrix
        is factorised already.

        dual : (d, n), forces to begin with.
        resisting : function that returns the forces (d, n) of the springs against a change of the slips (d, n).
        load : (unknowns,), torques that the forces are to have, or 0.
        solves : number of solves; those after the first correct the rounding.
        """
        rows = self._system.offset.shape
        # Each solve starts from the last forces: changes become smaller, and so do their rounding errors.
        for _ in range(solves):
            spins = self.solve(self._system.torques(dual.reshape(rows)) - load)
            pull = resisting(self._system.change(spins).reshape(dual.shape))
            dual = np.subtract(dual, pull, out=pull)
        return dual


def _side_by_side(values: np.ndarray) -> np.ndarray:
    """Return an array (n, S) of S samples as it is, and an array (n,) of one sample as (n, 1).

    values : (n,) or (n, S), the array.
    """
    return values if values.ndim == 2 else values[:, None]


def _factorise_raising(
    factor: Factor, diagonal: np.ndarray, wanted: np.ndarray, first: int = 0
) -> tuple[np.ndarray, int]:
    """Factorise S matrices, each with the smallest addition to its diagonal (DIAGONAL_SHIFTS) with which that succeeds.
    Return a mask (S,) of the wanted matrices that were factorised, and the index of the largest addition tried.

    factor : Cholesky factor whose `entries` hold the matrices.
    diagonal : (unknowns,) places of their diagonals among the entries.
    wanted : (S,) mask of the matrices that are wanted.
    first : index in DIAGONAL_SHIFTS of the first addition to try, of all matrices.
    """
    numbers, shift, tried = factor.entries[diagonal], np.zeros(len(wanted)), first
    is_finite = np.isfinite(numbers).T.copy().all(axis=1)  # sample by sample, which is faster
    regular, hopeless = np.zeros(len(wanted), dtype=bool), ~(wanted & is_finite)
    for tried in range(first, len(DIAGONAL_SHIFTS)):
        shift[~regular] = DIAGONAL_SHIFTS[tried]
        if shift.any():
            factor.entries[diagonal] = numbers * (1 + shift)
        regular = factor.factorise()
        if (regular | hopeless).all():
            break
    found: np.ndarray = regular & wanted
    return found, tried


@lru_cache
def _compile(engine: Engine, samples: int) -> None:
    """Compile the kernels that factorise, by use on a lattice of 2 x 2 x 3 spheres: kernels are the same for all sizes.

    engine : the way to factorise.
    samples : number of samples factorised together, 1 or LANES.
    """
    lattice, spin_axes = Lattice((2, 2, 3)), (0, 1)
    system = lattice_system(lattice, spin_axes, np.ones(2))
    matrix = NewtonMatrix(system, dissect(lattice, spin_axes), engine=engine)
    rows = matrix.rows(samples)
    matrix.factorise_rows(rows, np.zeros(samples, dtype=bool))
    matrix.solve_rows(rows)


def resisted(stiffness: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return the forces (d, n) of n contacts against a change of their slips.

    stiffness : (d, d, n), stiffness matrix of each contact, for up to d slip components.
    change : (d, n), change of the slips.
    """
    found: np.ndarray = np.einsum("ijn,jn->in", stiffness, change)
    return found
