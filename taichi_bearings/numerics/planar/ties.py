"""Which contacts belong to every minimum cut of a planar grid, and which to some: exactly, whatever the weights.

Rounded down to whole units, a path of n contacts is known to n units. Of the contacts that a lightest path may cross
there are seldom many: those on a walk longer than the shortest one by less than what rounding took from that. Among
them the same search is repeated with a finer unit. Each length is replaced by how far it exceeds the difference of the
distances of its ends from the left, which changes all walks from left to right by the same length; those excesses are
so few units that the unit can be finer by some 2^40. So it goes on until one path is left, or until no length has a
rest: all is whole numbers below 2^53, without any rounding (scaling; Gabow, J. Comput. System Sci. 31, 1985).

What is left are the contacts of all lightest paths together. One path is followed; where others leave it and come back,
its own contacts between are not in all of them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from taichi_bearings.numerics.planar.paths import ShortestPaths, grids, through

DISTANCE_BITS = 51  # of the longest distance that counts


@dataclass(frozen=True)
class _Steps:
    """Steps from face to face that a lightest path may take, (E,) each.

    grid : which of the grids. contact : which contact is crossed. tail, head : nodes.
    units : length in whole units of the grid. rest : what is missing, in [0, 1) units.
    """

    grid: np.ndarray
    contact: np.ndarray
    tail: np.ndarray
    head: np.ndarray
    units: np.ndarray
    rest: np.ndarray

    def pick(self, which: np.ndarray) -> "_Steps":
        return _Steps(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class _Tree:
    """Nodes (N,) by their distances from the left and from the right, in units.

    before : node before each one on the way from the left, negative for the left itself.
    place : how many steps along the path found, counted from the right; -1 off it.
    """

    from_left: np.ndarray
    from_right: np.ndarray
    before: np.ndarray
    place: np.ndarray

    def on_path(self, steps: _Steps) -> np.ndarray:
        """True for the steps of the path found, (E,)."""
        return (self.place[steps.head] >= 0) & (self.before[steps.head] == steps.tail)


def equal_paths(
    inner: np.ndarray, upward: np.ndarray, unit: np.ndarray, path: ShortestPaths
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A lightest path of each grid, and what other lightest ones do not share with it.

    inner, upward : weights (B, w - 1, h - 2) and (B, w, h - 1). unit : (B,). path : from these weights, rounded down.
    returns : mask of the upward contacts of a path that no other is lighter than; masks of the inner and of the upward
        contacts that are in some but not in all lightest paths.
    """
    steps, left, right = _steps_in_doubt(inner, upward, unit, path)
    steps, tree = _lightest(steps, left, right)
    own = tree.on_path(steps)
    shared = np.zeros(len(steps.grid), dtype=bool)
    shared[own] = ~_avoidable(steps, tree, own, left)[own]
    masks = []
    for chosen in (own, ~shared):
        mask = np.zeros(upward.size + inner.size, dtype=bool)
        mask[steps.contact[chosen]] = True
        masks.append((mask[: upward.size].reshape(upward.shape), mask[upward.size :].reshape(inner.shape)))
    (crossed, _), (upward_tied, inner_tied) = masks
    return crossed, inner_tied, upward_tied


def _steps_in_doubt(
    inner: np.ndarray, upward: np.ndarray, unit: np.ndarray, path: ShortestPaths
) -> tuple[_Steps, np.ndarray, np.ndarray]:
    """Steps on walks that are longer than the path by less than a unit a contact; nodes (B,) of the outsides."""
    inner_units, upward_units = np.floor(inner / grids(unit)), np.floor(upward / grids(unit))
    node = np.arange(path.from_left.size).reshape(path.from_left.shape)
    node[:, 0], node[:, -1] = node[:, 0, :1], node[:, -1, :1]  # each outside is one node
    rightward, leftward, climbing, falling = through(inner_units, upward_units, path.from_left, path.from_right)
    beside, face = (node[:, :-1], node[:, 1:]), node[:, 1:-1]
    limit, found = grids(path.length + path.contacts), []
    for length, tail, head, first in (
        (rightward, *beside, 0),
        (leftward, *beside[::-1], 0),
        (climbing, face[..., :-1], face[..., 1:], upward.size),
        (falling, face[..., 1:], face[..., :-1], upward.size),
    ):
        near = np.nonzero(length < limit)
        weight, units = (inner, inner_units) if first else (upward, upward_units)
        rest = weight[near] / unit[near[0]] - units[near]
        contact = first + np.ravel_multi_index(near, length.shape)
        found.append((near[0], contact, tail[near], head[near], units[near], rest))
    steps = _Steps(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
    nodes, ends = np.unique(np.concatenate([steps.tail, steps.head]), return_inverse=True)
    tail, head = ends.reshape(2, -1)
    left, right = (np.searchsorted(nodes, node[:, column, 0]) for column in (0, -1))
    return _Steps(steps.grid, steps.contact, tail, head, steps.units, steps.rest), left, right


def _lightest(steps: _Steps, left: np.ndarray, right: np.ndarray) -> tuple[_Steps, _Tree]:
    """The steps of all lightest paths, and a tree whose path is one of them. left, right : nodes (B,)."""
    while True:
        tree = _grow(steps, left, right)
        own = tree.on_path(steps)
        contacts = np.bincount(steps.grid[own], minlength=len(left))
        lost = np.bincount(steps.grid[own], steps.rest[own], len(left))
        spare = np.floor(lost * (1 + contacts * np.finfo(float).eps))  # the sum itself is rounded, too
        length = tree.from_left[steps.tail] + steps.units + tree.from_right[steps.head]
        steps = steps.pick(length <= (tree.from_left[right] + spare)[steps.grid])
        others = np.bincount(steps.grid, minlength=len(left)) > contacts
        if not (steps.rest[others[steps.grid]] > 0).any():
            return steps, tree
        steps = _finer(steps, tree, spare)


def _finer(steps: _Steps, tree: _Tree, spare: np.ndarray) -> _Steps:
    """The same steps by their excess, in finer units. spare : (B,), no path is longer by more."""
    factor = np.ldexp(1.0, DISTANCE_BITS - np.frexp(spare + 1)[1])[steps.grid]
    excess = tree.from_left[steps.tail] + steps.units - tree.from_left[steps.head]
    rest = factor * steps.rest
    whole = np.floor(rest)
    return _Steps(steps.grid, steps.contact, steps.tail, steps.head, factor * excess + whole, rest - whole)


def _grow(steps: _Steps, left: np.ndarray, right: np.ndarray) -> _Tree:
    """Distances by Dijkstra's method and one shortest path a grid. left, right : nodes (B,)."""
    nodes = int(max(steps.tail.max(), steps.head.max())) + 1
    ends, shape = (steps.tail.astype(np.int32), steps.head.astype(np.int32)), (nodes, nodes)
    from_left, before, _ = dijkstra(
        csr_array((steps.units, ends), shape=shape), indices=left, min_only=True, return_predecessors=True
    )
    from_right = dijkstra(csr_array((steps.units, ends[::-1]), shape=shape), indices=right, min_only=True)
    place, here, count = np.full(nodes, -1), right, 0
    while len(here):
        place[here] = count
        here, count = before[here], count + 1
        here = here[here >= 0]
    return _Tree(from_left, from_right, before, place)


def _avoidable(steps: _Steps, tree: _Tree, own: np.ndarray, left: np.ndarray) -> np.ndarray:
    """True for the steps of the path that another lightest path does not take, (E,); False for those off it.

    own : True for the steps of the path. left : nodes (B,). Steps off the path that hang together away from it leave it
    somewhere and come back. They cover all distances between: a step of the path that overlaps with one of them is not
    in the lightest path through that one.
    """
    off, nodes = steps.pick(~own), len(tree.place)
    start = np.concatenate([[0], np.cumsum(tree.place[left] + 1)[:-1]])  # of each path in one row of all of them
    ends = np.stack([off.tail, off.head])
    on = tree.place[ends] >= 0
    away = ~on.any(axis=0)
    graph = csr_array((np.ones(away.sum(), dtype=np.int8), tuple(ends[:, away].astype(np.int32))), shape=(nodes, nodes))
    label = connected_components(graph, directed=False)[1]
    group = np.where(on[0], np.where(on[1], nodes + np.arange(len(off.grid)), label[off.head]), label[off.tail])
    spot = tree.place[ends] + start[off.grid]
    length = int(start[-1] + tree.place[left[-1]] + 1)
    first, last = np.full(nodes + len(off.grid), length), np.full(nodes + len(off.grid), -1)
    for end in range(2):
        np.minimum.at(first, group[on[end]], spot[end][on[end]])
        np.maximum.at(last, group[on[end]], spot[end][on[end]])
    spans = last > first
    change = np.bincount(first[spans], minlength=length) - np.bincount(last[spans], minlength=length)
    covered = np.cumsum(change) > 0
    return own & covered[np.where(own, tree.place[steps.head] + start[steps.grid], 0)]


__all__ = ["equal_paths"]
