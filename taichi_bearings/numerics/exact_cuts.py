"""Finds what all lightest cuts of a graph have in common, exactly: in whole numbers, however large.

A cut divides the nodes into a near side, with the first node, and a far side, with the last node; its weight is the sum
of the weights of the edges between the sides. A largest flow from the first to the last node leaves capacity in some
arcs, which make up its *residual graph*. A set of nodes is the near side of a lightest cut if no arc of the residual
graph leads out of it (Picard and Queyranne, Math. Program. Study 13, 1980). It follows that

* nodes that the first one reaches along such arcs are on the near side of every lightest cut;
* nodes from which the last one is reached are on the far side of every lightest cut;
* an edge is in some lightest cut if its ends lie in different strongly connected components of the residual graph.
"""

from dataclasses import dataclass, replace
from functools import reduce
from math import gcd

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.exact_flow import exact_flow
from taichi_bearings.numerics.minimum_cut import MinimumCut, edges_of, graph_of_lattice, weight_of_cut, within_reach


@dataclass(frozen=True)
class LightestCuts:
    """What all lightest cuts of a graph have in common. A cut divides the nodes into a side with the first node and a
    side with the last one; its weight is the sum of the weights of the edges between the sides.

    near, far : (nodes,) True for nodes that are on the side of the first, or of the last, node in every lightest cut.
        Cuts that are heavier by no more than the slack of `lightest_cuts` count as lightest here.
    above : (nodes,) True on the last node's side, for the lightest cut with the fewest nodes on the other side.
    some, every : (edges,) True for edges with capacity that belong to some lightest cut, or to every one (no slack).
    residual : directed graph (nodes, nodes) of the arcs with capacity left. A lightest cut that has node i on the side
        of the first node has every node there that i reaches along these arcs.
    together : (nodes,), labels, equal for nodes that reach each other along these arcs.
    """

    near: np.ndarray
    far: np.ndarray
    above: np.ndarray
    some: np.ndarray
    every: np.ndarray
    residual: csr_array
    together: np.ndarray

    @property
    def between(self) -> np.ndarray:
        """(nodes,) True for nodes whose side is not the same, or not known to be the same, in all these cuts."""
        found: np.ndarray = ~(self.near | self.far)
        return found


def whole_numbers(values: np.ndarray) -> np.ndarray:
    """Return whole numbers of Python, an array (dtype object) of the length of `values`, whose ratios are exactly those
    of the values. They have no common divisor.

    values : (numbers,) floats, none negative.

    >>> whole_numbers(np.array([0.5, 0.75])).tolist()
    [2, 3]
    """
    part, exponent = np.frexp(values)
    parts, shifts = np.ldexp(part, 53).astype(np.int64).tolist(), exponent - exponent[values > 0].min(initial=2000)
    numbers = [n << int(shift) if n else 0 for n, shift in zip(parts, shifts, strict=True)]
    divisor = reduce(gcd, numbers, 0) or 1
    found = np.empty(len(numbers), dtype=object)
    found[:] = [number // divisor for number in numbers]
    return found


def _as_whole_numbers(weight: np.ndarray) -> np.ndarray:
    """Return the weights of edges as whole numbers of Python (dtype object) with the same ratios, exactly.

    weight : (edges,) floats; or such whole numbers, which are returned as they are.
    """
    return weight if weight.dtype == object else whole_numbers(weight)


def lightest_cuts(ends: np.ndarray, weight: np.ndarray, nodes: int, rounding: float = 0.0) -> LightestCuts:
    """Return what the lightest cuts between the first and the last node of an undirected graph have in common.

    ends : (2, edges) nodes that each edge joins.
    weight : (edges,) floats, or whole numbers of Python (dtype object), none negative. They count as exact.
    nodes : number of nodes.
    rounding : relative error of the weights. For the fields `near` and `far` of the result cuts count as lightest that
        are heavier by up to 3 * rounding * least weight. (Edges from the first to the last node, which are in every
        cut, are left out of this weight.)
    """
    last, taken = nodes - 1, (weight > 0) & (ends[0] != ends[1])
    always = taken & (np.minimum(*ends) == 0) & (np.maximum(*ends) == last)
    taken &= ~always
    # an edge without capacity from the first to the last node, so that both are there
    pairs, size = np.append(ends[:, taken], [[0], [last]], axis=1), np.append(_as_whole_numbers(weight[taken]), [0])
    # a largest flow, which is at most the capacity of all edges at the first node, or at the last one
    at_most = min(int(size[(pairs == end).any(axis=0)].sum()) for end in (0, last))
    source, sink = np.zeros((2, nodes), dtype=object)
    source[0] = sink[last] = at_most
    flow = exact_flow(pairs, size, source, sink)[0]
    left = np.stack([size - flow, size + flow])  # residual capacity, there and back
    near, far = within_reach(pairs, left, 0), within_reach(pairs, left[::-1], last)
    parted = near[pairs[0]] != near[pairs[1]]
    slack = int(3 * rounding * int(size[parted].sum())) + (rounding > 0)
    # No lightest cut divides a strongly connected component of the residual graph.
    row, column = np.concatenate([pairs, pairs[::-1]], axis=1)[:, np.asarray(left > 0, dtype=bool).ravel()]
    arcs = csr_array((np.ones(len(row), dtype=bool), (row, column)), shape=(nodes, nodes))
    label = connected_components(arcs, directed=True, connection="strong")[1]
    some, every = always.copy(), always.copy()
    some[taken] = (label[pairs[0]] != label[pairs[1]])[:-1]
    every[taken] = ((near[pairs[0]] & far[pairs[1]]) | (near[pairs[1]] & far[pairs[0]]))[:-1]
    within = (
        (within_reach(pairs, left, 0, slack), within_reach(pairs, left[::-1], last, slack)) if slack else (near, far)
    )
    return LightestCuts(*within, ~near, some, every, arcs, label)


def cuts_between(
    ends: np.ndarray, weight: np.ndarray, above: np.ndarray, between: np.ndarray, rounding: float = 0.0
) -> tuple[LightestCuts, np.ndarray]:
    """Return what all lightest cuts between the first and the last node of a graph have in common, given one of them
    and the nodes that may change sides. All other nodes of a side are merged into one node, so the search is over a
    smaller graph.

    ends : (2, edges) nodes that each edge joins.
    weight : (edges,) floats, or whole numbers of Python (dtype object), none negative.
    above : (nodes,) True for nodes on the last node's side of the lightest cut that is known.
    between : (nodes,) True for nodes whose side may differ in another lightest cut.
    rounding : relative error of the weights; cuts that are heavier by up to 3 * rounding * least weight also count as
        lightest.
    returns : the cuts of the smaller graph; and (nodes,) the node of the smaller graph that stands for each node.
    """
    last = int(between.sum()) + 1
    place = np.where(between, np.cumsum(between), np.where(above, last, 0))
    return lightest_cuts(place[ends], weight, last + 1, rounding), place


def with_exact_ties(cut: MinimumCut, weight: tuple[np.ndarray, ...], rounding: float) -> MinimumCut:
    """Return minimum cuts of R lattices of shape N, with ties decided by exact weights, whole numbers of any size.

    Of several lightest cuts the result has the lowest. Its mask `between`, of spheres that are not known to lie on one
    side of all lightest cuts, has lost the spheres that only the rounding of weights had left there.

    cut : the cuts as :func:`taichi_bearings.numerics.minimum_cut.minimum_cut` found them from these weights.
    weight : weights of the contacts, one array (R, *contacts) for each axis.
    rounding : relative error of the weights; no cut that could be as light within it is taken to be heavier.
    """
    sides, between = cut.above.copy(), cut.between.copy()
    for sample in np.flatnonzero(~cut.unique):
        own = tuple(values[sample] for values in weight)
        node, ends = graph_of_lattice(Lattice.of(own))
        above, open_ = np.zeros((2, int(node.max()) + 1), dtype=bool)
        above[node], open_[node] = cut.above[sample], between[sample]
        found, place = cuts_between(ends, edges_of(own), above, open_, rounding)
        between[sample] &= found.between[place][node]
        sides[sample] = found.above[place][node]
    found_weight = weight_of_cut(sides, weight)
    return replace(
        cut, above=sides, between=between, weight=found_weight, lower_bound=np.minimum(cut.lower_bound, found_weight)
    )


__all__ = ["LightestCuts", "cuts_between", "lightest_cuts", "whole_numbers", "with_exact_ties"]
