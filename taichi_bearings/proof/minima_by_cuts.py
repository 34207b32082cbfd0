"""Which contacts slip at every minimum, at some or at none, where one component of the spins matters: theorem 6.

This covers friction alone in all of 2D, in cubic lattices driven about x or y, and in packings alike. The power has no
curvature there: it is the sum of mu F_n |slip|, and minima are mixtures of cuts.

Symbols
    u : spin times radius along the component, with signs such that a contact slips by u_high - u_low between its nodes.
    m : number of the contacts that this component makes slip. Each is an edge between two nodes of a graph.
    f : friction of an edge, positive if it goes with a positive slip; between -mu F_n and mu F_n.
    step : difference between two successive imposed values in a connected part of the graph.
    E : excess, the power of the given spins less the lower bound that the friction proves.
    cut : a division of the nodes into those above and those below a step; for driven nodes the imposed values say on
        which side they are. Its weight is the sum of mu F_n over the edges between both sides.

The proof
1. At a minimum the nodes with u above almost any number between two imposed values are one side of a lightest cut of
   this step. A contact slips if its ends are on different sides of such a cut.
2. On lightest cuts friction is close to its limit. By step 5 each of them belongs to a minimum, at which the sum of
   mu F_n |slip| - f slip over all edges is at most E (theorem 5; E includes the price of torques that f leaves over).
   No term is negative, and an edge across the cut slips by at least the step. So an edge from below to above such a cut
   has mu F_n - f <= E / step, one from above to below mu F_n + f <= E / step. Hence, if mu F_n - f > E / step and the
   node `high` of an edge is above, then its node `low` is above, too: "above" follows along such edges.
3. Nodes that follow from driven ones above are above every lightest cut; in the same way nodes are below. Nodes that
   follow from each other are on one side. That decides many contacts.
4. Where cuts tie, the other contacts are decided in whole numbers (numerics/exact_cuts.py): which are in all lightest
   cuts, in some, in none.
5. At a minimum each step has a lightest cut, and the nodes above it include those above the cut of the next step. The
   unions and the intersections of lightest cuts of two steps are lightest cuts of these steps. So any lightest cut of
   one step belongs to a minimum. Lightest cuts without a given contact between their sides are closed under union and
   intersection as well; if there is such a cut for each step, the smallest ones make a minimum at which the contact
   rests. So a contact is tied if it is in some lightest cut of a step and in all of them at no step.

Where loops have an odd number of contacts no signs fit. Then every sphere has two nodes, u and -u, and every contact
two edges (double cover); both together have twice the excess. The mean of a minimum of the double cover and of its
mirror image is a minimum in which the two nodes of a sphere have opposite values, and such minima are those of the
network. No edge has slips of opposite signs at two minima, so nothing cancels in the mean: the contact slips there if
either of its edges does. So it slips at every minimum if at some step every lightest cut has at least one of its two
edges. A sphere at rest, u = 0, is the common case: its nodes may both be above or both below.

Example. A chain bottom - a - b - top of discs whose contacts have mu F_n = 3, 1, 2, and one step of 1. Friction in
balance is 1 everywhere, so E = 0 at the minimum, and mu F_n - f = 2, 0, 1. "Above" follows from a to bottom and from
top to b, so a is below and b above: only the contact a - b slips, at every minimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import prod

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components

from taichi_bearings.numerics.exact_cuts import cuts_between, whole_numbers
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.enclosure import UP, Enclosure, joined
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, TIED, UNDECIDED

NEARLY_LEAST = 1e-9  # excess over the power, up to which lightest cuts are found in whole numbers
MOST_COUNTED = 40_000  # most contacts of a sample for which that is done
MOST_LEVELS = 100  # most steps between imposed values of a part that are looked at, the largest ones
MOST_SOUGHT = 300  # most searches, one from each node, for nodes that follow from it; for each of eight orders of nodes


@dataclass(frozen=True)
class CutGraph:
    """A graph whose lightest cuts give the minima of the power along one spin component, for all samples side by side.

    Nodes are spheres, edges are contacts. A cut divides the nodes into those whose u (spin times radius, times a sign
    that differs between neighbours) is above some number and those below. Its weight is the sum of the friction limits
    mu F_n of the edges between both sides. Where loops of an odd number of contacts allow no such signs (`is_double`),
    each sphere has two nodes, u and -u, and each contact two edges.

    own : (m,), indices in the network of the contacts that the component makes slip.
    low, high : (q,), nodes of each edge, q = m or 2 m; the contact slips by u at `high` less u at `low`.
    up, down : (q,), lower bounds of mu F_n - f and of mu F_n + f: the friction left up to the limit for slips upwards
        (u larger at `high`) and downwards. Here f is the friction, positive if it goes with a slip upwards.
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
        friction = network.moment[k].at(own)
        if (bounds.worst > 1).any():
            friction = friction / Enclosure.exact(bounds.worst[network.sample_of(own)])
        limit = network.friction_limit.at(own)
        driven = np.unique(network.graph.contact[:, own])
        driven = driven[~network.free[driven]]
        is_double = bool(odd[first].any())
        if is_double:  # node i is u_i, node i + count is -u_i: both edges of a contact slip by u_i + u_j
            low, high = np.append(second + count, first + count), np.append(first, second)
            friction, limit = joined([friction, friction]), joined([limit, limit])
            label = pieces(2 * count, low, high)
            imposed = network.imposed[k].at(driven)
            node, value = np.append(driven, driven + count), joined([imposed, -imposed])
        else:
            low, high, friction = first, second, friction.signed(sign[second])
            node, value = driven, network.imposed[k].signed(sign).at(driven)
        up, down = (limit - friction).lower(), (limit + friction).lower()
        order = np.lexsort((value.low, value.high, label[node]))
        return cls(own, low, high, up, down, label, node[order], value[order], is_double)

    def follows(self, margin: np.ndarray) -> sparse.csr_array:
        """Return a directed graph of the nodes, a matrix (nodes, nodes): an edge leads from i to j if j is proven to be
        above every lightest cut that i is above. That is so if the friction of the contact, in the direction of a slip
        with i above and j below, is farther from its limit than on any lightest cut.

        margin : (q,), for each edge the most that friction may miss of its limit mu F_n if the edge crosses a lightest
            cut: excess / step. The excess of its sample is the power less its proven lower bound (twice that if spheres
            have two nodes); the step is the difference of the two imposed values of u that the cut separates."""
        size, not_up, not_down = len(self.label), self.up > margin, self.down > margin
        tail = np.append(self.high[not_up], self.low[not_down])
        head = np.append(self.low[not_up], self.high[not_down])
        return sparse.csr_array((np.ones(len(tail), dtype=bool), (tail, head)), shape=(size, size))


def states_by_cuts(bounds: Bounds, k: int) -> np.ndarray:
    """Return the states (m,) of all m contacts of a network with friction alone in which minima slip along component k
    of the spins only.

    Sort the values imposed on the driven spheres of a connected part. Between two successive ones, a *step*, a cut
    divides its spheres into two sides. It is lightest if the friction limits of the contacts between the sides have the
    least sum. Minima are mixtures of lightest cuts, one for each step. So a contact is

    * SLIPPING if for some step it is between the sides of every lightest cut;
    * SLIPLESS if for all steps it is within one side of every lightest cut;
    * TIED if for some step it is between the sides of some lightest cuts, and for no step of all;
    * UNDECIDED if stored friction and excess of power do not tell.

    bounds : the network, its friction, and the excess of the power over its lower bound."""
    network, graph = bounds.network, CutGraph.of(bounds, k)
    own, label, node = graph.own, graph.label, graph.node
    part, size = label[node], len(label)
    # Steps between successive imposed values of a part, and their rank by size in each part, the largest first.
    step = graph.value[1:] - graph.value[:-1]
    differs = (graph.value.high[1:] != graph.value.high[:-1]) | (graph.value.low[1:] != graph.value.low[:-1])
    steps = np.flatnonzero(differs & (part[1:] == part[:-1]))
    steps = steps[np.lexsort((-step.high[steps], part[steps]))]
    rank = np.arange(len(steps)) - np.searchsorted(part[steps], part[steps])
    unknown = np.isin(label[graph.low[: len(own)]], part[steps[rank >= MOST_LEVELS]])
    slips, tied = np.zeros((2, len(own)), dtype=bool)
    for number in range(min(int(rank.max(initial=-1)) + 1, MOST_LEVELS)):
        # One step of each part at a time: where it begins in the list of driven nodes, and a lower bound of its size.
        of_rank = steps[rank == number]
        begin, least = np.full(size, len(node)), np.zeros(size)
        begin[part[of_rank]], least[part[of_rank]] = of_rank, step[of_rank].lower()
        in_none, in_all, in_some = _at_one_step(bounds, graph, begin, np.maximum(least, 0.0))
        slips, tied, unknown = slips | in_all, tied | in_some, unknown | ~(in_none | in_all | in_some)
    states = np.where(network.acts & network.counts & network.feels[k], UNDECIDED, SLIPLESS)
    states[own] = np.select([slips, unknown, tied], [SLIPPING, UNDECIDED, TIED], SLIPLESS)
    return states


def _at_one_step(
    bounds: Bounds, graph: CutGraph, begin: np.ndarray, least: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return three masks (m,) of m contacts: True for a contact that is in no lightest cut of one step between imposed
    values; in every one; in some, but not in every one. Where nothing is known all three are False. A contact is in a
    cut if its edge (with two nodes for each sphere: one of its two edges) has its ends on different sides.

    bounds : the network, its friction, and the excess of each sample.
    graph : the graph with its m contacts.
    begin : (nodes,), for each connected part (by its label) the index in `graph.node` of the driven node below the
        step; the number of driven nodes for parts without a step.
    least : (nodes,), lower bound of the size of the step of each part, by its label."""
    low, high, label, count = graph.low, graph.high, graph.label, len(graph.own)
    copies = 1 + graph.is_double
    margin = copies * np.tile(bounds.excess[bounds.network.sample_of(graph.own)], copies) / least[label[low]] * UP
    follows = graph.follows(margin)
    # Nodes above and below every lightest cut, as they follow from driven ones; then edges on one side, and across.
    together = connected_components(follows, directed=True, connection="strong")[1]
    place, first = np.arange(len(graph.node)), begin[label[graph.node]]
    above = reached(follows, graph.node[place > first])
    below = reached(follows.T.tocsr(), graph.node[(place <= first) & (first < len(graph.node))])
    one_side = (together[low] == together[high]) | (above[low] & above[high]) | (below[low] & below[high])
    one_side |= begin[label[low]] == len(graph.node)  # where there is no step, nothing slips
    across = (above[low] & below[high]) | (below[low] & above[high])
    # The first and the last `count` edges are all edges, or the two copies.
    in_none, in_some = one_side[:count] & one_side[-count:], np.zeros(count, dtype=bool)
    in_all = across[:count] | across[-count:]
    if graph.is_double:
        left = np.flatnonzero(~(in_none | in_all))
        edges = np.stack([low, high]).reshape(2, 2, count)[:, :, left]
        in_all[left] = _in_either_copy(follows, together, above, below, edges)[0]
    if not (in_none | in_all).all():
        decided, some, every = _in_whole_numbers(bounds, graph, together, above, below)
        in_none[decided], in_all[decided], in_some[decided] = ~some, every, some & ~every
    return in_none, in_all, in_some


def _in_whole_numbers(
    bounds: Bounds, graph: CutGraph, together: np.ndarray, above: np.ndarray, below: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decide which contacts belong to lightest cuts, in whole numbers and so exactly, where cuts have (nearly) the same
    weight. Return the indices (q,) of the contacts that were decided; the mask (q,) of those that are in some lightest
    cut (with one of their edges); and the mask (q,) of those that are in every one.

    A cut divides the nodes into two sides; its weight is the sum of the friction limits of the edges between them. Only
    contacts are decided with an edge whose ends may be on different sides. Samples are left out whose excess, power
    less its proven lower bound, is above NEARLY_LEAST of the power, or that have more than MOST_COUNTED such contacts.

    bounds : the network, its friction, and the excess of each sample.
    graph : the graph with its m contacts, each with one edge or, with two nodes for each sphere, with two.
    together : (nodes,), labels, equal for nodes that are on one side of every lightest cut.
    above, below : (nodes,), masks of the nodes that are surely above, surely below every lightest cut."""
    # Nodes that are on one side of every lightest cut become one: `edges` are edges between these.
    network, node = bounds.network, np.unique(together, return_index=True)[1]  # a node of each label
    above, between = above[node], ~(above | below)[node]
    edges = together[np.stack([graph.low, graph.high])].reshape(2, -1, len(graph.own))  # (both ends, copies, contacts)
    chosen = np.flatnonzero((between[edges].any(axis=0) & (edges[0] != edges[1])).any(axis=0))
    sample = network.sample_of(graph.own[chosen])
    is_small = np.bincount(sample, minlength=network.count) <= MOST_COUNTED
    can_be_tried = (bounds.excess <= NEARLY_LEAST * bounds.upper) & is_small
    chosen = chosen[can_be_tried[sample]]
    # Friction limits as whole multiples of one unit are the weights of the edges.
    multiples = [whole_numbers(factor[graph.own[chosen]]) for factor in network.factors]
    weight, edges = prod(multiples, start=np.ones(len(chosen), dtype=object)), edges[:, :, chosen]
    copies = edges.shape[1]
    # `merged` is the node, in a smaller graph, of each label; nodes whose side is known are merged there.
    cuts, merged = cuts_between(edges.reshape(2, -1), np.tile(weight, copies), above, between)
    some, every = (np.any(list(of.reshape(copies, -1)), axis=0) for of in (cuts.some, cuts.every))
    if graph.is_double:
        left = np.flatnonzero(some & ~every)
        every[left], is_known = _in_either_copy(
            cuts.residual, cuts.together, cuts.near, cuts.far, merged[edges[:, :, left]]
        )
        kept = np.delete(np.arange(len(chosen)), left[~is_known])
        chosen, some, every = chosen[kept], some[kept], every[kept]
    return chosen, some, every


def _in_either_copy(
    follows: sparse.csr_array, together: np.ndarray, begin: np.ndarray, end: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return two masks (n,) about n contacts of a graph in which each contact has two edges: True if every lightest cut
    is proven to have at least one of the two between its sides; and True if that mask is certain either way, as no more
    than MOST_SOUGHT searches were needed.

    Suppose that a lightest cut has neither edge, p - q or r - s, between its sides. With p on the first side q is there
    as well, and so is all that follows from q. If r follows from q, then r and s are there. So there is no such cut if
    p is surely on the first side, s is surely on the second one, and r follows from q. The loop tries all eight names
    of the four nodes: either edge first, either end of each. Nothing else excludes such a cut: a path from the first
    side to the second one that uses each edge at most once is one of these, or it uses one edge alone, which the caller
    has looked at.

    follows : directed graph of the nodes: if a node is on the first side, so are all to which a path leads from it.
    together : (nodes,), labels, equal for nodes that reach each other.
    begin, end : (nodes,), masks of the nodes that are surely on the first side, surely on the second one.
    edges : (2, 2, n), nodes at both ends (first axis) of both edges (second axis) of each contact."""
    found, is_known = np.zeros(edges.shape[2], dtype=bool), np.ones(edges.shape[2], dtype=bool)
    for copy, near, far in product((0, 1), repeat=3):
        p, q, r, s = edges[near, copy], edges[1 - near, copy], edges[far, 1 - copy], edges[1 - far, 1 - copy]
        left = np.flatnonzero(~found & begin[p] & end[s])
        found[left] = together[q[left]] == together[r[left]]
        left = left[~found[left]]
        # One search from each node q finds all nodes that follow from it.
        sources = np.unique(q[left])
        is_known[left[np.isin(q[left], sources[MOST_SOUGHT:])]] = False
        for source in sources[:MOST_SOUGHT]:
            some = left[q[left] == source]
            found[some] = np.isin(r[some], breadth_first_order(follows, source, return_predecessors=False))
    return found, found | is_known


def reached(follows: sparse.csr_array, starts: np.ndarray) -> np.ndarray:
    """Return the mask (nodes,) of the nodes that can be reached along the edges of a directed graph from any of some
    nodes, these included.

    follows : the graph, (nodes, nodes).
    starts : (n,), indices of the nodes to begin with."""
    size = follows.shape[0]
    ends = (np.full(len(starts), size), starts)
    source = sparse.csr_array((np.ones(len(starts), dtype=bool), ends), shape=(size + 1, size + 1))
    whole = sparse.block_diag([follows, sparse.csr_array((1, 1), dtype=bool)], format="csr") + source
    reached = np.zeros(size + 1, dtype=bool)
    reached[breadth_first_order(whole, size, return_predecessors=False)] = True
    return reached[:-1]
