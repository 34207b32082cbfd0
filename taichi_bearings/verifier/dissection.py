"""Nested dissection of a graph whose nodes have places: an order in which elimination fills in little.

A region is halved across each of its axes in turn. The least set of nodes that meets every edge between the two halves,
a least cover of a bipartite graph (König), separates what is left of them and is eliminated last; the axis with the
smallest one is taken. All regions of a level are worked on at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_bipartite_matching

LEAF = 150  # nodes of a region that is not divided


@dataclass(frozen=True)
class Part:
    """One of the parts of a graph. nodes : its own, which touch none outside it but in the parts above it.

    children : numbers of the parts that it separates, all before its own.
    """

    nodes: np.ndarray
    children: list[int]


def dissected(graph: sparse.coo_array, place: np.ndarray) -> list[Part]:
    """Parts of a symmetric graph (n, n) whose nodes have these coordinates (d, n), children before parents."""
    first, second = (end[graph.row > graph.col] for end in (graph.row, graph.col))
    count = graph.shape[0]
    alone, own = connected_components(graph, directed=False)
    parent, part, active = [np.full(alone, -1)], np.empty(count, dtype=np.int64), np.arange(count)
    while True:
        # regions are numbered from 0 on a level, parts from `begin` on
        begin = sum(map(len, parent)) - len(parent[-1])
        part[active] = begin + own[active]
        active = active[np.bincount(own[active], minlength=1)[own[active]] > LEAF]
        if not len(active):
            return _in_postorder(np.concatenate(parent), part)
        large = np.zeros(count, dtype=bool)
        large[active] = True
        inside = large[first] & large[second]
        first, second = first[inside], second[inside]
        side, cover = _best_cut(first, second, own, active, place)
        active = active[~cover[active]]
        halves, own[active] = np.unique(2 * own[active] + side[active], return_inverse=True)
        parent.append(begin + halves // 2)


def _best_cut(
    first: np.ndarray, second: np.ndarray, region: np.ndarray, active: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Masks (n,): the upper half of each region of active nodes, and the separator of the halves."""
    side, cover = np.zeros((2, len(region)), dtype=bool)
    least = np.full(len(region), len(region))  # of the region of each node
    for coordinate in place:
        halved = _upper_half(coordinate, region, active)
        cut = halved[first] != halved[second]
        low = np.where(halved[first], second, first)[cut]
        found = _least_cover(low, np.where(halved[first], first, second)[cut], len(region))
        size = np.bincount(region[found], minlength=len(region))[region]
        better = size < least
        side, cover = np.where(better, halved, side), np.where(better, found, cover)
        least = np.minimum(size, least)
    return side, cover


def _upper_half(coordinate: np.ndarray, region: np.ndarray, active: np.ndarray) -> np.ndarray:
    """Mask (n,) of the active nodes beyond the median of their region."""
    order = active[np.lexsort((coordinate[active], region[active]))]
    size = np.bincount(region[active], minlength=1)
    rank = np.arange(len(order)) - (np.cumsum(size) - size)[region[order]]
    upper = np.zeros(len(region), dtype=bool)
    upper[order] = 2 * rank >= size[region[order]]
    return upper


def _least_cover(low: np.ndarray, high: np.ndarray, count: int) -> np.ndarray:
    """Mask (count,) of fewest nodes that meet every edge from a node of one side to one of the other."""
    edges = sparse.csr_array((np.ones(len(low), dtype=np.int8), (low, high)), shape=(count, count))
    mate = maximum_bipartite_matching(edges, perm_type="column")
    lower, matched = np.unique(low), np.flatnonzero(mate >= 0)
    free = lower[mate[lower] < 0]
    source = 2 * count  # to free nodes below, from there by any edge, and back by those that are matched
    begin = np.concatenate([low, count + mate[matched], np.full(len(free), source)])
    end = np.concatenate([count + high, matched, free])
    walk = sparse.csr_array((np.ones(len(begin), dtype=np.int8), (begin, end)), shape=(source + 1, source + 1))
    reached = np.zeros(source + 1, dtype=bool)
    reached[breadth_first_order(walk, source, return_predecessors=False)] = True
    cover = reached[count:source].copy()
    cover[lower[~reached[lower]]] = True
    return cover


def _in_postorder(parent: np.ndarray, part: np.ndarray) -> list[Part]:
    """Parts in an order in which few that are done wait for their parents."""
    children: list[list[int]] = [[] for _ in parent]
    for child in np.flatnonzero(parent >= 0):
        children[parent[child]].append(int(child))
    order, waiting = [], np.flatnonzero(parent < 0).tolist()
    while waiting:  # parents first, and backwards
        order.append(waiting.pop())
        waiting += children[order[-1]]
    order.reverse()
    number = {old: new for new, old in enumerate(order)}
    nodes = np.split(np.argsort(part, kind="stable"), np.cumsum(np.bincount(part, minlength=len(parent)))[:-1])
    return [Part(nodes[old], [number[child] for child in children[old]]) for old in order]
