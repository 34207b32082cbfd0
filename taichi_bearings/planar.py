"""Minimum cuts of planar grids, exactly: a cut between bottom and top is a path from left to right of the dual graph.

The faces of a grid, together with the outside on its left and the outside on its right, are the nodes of the dual
graph; each contact is an edge between the two faces beside it. The contacts that a path from the left to the right
outside crosses separate bottom from top, so the lightest cut is the shortest path (Hu, Integer Programming and Network
Flows, 1969; Reif, SIAM J. Comput. 12, 1983). The distances from the left, cut off at the least weight, are the
potential of a largest flow: across each contact they differ by no more than its weight.

Weights are rounded down to multiples of a unit, 2^-50 to 2^-52 of the least weight, so that every distance that counts
is an integer below 2^52. Flows then balance without any rounding and are admissible, however many decades the weights
span, and the least weight is wrong by at most a unit a contact of the cut.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

BUNDLE = 2_000_000  # faces that one graph holds: about 0.4 GB
TIE = 1e-12  # relative difference up to which two cuts count as equally light


@dataclass(frozen=True)
class MinimumCuts:
    """Minimum cuts of B grids of w columns and h rows, and largest flows, which have the same weight.

    above : (B, w, h), True on the top side of the cut; the contacts whose ends differ are the cut.
    sideways_flow, upward_flow : shaped as the weights, towards the higher index; balanced but in the end rows.
    sideways_shared, upward_shared : True for the contacts of any cut as light as this one.
    weight, next_weight : (B,), of this cut and of the lightest other one that leaves either side in one piece.
    """

    above: np.ndarray
    sideways_flow: np.ndarray
    upward_flow: np.ndarray
    sideways_shared: np.ndarray
    upward_shared: np.ndarray
    weight: np.ndarray
    next_weight: np.ndarray

    @property
    def unique(self) -> np.ndarray:
        """True where every other cut is heavier, (B,)."""
        return self.next_weight > self.weight * (1 + TIE)


def minimum_cuts(sideways: np.ndarray, upward: np.ndarray) -> Iterator[tuple[slice, MinimumCuts]]:
    """Cuts of least weight between the bottom row and the top row of each grid, bundle by bundle.

    sideways : weights (B, w - 1, h) along the rows, none negative; those of the bottom and the top row take no part.
    upward : weights (B, w, h - 1) along the columns, all positive; w >= 2, h >= 3.
    yields : the grids of a bundle and their cuts.
    """
    batch, columns, rows = upward.shape
    step = max(1, BUNDLE // ((columns - 1) * rows))
    for start in range(0, batch, step):
        part = slice(start, min(start + step, batch))
        yield part, _cuts_of(sideways[part, :, 1:-1], upward[part])


def _cuts_of(inner: np.ndarray, upward: np.ndarray) -> MinimumCuts:
    """The cuts of one bundle; inner : sideways weights without those of the end rows, (B, w - 1, h - 2)."""
    at_most = upward.sum(axis=1).min(axis=1)  # the weight of a straight cut
    while True:
        unit = np.ldexp(1.0, np.frexp(at_most)[1] - 52)
        path = _shortest_paths(np.floor(inner / _grids(unit)), np.floor(upward / _grids(unit)))
        coarse = path.length < 2.0**50
        if not coarse.any():
            break
        found = np.sum(inner, axis=(1, 2), where=path.inner) + np.sum(upward, axis=(1, 2), where=path.upward)
        at_most = np.where(coarse, found, at_most)
    batch, columns, gaps = upward.shape
    potential = np.empty((batch, columns + 1, gaps))
    potential[:, 0], potential[:, -1] = 0.0, path.length[:, None]
    np.minimum(path.from_left, _grids(path.length), out=potential[:, 1:-1])
    potential *= _grids(unit)
    sideways_flow, sideways_shared = (np.zeros((batch, columns - 1, gaps + 1), dtype) for dtype in (float, bool))
    sideways_flow[..., 1:-1] = -np.diff(potential[:, 1:-1], axis=2)
    sideways_shared[..., 1:-1] = path.through_inner <= _grids(path.length * (1 + TIE))
    above = np.zeros((batch, columns, gaps + 1), dtype=bool)
    np.logical_xor.accumulate(path.upward, axis=2, out=above[..., 1:])  # each crossing of the path changes the side
    return MinimumCuts(
        above=above,
        sideways_flow=sideways_flow,
        upward_flow=np.diff(potential, axis=1),
        sideways_shared=sideways_shared,
        upward_shared=path.through_upward <= _grids(path.length * (1 + TIE)),
        weight=path.length * unit,
        next_weight=path.next_length * unit,
    )


@dataclass(frozen=True)
class _Paths:
    """Shortest paths of B dual graphs from the left outside to the right one.

    length, next_length : (B,), of the path and of the shortest other path.
    from_left : distance of each face from the left outside, (B, w - 1, h - 1).
    inner, upward : masks of the contacts that the path crosses, (B, w - 1, h - 2) and (B, w, h - 1).
    through_inner, through_upward : length of the shortest walk across each contact, of the same shapes.
    """

    length: np.ndarray
    next_length: np.ndarray
    from_left: np.ndarray
    inner: np.ndarray
    upward: np.ndarray
    through_inner: np.ndarray
    through_upward: np.ndarray


def _shortest_paths(inner: np.ndarray, upward: np.ndarray) -> _Paths:
    """Distances from both outsides by Dijkstra's method, the path, and the shortest other path.

    The other path leaves the first one at some node and joins it again later on. Let the block of a node be the last
    node of the path on the way to it in the tree of shortest paths. Then the shortest other path uses one contact that
    is off the path and leads from u to v of a later block, and its length is (left to u) + weight + (v to right), least
    over all those contacts (Malik, Mittal and Gupta, Oper. Res. Lett. 8, 1989).
    """
    batch, columns, gaps = upward.shape
    shape = (batch, columns - 1, gaps)
    faces = batch * (columns - 1) * gaps
    distance, before = dijkstra(_dual_graph(inner, upward), indices=[faces, faces + 1], return_predecessors=True)
    from_left, from_right = distance[:, :faces].reshape(2, *shape)
    ends = from_left[:, -1] + upward[:, -1]
    last = ends.argmin(axis=1)
    length = ends[np.arange(batch), last]

    left_out, right_out = np.zeros((batch, 1, gaps)), np.full((batch, 1, gaps), np.inf)
    to_left = np.concatenate([left_out, from_left, right_out], axis=1)
    to_right = np.concatenate([right_out, from_right, left_out], axis=1)
    rightward = to_left[:, :-1] + upward + to_right[:, 1:]
    leftward = to_left[:, 1:] + upward + to_right[:, :-1]
    climbing = from_left[..., :-1] + inner + from_right[..., 1:]
    falling = from_left[..., 1:] + inner + from_right[..., :-1]

    on_inner, on_upward, order, steps = _trace(before[0], last, shape)
    block = _blocks(before[0, :faces], order).reshape(shape)
    outside = np.zeros((batch, 1, gaps), dtype=np.int32)
    blocks = np.concatenate([outside, block, outside + steps[:, None, None]], axis=1)
    later = np.diff(blocks, axis=1)
    other = np.where(later > 0, rightward, np.where(later < 0, leftward, np.inf))
    later = np.diff(block, axis=2)
    other_inner = np.where(later > 0, climbing, np.where(later < 0, falling, np.inf))
    return _Paths(
        length=length,
        next_length=np.minimum(
            np.min(other, axis=(1, 2), where=~on_upward, initial=np.inf),
            np.min(other_inner, axis=(1, 2), where=~on_inner, initial=np.inf),
        ),
        from_left=from_left,
        inner=on_inner,
        upward=on_upward,
        through_inner=np.minimum(climbing, falling),
        through_upward=np.minimum(rightward, leftward),
    )


def _dual_graph(inner: np.ndarray, upward: np.ndarray) -> csr_array:
    """All faces of the grids, column by column, then the left and the right outside, which edges only leave."""
    batch, columns, gaps = upward.shape
    shape = (batch, columns - 1, gaps)
    faces = batch * (columns - 1) * gaps
    face = np.arange(faces, dtype=np.int32).reshape(shape)
    beside = np.stack([face - gaps, face - 1, face + 1, face + gaps], axis=-1)
    weight = np.zeros((*shape, 4))
    weight[..., 0], weight[..., 3] = upward[:, :-1], upward[:, 1:]
    weight[..., 1:, 1], weight[..., :-1, 2] = inner, inner
    there = np.ones((*shape, 4), dtype=bool)
    there[:, 0, :, 0] = there[:, -1, :, 3] = there[..., 0, 1] = there[..., -1, 2] = False
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
    """Walk back along the paths, all at once.

    before : predecessor of each face in the tree from the left; last : gap (B,) in which each path ends.
    returns : masks of the inner and of the upward contacts that are crossed; position of each face on its path, counted
        from 1, and 0 off it, (faces,); position (B,) of the right outside.
    """
    batch, across, gaps = shape
    faces = batch * across * gaps
    inner, upward = np.zeros((batch, across, gaps - 1), dtype=bool), np.zeros((batch, across + 1, gaps), dtype=bool)
    grid, column, gap = np.arange(batch), np.full(batch, across - 1), last
    upward[grid, column + 1, gap] = True
    walked = []
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
    steps = np.zeros(batch, dtype=np.int32)
    for grid, _ in walked:
        steps[grid] += 1
    order = np.zeros(faces, dtype=np.int32)
    for back, (grid, here) in enumerate(walked):
        order[here] = steps[grid] - back
    return inner, upward, order, steps + 1


def _blocks(before: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Position of the last face of the path on the way from the left outside to each face; 0 for the outside itself."""
    faces = len(before)
    ancestor = np.where(order > 0, np.arange(faces, dtype=np.int32), before)
    ancestor = np.append(ancestor, np.int32(faces))
    while True:
        further = ancestor[ancestor]
        if np.array_equal(further, ancestor):
            return np.append(order, np.int32(0))[ancestor[:-1]]
        ancestor = further


def _grids(values: np.ndarray) -> np.ndarray:
    """(B,) as (B, 1, 1)."""
    return values[:, None, None]


__all__ = ["TIE", "MinimumCuts", "minimum_cuts"]
