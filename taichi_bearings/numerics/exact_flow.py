"""Largest flows of whole numbers of any length, without rounding.

Capacities may span any number of decades. Each round works with the leading bits of the capacity that is left
(capacity scaling; Gabow, J. Comput. System Sci. 31, 1985):

1. Let B be a bound on the flow that can still come. No edge carries more, so capacities are reduced to B.
2. Bits below a unit of some B / 2^50 are dropped, so that numbers fit into 64 bits.
3. A largest flow of these short numbers is subtracted from the capacities. Some cut then has less than a unit left per
   edge; that is the next, smaller B.

Connected parts of the graph have bounds and units of their own. At the end some cut has no capacity left at all, so
that the flow is a largest one. Letters: E edges, P pairs of nodes that edges join.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.numerics.minimum_cut import flow_by_edge, largest_flow, reachable_from

ROUND_BITS = 57  # most bits of the flows of one round, all parts together
SHORT = 2**59  # if the totals of capacities are below this, all sums fit into 64 bits


@dataclass
class _Residual:
    """Capacity that is left in a graph after some flow has been taken away. The graph has P pairs of nodes that edges
    join, numbered such that one is the lower and one the upper node.

    there, back : (P,) capacity from the lower to the upper node of each pair, and from the upper to the lower one.
    fed, drained : (nodes,) what can still come from the source, and go to the sink, at each node.
    """

    there: np.ndarray
    back: np.ndarray
    fed: np.ndarray
    drained: np.ndarray

    @property
    def parts(self) -> tuple[np.ndarray, ...]:
        """The four arrays of capacities: there and back, (pairs P,) each; fed and drained, (nodes,) each."""
        return self.there, self.back, self.fed, self.drained


def exact_flow(
    ends: np.ndarray, capacity: np.ndarray, source: np.ndarray, sink: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a largest flow through a graph from a source to a sink, exactly.

    ends : (2, E) nodes that each of E edges joins, low and high end.
    capacity : (E,) most that an edge carries, either way.
    source, sink : (nodes,) most that may come from outside, and leave, at each node.
    returns : flow (E,) from low to high end, negative the other way; inflow from the source (nodes,); outflow to the
        sink (nodes,).

    Capacities are whole numbers, int64 or of Python (dtype object), none negative. The flow is int64 if it fits.
    """
    pairs, own = np.unique(np.sort(ends, axis=0), axis=1, return_inverse=True)
    own, nodes = own.ravel(), len(source)
    total = np.zeros(pairs.shape[1], dtype=object)
    np.add.at(total, own, capacity.astype(object))
    short = max([0, int(source.sum()), int(sink.sum()), *total]) < SHORT
    kind = np.int64 if short else object
    left = _Residual(*(values.astype(kind) for values in (total, total, source, sink)))
    _take_largest_flow(left, pairs, pieces(nodes, *pairs[:, total > 0]))
    flow = flow_by_edge((total - left.there).astype(kind), capacity.astype(kind), own, ends)
    return flow, source - left.fed, sink - left.drained


def _take_largest_flow(left: _Residual, pairs: np.ndarray, part: np.ndarray) -> None:
    """Subtract a largest flow from the capacity that is left in a graph.

    left : capacities, whole numbers of any size, changed in place.
    pairs : (2, P) nodes of each of P joined pairs, lower and upper.
    part : (nodes,) number of the connected part of each node.

    Each round takes the leading bits of all capacities, in a unit for each connected part, and subtracts a largest flow
    of these whole numbers. After that less than one unit for each edge of some cut can still flow. So the next round
    can reduce capacities to that bound and work with a finer unit, until nothing is left.
    """
    count, nodes = int(part.max(initial=-1)) + 1, len(part)
    kind = left.there.dtype
    # no more can flow in a part than the source gives it, or the sink takes
    bound = np.minimum(*(_sums_by_owner(values, part, count, kind) for values in (left.fed, left.drained)))
    of_pair = part[pairs[0]]
    while (open_ := bound > 0).any():
        # leading bits of all capacities, in a unit 2^shift of each part
        bits = max(ROUND_BITS - int(open_.sum()).bit_length(), 1)
        shift = np.array([max(int(b).bit_length() - bits, 0) for b in bound], dtype=kind)
        owners = of_pair, of_pair, part, part
        units = [
            (np.minimum(values, bound[owner]) >> shift[owner]).astype(np.int64)
            for values, owner in zip(left.parts, owners, strict=True)
        ]
        sent, into, out = _flow_of_round(pairs, *units)
        moved = sent.astype(kind) << shift[of_pair]
        left.there, left.back = left.there - moved, left.back + moved
        left.fed = left.fed - (into.astype(kind) << shift[part])
        left.drained = left.drained - (out.astype(kind) << shift[part])
        # the next bound: capacity left in the cut between the nodes that the source still reaches and all others
        over = np.stack([units[0] - sent, units[1] + sent]) > 0
        row, column = np.concatenate([pairs, pairs[::-1]], axis=1)[:, over.ravel()]
        above = reachable_from(nodes, row, column, np.flatnonzero(units[2] > into))
        low, high = above[pairs]
        crossing = np.where(low & ~high, left.there, np.where(high & ~low, left.back, 0)).astype(kind)
        cut = _sums_by_owner(crossing, of_pair, count, kind)
        cut = cut + _sums_by_owner(np.where(above, left.drained, left.fed).astype(kind), part, count, kind)
        sums = _sums_by_owner(into.astype(kind) << shift[part], part, count, kind)
        bound = np.where(open_, np.minimum(bound - sums, cut), 0).astype(kind)


def _sums_by_owner(values: np.ndarray, owner: np.ndarray, count: int, kind: np.dtype) -> np.ndarray:
    """Return for each of `count` groups the sum (count,) of its values.

    values : (numbers,), what is summed.
    owner : (numbers,), the group of each, 0 to count - 1.
    kind : type of the sums, int64 or whole numbers of Python (object).
    """
    found = np.zeros(count, dtype=kind)
    np.add.at(found, owner, values)
    return found


def _flow_of_round(
    pairs: np.ndarray, there: np.ndarray, back: np.ndarray, fed: np.ndarray, drained: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a largest flow of capacities that fit into 64 bits, as three arrays: net flow (pairs,) from the lower to
    the upper node of each pair of joined nodes; inflow (nodes,) from the source; and outflow (nodes,) to the sink.

    pairs : (2, pairs) nodes of each pair, lower and upper.
    there, back : (pairs,) capacities from the lower to the upper node, and back.
    fed, drained : (nodes,) capacities from the source, and to the sink, at each node. Source and sink become two more
        nodes, the first and the last one.
    """
    nodes, begins, ends = len(fed), np.flatnonzero(fed), np.flatnonzero(drained)
    taken, given = np.zeros(nodes, dtype=np.int64), np.zeros(nodes, dtype=np.int64)
    at_most = min(int(fed.sum()), int(drained.sum()))
    if not at_most:
        return np.zeros_like(there), taken, given
    low = np.concatenate([pairs[0] + 1, np.zeros(len(begins), dtype=np.int64), ends + 1])
    high = np.concatenate([pairs[1] + 1, begins + 1, np.full(len(ends), nodes + 1)])
    nothing = np.zeros(len(begins) + len(ends), dtype=np.int64)
    capacity = np.stack([np.concatenate([there, fed[begins], drained[ends]]), np.append(back, nothing)])
    flow = largest_flow(np.stack([low, high]), capacity, at_most)
    sent, taken[begins], given[ends] = np.split(flow, [len(there), len(there) + len(begins)])
    return sent, taken, given
