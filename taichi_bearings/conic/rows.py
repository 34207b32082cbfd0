"""The table of numbers that the kernels of a Newton step read and write: a row for each kind of number (bound, slip,
force, ...), a column for each contact, for one sample or several.

A *pass* calls one function for every contact; the function reads some rows and writes others. Letters: n contacts with
up to d slip components, S samples (1 or LANES), as in conic/__init__.py. The names of the rows (BOUND, SLIP, DUAL, ...)
and what each holds are in kernels/central_path.py.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from scipy import sparse

from taichi_bearings import runtime
from taichi_bearings.conic import by_numpy
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.kernels import central_path as kernels
from taichi_bearings.launch import prepared
from taichi_bearings.memory import aligned_zeros

# padding contacts: finite in every formula, with negligible power
PADDING = {kernels.FRICTION_ROW: 1e-300, kernels.BOUND: 1.0, kernels.SLIP: 1.0, kernels.SMOOTH: 1.0}
# From PARTED_CONTACTS contacts on the sums over a sample are made in SUM_PARTS parts, which are then added up. From
# SHARED_CONTACTS on threads share these parts: in smaller samples that gains less time than loading the kernels takes.
PARTED_CONTACTS, SHARED_CONTACTS, SUM_PARTS = 16_000, 80_000, 64
MOST_CONSTANTS = 5  # most numbers of each sample that a pass over the contacts takes
# tables that say which numbers to add and to subtract, for kernels.add_up; or a matrix of other factors
Sums: TypeAlias = tuple[np.ndarray, np.ndarray] | sparse.csr_array


class ContactRows:
    """Memory for the Newton steps of S samples, and the maps between spins and slips.

    A row holds one number for every contact; contact by contact, the numbers of all samples follow each other. Slips
    and forces are vectors of up to two components and take two rows, one after the other; the second is 0 at contacts
    with one component. A stiffness is a symmetric 2 x 2 matrix and takes three rows. `contacts` counts the contacts
    with those that fill up SIMD blocks.

    values : (rows, contacts, S), all rows.
    spins : (unknowns or more, S), array that is read as changes of the spins, and overwritten with torques on them.
    samples : S, the number of samples.
    shared : True if threads share the passes; bits are the same.
    place : (unknowns,), row of `spins` in which each unknown stands.
    """

    def __init__(
        self,
        system: ContactSystem,
        spins: np.ndarray,
        place: np.ndarray | None = None,
        laplacian: sparse.csr_matrix | None = None,
        shared: bool = False,
    ) -> None:
        """Reserve memory for the numbers of all contacts of a system, and prepare the maps between spins and slips.

        The memory is a table: a row for each kind of number (components of slip and force, bound of the slip, friction
        limit and so on, kernels/central_path.py) with a number of each contact of each of S samples.

        system : the n contacts, with up to d slip components each.
        spins : array (unknowns or more, S) that is kept: changes of spins are read from it and torques are written into
            it.
        place : (unknowns,), row of `spins` in which each unknown stands; None if they are in order.
        laplacian : sparse matrix that turns the stiffnesses of the contacts (all entries [0, 0] of their matrices, then
            all [0, 1], ...) into the entries of the Newton matrix; None if :meth:`add_stiffnesses` is not called.
        shared : True to let threads share the passes over a single sample.
        """
        self.samples, self.spins, d = spins.shape[1], spins, len(system.offset)
        self.shared = shared and self.samples == 1
        # Contacts with one component come before those with two, each kind padded to a multiple of BLOCK.
        two = system.felt.sum(axis=0) == 2
        kinds = [np.flatnonzero(~two), np.flatnonzero(two)]
        begins = np.cumsum([0, *(-(-len(own) // kernels.BLOCK) * kernels.BLOCK for own in kinds)])
        # (n,), place of each contact in a row; length of a row, with the contacts that fill up blocks
        self._at, contacts = np.empty(system.offset.shape[1], dtype=np.int64), int(begins[2])
        for begin, own in zip(begins, kinds, strict=False):
            self._at[own] = begin + np.arange(len(own))
        # block of BLOCK numbers with which the contacts with two components begin; numbers of a row, of all samples
        self._first_two = int(begins[1]) * self.samples // kernels.BLOCK
        self._second = int(begins[1])  # first contact with two components
        self._contacts, self._length = contacts, contacts * self.samples
        self._flat = aligned_zeros(kernels.ROWS * self._length, kernels.BLOCK)
        self.values = self._flat.reshape(kernels.ROWS, contacts, self.samples)
        for row, value in PADDING.items():
            self.values[row] = value
        # a block is what a kernel works on at once: each constant is repeated for every place of it, and each result of
        # a reduction (a sum, a least value) has one part for every place
        self._numbers = np.zeros((MOST_CONSTANTS, kernels.BLOCK // self.samples, self.samples))
        self._span, self._found = self._place_of_sums()
        self.place = np.arange(system.unknowns) if place is None else place
        # Maps from spins to slips, and back from forces to torques.
        of_all, rows = system.operator.tocoo(), self._places(d)
        ends = rows[of_all.row], self.place[of_all.col], of_all.data
        self._changes = _sums(*ends, (2 * contacts, len(spins)))
        self._torques = _sums(ends[1], ends[0], ends[2], (len(spins), 2 * contacts))
        if laplacian is not None:
            terms, stiffness = laplacian.tocoo(), self._places(d * (d + 1) // 2)
            self._stiffnesses = _sums(terms.row, stiffness[terms.col], terms.data, (terms.shape[0], 3 * contacts))
        # calls of kernels with their arguments, ready to be repeated, by kernel and rows (or sums and places); and, by
        # the `id` of the sums, the matrices that take the place of these kernels
        self._starts: dict[tuple[object, ...], list[Callable[[], None]]] = {}
        self._matrices: dict[int, sparse.csr_array] = {}

    def _place_of_sums(self) -> tuple[int, np.ndarray]:
        """Return two things: how many successive blocks (of BLOCK numbers) add to the same partial sums; and memory for
        the partial results of a pass, (FOUND results, parts * BLOCK, S samples).

        A large single sample is divided into SUM_PARTS parts with sums of their own. Where several samples are
        computed together, each block adds to other sums than the block before it.
        """
        parts = SUM_PARTS if self.samples == 1 and self._contacts > PARTED_CONTACTS else 1
        span = max(1, -(-self._length // (parts * kernels.BLOCK))) if self.samples == 1 else 1
        found = aligned_zeros(kernels.FOUND * parts * kernels.BLOCK * self.samples, kernels.BLOCK)
        return span, found.reshape(kernels.FOUND, parts * kernels.BLOCK, self.samples)

    def _places(self, count: int) -> np.ndarray:
        """Return where the numbers of n contacts stand in `count` successive rows: indices (count * n,), row by row,
        counted from the beginning of the first row. (A row is longer than n, as SIMD blocks are filled up.)"""
        return (self._at + self._contacts * np.arange(count)[:, None]).ravel()

    def run(self, kernel: kernels.Passes, slots: tuple[int, int] = (0, 0), *numbers: float | np.ndarray) -> np.ndarray:
        """Make a pass over all contacts. Return its results for each of S samples, (FOUND, S): first minima over the
        contacts, then sums; (0, S) for a pass without results.

        kernel : the pass.
        slots : the table has rows for two Newton steps, 0 and 1: which of them the kernel reads, and which it writes.
        numbers : constants of the kernel, at most MOST_CONSTANTS, each one number or (S,).
        """
        if by_numpy.is_quicker(self._contacts, self.samples):
            constants = [float(np.ravel(number)[0]) for number in numbers]
            self._found[:, :, 0] = by_numpy.run(kernel, self._flat, self._length, self._second, slots, constants)
        else:
            self._launch(kernel, slots, numbers)
        if not kernel.finds:
            return np.zeros((0, self.samples))
        by_sample = self._found.transpose(0, 2, 1).copy()  # added up in one order however many samples there are
        return np.concatenate(
            [by_sample[: kernels.LEAST_FOUND].min(axis=2), by_sample[kernels.LEAST_FOUND :].sum(axis=2)]
        )

    def _launch(self, kernel: kernels.Passes, slots: tuple[int, int], numbers: tuple[float | np.ndarray, ...]) -> None:
        """Launch a kernel over all contacts; its partial results are then in `_found`.

        kernel : the pass.
        slots : which of the two Newton steps in memory (0 or 1) is read, and which is written.
        numbers : constants of the kernel, each one number or (S,).
        """
        for own, number in zip(self._numbers, numbers, strict=False):
            own[:] = number
        if kernel.finds:
            self._found[: kernels.LEAST_FOUND], self._found[kernels.LEAST_FOUND :] = np.inf, 0.0
        key = (kernel, slots)
        if key not in self._starts:
            blocks, results = self._length // kernels.BLOCK, self._found.reshape(-1, kernels.BLOCK)
            arrays = self._flat, self._flat.reshape(-1, kernels.BLOCK), results, self._numbers.ravel()
            # kernel for contacts that all have one slip component, or all two, or either
            fitting = kernel.one if self._first_two == blocks else kernel.both if self._first_two else kernel.two
            fitting = kernel.shared if self.shared else fitting
            ends = self._length, self._first_two, blocks, self._span
            self._starts[key] = [prepared(fitting, *arrays, *ends, *slots)] if blocks else []
        for start in self._starts[key]:
            start()

    def change(self, row: int) -> None:
        """Compute the change K x of the slips, and write its two components into two rows of the contacts' numbers. K
        is the matrix from spins to slips, and x the change of the spins that stands in `self.spins`.

        row : number of the first of these rows; the second follows.
        """
        self._add_up(self._changes, self.spins, self._flat, 0, row * self._contacts)

    def torques(self, row: int) -> None:
        """Compute the torques K^T f of contact forces f, and write them into `self.spins`, which is overwritten. K is
        the matrix from spins to slips.

        row : number of the row of the contacts' numbers with the first component of f; the second is in the next row.
        """
        self._add_up(self._torques, self._flat, self.spins, row * self._contacts, 0)

    def add_stiffnesses(self, entries: np.ndarray) -> None:
        """Compute the entries of the Newton matrix K^T (stiffness) K, where K is the matrix from spins to slips, from
        the stiffnesses of the contacts, which stand in three rows of this memory.

        entries : (entries or more, S), array for S samples that is overwritten.
        """
        self._add_up(self._stiffnesses, self._flat, entries, kernels.STIFFNESS * self._contacts, 0)

    def _add_up(self, sums: Sums, values: np.ndarray, found: np.ndarray, first: int, to: int) -> None:
        """Compute the product of a sparse matrix with numbers of the memory, and write it to `found`.

        sums : the matrix; or, if its entries are all 1 or -1, two tables that say which numbers to add and to subtract.
        values : array of numbers of contacts or of spins, any shape; read as if it were flat.
        found : array that the result is written into, any shape; indexed as if it were flat.
        first : where in `values` the numbers begin that are multiplied, counted in numbers of each sample.
        to : where in `found` the result begins, counted likewise.
        """
        key, shape = (id(sums), first, to), (-1,) if self.samples == 1 else (-1, self.samples)
        # A matrix is multiplied by SciPy. So are two tables, as a matrix, if NumPy makes the passes.
        if not isinstance(sums, sparse.csr_array) and by_numpy.is_quicker(self._contacts, self.samples):
            if id(sums) not in self._matrices:
                self._matrices[id(sums)] = by_numpy.matrix_of(*sums)
            sums = self._matrices[id(sums)]
        if isinstance(sums, sparse.csr_array):
            rows, columns = sums.shape
            found.reshape(shape)[to : to + rows] = sums @ values.reshape(shape)[first : first + columns]
            return
        # Otherwise a kernel adds up the numbers.
        if key not in self._starts:
            alone = kernels.add_up_shared if self.shared else kernels.add_up_alone
            kernel = alone if self.samples == 1 else kernels.add_up
            self._starts[key] = [prepared(kernel, *sums, values.reshape(shape), found.reshape(shape), first, to)]
        self._starts[key][0]()

    def copy_step(self, slot: int, to: int, sample: int) -> None:
        """Copy the Newton step of one sample from one of the two places in memory to the other: all numbers that are
        needed to take the step and to refine it.

        slot : 0 or 1, which of the two steps in memory is read.
        to : 0 or 1, which of them is written.
        sample : number of the sample.
        """
        begin, end = (self.values[kernels.STATE_ROWS + n * kernels.STEP_ROWS :, :, sample] for n in (slot, to))
        for row in (kernels.RIGHT_HEAD, kernels.PULL, kernels.CHANGE, kernels.BOUND_STEP, kernels.DUAL_STEP):
            end[row] = begin[row]
        for row in (kernels.PULL + 1, kernels.CHANGE + 1, kernels.DUAL_STEP + 1):
            end[row, self._second :] = begin[row, self._second :]

    def mix(self, slot: int, to: int, share: float) -> None:
        """Mix the Newton steps in the two places in memory, for all samples: step + share * (other - step).

        slot : 0 or 1, the place of `step`, which stays.
        to : the other place, of `other`, which the mixture overwrites.
        share : from 0 to 1.
        """
        step, other = (
            self.values[kernels.STATE_ROWS + n * kernels.STEP_ROWS :][: kernels.STEP_ROWS] for n in (slot, to)
        )
        seconds = {row + 1 for row in (kernels.RIGHT_TAIL, kernels.PULL, kernels.CHANGE, kernels.DUAL_STEP)}
        for row, (begin, end) in enumerate(zip(step, other, strict=True)):  # row by row, which takes less memory
            here, there = (of[self._second if row in seconds else 0 :] for of in (begin, end))
            there -= here
            there *= share
            there += here

    def add(self, row: int, other: int, to: int) -> None:
        """Add two vectors on each contact, and write the sums. The two components of a vector stand in two rows of
        memory, one after the other; a row has one number of every contact and sample.

        row, other : first row of each of the vectors that are added.
        to : first row of the sums, which are written there.
        """
        np.add(self.values[row], self.values[other], out=self.values[to])
        with_two = slice(self._second, None)
        np.add(self.values[row + 1, with_two], self.values[other + 1, with_two], out=self.values[to + 1, with_two])

    def put(self, row: int, sample: int, values: np.ndarray) -> None:
        """Write numbers or vectors on the contacts of one sample into rows, in place; a row has one number of every
        contact and sample.

        row : row that is written; for vectors the first one.
        sample : number of the sample.
        values : (n,), a number for each of n contacts; or (d, n), vectors with d components, which fill d rows.
        """
        self.values[row : row + (len(values) if values.ndim == 2 else 1), self._at, sample] = values

    def numbers(self, row: int, sample: int) -> np.ndarray:
        """Return the numbers (n,) that n contacts of one sample have in a row.

        row : number of the row, which has one number of every contact and sample.
        sample : number of the sample.
        """
        found: np.ndarray = self.values[row, self._at, sample]
        return found

    def vectors(self, row: int, sample: int, count: int) -> np.ndarray:
        """Return vectors (count, n) on the n contacts of one sample.

        row : row of the first component; the others stand in the rows that follow.
        sample : number of the sample.
        count : number of components.
        """
        return self.values[row : row + count, :, sample].take(self._at, axis=1)

    def two_components(self, row: int) -> np.ndarray:
        """Return a view (2*contacts, S) of rows `row` and `row + 1`: the two components of a vector on each contact.
        Letters: S samples."""
        return self._flat[row * self._length : (row + 2) * self._length].reshape(-1, self.samples)


def are_shared(contacts: int) -> bool:
    """Return True if threads share the passes over a single sample with so many contacts."""
    return contacts > SHARED_CONTACTS and runtime.current().threads > 1


def compile_passes(contacts: int, samples: int = 1, costly: bool = False) -> None:
    """Compile the kernels of a Newton step, unless NumPy takes their place at first.

    contacts : number of contacts of a sample.
    samples : number of samples computed together, 1 or LANES.
    costly : True to compile also those that are used where a factorisation takes long.
    """
    if not by_numpy.is_quicker(contacts, samples):
        _compile_passes(samples, costly, are_shared(contacts))


@lru_cache
def _compile_passes(samples: int, costly: bool, shared: bool) -> None:
    """Compile the kernels of a Newton step, by running them on a system of two contacts: they are the same for all
    systems.

    samples : number of samples computed together, 1 or LANES.
    costly : True to compile also those that are used where a factorisation takes long.
    shared : True for kernels whose work threads share.
    """
    by_numpy.kernels_are_loaded()
    felt = np.array([[True, True], [False, True]])
    slips = sparse.csr_array(np.array([[1.0], [1.0], [0.0], [1.0]]))
    spins = aligned_zeros(samples, kernels.BLOCK).reshape(1, samples)
    rows = ContactRows(ContactSystem(1, np.zeros((2, 2)), felt, slips=slips), spins, shared=shared)
    passes = kernels.prepare, kernels.expand, kernels.correct, kernels.recentre, kernels.take
    for kernel in (*passes, kernels.between_steps) if costly else passes:
        rows.run(kernel)
    rows.torques(kernels.FORCE)


def _sums(row: np.ndarray, column: np.ndarray, sign: np.ndarray, shape: tuple[int, int]) -> Sums:
    """Return a sparse matrix in the form that suits its entries: two tables if they are all 1 or -1, else a matrix of
    SciPy.

    row, column, sign : (entries,), row, column and value of each entry. If all values are 1 or -1, two tables for
        `kernels.add_up` are returned. The first says where the terms of each row begin in the second. The second has
        the columns of the terms, in rising order; a term that is subtracted has the bitwise complement of its column.
    shape : numbers of rows and columns.
    """
    found = sparse.csr_array((sign, (row, column)), shape=shape)
    if (np.abs(found.data) != 1).any():
        return found
    found.sort_indices()
    return found.indptr.astype(np.int32), np.where(found.data > 0, found.indices, ~found.indices).astype(np.int32)
