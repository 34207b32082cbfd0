"""Passes over the contacts by NumPy instead of kernels, for the first small samples of a process; results have the same
bits.

To load a kernel takes a process 40 ms, as long as NumPy takes for a hundred passes over 10^3 spheres. So single small
samples are computed by NumPy, until that has taken as long in this process as loading the kernels takes.

A pass calls one function, the *law*, for every contact. The kernels are compiled from the source of these laws. Here
Python executes the same source: the index of a contact is replaced by a range of contacts, so that a law reads and
returns arrays instead of single numbers, and functions of the compiler are replaced by those of NumPy.

Letters: n contacts, with those that fill up blocks, as in conic/rows.py.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
from scipy import sparse

from taichi_bearings.kernels import central_path as kernels

MOST_BY_NUMPY = 6_000  # contacts; for a larger sample NumPy would take as long as kernels take to load
WORTH_LOADING = 1_500_000  # contacts, counted once in each pass, for which NumPy takes as long as kernels take to load
LANGUAGE = SimpleNamespace(
    static=lambda value: value, cast=lambda value, kind: value, f64=None,
    abs=np.abs, sqrt=np.sqrt, max=np.fmax, min=np.fmin, select=np.where,
)  # fmt: skip
"""The functions of the compiler that laws call, for arrays."""


@dataclass
class Spent:
    """How many contacts NumPy has passed over in this process, counted once in each pass."""

    contacts: int = 0


SPENT = Spent()


def is_quicker(contacts: int, samples: int) -> bool:
    """Return True if passes are made by NumPy: over one small sample, before their kernels are worth loading.

    contacts : number of contacts of a sample.
    samples : number of samples computed together.
    """
    return samples == 1 and contacts <= MOST_BY_NUMPY and SPENT.contacts < WORTH_LOADING


def kernels_are_loaded() -> None:
    """Have all later passes of this process made by kernels, as these are loaded."""
    SPENT.contacts = WORTH_LOADING


@dataclass(frozen=True)
class _Contacts:
    """A range of contacts, passed to a law in place of the index m of one contact. A law reads flat[begin + m], where
    `begin` is the place where a row begins; here begin + m is the slice of that row for all contacts of the range.

    first, end : the first contact, and the one after the last.
    """

    first: int
    end: int

    def __radd__(self, begin: int) -> slice:
        """Return the slice of the numbers of these contacts in a row that begins at index `begin`."""
        return slice(begin + self.first, begin + self.end)


@dataclass(frozen=True)
class _Numbers:
    """The constants of a pass, such as the length of a step, passed to a law in place of the kernel's array of them. A
    law reads numbers[k * BLOCK + m] for constant k at contact m; here m is a range of contacts, of class _Contacts.

    values : the constants, each the same for all contacts.
    first : the first contact of the range.
    """

    values: list[float]
    first: int

    def __getitem__(self, place: "slice | _Contacts") -> float:
        """Return the constant values[k] for a place that a law reads.

        place : k * BLOCK + m. As m is the range of contacts from `first` on, that is a slice that begins at
            k * BLOCK + first; for k = 0 a law writes m alone.
        """
        return self.values[0 if isinstance(place, _Contacts) else (place.start - self.first) // kernels.BLOCK]


@cache
def _laws() -> dict[str, Any]:
    """Return the contents of the module that defines the laws, by name, with every function of the compiler's language
    replaced by a Python function of the same source that calls NumPy."""
    found = dict(vars(kernels))
    for name, value in vars(kernels).items():
        source = getattr(value, "__wrapped__", None)  # of a function of the compiler's language
        if isinstance(source, FunctionType) and source.__module__ == kernels.__name__:
            found[name] = FunctionType(source.__code__, found, name, source.__defaults__, source.__closure__)
    found["ti"] = LANGUAGE
    return found


def run(
    kernel: kernels.Passes, flat: np.ndarray, length: int, second: int, slots: tuple[int, int], numbers: list[float]
) -> np.ndarray:
    """Make one pass over all contacts of a sample, and write the rows that its law computes. Return its results (FOUND,
    BLOCK): minima, then sums. Column k is over contacts k, k + BLOCK, ..., as kernels make them.

    kernel : the pass: the name of its law, the rows into which its numbers go, and the results.
    flat : all rows, one after the other; changed in place. A row has one number of every contact.
    length : length of a row, n.
    second : first contact with two slip components; those before it have one.
    slots : which of the two Newton steps in memory (0 or 1) the law reads, and which it writes.
    numbers : constants of the pass.
    """
    SPENT.contacts += length
    law: Callable[..., list[np.ndarray]] = _laws()[kernel.law]
    found = np.zeros((kernels.FOUND, kernels.BLOCK))
    found[: kernels.LEAST_FOUND] = np.inf
    # where rows begin: those of the point of the path, and those of the Newton steps that are read and written
    state = [row * length for row in range(kernels.STATE_ROWS)]
    old, new = (
        [(kernels.STATE_ROWS + slot * kernels.STEP_ROWS + row) * length for row in range(kernels.STEP_ROWS)]
        for slot in slots
    )
    for kind, (first, end) in enumerate(((0, second), (second, length))):  # contacts with one component, then two
        if first == end:
            continue
        with np.errstate(all="ignore"):  # as kernels do
            made = law(flat, [state, old, (0,) * (kind + 1), new], _Numbers(numbers, first), _Contacts(first, end))
        to = [state[row] for row in kernel.iterate[kind]] + [new[row] for row in kernel.step[kind]]
        whole = [np.array(values) for values in made[: len(to)]]  # not views of rows that are written next
        for begin, values in zip(to, whole, strict=True):
            flat[begin + first : begin + end] = values
        for k, values in zip(kernel.finds, made[len(to) :], strict=True):
            # block after block, as kernels add them up
            blocks = np.concatenate([found[k], np.broadcast_to(values, end - first)]).reshape(-1, kernels.BLOCK)
            reduce = np.fmin if k < kernels.LEAST_FOUND else np.add
            found[k] = reduce.reduce(blocks, axis=0)
    return found


def matrix_of(begins: np.ndarray, places: np.ndarray) -> sparse.csr_array:
    """Return the sparse matrix, with entries 1 and -1, that two tables of the kernel `kernels.add_up` stand for. A
    product with it has the same bits as the sums of that kernel.

    begins : where the entries of each row begin in `places`; one more than there are rows.
    places : for each entry its column, or the bitwise complement of its column for an entry -1.
    """
    minus = places >> 31  # -1 for what is subtracted, 0 for the rest
    columns = places ^ minus
    shape = len(begins) - 1, int(columns.max(initial=-1)) + 1
    return sparse.csr_array(((1 | minus).astype(float), columns, begins), shape=shape)
