"""All lightest cuts of a graph, exactly: in whole numbers, however large.

A largest flow leaves capacity in arcs, its *residual graph*. A set of nodes is the near side of a lightest cut if no
arc with capacity left leads out of it (Picard and Queyranne, Math. Program. Study 13, 1980). So the nodes that the
first one reaches along such arcs are on the near side of every lightest cut, those that reach the last one on the far
side, and an edge is in some lightest cut if its ends lie in different strongly connected components.
"""

from dataclasses import dataclass, replace
from functools import reduce
from math import gcd

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.exact_flow import exact_flow
from taichi_bearings.numerics.minimum_cut import MinimumCut, edges_of, graph_of_lattice, within_reach


@dataclass(frozen=True)
class LightestCuts:
    """What the cuts between the first and the last node of a graph that are heavier than the lightest one by no more
    than a slack have in common, and what the lightest ones have.

    near, far : (nodes,) True on the side of the first, of the last node in every cut within the slack. above : (nodes,)
        True on the far side of the lightest cut that has most nodes there. some, every : (edges,) True for the edges
        with capacity of some, of every lightest cut.
    """

    near: np.ndarray
    far: np.ndarray
    above: np.ndarray
    some: np.ndarray
    every: np.ndarray

    @property
    def between(self) -> np.ndarray:
        """(nodes,) True for those that are not known to lie on one side."""
        return ~(self.near | self.far)


def whole_numbers(values: np.ndarray) -> np.ndarray:
    """(n,) whole numbers of Python in the proportions of floats >= 0, exactly, without a common divisor."""
    part, exponent = np.frexp(values)
    parts, shifts = np.ldexp(part, 53).astype(np.int64).tolist(), exponent - exponent[values > 0].min(initial=2000)
    numbers = [n << int(shift) if n else 0 for n, shift in zip(parts, shifts, strict=True)]
    divisor = reduce(gcd, numbers, 0) or 1
    found = np.empty(len(numbers), dtype=object)
    found[:] = [number // divisor for number in numbers]
    return found


def _whole(weight: np.ndarray) -> np.ndarray:
    return weight if weight.dtype == object else whole_numbers(weight)


def lightest_cuts(ends: np.ndarray, weight: np.ndarray, nodes: int, rounding: float = 0.0) -> LightestCuts:
    """The lightest cuts of an undirected graph between its first and its last node.

    ends : (2, edges) nodes. weight : (edges,) floats or whole numbers of Python (dtype object), none negative, taken as
    they are. nodes : number of them. rounding : the slack is three times this share of the lightest weight, edges from
    the first to the last node apart.
    """
    last, taken = nodes - 1, (weight > 0) & (ends[0] != ends[1])
    always = taken & (np.minimum(*ends) == 0) & (np.maximum(*ends) == last)
    taken &= ~always
    # an edge without capacity from the first to the last node, so that both are there
    pairs, size = np.append(ends[:, taken], [[0], [last]], axis=1), np.append(_whole(weight[taken]), [0])
    at_most = min(int(size[(pairs == end).any(axis=0)].sum()) for end in (0, last))
    source, sink = np.zeros((2, nodes), dtype=object)
    source[0] = sink[last] = at_most
    flow = exact_flow(pairs, size, source, sink)[0]
    left = np.stack([size - flow, size + flow])
    near, far = within_reach(pairs, left, 0), within_reach(pairs, left[::-1], last)
    parted = near[pairs[0]] != near[pairs[1]]
    slack = int(3 * rounding * int(size[parted].sum())) + (rounding > 0)
    row, column = np.concatenate([pairs, pairs[::-1]], axis=1)[:, np.asarray(left > 0, dtype=bool).ravel()]
    arcs = csr_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(nodes, nodes))
    label = connected_components(arcs, directed=True, connection="strong")[1]
    some, every = always.copy(), always.copy()
    some[taken] = (label[pairs[0]] != label[pairs[1]])[:-1]
    every[taken] = ((near[pairs[0]] & far[pairs[1]]) | (near[pairs[1]] & far[pairs[0]]))[:-1]
    within = (
        (within_reach(pairs, left, 0, slack), within_reach(pairs, left[::-1], last, slack)) if slack else (near, far)
    )
    return LightestCuts(*within, ~near, some, every)


def cuts_between(
    ends: np.ndarray, weight: np.ndarray, above: np.ndarray, between: np.ndarray, rounding: float = 0.0
) -> tuple[LightestCuts, np.ndarray]:
    """The lightest cuts where only some nodes are not known to lie on one side, and the node of each node among them.

    above, between : (nodes,) True on the far side of a lightest cut; True for those that may lie on the other side. All
    others of a side are one node.
    """
    last = int(between.sum()) + 1
    place = np.where(between, np.cumsum(between), np.where(above, last, 0))
    return lightest_cuts(place[ends], weight, last + 1, rounding), place


def decided(cut: MinimumCut, weight: tuple[np.ndarray, ...], rounding: float) -> MinimumCut:
    """The same cuts with fewer spheres between them: those that a flow in machine numbers leaves there are tried in
    whole numbers of any size. weight, rounding : what :func:`taichi_bearings.numerics.minimum_cut.minimum_cut` had."""
    between = cut.between.copy()
    for sample in np.flatnonzero(~cut.unique):
        own = tuple(values[sample] for values in weight)
        node, ends = graph_of_lattice(Lattice.of(own))
        above, open_ = np.zeros((2, int(node.max()) + 1), dtype=bool)
        above[node], open_[node] = cut.above[sample], between[sample]
        found, place = cuts_between(ends, edges_of(own), above, open_, rounding)
        between[sample] &= found.between[place][node]
    return replace(cut, between=between)


__all__ = ["LightestCuts", "cuts_between", "decided", "lightest_cuts", "whole_numbers"]
