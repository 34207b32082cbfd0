"""Finds minimum cuts of lattices: the lightest sets of contacts whose removal separates bottom and top.

If every sphere rotates either with the bottom or with the top, the contacts between the two sides slip with the imposed
jump, less its component along the contact; all others do not slip. The power of such a state is the weight of a cut,
and the least one is that of a minimum cut (Ford and Fulkerson, Canad. J. Math. 8, 1956). In 2D, and wherever the
contacts of one sideways axis have no weight, the lattice is a stack of planar grids, which planar/ cuts exactly. Any
other lattice, and every periodic one, takes a largest flow, by OR-tools where it is installed, else by SciPy.

Weights are rounded down to multiples of a unit, 2^-51 to 2^-52 of the lightest level cut, so a flow is a number of
units below 2^53 and exact. A largest flow of rounded weights is a flow of the true ones, hence a proven lower bound,
and the cut that it shows weighs at most one unit for each of its contacts more.

A largest flow also shows which cuts are nearly as light: a cut is heavier than the lightest one by the unused capacity
from its lower to its upper side. So a sphere that the bottom reaches through contacts with more than x of unused
capacity is below every cut that is heavier by x or less, and likewise from the top (Picard and Queyranne, Math.
Program. Study 13, 1980).

Letters: R lattices (samples), N the shape of a lattice. Weights come as one array (R, *contacts) an axis, height last.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.planar import minimum_cuts

WEIGHT_ROUNDING = 2.0**-48  # relative error of weights that are computed: a dozen roundings of 2^-53 each
ROUNDED_WEIGHT = 2.0**-6  # a cut lighter than this share of the one known before is found anew, in a finer unit
PRESENT_CAPACITY = 2**40  # capacity of every contact with weight, if some cut has no weight
FLOW_BITS = 29  # most bits of a flow in SciPy, which has 31: capacity left over is up to three times the flow


@dataclass(frozen=True)
class MinimumCut:
    """Minimum cuts of R lattices of shape N: the lightest sets of contacts whose removal separates bottom and top.

    above : (R, *N) True for spheres on the top side. The contacts between both sides are the cut; of several equally
        light cuts it is the lowest.
    between : (R, *N) True for spheres that are not proven to lie on the same side of all cuts as light as this one; in
        planar grids with exact weights, for spheres that do not. False for spheres that no chain of contacts with
        weight joins to bottom or top, as they change no cut.
    weight : (R,) weight of this cut.
    lower_bound : (R,) proven lower bound on the weight of every cut. For each contact of the cut it is too low by about
        1e-15 of the least weight (3e-14 at most).
    next_weight : (R,) weight of the lightest other cut that leaves the spheres of either side connected, as precise as
        the bound; NaN where it is not known. :func:`next_cut` computes it.
    """

    above: np.ndarray
    between: np.ndarray
    weight: np.ndarray
    lower_bound: np.ndarray
    next_weight: np.ndarray

    @property
    def unique(self) -> np.ndarray:
        """(lattices R,) True where every other cut between bottom and top is proven to be heavier."""
        return np.asarray(~self.between.reshape(len(self.between), -1).any(axis=1))


def minimum_cut(weight: tuple[np.ndarray, ...], rounding: float = 0.0) -> MinimumCut:
    """Find a lightest cut between the bottom plane and the top plane of each of R lattices.

    weight : one array (R, *contacts) for each axis, none negative, the height last. Lattices are 2 or more wide and 3
        or more high. Contacts between two spheres of the bottom or of the top take no part.
    rounding : relative error of each weight. No cut that could be as light within that error is taken to be heavier.
    """
    *sideways, upward = weight
    # Lattices that are stacks of planar grids, since contacts along one axis weigh nothing, are cut by shortest paths;
    # all others by a largest flow.
    idle = next((axis for axis, values in enumerate(sideways) if not values.any()), None)
    closed = set(Lattice.of(weight).periodic) - {idle}
    if closed or (len(sideways) == 2 and idle is None):
        return flow_cut(weight, rounding)
    if len(sideways) == 1:
        above, between, bound, following = _cut_planes(sideways[0][:, None], upward[:, None])
        above, between = above[:, 0], between[:, 0]
    else:
        assert idle is not None
        stacks = (np.moveaxis(values, 1 + idle, 1) for values in (sideways[1 - idle], upward))
        above, between, bound, following = _cut_planes(*stacks)
        above, between = (np.moveaxis(spheres, 1, 1 + idle) for spheres in (above, between))
    found = weight_of_cut(above, weight)
    following = found + (following - bound)  # equal weights stay equal, whatever the rounding of their sums
    # Where another cut is as light within the rounding of the weights, a flow says which spheres may change sides.
    close = np.flatnonzero(~(following > found * (1 + 4 * rounding)))
    if rounding and len(close):
        between[close] = flow_cut(tuple(values[close] for values in weight), rounding).between
    return MinimumCut(above, between, found, np.minimum(bound, found), following)


def flow_cut(weight: tuple[np.ndarray, ...], rounding: float = 0.0) -> MinimumCut:
    """Return lightest cuts between bottom and top plane of R lattices of any kind, found by a largest flow. The weight
    of the lightest other cut, `next_weight`, is not computed but NaN.

    weight : one array (R, *contacts) for each axis, none negative, the height last.
    rounding : relative error of each weight.

    For planar grids this is slower than shortest paths, but shares no code with them.
    """
    cuts = [cut_lattice(tuple(values[replica] for values in weight), rounding) for replica in range(len(weight[-1]))]
    above, between, bound = (np.stack([getattr(cut, name) for cut in cuts]) for name in ("above", "between", "weight"))
    found = weight_of_cut(above, weight)
    return MinimumCut(above, between, found, np.minimum(bound, found), np.full(len(found), np.nan))


def next_cut(weight: tuple[np.ndarray, ...], cut: MinimumCut) -> tuple[np.ndarray, np.ndarray]:
    """Return for each of R lattices the lightest cut other than `cut` that leaves the spheres of either side connected:
    a mask (R, *N) of the spheres on one side, and the weights (R,).

    weight : weights of the contacts of R lattices of shape N, one array (R, *contacts) for each axis.
    cut : lightest cuts for these weights, the answer of :func:`minimum_cut`.

    Such a cut lacks at least one contact of `cut`. So for each contact of `cut` in turn the lightest cut without it is
    found, by giving it an infinite weight; the lightest of all these is returned. As that takes a flow for each
    contact, it is for small lattices.
    """
    sides, lattice = np.empty_like(cut.above), Lattice.of(weight)
    for replica in range(len(sides)):
        sample = tuple(values[[replica]] for values in weight)
        others = []
        for axis, values in enumerate(sample):
            for contact in np.argwhere(_joins_both_sides(cut.above[replica], axis, lattice) & (values[0] > 0)):
                spared = tuple(part[0].copy() for part in sample)
                spared[axis][tuple(contact)] = np.inf
                others.append(cut_lattice(spared).above)
        sides[replica] = min(others, key=lambda above: float(weight_of_cut(above[None], sample)[0]))
    return sides, weight_of_cut(sides, weight)


def weight_of_cut(above: np.ndarray, weight: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the weight (R,) of the contacts between the two sides of a cut of each of R lattices of shape N.

    above : (R, *N) True for spheres on one of the sides.
    weight : one array (R, *contacts) for each axis.
    """
    replicas, lattice = range(len(above)), Lattice.of(weight)
    parts = (
        [values[r][_joins_both_sides(above[r], a, lattice)].sum() for r in replicas] for a, values in enumerate(weight)
    )
    found: np.ndarray = np.sum(list(parts), axis=0)
    return found


def _cut_planes(sideways: np.ndarray, upward: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return minimum cuts of R stacks of planar grids of w columns and h rows; no contact joins the grids of a stack.

    sideways, upward : weights (R, planes, w - 1, h) along rows and (R, planes, w, h - 1) between rows.
    returns : masks (R, planes, w, h) of the spheres on the top side, and of spheres whose side differs among the
        lightest cuts; (R,) proven least weight of a cut; (R,) weight of the lightest other cut.
    """
    replicas, planes, columns, gaps = upward.shape
    sideways, upward = (np.ascontiguousarray(values).reshape(-1, *values.shape[2:]) for values in (sideways, upward))
    above, between = (np.zeros((replicas * planes, columns, gaps + 1), dtype=bool) for _ in range(2))
    bound, further = np.empty((2, replicas * planes))
    for part, cuts in minimum_cuts(sideways, upward):
        above[part], bound[part], further[part] = cuts.above, cuts.weight, cuts.next_weight - cuts.weight
        # Where several cuts tie: `apart` are the contacts that are in any of them. Spheres that other contacts join to
        # bottom or top are on that side of every cut; spheres that only contacts of cuts join to them may change sides.
        for grid in np.flatnonzero(~cuts.unique):
            cut = np.diff(cuts.above[grid], axis=0), np.diff(cuts.above[grid], axis=1)
            apart = cut[0] | cuts.sideways_tied[grid], cut[1] | cuts.upward_tied[grid]
            present = sideways[part][grid] > 0, upward[part][grid] > 0
            node, ends = graph_of_lattice(Lattice.of(apart))
            known, joined = (
                np.logical_or(*(within_reach(ends, np.tile(edges, (2, 1)), start) for start in (0, node.max())))
                for edges in (edges_of(present) & ~edges_of(apart), edges_of(present))
            )
            between[part][grid] = (joined & ~known)[node]
    stack = (replicas, planes, columns, gaps + 1)
    bound, further = (values.reshape(replicas, planes) for values in (bound, further))
    weight = bound.sum(axis=1)
    return above.reshape(stack), between.reshape(stack), weight, weight + further.min(axis=1)


@dataclass(frozen=True)
class GraphCut:
    """A minimum cut of one graph between its first and its last node, or of one lattice between bottom and top: the
    lightest set of edges, or contacts, whose removal separates the two.

    above : (nodes,), or the shape of the lattice: True on the side of the last node, or of the top.
    between : the same shape, True where the side is not proven to be the same in all cuts as light as this one.
    flow : (edges,) a largest flow, in whole units of weight.
    unit : weight of one unit.
    units : capacity of the cut in whole units, which is the size of the flow.
    """

    above: np.ndarray
    between: np.ndarray
    flow: np.ndarray
    unit: float
    units: int

    @property
    def weight(self) -> float:
        """Weight that no cut is lighter than, proven by the flow."""
        return self.units * self.unit


def cut_lattice(weight: tuple[np.ndarray, ...], rounding: float = 0.0) -> GraphCut:
    """Return a minimum cut of one lattice between its bottom and its top plane, with masks of the lattice's shape.

    weight : one array of contacts for each axis, the height last.
    rounding : relative error of each weight; cuts that could be as light within it count as equally light.
    """
    node, ends = graph_of_lattice(Lattice.of(weight))
    lightest = weight[-1].reshape(-1, weight[-1].shape[-1]).sum(axis=0).argmin()
    above = np.zeros(node.max() + 1, dtype=bool)
    above[node[..., lightest + 1 :]] = True
    cut = graph_cut(ends, edges_of(weight), above, rounding)
    return replace(cut, above=cut.above[node], between=cut.between[node])


def graph_cut(
    ends: np.ndarray, edges: np.ndarray, above: np.ndarray, rounding: float = 0.0, slack: float = 0.0
) -> GraphCut:
    """Return a lightest cut between the first and the last node of an undirected graph.

    A cut divides the nodes into a side with the first and a side with the last node; its weight is the sum of the
    weights of the edges between the sides. Cuts that are heavier by no more than the errors `rounding` and `slack`
    count as equally light.

    ends : (2, edges) nodes that each edge joins.
    edges : (edges,) weights, none negative.
    above : (nodes,) any cut: True on the side of the last node.
    rounding : relative error of each weight.
    slack : further error of the weight of a cut, in the unit of the weights.
    """
    cut, light = above[ends[0]] != above[ends[1]], False
    while not light:  # a cut that is much lighter than the one known before is found anew, in a finer unit
        at_most = float(edges[cut].sum())
        unit = np.ldexp(1.0, np.frexp(at_most)[1] - 52)
        capacity = np.where(edges > 0, PRESENT_CAPACITY, 0)
        if at_most > 0:
            capacity = np.floor(np.minimum(edges, 2 * at_most) / unit).astype(np.int64)
        flow = largest_flow(ends, capacity, int(capacity[cut].sum()))
        left_over = np.stack([capacity - flow, capacity + flow])
        above = ~within_reach(ends, left_over, 0)
        cut = above[ends[0]] != above[ends[1]]
        light = bool(edges[cut].sum() >= at_most * ROUNDED_WEIGHT)
    units, last = int(capacity[cut].sum()), len(above) - 1
    # A cut that is heavier by more than `tie` units is heavier by the true weights, too: 3 times `rounding` covers the
    # errors of both cuts, and rounding down to units changes this cut by less than a unit per contact.
    tie = int(3 * rounding * (units + cut.sum())) + int(cut.sum())
    tie += min(int(3 * slack / unit), PRESENT_CAPACITY**2 >> 20)  # beyond that no capacity is left
    from_bottom, from_top = (
        within_reach(ends, left, start, tie) for left, start in ((left_over, 0), (left_over[::-1], last))
    )
    present = np.tile(edges > 0, (2, 1))
    joined = within_reach(ends, present, 0) | within_reach(ends, present, last)
    return GraphCut(above, joined & ~(from_bottom | from_top), flow, float(unit), units)


def _joins_both_sides(above: np.ndarray, axis: int, lattice: Lattice) -> np.ndarray:
    """Return a mask of the shape of the contacts along an axis, True where their two spheres lie on different sides.

    above : (*N) mask of the spheres on one of the sides.
    axis : number of the axis.
    lattice : the lattice, of shape *N.
    """
    low, high = lattice.along(axis)
    return np.asarray(above[low] != above[high])


def graph_of_lattice(lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """Return the graph of a lattice in which the bottom plane is one node, the first, and the top plane another, the
    last.

    returns : node of each sphere, of the shape of the lattice; both nodes (2, edges) of each contact that is not
        between two spheres of one of these planes, axis by axis, as :func:`edges_of` orders the values of contacts.
    """
    node = number_bodies(lattice.driven)
    pairs = []
    for axis in range(lattice.dimension):
        inner = node if axis == lattice.height_axis else node[..., 1:-1]
        pairs.append(np.stack([inner[end].ravel() for end in lattice.along(axis)]))
    return node, np.concatenate(pairs, axis=1)


def number_bodies(driven: np.ndarray) -> np.ndarray:
    """Return the node of each sphere, of the shape of `driven`, in a graph in which every driven body is one node.

    Node 0 is the first body, then come the free spheres in C order, then the other bodies.

    driven : of any shape, number of the driven body that each sphere belongs to, -1 for free ones.
    """
    free = driven < 0
    rank, number = np.unique(driven[~free], return_inverse=True)
    node = np.empty(driven.shape, dtype=np.int64)
    node[free] = (len(rank) > 0) + np.arange(free.sum())
    node[~free] = np.where(number == 0, 0, free.sum() + number)
    return node


def edges_of(values: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the values of the contacts that take part in cuts of a lattice, axis by axis, as one array (edges,).

    Contacts between two spheres of the bottom or of the top plane do not take part.

    values : one array of contacts for each axis, the height last.
    """
    *sideways, upward = values
    return np.concatenate([*(part[..., 1:-1].ravel() for part in sideways), upward.ravel()])


def within_reach(ends: np.ndarray, left_over: np.ndarray, start: int, least: int = 0) -> np.ndarray:
    """Return a mask (nodes,), True for nodes that can be reached from the node `start` along edges with more than
    `least` capacity left over in that direction.

    ends : (2, edges) first and second node of each edge.
    left_over : (2, edges) capacity from the first node to the second, and back.
    """
    row, column = np.concatenate([ends, ends[::-1]], axis=1)[:, left_over.ravel() > least]
    return reachable_from(int(ends.max()) + 1, row, column, np.array([start]))


def reachable_from(nodes: int, row: np.ndarray, column: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return a mask (nodes,), True for nodes that can be reached along arcs from any of the nodes `starts`.

    nodes : number of nodes.
    row, column : (arcs,) the node that each arc leaves, and the node that it leads to.
    """
    rows, columns = np.concatenate([row, np.full(len(starts), nodes)]), np.concatenate([column, starts])
    graph = csr_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(nodes + 1, nodes + 1))
    found = np.zeros(nodes + 1, dtype=bool)
    found[breadth_first_order(graph, nodes, return_predecessors=False)] = True
    return found[:nodes]


def largest_flow(ends: np.ndarray, capacity: np.ndarray, at_most: int) -> np.ndarray:
    """Return a largest flow from the first to the last node of an undirected graph: (edges,) int64, from lower to upper
    end.

    ends : (2, edges) nodes, lower and upper.
    capacity : int64 below 2^62, (edges,) of both ways, or (2, edges) from lower to upper end and back. With two rows no
        two edges may join the same two nodes.
    at_most : a number below 2^62 that no flow exceeds.

    OR-tools does it where it is installed, by push and relabel, else SciPy. There can be several largest flows; the set
    of nodes that the first node still reaches is the same for all of them (Ford and Fulkerson).
    """
    try:
        from ortools.graph.python.max_flow import SimpleMaxFlow
    except ImportError:
        return flow_by_scipy(ends, capacity, at_most)
    last, network = int(ends.max()), SimpleMaxFlow()
    lower, upper = ends.astype(np.int32)
    up, down = np.broadcast_to(capacity, ends.shape)
    edges = [network.add_arcs_with_capacity(*way) for way in ((lower, upper, up), (upper, lower, down))]
    network.add_arc_with_capacity(last + 1, 0, at_most)  # so that no sum of capacities can overflow
    status = network.solve(last + 1, last)
    if status != network.OPTIMAL:
        raise RuntimeError(f"internal check failed: the maximum flow of OR-tools ended with {status}; please report it")
    there, back = (network.flows(arcs) for arcs in edges)
    found: np.ndarray = there - back
    return found


def flow_by_scipy(ends: np.ndarray, capacity: np.ndarray, at_most: int) -> np.ndarray:
    """Return a largest flow (edges,) from the first to the last node of an undirected graph, positive from the lower to
    the upper end, by Dinic's method of SciPy.

    ends : (2, edges) nodes, lower and upper.
    capacity : int64 below 2^62, (edges,) of both ways, or (2, edges) from the lower to the upper end and back.
    at_most : a number below 2^62 that no flow exceeds.

    SciPy's flows have 32 bits, so a first round uses the leading bits of capacities. The flow that can still come is
    then at most the capacity left in the cut that was found, which has fewer bits, and so on for three or four rounds
    (capacity scaling; Gabow, J. Comput. System Sci. 31, 1985). Capacities that no flow can fill are reduced to a little
    more than the bound on the flow.
    """
    nodes = int(ends.max()) + 1
    pairs, own = np.unique(np.sort(ends, axis=0), axis=1, return_inverse=True)
    # rings of two spheres have two contacts between the same pair
    if pairs.shape[1] < ends.shape[1] and capacity.ndim == 1:
        total = np.zeros(pairs.shape[1], dtype=np.int64)
        np.add.at(total, own.ravel(), capacity)
        return flow_by_edge(flow_by_scipy(pairs, total, at_most), capacity, own.ravel(), ends)
    row, column = np.concatenate([ends, ends[::-1]], axis=1).astype(np.int32)  # the only indices SciPy 1.11 takes
    left_over = np.broadcast_to(capacity, ends.shape).ravel()  # of both directions
    at_start = left_over[: ends.shape[1]].copy()
    while True:
        shift = max(at_most.bit_length() - FLOW_BITS, 0)
        graph = (np.minimum(left_over, 2 * at_most + 1) >> shift).astype(np.int32)
        result = maximum_flow(csr_array((graph, (row, column)), shape=(nodes, nodes)), 0, nodes - 1)
        sent = np.asarray(result.flow[row, column]).ravel().astype(np.int64)
        left_over = left_over - (sent << shift)
        if shift == 0:
            return np.asarray(at_start - left_over[: ends.shape[1]])
        below = within_reach(ends, graph - sent, 0)
        cut = int(left_over[below[row] & ~below[column]].sum())
        at_most = min(at_most - (int(result.flow_value) << shift), cut)


def flow_by_edge(flow: np.ndarray, capacity: np.ndarray, own: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the flow (edges,) of each edge, from its first to its second end, from the flow of each pair of nodes.
    Edges that join the same two nodes share it; each is filled before the next one gets anything.

    flow : (pairs,) flow from the lower to the upper node of each pair, whole numbers.
    capacity : (edges,) most that an edge carries, of the same type: int64, or numbers of Python of any length (object).
    own : (edges,) number of the pair of nodes that each edge joins.
    ends : (2, edges) the two nodes of each edge.
    """
    order = np.argsort(own, kind="stable")
    ordered, first = capacity[order], np.flatnonzero(np.diff(own[order], prepend=-1))
    earlier = np.cumsum(ordered) - ordered
    before = np.empty_like(capacity)  # capacity of the edges of the same pair that come first
    before[order] = earlier - earlier[first][own[order]]
    shared = np.sign(flow)[own] * np.clip(np.abs(flow)[own] - before, 0, capacity)
    found: np.ndarray = np.where(ends[0] > ends[1], -shared, shared)
    return found
