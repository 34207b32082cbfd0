"""Symbolic factorisation: which rows each part of the elimination tree touches, and where everything is stored.

Multifrontal method (Duff & Reid 1983; Liu 1992). The front of a part has its own unknowns first and then its border:
the later unknowns that its subtree is coupled to. Eliminating the own unknowns leaves an update of the border, which is
added into the front of the parent. Fronts of one depth do not depend on each other.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.numerics.cholesky.supernodes import supernodes
from taichi_bearings.numerics.cholesky.tuning import Price


@dataclass(frozen=True)
class Front:
    """One part of the tree. Numbers are places in the order of elimination.

    first : its own unknowns are first ... first + own - 1. border : sorted later unknowns. place_in_parent : of each
    border unknown, counted along the parent's own unknowns and border. depth : 0 at the root.
    """

    first: int
    own: int
    border: np.ndarray
    children: tuple[int, ...]
    place_in_parent: np.ndarray
    depth: int


@dataclass(frozen=True)
class Pattern:
    """Everything about a factorisation that does not depend on the numbers.

    order : unknown at each place of the elimination order; place : its inverse.
    fronts : in postorder.
    row, column : places of the stored entries (row >= column), sorted by column, then row.
    """

    order: np.ndarray
    place: np.ndarray
    fronts: tuple[Front, ...]
    row: np.ndarray
    column: np.ndarray

    @property
    def size(self) -> int:
        return len(self.order)

    @property
    def entries(self) -> int:
        """Number of the stored entries."""
        return len(self.row)

    @cached_property
    def diagonal(self) -> np.ndarray:
        """Which of the stored entries are on the diagonal, (size,)."""
        return np.flatnonzero(self.row == self.column)

    @property
    def kin(self) -> np.ndarray:
        """First child of each front, and the next child of its parent, (fronts, 2); -1 of none."""
        found = np.full((len(self.fronts), 2), -1)
        for number, front in enumerate(self.fronts):
            found[number, 0] = front.children[0] if front.children else -1
            found[list(front.children[:-1]), 1] = front.children[1:]
        return found

    @cached_property
    def factor_entries(self) -> int:
        return sum(f.own * (f.own + len(f.border)) for f in self.fronts)

    @property
    def operations(self) -> float:
        """Floating-point multiplications and additions of one factorisation."""
        return sum(f.own**3 / 3 + f.own**2 * len(f.border) + f.own * len(f.border) ** 2 for f in self.fronts)

    def entry(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Where the entries that couple the unknowns `first` and `second` are stored."""
        a, b = self.place[first], self.place[second]
        wanted = np.minimum(a, b) * np.int64(self.size) + np.maximum(a, b)
        return np.searchsorted(self.column * np.int64(self.size) + self.row, wanted)


@dataclass(frozen=True)
class BlockPattern:
    """All entries of a matrix of this size are stored, unknowns in their order; the lower triangle counts."""

    size: int

    @property
    def order(self) -> np.ndarray:
        return np.arange(self.size)

    place = order

    @property
    def entries(self) -> int:
        return self.size**2

    factor_entries = entries

    @property
    def diagonal(self) -> np.ndarray:
        return np.arange(self.size) * (self.size + 1)

    def entry(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Where the entries that couple the unknowns `first` and `second` are stored."""
        return np.minimum(first, second) * self.size + np.maximum(first, second)


def analyse(order: np.ndarray, first: np.ndarray, second: np.ndarray, price: Price) -> Pattern:
    """Symbolic factorisation of the symmetric matrix that couples the unknowns `first` and `second` pairwise.

    order : the unknowns as they are to be eliminated, which branches of the tree may change places in.
    """
    pattern = coupled(_inverse(order), first, second)
    parts = supernodes(pattern, price)
    order, place = order[parts.order], _inverse(parts.order)
    half = sparse.tril(pattern).tocoo()
    a, b = place[half.row], place[half.col]
    column, row = np.divmod(np.sort(np.minimum(a, b) * len(order) + np.maximum(a, b)), len(order))
    entries = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=len(order)))]).tolist()
    starts = np.cumsum([0, *parts.own]).tolist()
    borders: list[np.ndarray] = []
    for begin, end, children in zip(starts[:-1], starts[1:], parts.children, strict=True):
        touched = row[entries[begin] : entries[end]]
        later = np.unique(np.concatenate([touched, *(borders[child] for child in children)]))
        borders.append(later[later >= end])

    parent = {child: number for number, children in enumerate(parts.children) for child in children}
    depth, fronts = [0] * len(borders), list[Front]()
    for number, border in reversed(list(enumerate(borders))):
        places = np.zeros(0, dtype=np.int64)
        if number in parent:
            above = parent[number]
            depth[number] = depth[above] + 1
            begin, end = starts[above], starts[above + 1]
            places = np.where(border < end, border - begin, end - begin + np.searchsorted(borders[above], border))
        own, children = parts.own[number], parts.children[number]
        fronts.append(Front(starts[number], own, border, children, places, depth[number]))
    return Pattern(order, _inverse(order), tuple(reversed(fronts)), row, column)


def coupled(place: np.ndarray, first: np.ndarray, second: np.ndarray) -> sparse.csr_matrix:
    """Which places are coupled, both ways, and each with itself. place : of each unknown, (unknowns,)."""
    diagonal = np.arange(len(place))
    a, b = place[first], place[second]
    rows, columns = np.concatenate([a, b, diagonal]), np.concatenate([b, a, diagonal])
    return sparse.csr_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(len(place),) * 2)


def _inverse(order: np.ndarray) -> np.ndarray:
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return place
