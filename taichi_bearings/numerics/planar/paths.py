"""Finds shortest paths of the dual graphs of planar grids, all grids at once, and the next shortest path of each.

Letters: B grids, w columns, h rows. Faces lie between w + 1 columns (outsides included) and h - 1 gaps of rows. `inner`
are lengths (B, w - 1, h - 2) of the sideways contacts without the end rows, `upward` those (B, w, h - 1) between rows.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra


@dataclass(frozen=True)
class ShortestPaths:
    """Shortest paths of B dual graphs of planar grids with w columns and h rows. The faces of a grid are the nodes of
    its dual graph; a path leads from the outside on the left to that on the right, and crosses a contact in each step.

    length, next_length : (B,) length of the path, the sum of the weights of the contacts that it crosses; and length of
        the shortest other path.
    contacts : (B,) number of contacts that the path crosses.
    from_left : (B, w + 1, h - 1) distance of each face from the left outside. Column 0 is the left outside itself;
        column w is the right one, where infinity is stored, not `length`.
    from_right : (B, w + 1, h - 1) distance of each face from the right outside, likewise with infinity in column 0.
    inner : (B, w - 1, h - 2) mask of the contacts within a row that the path crosses; the end rows have none.
    upward : (B, w, h - 1) mask of the contacts between two rows that the path crosses.
    """

    length: np.ndarray
    next_length: np.ndarray
    contacts: np.ndarray
    from_left: np.ndarray
    from_right: np.ndarray
    inner: np.ndarray
    upward: np.ndarray

    def pick(self, which: np.ndarray) -> "ShortestPaths":
        """Return the paths of the n grids with the numbers `which`, (n,), counted from 0."""
        return ShortestPaths(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


def shortest_paths(inner: np.ndarray, upward: np.ndarray) -> ShortestPaths:
    """Return the shortest paths over the faces of B planar grids of w columns and h rows, from the outside on the left
    to that on the right. The result also has the distances of all faces from both, and the length of the shortest other
    path of each grid.

    inner : lengths (B, w - 1, h - 2) of steps across contacts along rows, without the end rows, whole numbers.
    upward : lengths (B, w, h - 1) of steps across contacts between rows, whole numbers.

    Dijkstra's method finds the distances, and a tree of shortest paths from the left. The block of a node is the last
    node of the shortest path that one passes on the way to it in this tree. The shortest other path leaves the shortest
    one and joins it again. It uses one contact off the path, which leads from a node u to a node v of a later block.
    Its length is the least (left to u) + weight + (v to right) over all such contacts (Malik, Mittal and Gupta, Oper.
    Res. Lett. 8, 1989).
    """
    batch, columns, gaps = upward.shape
    shape = (batch, columns - 1, gaps)
    faces = batch * (columns - 1) * gaps
    distance, before = dijkstra(_dual_graph(inner, upward), indices=[faces, faces + 1], return_predecessors=True)
    from_left, from_right = distance[:, :faces].reshape(2, *shape)
    # The last step leads across the last column of contacts to the right outside.
    ends = from_left[:, -1] + upward[:, -1]
    last = ends.argmin(axis=1)

    # Distances with the outsides as first and last column; the shortest path; the block of each face.
    here, nowhere = np.zeros((batch, 1, gaps)), np.full((batch, 1, gaps), np.inf)
    from_left = np.concatenate([here, from_left, nowhere], axis=1)
    from_right = np.concatenate([nowhere, from_right, here], axis=1)
    on_inner, on_upward, order, contacts = _trace(before[0], last, shape)
    block = _blocks(before[0, :faces], order).reshape(shape)
    outside = np.zeros((batch, 1, gaps), dtype=np.int32)
    blocks = np.concatenate([outside, block, outside + grids(contacts)], axis=1)
    # The shortest other path uses a contact that leads to a later block.
    rightward, leftward, climbing, falling = through(inner, upward, from_left, from_right)
    later = np.diff(blocks, axis=1)
    other = np.where(later > 0, rightward, np.where(later < 0, leftward, np.inf))
    later = np.diff(block, axis=2)
    other_inner = np.where(later > 0, climbing, np.where(later < 0, falling, np.inf))
    return ShortestPaths(
        length=ends[np.arange(batch), last],
        next_length=np.minimum(
            np.min(other, axis=(1, 2), where=~on_upward, initial=np.inf),
            np.min(other_inner, axis=(1, 2), where=~on_inner, initial=np.inf),
        ),
        contacts=contacts,
        from_left=from_left,
        from_right=from_right,
        inner=on_inner,
        upward=on_upward,
    )


def through(
    inner: np.ndarray, upward: np.ndarray, from_left: np.ndarray, from_right: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return, for each contact and both directions, the length of the shortest way from the left to the right outside
    that crosses the contact in this direction.

    inner, upward : lengths of the contacts of B grids of w columns and h rows: along rows without the end rows, (B, w -
        1, h - 2), and between rows, (B, w, h - 1).
    from_left, from_right : (B, w + 1, h - 1) distances of each face from the left and the right outside; the outsides
        are the first and the last column.
    returns : rightward and leftward across upward contacts (B, w, h - 1); climbing and falling across inner ones
        (B, w - 1, h - 2).
    """
    left, right = from_left[:, 1:-1], from_right[:, 1:-1]
    return (
        from_left[:, :-1] + upward + from_right[:, 1:],
        from_left[:, 1:] + upward + from_right[:, :-1],
        left[..., :-1] + inner + right[..., 1:],
        left[..., 1:] + inner + right[..., :-1],
    )


def _dual_graph(inner: np.ndarray, upward: np.ndarray) -> csr_array:
    """Return the dual graph of B grids as a sparse matrix (F + 2, F + 2) of the lengths of its edges. Its nodes are the
    F = B (w - 1)(h - 1) faces between neighbouring columns and rows, grid by grid and column by column; then one node
    for all that is left of the grids, and one for what is right of them. Each contact is an edge between the two faces
    beside it. Edges only lead out of the last two nodes, so that no path passes through the outside.

    inner, upward : lengths of the contacts of grids of w columns and h rows, (B, w - 1, h - 2) along rows without the
        end rows, and (B, w, h - 1) between rows.
    """
    batch, columns, gaps = upward.shape
    shape = (batch, columns - 1, gaps)
    faces = batch * (columns - 1) * gaps
    face = np.arange(faces, dtype=np.int32).reshape(shape)
    # Neighbours of a face in rising order: in the column before, below, above, in the next column.
    beside = np.stack([face - gaps, face - 1, face + 1, face + gaps], axis=-1)
    weight = np.zeros((*shape, 4))
    weight[..., 0], weight[..., 3] = upward[:, :-1], upward[:, 1:]
    weight[..., 1:, 1], weight[..., :-1, 2] = inner, inner
    there = np.ones((*shape, 4), dtype=bool)
    there[:, 0, :, 0] = there[:, -1, :, 3] = there[..., 0, 1] = there[..., -1, 2] = False
    # Rows of the matrix: the faces, then both outsides with an edge to each face beside them.
    edges = np.concatenate([there.sum(axis=-1, dtype=np.int32).ravel(), np.full(2, batch * gaps, dtype=np.int32)])
    return csr_array(
        (
            np.concatenate([weight[there], upward[:, 0].ravel(), upward[:, -1].ravel()]),
            np.concatenate([beside[there], face[:, 0].ravel(), face[:, -1].ravel()]),
            np.concatenate([[0], np.cumsum(edges)]).astype(np.int32),
        ),
        shape=(faces + 2, faces + 2),
    )


def _trace(
    before: np.ndarray, last: np.ndarray, shape: tuple[int, int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Follow the shortest paths of B grids back from the right outside to the left one, all grids at once.

    before : (faces,) predecessor of each face in the tree of shortest paths from the left outside.
    last : (B,) gap between rows in which each path ends.
    shape : that of the faces of grids of w columns and h rows, (B, w - 1, h - 1).

    Returns four arrays:

    1. mask (B, w - 1, h - 2) of the contacts along rows, without the end rows, that are crossed;
    2. mask (B, w, h - 1) of the contacts between rows that are crossed;
    3. position (faces,) of each face on its path, counted from 1, and 0 off it;
    4. position (B,) of the right outside.
    """
    batch, across, gaps = shape
    faces = batch * across * gaps
    inner, upward = np.zeros((batch, across, gaps - 1), dtype=bool), np.zeros((batch, across + 1, gaps), dtype=bool)
    grid, column, gap = np.arange(batch), np.full(batch, across - 1), last
    upward[grid, column + 1, gap] = True
    walked = []
    # One step back on all paths that have not reached the left outside; the contact between both faces is crossed.
    while len(grid):
        here = (grid * across + column) * gaps + gap
        walked.append((grid, here))
        previous = before[here]
        out = previous == faces
        new_column, new_gap = np.where(out, -1, previous // gaps % across), np.where(out, gap, previous % gaps)
        straight = new_column != column
        upward[grid[straight], np.maximum(column, new_column)[straight], gap[straight]] = True
        inner[grid[~straight], column[~straight], np.minimum(gap, new_gap)[~straight]] = True
        grid, column, gap = grid[~out], new_column[~out], new_gap[~out]
    # Places on each path, counted from its beginning.
    steps = np.zeros(batch, dtype=np.int32)
    for grid, _ in walked:
        steps[grid] += 1
    order = np.zeros(faces, dtype=np.int32)
    for back, (grid, here) in enumerate(walked):
        order[here] = steps[grid] - back
    return inner, upward, order, steps + 1


def _blocks(before: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Return for each face, (faces,), how far the shortest way to it follows the shortest path: the position on this
    path of the last face that both share; 0 if they share none. Both start at the left outside.

    before : (faces,) the face before each face on the shortest way to it; a number beyond all faces for the outside.
    order : (faces,) position of each face on the shortest path, counted from 1, and 0 off it.
    """
    faces = len(before)
    # The nearest known ancestor of each face that may be on the path; each pass doubles how far back it lies.
    ancestor = np.where(order > 0, np.arange(faces, dtype=np.int32), before)
    ancestor = np.append(ancestor, np.int32(faces))
    while True:
        further = ancestor[ancestor]
        if np.array_equal(further, ancestor):
            found: np.ndarray = np.append(order, np.int32(0))[ancestor[:-1]]
            return found
        ancestor = further


def grids(values: np.ndarray) -> np.ndarray:
    """Return numbers (grids,) in the shape (grids, 1, 1), in which they can be combined with arrays (grids, columns,
    rows) of contacts.

    values : (grids,), one number for each grid.
    """
    return values[:, None, None]


__all__ = ["ShortestPaths", "grids", "shortest_paths", "through"]
