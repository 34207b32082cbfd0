"""Nested dissection of a graph whose nodes have coordinates: an order in which elimination fills in little.

A region is a set of nodes; at first there is one for each connected piece of the graph. It is halved across an axis.
The smallest set of nodes that meets every edge between the two halves, a least vertex cover of a bipartite graph
(König), separates what is left of them and is eliminated last. Of all axes the one with the smallest separator is
taken. All regions of a level are worked on at once. An active node is one that is in no separator yet.

Numbers of nodes and parts are from 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from threading import Lock

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_flow


@dataclass(frozen=True)
class Part:
    """One part of a divided graph: a separator, the nodes that separate the halves of a region; or all nodes of a
    region that is not divided. Below a separator are the parts of the two halves.

    nodes : numbers of its own nodes. Their neighbours are in the part itself, in parts above it, or in parts below it.
    children : numbers of the parts next below it, all smaller than its own number.
    """

    nodes: np.ndarray
    children: list[int]


KEPT_DIVISIONS = 8  # so many divisions are kept in memory, those used last
MOST_KEPT_NODES = 200_000  # the division of a graph with more nodes is not kept
_kept: dict[bytes, list[Part]] = {}
_keeping = Lock()


def dissected(graph: sparse.csc_array | sparse.csr_matrix, place: np.ndarray, leaf: int, whole: int = 0) -> list[Part]:
    """Return the parts of a graph, children before parents: separators, and regions that are not divided further.

    graph : (nodes, nodes), symmetric; an entry joins two nodes. One triangle of it is enough if its entries are stored
        with the larger node of each pair in `indices`.
    place : (coordinates, nodes), where the nodes lie.
    leaf : largest number of nodes of a region that is not divided.
    whole : largest number of nodes of a connected piece of the graph that is not divided, if that is more than `leaf`.

    Recent results are kept: methods and proofs of one network, and of samples that share it, ask for the same division
    again and again.
    """
    if graph.shape[0] > MOST_KEPT_NODES:
        return _divided(graph, place, leaf, whole)
    arrays = graph.indptr, graph.indices, place
    key = blake2b(f"{[(of.shape, of.dtype) for of in arrays]} {leaf} {whole}".encode())
    for values in arrays:
        key.update(np.ravel(values).data)
    name = key.digest()
    found = _kept.get(name) or _divided(graph, place, leaf, whole)
    with _keeping:
        _kept.pop(name, None)
        _kept[name] = found  # as the last one used
        while len(_kept) > KEPT_DIVISIONS:
            del _kept[next(iter(_kept))]
    return found


def restricted(parts: list[Part], node: np.ndarray, leaf: int) -> list[Part]:
    """Return the parts of a new graph, children before parents, made from the parts of a graph that was divided before.
    No separator is looked for, so this takes far less time than a new division.

    parts : the parts of the divided graph.
    node : (nodes,), the node of the divided graph to which each node of the new graph belongs. Nodes of the new graph
        may be joined only if they belong to one node of the divided graph, or to two that are joined.
    leaf : a part and all parts below it become one part if together they have at most so many nodes. Parts without
        nodes are left out.
    """
    size = sum(len(part.nodes) for part in parts)
    owner, parent = np.empty(size, dtype=np.intp), np.full(len(parts), -1)
    for number, part in enumerate(parts):
        owner[part.nodes], parent[part.children] = number, number
    # new nodes of each part, and those of the part with all parts below it
    own = np.bincount(owner[node], minlength=len(parts))
    below = own.copy()
    for number, above in enumerate(parent.tolist()):
        if above >= 0:
            below[above] += below[number]
    # for each part: the part into which its nodes go, itself or the highest one above it that becomes one with all
    # parts below it; and the nearest part above it that has new nodes
    becomes, higher = np.arange(len(parts)), np.full(len(parts), -1)
    for number, above in reversed(list(enumerate(parent.tolist()))):
        if above < 0:
            continue
        higher[number] = above if own[above] else higher[above]
        if below[above] <= leaf:
            becomes[number] = becomes[above]
    # parts that have nodes are numbered anew, in their order
    of_node = becomes[owner[node]]
    number_of = np.cumsum(np.bincount(of_node, minlength=len(parts)) > 0) - 1
    order = np.argsort(of_node, kind="stable")
    found = [Part(nodes, []) for nodes in np.split(order, np.flatnonzero(np.diff(of_node[order])) + 1)]
    for number in np.unique(of_node).tolist():
        if higher[number] >= 0:
            found[number_of[higher[number]]].children.append(int(number_of[number]))
    return found


def _divided(graph: sparse.csc_array | sparse.csr_matrix, place: np.ndarray, leaf: int, whole: int = 0) -> list[Part]:
    """Return the parts of a graph, children before parents, as `dissected` does, but without keeping them in memory.

    graph : (nodes, nodes), symmetric; an entry joins two nodes.
    place : (coordinates, nodes), where the nodes lie.
    leaf : largest number of nodes of a region that is not divided.
    whole : largest number of nodes of a connected piece of the graph that is not divided, if that is more than `leaf`.
    """
    count = graph.shape[0]
    second = np.repeat(np.arange(count), np.diff(graph.indptr))
    # each edge once, and the connected pieces, which are the first regions
    once = graph.indices > second
    first, second = graph.indices[once].astype(np.intp), second[once]
    begin = np.append(0, np.cumsum(np.bincount(second, minlength=count)))
    pieces, region = connected_components(
        sparse.csr_array((np.ones(len(first)), first, begin), shape=graph.shape), directed=False
    )
    ordered = np.argsort(place, axis=1, kind="stable")  # active nodes along each axis
    parent, part, active = [np.full(pieces, -1)], np.empty(count, dtype=np.int64), np.arange(count)
    most = max(leaf, whole)  # nodes of a region of this level that is not divided
    while True:
        # regions are numbered from 0 on a level, parts from `first_part` on
        first_part = sum(map(len, parent)) - len(parent[-1])
        part[active] = first_part + region[active]
        active, most = active[np.bincount(region[active], minlength=1)[region[active]] > most], leaf
        if not len(active):
            return _in_postorder(np.concatenate(parent), part)
        # only edges inside regions that are still to be divided matter further on
        large = np.zeros(count, dtype=bool)
        large[active] = True
        inside = large[first] & large[second]
        first, second = first[inside], second[inside]
        ordered = ordered[large[ordered]].reshape(len(place), -1)
        # separators stay with the part of their region; its two halves are the regions of the next level
        side, cover = _best_cut(first, second, region, ordered)
        active = active[~cover[active]]
        halves, region[active] = np.unique(2 * region[active] + side[active], return_inverse=True)
        parent.append(first_part + halves // 2)


def _best_cut(
    first: np.ndarray, second: np.ndarray, region: np.ndarray, ordered: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return two masks (nodes,). The first marks the upper half of each region; each region is halved across the axis
    along which fewest nodes separate the halves. The second marks these separating nodes.

    first, second : (edges,), numbers of the two nodes of each edge.
    region : (nodes,) number of the region of each node.
    ordered : (axes, active nodes), numbers of the nodes that are in no separator yet, in order along each axis.
    """
    halved = np.stack([_upper_half(along, region) for along in ordered])
    covers = np.stack([_least_cover(*_across(first, second, upper), len(region)) for upper in halved])
    sizes = [np.bincount(region[cover], minlength=int(region.max()) + 1) for cover in covers]
    best, node = np.argmin(sizes, axis=0)[region], np.arange(len(region))
    return halved[best, node], covers[best, node]


def _upper_half(ordered: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Return the mask (nodes,) of the nodes beyond the median of their region along an axis.

    ordered : (active nodes,), numbers of the nodes that are in no separator yet, in their order along the axis.
    region : (nodes,) number of the region of each node.
    """
    # sorted by region, and within each by the place along the axis: the second half of each is its upper half
    own = region[ordered]
    order = np.argsort(own.astype(np.uint16) if own.max() < 2**16 else own, kind="stable")
    size = np.bincount(own)
    middle = np.cumsum(size) - size // 2
    upper = np.zeros(len(region), dtype=bool)
    upper[ordered[order]] = np.arange(len(order)) >= middle[own[order]]
    return upper


def _across(first: np.ndarray, second: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays (joining edges,), with an entry for each edge that joins the two halves of a region: the number
    of its node in the lower half, and that of its node in the upper half.

    first, second : (edges,), numbers of the two nodes of each edge.
    upper : (nodes,) mask of the upper halves.
    """
    at = np.flatnonzero(upper[first] != upper[second])
    first, second = first[at], second[at]
    swapped = upper[first]
    return np.where(swapped, second, first), np.where(swapped, first, second)


def _least_cover(low: np.ndarray, high: np.ndarray, count: int) -> np.ndarray:
    """Return a mask (count,) of the smallest set of nodes that contains an end of every edge between two sides.

    low, high : (edges,), numbers of the nodes of each edge on the lower and on the upper side.
    count : number of all nodes.

    The set is found as a minimum cut of a network in which a flow of 1 can pass through each node, from a source to the
    lower nodes, along the edges, and from the upper nodes to a sink. Of all minimum cuts the one nearest to the source
    is taken, whichever largest flow was found. SciPy's own matchings can take minutes.
    """
    (lower, begin), (upper, end) = (_numbered(side, count) for side in (low, high))
    below, above = len(lower), len(upper)
    source, sink = below + above, below + above + 1
    # rows in order: edges of each lower node, then those of the upper nodes to the sink, then those of the source
    order = np.argsort(begin * np.int64(above) + end)
    second = np.concatenate([below + end[order], np.full(above, sink), np.arange(below)]).astype(np.int32)
    outgoing = np.concatenate([np.bincount(begin, minlength=below), np.ones(above, dtype=np.int64), [below, 0]])
    starts = np.append(0, np.cumsum(outgoing)).astype(np.int32)
    capacity = sparse.csr_array((np.ones(len(second), dtype=np.int32), second, starts), shape=(sink + 1, sink + 1))
    capacity.sum_duplicates()
    left = sparse.csr_array(capacity - maximum_flow(capacity, source, sink).flow)
    left.eliminate_zeros()
    # nodes on the lower side that the source no longer reaches, and those on the upper side that it does
    reached = np.zeros(sink + 1, dtype=bool)
    reached[breadth_first_order(left, source, return_predecessors=False)] = True
    cover = np.zeros(count, dtype=bool)
    cover[lower[~reached[:below]]], cover[upper[reached[below:source]]] = True, True
    return cover


def _numbered(nodes: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays: the numbers in `nodes` without repetitions, (m,), in rising order; and for each entry of
    `nodes` its index in the first array, (n,).

    nodes : (n,), numbers of nodes, which may repeat.
    count : number of all nodes.
    """
    there = np.zeros(count, dtype=bool)
    there[nodes] = True
    return np.flatnonzero(there), (np.cumsum(there) - 1)[nodes]


def _in_postorder(parent: np.ndarray, part: np.ndarray) -> list[Part]:
    """Return the parts with children before parents, in an order in which few finished ones wait for their parents.

    parent : (parts,), number of the part above each, or -1.
    part : (nodes,), number of the part of each node.
    """
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
