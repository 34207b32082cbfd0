"""Which contacts slip at every minimum, at some or at none, where one component of the spins matters: theorem 6.

This covers all of 2D, and cubic lattices driven about x or y. The power has no curvature there: it is the sum of mu F_n
|slip|, and minima are mixtures of cuts.

Symbols
    u : spin times radius along the component, with signs such that a contact slips by u_high - u_low between its nodes.
    m : number of the contacts that this component makes slip. Each is an edge between two nodes of a graph.
    f : friction of an edge, with the sign of the slip that would go with it; between -mu F_n and mu F_n.
    step : difference between two successive imposed values in a connected part of the graph.
    E : excess, the power of the given spins less what the friction proves.
    cut : parts the nodes into those above and those below; driven nodes lie as the values imposed on them. Its weight
        is the sum of mu F_n over the edges between both sides.

The proof
1. At a minimum the nodes with u above almost any number between two imposed values are one side of a lightest cut of
   this step. A contact slips if its ends are on different sides of such a cut.
2. Friction in balance leaves little unused on lightest cuts. An edge from below to above such a cut has mu F_n - f <= E
   / step, one from above to below mu F_n + f <= E / step. So if mu F_n - f > E / step and the upper end is above, then
   the lower end is above, too: "above" follows along such edges.
3. Nodes that follow from driven ones above are above every lightest cut, and so for those below. Nodes that follow from
   each other are on one side. That decides contacts one by one.
4. Where cuts tie, the contacts that are left are decided in whole numbers (numerics/exact_cuts.py): which are in all
   lightest cuts, in some, in none.

Where loops have an odd number of contacts no signs fit. Then every sphere has two nodes, u and -u, and every contact
two edges (double cover); both together have twice the excess.

Example. A chain bottom - a - b - top of discs whose contacts have mu F_n = 3, 1, 2, and one step of 1. Friction in
balance is 1 everywhere, so E = 0 at the minimum, and mu F_n - f = 2, 0, 1. "Above" follows from a to bottom and from
top to b, so a is below and b above: only the contact a - b slips, at every minimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components

from taichi_bearings.numerics.exact_cuts import cuts_between, whole_numbers
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.enclosure import UP, Enclosure, joined
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, TIED, UNDECIDED

NEARLY_LEAST = 1e-9  # excess over the power, up to which cuts are counted in whole numbers
MOST_COUNTED = 40_000  # most contacts of a sample for which that is done
MOST_LEVELS = 100  # most steps between imposed values of a part that are looked at, the largest ones


@dataclass(frozen=True)
class CutGraph:
    """A graph whose lightest cuts give the minima of the power along one spin component, for all samples side by side.

    Nodes are spheres, edges are contacts. A cut divides the nodes into those whose u (spin times radius, times a sign
    that differs between neighbours) is above some number and those below. Its weight is the sum of the friction limits
    mu F_n of the edges between both sides. Where loops of an odd number of contacts allow no such signs (`is_double`),
    each sphere has two nodes, u and -u, and each contact two edges.

    own : (m,), indices in the network of the contacts that the component makes slip.
    low, high : (q,), nodes of each edge, q = m or 2 m; the contact slips by u at `high` less u at `low`.
    up, down : (q,), lower bounds of mu F_n - f and of mu F_n + f: what a contact has left of its friction limit if it
        slips upwards or downwards. Here f is its friction, positive if it goes with a slip upwards.
    label : (nodes,), the number of the connected part of each node.
    node, value : (d,), the driven nodes and the values of u imposed on them, sorted by part and value.
    is_double : True if there are loops of an odd number of contacts."""

    own: np.ndarray
    low: np.ndarray
    high: np.ndarray
    up: np.ndarray
    down: np.ndarray
    label: np.ndarray
    node: np.ndarray
    value: Enclosure
    is_double: bool

    @classmethod
    def of(cls, bounds: Bounds, k: int) -> CutGraph:
        """Return the graph for component k of the spins: a node for each sphere, an edge for each contact that this
        component makes slip; two of either if some loop has an odd number of contacts.

        bounds : bounds on the power, with the network and its friction. The friction is divided by `bounds.worst`, so
            that none exceeds its limit."""
        network, count = bounds.network, len(bounds.network.free)
        own = np.flatnonzero(network.feels[k])
        first, second = network.graph.contact[:, own]
        label, odd, sign = network.signs(k)
        # Friction along the component, divided such that none exceeds its limit.
        pull = network.moment[k].at(own)
        if (bounds.worst > 1).any():
            pull = pull / Enclosure.exact(bounds.worst[network.sample_of(own)])
        strength = network.holding.at(own)
        held = np.unique(network.graph.contact[:, own])
        held = held[~network.free[held]]
        is_double = bool(odd[first].any())
        if is_double:  # nodes u and -u of each sphere, so that u_i + u_j is high less low, in either copy
            low, high = np.append(second + count, first + count), np.append(first, second)
            pull, strength = joined([pull, pull]), joined([strength, strength])
            label = pieces(2 * count, low, high)
            imposed = network.imposed[k].at(held)
            node, value = np.append(held, held + count), joined([imposed, -imposed])
        else:
            low, high, pull = first, second, pull.signed(sign[second])
            node, value = held, network.imposed[k].signed(sign).at(held)
        up, down = (strength - pull).lower(), (strength + pull).lower()
        order = np.lexsort((value.low, value.high, label[node]))
        return cls(own, low, high, up, down, label, node[order], value[order], is_double)

    def follows(self, margin: np.ndarray) -> sparse.csr_array:
        """Return a directed graph of the nodes, a matrix (nodes, nodes): an edge leads from i to j if every lightest
        cut that has i above it is known to have j above it, too.

        This is known of the two ends of an edge of the cut graph, in a direction in which its friction f leaves more of
        its limit mu F_n unused than the edge could on a lightest cut.

        margin : (q,), for each edge the most of mu F_n that may stay unused if the edge crosses a lightest cut: (power
            less its proven lower bound) / (difference of the two imposed spins times radius that the cut separates).
            The first is that of the sample of the edge, and twice that if spheres have two nodes; the second is that of
            its connected part.
        """
        size, rises, falls = len(self.label), self.up > margin, self.down > margin
        tail, head = np.append(self.high[rises], self.low[falls]), np.append(self.low[rises], self.high[falls])
        return sparse.csr_array((np.ones(len(tail), dtype=np.int8), (tail, head)), shape=(size, size))


def states_by_cuts(bounds: Bounds, k: int) -> np.ndarray:
    """Return the states (m,) of all m contacts of a network with friction alone in which minima slip along component k
    of the spins only.

    Sort the values imposed on the driven spheres of a connected part. Between two successive ones, a *step*, a cut
    divides its spheres into two sides. It is lightest if the friction limits of the contacts between the sides have the
    least sum. Minima are mixtures of lightest cuts, one for each step. So a contact is

    * SLIPPING if for some step it is between the sides of every lightest cut;
    * SLIPLESS if for all steps it is within one side of every lightest cut;
    * TIED if there is one step only, and it is in some of its lightest cuts, but not in all;
    * UNDECIDED if stored friction and excess of power do not tell.

    bounds : the network, its friction, and the excess of the power over what the friction proves."""
    network, graph = bounds.network, CutGraph.of(bounds, k)
    own, low, high, label, node = graph.own, graph.low, graph.high, graph.label, graph.node
    sample, part, size, copies = network.sample_of(own), label[node], len(label), 1 + graph.is_double
    # Steps between successive imposed values of a part, and their rank by size in each part, the largest first.
    step = graph.value[1:] - graph.value[:-1]
    differs = (graph.value.high[1:] != graph.value.high[:-1]) | (graph.value.low[1:] != graph.value.low[:-1])
    steps = np.flatnonzero(differs & (part[1:] == part[:-1]))
    steps = steps[np.lexsort((-step.high[steps], part[steps]))]
    rank = np.arange(len(steps)) - np.searchsorted(part[steps], part[steps])
    # For each edge: the sum of the sizes of the steps at which it may slip; whether it is surely on one side of all
    # lightest cuts of a step; whether it slips, or is tied; whether its part has one step alone.
    open_ = np.bincount(part[steps], np.where(rank < MOST_LEVELS, 0.0, step.most[steps]), size)[label[low]]
    alike, slips, tied = (np.full(len(low), of) for of in (True, False, False))
    once = (np.bincount(part[steps], minlength=size) == 1)[label[low]]
    for number in range(min(int(rank.max(initial=-1)) + 1, MOST_LEVELS)):
        # One step of each part at a time: where it begins in the list of driven nodes, and bounds of its size.
        mine = steps[rank == number]
        begin, most, least = np.full(size, len(node)), np.zeros(size), np.zeros(size)
        begin[part[mine]], most[part[mine]], least[part[mine]] = mine, step.most[mine], step[mine].lower()
        margin = copies * np.tile(bounds.excess[sample], copies) / np.maximum(least[label[low]], 0.0) * UP
        follows = graph.follows(margin)
        # Nodes above and below every lightest cut, as they follow from driven ones; then edges on one side, and across.
        together = connected_components(follows, directed=True, connection="strong")[1]
        place, known = np.arange(len(node)), begin[part] < len(node)
        above = reached(follows, node[known & (place > begin[part])])
        below = reached(follows.T.tocsr(), node[known & (place <= begin[part])])
        alike = (together[low] == together[high]) | (above[low] & above[high]) | (below[low] & below[high])
        apart = (above[low] & below[high]) | (below[low] & above[high])
        if not (graph.is_double or (alike | apart).all()):
            near, some, every = _in_whole_numbers(bounds, own, np.stack([low, high]), above, below)
            alike[near], apart[near] = ~some, every
            tied[near] |= some & ~every & once[near]
        slips |= apart
        open_ = open_ + np.where(alike, 0.0, most[label[low]])
    slips, tied, open_ = slips[: len(own)], tied[: len(own)], open_[: len(own)]
    states = np.where(network.acts & network.counts & network.feels[k], UNDECIDED, SLIPLESS)
    states[own] = np.select([slips, tied, open_ == 0], [SLIPPING, TIED, SLIPLESS], UNDECIDED)
    return states


def _in_whole_numbers(
    bounds: Bounds, own: np.ndarray, ends: np.ndarray, above: np.ndarray, below: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decide with whole numbers, and so exactly, which contacts belong to lightest cuts, where several cuts have
    (nearly) the same weight.

    A cut divides the spheres into two sides; its weight is the sum of the friction limits of the contacts between them.
    Only contacts are decided that have an end which is neither in `above` nor in `below`. Samples are left out whose
    excess, power less its proven lower bound, is above NEARLY_LEAST of the power, or that have more than MOST_COUNTED
    such contacts.

    bounds : the network, its friction, and the excess of each sample.
    own : (m,), indices in the network of the contacts that are looked at.
    ends : (2, m), the two spheres of each.
    above, below : (spheres,), masks of the spheres that are proven to be above, or below, every lightest cut.

    Returns the positions (q,) in `own` of the contacts that were decided; the mask (q,) of those that are in some
    lightest cut; and the mask (q,) of those that are in all of them."""
    network, between = bounds.network, ~(above | below)
    near = np.flatnonzero(between[ends].any(axis=0))
    sample = network.sample_of(own[near])
    counts = (bounds.excess <= NEARLY_LEAST * bounds.upper) & (
        np.bincount(sample, minlength=network.count) <= MOST_COUNTED
    )
    near = near[counts[sample]]
    weight = prod((whole_numbers(of[own[near]]) for of in network.factors), start=np.ones(len(near), dtype=object))
    cuts = cuts_between(ends[:, near], weight, above, between)[0]
    return near, cuts.some, cuts.every


def reached(follows: sparse.csr_array, starts: np.ndarray) -> np.ndarray:
    """Return the mask (nodes,) of the nodes that can be reached along the edges of a directed graph from any of some
    nodes, these included.

    follows : the graph, (nodes, nodes).
    starts : indices of the nodes to begin with."""
    size = follows.shape[0]
    ends = (np.full(len(starts), size), starts)
    source = sparse.csr_array((np.ones(len(starts), dtype=np.int8), ends), shape=(size + 1, size + 1))
    whole = sparse.block_diag([follows, sparse.csr_array((1, 1), dtype=np.int8)], format="csr") + source
    reached = np.zeros(size + 1, dtype=bool)
    reached[breadth_first_order(whole, size, return_predecessors=False)] = True
    return reached[:-1]
