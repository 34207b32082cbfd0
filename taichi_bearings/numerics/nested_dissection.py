"""Direct solution of weighted grid Laplacians, many grids at once: nested dissection with dense batched fronts.

A grid (m, n) of nodes is cut into two cells by a line of nodes, each cell again, and so on down to cells of a few
nodes. From the smallest cells up, the nodes inside a cell are eliminated and what remains of it is a dense matrix on
the nodes that it shares with other cells; two cells are put together by adding their matrices and eliminating the line
between them (George 1973; the multifrontal method of Duff and Reid 1983). Cells of one size that touch the same walls
have the same pattern, so they are eliminated together, over all grids of the batch: few calls, all of them to BLAS and
LAPACK. For a square of N nodes the factor grows like N log N and the work like N^1.5.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil
from typing import NamedTuple

import numpy as np

LARGEST_LEAF = 5  # links along a side of the smallest cells, at most; 5 measured better than 3 and 9
CACHED = 500_000  # numbers in the matrices that are worked on together


@dataclass(frozen=True)
class Cell:
    """A rectangle of links and which of its sides are walls of the grid; the other sides are shared with other cells.

    sides : links along each of the two axes, one less than nodes.
    walls : low and high side along the first axis, low and high side along the second.
    """

    sides: tuple[int, ...]
    walls: tuple[bool, ...]

    @property
    def nodes(self) -> int:
        return (self.sides[0] + 1) * (self.sides[1] + 1)

    def code(self, places: np.ndarray) -> np.ndarray:
        """One number for each place (k, 2) in the cell."""
        return places[:, 0] * (self.sides[1] + 1) + places[:, 1]

    @cached_property
    def shared(self) -> np.ndarray:
        """Places (k, 2) of the nodes on sides that are no walls, in an order that survives mergers in few pieces."""
        (p, q), (left, right, bottom, top) = self.sides, self.walls
        columns = [(i, j) for i, wall in ((0, left), (p, right)) if not wall for j in range(q + 1)]
        between = range(0 if left else 1, p + 1 if right else p)
        rows = [(i, j) for j, wall in ((0, bottom), (q, top)) if not wall for i in between]
        return np.array(columns + rows, dtype=np.intp).reshape(-1, 2)

    @cached_property
    def owned(self) -> np.ndarray:
        """True (p + 1, q + 1) for the nodes that belong to this cell: of shared sides it has only the low ones."""
        owned = np.ones((self.sides[0] + 1, self.sides[1] + 1), dtype=bool)
        owned[-1] &= self.walls[1]
        owned[:, -1] &= self.walls[3]
        return owned

    def cut(self, leaf: tuple[int, int]) -> tuple[int, int] | None:
        """(axis, place) of the line that halves the longer side, in steps of `leaf`; None for a smallest cell."""
        pieces = [ceil(side / step) for side, step in zip(self.sides, leaf, strict=True)]
        if max(pieces) <= 1:
            return None
        axis = int(np.argmax([side if count > 1 else 0 for side, count in zip(self.sides, pieces, strict=True)]))
        return axis, leaf[axis] * 2 ** ((pieces[axis] - 1).bit_length() - 1)

    def halves(self, axis: int, place: int) -> tuple["Cell", "Cell"]:
        """The cells below and above a cut, which is no wall of either."""
        below, above = list(self.sides), list(self.sides)
        below[axis], above[axis] = place, self.sides[axis] - place
        walls_below, walls_above = list(self.walls), list(self.walls)
        walls_below[2 * axis + 1] = walls_above[2 * axis] = False
        return Cell(tuple(below), tuple(walls_below)), Cell(tuple(above), tuple(walls_above))


class Half(NamedTuple):
    """Where one half of the cells of a front comes from.

    cells : which cells of `front` lie in the larger cells, in their order.
    positions : index of each shared node of the half in the larger front's nodes; runs : (from, to) slices of them.
    """

    front: "Front"
    cells: slice
    positions: np.ndarray
    runs: list[tuple[slice, slice]]


class Front:
    """All cells of one kind: where they lie, which nodes they eliminate and which they pass on.

    origins : (cells, 2), grid place of each cell's lowest corner.
    nodes : places (k, 2) in the cell; the first `inside` of them are eliminated, the others are shared.
    halves : what the cells are put together from; none for the smallest cells.
    spent : fronts that no cell uses any more once the cells here are put together.
    """

    def __init__(self, cell: Cell, origins: np.ndarray, cut: tuple[int, int] | None) -> None:
        self.cell, self.origins = cell, origins
        self.halves: list[Half] = []
        self.spent: list[Front] = []
        if cut is None:
            candidates = np.argwhere(np.ones_like(cell.owned))
        else:
            axis, place = cut
            candidates = np.full((cell.sides[1 - axis] + 1, 2), place, dtype=np.intp)
            candidates[:, 1 - axis] = np.arange(len(candidates))
        inside = candidates[~np.isin(cell.code(candidates), cell.code(cell.shared))]
        self.inside = len(inside)
        self.nodes = np.concatenate([inside, cell.shared])
        self.owned = cell.owned[tuple(self.nodes.T)]

    def positions(self, places: np.ndarray) -> np.ndarray:
        """Index in `nodes` of each of these places (k, 2) in the cell."""
        code = self.cell.code(self.nodes)
        order = np.argsort(code)
        return order[np.searchsorted(code, self.cell.code(places), sorter=order)]

    def portions(self, grids: int) -> list[slice]:
        """The cells in portions whose matrices, for that many grids, stay in the processor's cache if they can."""
        step = max(1, CACHED // (grids * len(self.nodes) ** 2))
        return [slice(start, start + step) for start in range(0, len(self.origins), step)]

    def at(self, places: np.ndarray, some: slice = slice(None)) -> tuple:
        """Index of an array (B, m, n) that gives its values (B, cells, k) at places (k, 2) of some cells."""
        where = self.origins[some, None] + places
        return slice(None), where[..., 0], where[..., 1]


@lru_cache(maxsize=8)
def dissect(shape: tuple[int, int]) -> tuple[Front, ...]:
    """The fronts of a grid of `shape` nodes, from the whole grid down: larger cells come before their parts."""
    leaf = (_leaf_side(shape[0] - 1), _leaf_side(shape[1] - 1))
    fronts: list[Front] = []
    whole = Cell((shape[0] - 1, shape[1] - 1), (True,) * 4)
    waiting: dict[Cell, list[tuple[Front | None, np.ndarray]]] = {whole: [(None, np.zeros(2, dtype=np.intp))]}
    while waiting:
        cell = max(waiting, key=lambda c: c.nodes)
        uses = waiting.pop(cell)
        origins = [offset + (np.zeros((1, 2), np.intp) if large is None else large.origins) for large, offset in uses]
        cut = cell.cut(leaf)
        front = Front(cell, np.concatenate(origins), cut)
        start = 0
        for (large, offset), part in zip(uses, origins, strict=True):
            if large is not None:
                positions = large.positions(cell.shared + offset)
                large.halves.append(Half(front, slice(start, start + len(part)), positions, _runs(positions)))
            start += len(part)
        if uses[0][0] is not None:
            uses[0][0].spent.append(front)  # the largest user is the last one to be put together
        if cut is not None:
            axis, place = cut
            for half, distance in zip(cell.halves(axis, place), (0, place), strict=True):
                waiting.setdefault(half, []).append((front, distance * np.eye(2, dtype=np.intp)[axis]))
        fronts.append(front)
    return tuple(fronts)


def _leaf_side(links: int) -> int:
    """Side of the smallest cells: `links` over a power of two, rounded up, so that all cells are nearly alike."""
    pieces = 1
    while ceil(links / pieces) > LARGEST_LEAF:
        pieces *= 2
    return max(1, ceil(links / pieces))


def _runs(positions: np.ndarray) -> list[tuple[slice, slice]]:
    """(from, to) slices of the stretches of consecutive positions."""
    if len(positions) == 0:
        return []
    edges = [0, *(np.flatnonzero(np.diff(positions) != 1) + 1).tolist(), len(positions)]
    starts = positions[edges[:-1]].tolist()
    return [(slice(a, b), slice(to, to + b - a)) for a, b, to in zip(edges[:-1], edges[1:], starts, strict=True)]


class GridFactor:
    """Cholesky factor of the Laplacians of B weighted grids; `solve` then costs two passes over the factor.

    first, second : (B, m - 1, n) and (B, m, n - 1), weight of the links along each axis, 0 or more.
    anchor : (B, m, n), weight of each node's link to a fixed value, 0 or more; every node must hang on one somehow.

    Raises numpy.linalg.LinAlgError if a matrix is singular in float64.
    """

    def __init__(self, first: np.ndarray, second: np.ndarray, anchor: np.ndarray) -> None:
        self.shape = anchor.shape
        self.fronts = dissect((anchor.shape[1], anchor.shape[2]))
        # for each front, with A the matrix of its inside nodes and C their coupling to the shared ones:
        self.inverse: dict[Front, np.ndarray] = {}  # L^-1 with L L^T = A, (B, cells, inside, inside)
        self.coupling: dict[Front, np.ndarray] = {}  # L^-1 C, (B, cells, inside, shared)
        remains: dict[Front, np.ndarray] = {}
        for front in reversed(self.fronts):
            batch, s = (self.shape[0], len(front.origins)), front.inside
            shared = len(front.nodes) - s
            inverse, coupling = np.empty((*batch, s, s)), np.empty((*batch, s, shared))
            rest = np.empty((*batch, shared, shared))
            for some in front.portions(self.shape[0]):
                if front.halves:
                    matrix = _put_together(front, some, remains)
                else:
                    matrix = _leaf(front, some, first, second, anchor)
                inverse[:, some] = np.linalg.inv(np.linalg.cholesky(matrix[..., :s, :s]))
                couple = np.matmul(inverse[:, some], matrix[..., :s, s:], out=coupling[:, some])
                product = np.matmul(_transposed(couple), couple, out=rest[:, some])
                np.subtract(matrix[..., s:, s:], product, out=product)
            self.inverse[front], self.coupling[front], remains[front] = inverse, coupling, rest
            for half in front.spent:
                del remains[half]

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Node values (B, m, n) at which the Laplacian, anchors included, equals `right` (B, m, n)."""
        inside: dict[Front, np.ndarray] = {}
        passed: dict[Front, np.ndarray] = {}
        for front in reversed(self.fronts):
            if front.halves:
                load = np.zeros((self.shape[0], len(front.origins), len(front.nodes)))
                for half in front.halves:
                    load[..., half.positions] += passed[half.front][:, half.cells]
            else:
                load = right[front.at(front.nodes)] * front.owned
            inside[front] = _apply(self.inverse[front], load[..., : front.inside])
            passed[front] = load[..., front.inside :] - _apply(_transposed(self.coupling[front]), inside[front])
        values = np.empty(self.shape)
        shared = {front: np.zeros_like(load) for front, load in passed.items()}
        for front in self.fronts:
            free = inside[front] - _apply(self.coupling[front], shared[front])
            known = np.concatenate([_apply(_transposed(self.inverse[front]), free), shared[front]], axis=-1)
            for half in front.halves:
                shared[half.front][:, half.cells] = known[..., half.positions]
            if not front.halves:
                values[front.at(front.nodes)] = known
        return values


def _apply(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return np.matmul(matrix, vector[..., None])[..., 0]


def _transposed(matrix: np.ndarray) -> np.ndarray:
    return matrix.swapaxes(-1, -2)


def _put_together(front: Front, some: slice, remains: dict[Front, np.ndarray]) -> np.ndarray:
    """Matrices (B, cells, nodes, nodes) of some cells: the sum of what remains of their halves."""
    parts = [remains[half.front][:, half.cells][:, some] for half in front.halves]
    matrix = np.zeros((*parts[0].shape[:2], len(front.nodes), len(front.nodes)))
    for half, part in zip(front.halves, parts, strict=True):
        for from_row, to_row in half.runs:
            for from_column, to_column in half.runs:
                matrix[..., to_row, to_column] += part[..., from_row, from_column]
    return matrix


def _leaf(front: Front, some: slice, first: np.ndarray, second: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    """Laplacians (B, cells, nodes, nodes) of the links and anchors that some of the smallest cells own."""
    places, size = np.argwhere(front.cell.owned), len(front.nodes)
    lows, highs, weights = [], [], []
    for axis, links in enumerate((first, second)):
        low = places[places[:, axis] < front.cell.sides[axis]]
        lows.append(front.positions(low))
        highs.append(front.positions(low + np.eye(2, dtype=np.intp)[axis]))
        weights.append(links[front.at(low, some)])
    low, high, weight = np.concatenate(lows), np.concatenate(highs), np.concatenate(weights, axis=-1)
    ends = np.zeros((len(low), size))
    ends[np.arange(len(low)), low] = ends[np.arange(len(low)), high] = 1.0
    matrix = np.zeros((*weight.shape[:2], size, size))
    matrix[..., low, high] = matrix[..., high, low] = -weight
    matrix[..., np.arange(size), np.arange(size)] = weight @ ends + anchor[front.at(front.nodes, some)] * front.owned
    return matrix
