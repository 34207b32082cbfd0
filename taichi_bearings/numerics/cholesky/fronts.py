"""Symbolic factorisation: divides the unknowns of a sparse matrix into fronts, and finds which rows each front has.

Multifrontal method (Duff & Reid 1983; Liu 1992). The elimination tree is divided into *parts*, sets of unknowns that
are eliminated together in a dense matrix, the *front*. It has the own unknowns of the part first and then its border:
the later unknowns that its subtree is coupled to. Eliminating the own unknowns leaves an update of the border, which is
added to the front of the parent. Fronts of one depth do not depend on each other.

Columns of the factor with the same rows make up a part. As few have exactly the same rows, parts are joined if the
zeros that are then stored cost less than the calls and copies that are saved (relaxed supernodes: Ashcraft & Grimes,
TOMS 1989). If each plane of a dissection were a part, a quarter to almost half of the numbers would be zeros.

A *place* is the position of an unknown in the order of elimination.
"""

from dataclasses import astuple, dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings import runtime
from taichi_bearings.kernels import elimination_tree
from taichi_bearings.numerics.cholesky.tuning import Price


@dataclass(frozen=True)
class SparsePattern:
    """The entries of a symmetric matrix that are stored: those of its lower triangle that are not zero.

    order : (unknowns,) unknown at each place of the elimination order.
    place : (unknowns,) place of each unknown, the inverse of `order`.
    row, column : places of the stored entries (row >= column), sorted by column, then row.
    """

    order: np.ndarray
    place: np.ndarray
    row: np.ndarray
    column: np.ndarray

    @classmethod
    def of(cls, order: np.ndarray, first: np.ndarray, second: np.ndarray) -> "SparsePattern":
        """Return the pattern of the matrix that couples unknowns in pairs.

        order : (unknowns,), number of the unknown that is eliminated first, second, and so on.
        first, second : (pairs,), the two unknowns of each coupled pair.
        """
        place = _inverse(order)
        return cls(order, place, *_lower_entries(coupled(place, first, second)))

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.order)

    @property
    def entries(self) -> int:
        """Number of the stored entries."""
        return len(self.row)

    @property
    def factor_entries(self) -> int:
        """Lower bound on the number of entries of the factor: the number of the stored entries of the matrix."""
        return self.entries

    @property
    def operations(self) -> float:
        """Multiplications and additions of one factorisation: infinite, as they are not known."""
        return np.inf

    @cached_property
    def diagonal(self) -> np.ndarray:
        """(size,) numbers of those stored entries that are on the diagonal, in the order of elimination."""
        return np.flatnonzero(self.row == self.column)

    def entry(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return the index (pairs,), in the list of stored entries, of the entry that couples each pair of unknowns.

        first, second : (pairs,), the two unknowns of each pair.
        """
        a, b = self.place[first], self.place[second]
        begins = np.searchsorted(self.column, np.arange(self.size + 1))
        return _indices(self.row, begins, self.size, np.minimum(a, b), np.maximum(a, b))


@dataclass(frozen=True)
class Pattern(SparsePattern):
    """What a factorisation by fronts needs to know beside the values of the entries.

    A front is a set of unknowns that are eliminated together, its own unknowns, with its border: the later unknowns
    that these or fronts below are coupled to. A place is the position of an unknown in the order of elimination.

    first : (fronts,) place of the first own unknown of each front; the others follow. Children come before parents.
    own : (fronts,) number of own unknowns of each front.
    parent : (fronts,) the front above, or -1.
    depth : (fronts,) number of fronts above; 0 at a root.
    border : borders of all fronts one after the other, as sorted places.
    share : (fronts + 1,) where the border of each front begins in `border`.
    """

    first: np.ndarray
    own: np.ndarray
    parent: np.ndarray
    depth: np.ndarray
    border: np.ndarray
    share: np.ndarray

    @cached_property
    def width(self) -> np.ndarray:
        """(fronts,) number of unknowns in the border of each front, the later unknowns that it is coupled to."""
        return np.diff(self.share)

    @property
    def front(self) -> np.ndarray:
        """(unknowns,) number of the front of each unknown, in the order of elimination."""
        return np.repeat(np.arange(len(self.own)), self.own)

    @property
    def factor_entries(self) -> int:
        """Number of entries of the factor."""
        return int((self.own * (self.own + self.width)).sum())

    @property
    def operations_of_fronts(self) -> np.ndarray:
        """(fronts,), how many multiplications and additions of doubles each front (group of unknowns that are
        eliminated together) takes in one factorisation."""
        own, width = self.own.astype(float), self.width
        found: np.ndarray = own**3 / 3 + own**2 * width + own * width**2
        return found

    @property
    def operations(self) -> float:
        """Floating-point multiplications and additions of one factorisation."""
        return float(self.operations_of_fronts.sum())

    def within(self, front: np.ndarray, unknown: np.ndarray) -> np.ndarray:
        """Return for each of n unknowns its row (n,) within a front, a dense matrix. The first rows of a front belong
        to its own unknowns, which are eliminated in it; then come rows for the later unknowns that these are coupled
        to, its border.

        front : (n,) index of the front.
        unknown : (n,) place of the unknown in the order of elimination.
        """
        behind = _indices(self.border, self.share, self.size, front, unknown) - self.share[front]
        own = unknown - self.first[front]
        found: np.ndarray = np.where(own < self.own[front], own, self.own[front] + behind)
        return found


@dataclass(frozen=True)
class PlacedPattern:
    """The part of a pattern that is needed after all numbers have got places in memory. Lists of entries and borders
    are left out: they would take a tenth of the memory of a factor.

    order : (unknowns,) unknown at each place of the elimination order.
    place : (unknowns,) place of each unknown, the inverse of `order`.
    diagonal : (unknowns,) numbers of those stored entries that are on the diagonal, in the order of elimination.
    entries : number of the stored entries.
    factor_entries : number of entries of the factor.
    operations : floating-point multiplications and additions of one factorisation.
    """

    order: np.ndarray
    place: np.ndarray
    diagonal: np.ndarray
    entries: int
    factor_entries: int
    operations: float

    @classmethod
    def of(cls, pattern: Pattern) -> "PlacedPattern":
        """Return the part of a pattern that is still needed after all numbers have got places in memory."""
        sizes = pattern.entries, pattern.factor_entries, pattern.operations
        return cls(pattern.order, pattern.place, pattern.diagonal, *sizes)


@dataclass(frozen=True)
class BlockPattern:
    """Pattern of a dense matrix of `size` unknowns: all entries are stored, and unknowns are eliminated in their own
    order. The lower triangle is used.

    place : place of each unknown in the order of elimination, which is its number.
    factor_entries : as many as `entries`.
    """

    size: int

    @property
    def order(self) -> np.ndarray:
        """(size,) unknowns in the order of elimination, which for one dense block is that of their numbers."""
        return np.arange(self.size)

    place = order

    @property
    def entries(self) -> int:
        """Number of the stored entries."""
        return self.size**2

    factor_entries = entries

    @property
    def operations(self) -> float:
        """Multiplications and additions of one factorisation."""
        return self.size**3 / 3

    @property
    def diagonal(self) -> np.ndarray:
        """(size,) numbers of those stored entries that are on the diagonal."""
        return np.arange(self.size) * (self.size + 1)

    def entry(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return the index (pairs,), in the list of stored entries, of the entry that couples each pair of unknowns.

        first, second : (pairs,), the two unknowns of each pair.
        """
        found: np.ndarray = np.minimum(first, second) * self.size + np.maximum(first, second)
        return found


@dataclass(frozen=True)
class Parts:
    """The parts of an elimination tree. A part is a set of unknowns that are eliminated together, as one dense block;
    parts stand in postorder, children before parents.

    order : (unknowns,), for each column of the new order its place in the old one.
    own : (parts,) number of unknowns of a part.
    parent : (parts,) the part above, or -1.
    """

    order: np.ndarray
    own: np.ndarray
    parent: np.ndarray


def supernodes(pattern: sparse.csr_matrix, price: Price) -> Parts:
    """Return the parts of the elimination tree of a symmetric pattern: unknowns whose columns of the factor have about
    the same rows, so that they are eliminated together as one dense block.

    pattern : (unknowns, unknowns), in the order of elimination; its lower triangle is enough.
    price : what a part costs beside its arithmetic, by which small parts are joined.
    """
    runtime.current()  # starts it
    entries = [part.astype(np.int32) for of in (pattern, pattern.tocsc()) for part in (of.indptr, of.indices)]
    size, numbers = pattern.shape[0], np.zeros((8, pattern.shape[0]), dtype=np.int32)
    elimination_tree.divide(*astuple(price), *entries, *numbers, 1)
    parent, _, home, own, child, sibling, *_ = numbers
    # list parts with children before parents: list each root before the parts below it, then reverse the list
    first, following = child.tolist(), sibling.tolist()
    lasts, waiting = list[int](), np.flatnonzero(parent < 0).tolist()
    while waiting:
        lasts.append(waiting.pop())
        below = first[lasts[-1]]
        while below >= 0:
            waiting.append(below)
            below = following[below]
    lasts.reverse()
    number = np.zeros(size, dtype=np.int64)
    number[lasts] = np.arange(len(lasts))
    above = np.where(parent[lasts] >= 0, number[home[parent[lasts]]], -1)
    return Parts(np.argsort(number[home], kind="stable"), own[lasts].astype(np.int64), above)


def analyse(order: np.ndarray, first: np.ndarray, second: np.ndarray, price: Price) -> Pattern:
    """Return the symbolic factorisation of the symmetric matrix that couples unknowns in pairs: its fronts, sets of
    unknowns that are eliminated together, and their borders, the later unknowns that each set is coupled to.

    order : (unknowns,) order in which they are to be eliminated; independent branches of the tree may change places in
        it.
    first, second : (pairs,), the two unknowns of each coupled pair.
    price : what a front costs beside its arithmetic, by which small ones are joined; in operations.
    """
    lower = coupled(_inverse(order), first, second)
    parts = supernodes(lower.T.tocsr(), price)
    order, place = order[parts.order], _inverse(parts.order)
    row, column = _lower_entries(coupled(place, *_lower_entries(lower)))
    first = np.cumsum(parts.own) - parts.own
    depth = _depth(parts.parent)
    border, share = _borders(parts, depth, row, column)
    return Pattern(order, _inverse(order), row, column, first, parts.own, parts.parent, depth, border, share)


def _depth(parent: np.ndarray) -> np.ndarray:
    """Return for each part the number of parts above it in the tree, (parts,).

    parent : (parts,), the part above, or -1; children come before parents.
    """
    above = parent.tolist()
    found = [0] * len(above)
    for number in range(len(above) - 1, -1, -1):
        if above[number] >= 0:
            found[number] = found[above[number]] + 1
    return np.array(found, dtype=np.int64)


def _borders(parts: Parts, depth: np.ndarray, row: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the borders of all parts one after the other, as sorted places, and where each begins, (parts + 1,).

    A part is a set of unknowns that are eliminated together. Its border consists of the later unknowns in whose rows
    its columns have entries, and of the later unknowns in the borders of its children.

    parts : the parts, children before parents.
    depth : (parts,), number of parts above each.
    row, column : (entries,), places of the stored entries, row >= column, sorted by column.

    Parts are treated depth by depth, the deepest first. Here a row of a border is the number part * size + row, so that
    sorted numbers are sorted by part.
    """
    end, size = np.cumsum(parts.own), np.int64(len(parts.order))
    part = np.repeat(np.arange(len(end)), parts.own)[column]
    outside = row >= end[part]
    numbers, level = (part * size + row)[outside], depth[part[outside]]
    levels = int(depth.max(initial=0)) + 1
    by_level = np.argsort(level.astype(np.uint16) if levels < 2**16 else level, kind="stable")
    of_level = np.split(numbers[by_level], np.cumsum(np.bincount(level, minlength=levels))[:-1])
    found, below = list[np.ndarray](), np.zeros(0, dtype=np.int64)
    for own in reversed(of_level):
        child, later = np.divmod(below, size)
        above = parts.parent[child]
        every = np.sort(np.concatenate([own, (above * size + later)[later >= end[above]]]))
        below = every[np.diff(every, prepend=-1) > 0]
        found.append(below)
    border = np.sort(np.concatenate(found), kind="stable")  # which merges runs that are sorted
    share = np.searchsorted(border, size * np.arange(len(end) + 1))
    return border - size * np.repeat(np.arange(len(end)), np.diff(share)), share


def _indices(members: np.ndarray, begins: np.ndarray, most: int, which: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the index (n,) in `members` of n values, each looked up in one list of several; 0 if it is not there.

    members : values of all lists, one list after the other, each in ascending order.
    begins : (lists + 1,), where each list begins in `members`, and the end.
    most : number that all values are below.
    which : (n,), number of the list in which each value is to be found.
    wanted : (n,), the value.

    SciPy finds entries of a sparse matrix in a quarter of the time that NumPy takes to find numbers in one sorted list.
    """
    if not len(wanted):
        return np.zeros(0, dtype=np.int64)
    lists = sparse.csr_matrix((np.arange(len(members)), members, begins), shape=(len(begins) - 1, most))
    lists.has_canonical_format = True
    found: np.ndarray = np.asarray(lists[which, wanted])[0]
    return found


def coupled(place: np.ndarray, first: np.ndarray, second: np.ndarray) -> sparse.csr_array:
    """Return which entries the lower triangle of a symmetric matrix and its diagonal have, as a sparse array (unknowns,
    unknowns) whose values mean nothing. It is stored by columns: the indices in row k of the array are the rows of the
    entries in column k of the triangle, ascending. Unknowns stand in the order of elimination.

    place : (unknowns,) position of each unknown in the order of elimination.
    first, second : (pairs,), the two unknowns of each coupled pair, in any order; a pair may come twice.
    """
    a, b, diagonal = place[first], place[second], np.arange(len(place))
    columns, rows = np.append(np.minimum(a, b), diagonal), np.append(np.maximum(a, b), diagonal)
    found = sparse.csr_array((np.ones(len(rows), dtype=np.int8), (columns, rows)), shape=(len(place),) * 2)
    found.sum_duplicates()
    return found


def _lower_entries(lower: sparse.csr_array) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows and the columns (entries,) of the entries of `lower`, a pattern that :func:`coupled` has
    returned, sorted by column, then row."""
    return lower.indices.astype(np.int64), np.repeat(np.arange(lower.shape[0]), np.diff(lower.indptr))


def _inverse(order: np.ndarray) -> np.ndarray:
    """Return the inverse (n,) of a permutation (n,), an order of the numbers 0 to n - 1."""
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return place
