"""The lightest set of contacts whose removal parts bottom and top of a lattice: the interface of two rigid domains.

If every sphere turns either with the bottom or with the top, the contacts between the two sides slip with the imposed
jump d without its component along the contact n, all others not at all. The power of such a state is the weight of a
cut, and the least one is that of a minimum cut (Ford and Fulkerson, Canad. J. Math. 8, 1956). In 2D, and wherever the
contacts of one sideways axis weigh nothing, the lattice is a stack of planar grids, which planar.py cuts exactly. Any
other cubic lattice takes a largest flow.

Weights are rounded down to multiples of a unit, 2^-51 to 2^-52 of the lightest level cut, so a flow is a number of
units below 2^53 and exact. A largest flow of rounded weights is a flow of the true ones, hence a proven lower bound,
and the cut it leaves weighs at most one unit a contact more.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from taichi_bearings.planar import minimum_cuts

BITS = 29  # of a flow; scipy has 31, and what capacity is left is up to three times the flow


@dataclass(frozen=True)
class MinimumCut:
    """Minimum cuts of R lattices N.

    above : (R, *N), True on the top side; the contacts whose ends differ are the cut.
    weight : (R,), of this cut. lower_bound : (R,), no cut is lighter; proven, and good to about 1e-15 a contact.
    """

    above: np.ndarray
    weight: np.ndarray
    lower_bound: np.ndarray


def jump_weights(
    coefficient: tuple[np.ndarray, ...], direction: np.ndarray, exponent: float = 1.0
) -> tuple[np.ndarray, ...]:
    """Share of each contact in the power of a cut: coefficient |d x n|^exponent, shaped as `coefficient`.

    coefficient : one array (R, *contacts) an axis. direction : unit vector d (3,) of the jump; in 2D along z.
    exponent : 1 for friction, 2 for viscous damping.
    """
    across = (np.linalg.norm(np.delete(direction, axis)) for axis in range(len(coefficient)))
    return tuple(values * share**exponent for values, share in zip(coefficient, across, strict=True))


def minimum_cut(weight: tuple[np.ndarray, ...]) -> MinimumCut:
    """A lightest cut between the bottom plane and the top plane of each lattice.

    weight : one array (R, *contacts) an axis, none negative, height last; lattices are 2 or more wide and 3 or more
        high. Contacts between two spheres of the bottom or of the top take no part.
    """
    *sideways, upward = weight
    idle = next((axis for axis, values in enumerate(sideways) if not values.any()), None)
    if not (upward > 0).all() or (len(sideways) == 2 and idle is None):
        cuts = [_cut_lattice(tuple(values[replica] for values in weight)) for replica in range(len(upward))]
        above, bound = (np.stack(parts) for parts in zip(*cuts, strict=True))
    elif len(sideways) == 1:
        above, bound = _cut_planes(sideways[0][:, None], upward[:, None])
        above = above[:, 0]
    else:
        assert idle is not None
        above, bound = _cut_planes(*(np.moveaxis(values, 1 + idle, 1) for values in (sideways[1 - idle], upward)))
        above = np.moveaxis(above, 1, 1 + idle)
    found = weight_of_cut(above, weight)
    return MinimumCut(above, found, np.minimum(bound, found))


def weight_of_cut(above: np.ndarray, weight: tuple[np.ndarray, ...]) -> np.ndarray:
    """Weight (R,) of the contacts between the sides (R, *N)."""
    replicas = range(len(above))
    parts = ([values[r][np.diff(above[r], axis=a)].sum() for r in replicas] for a, values in enumerate(weight))
    return np.sum(list(parts), axis=0)


def _cut_planes(sideways: np.ndarray, upward: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sides (R, planes, w, h) and proven weight (R,) of stacks of planar grids that nothing joins."""
    replicas, planes, columns, gaps = upward.shape
    above, bound = np.empty((replicas * planes, columns, gaps + 1), dtype=bool), np.empty(replicas * planes)
    grids = (np.ascontiguousarray(values).reshape(-1, *values.shape[2:]) for values in (sideways, upward))
    for part, cuts in minimum_cuts(*grids):
        above[part], bound[part] = cuts.above, cuts.weight
    return above.reshape(replicas, planes, columns, gaps + 1), bound.reshape(replicas, planes).sum(axis=1)


def _cut_lattice(weight: tuple[np.ndarray, ...]) -> tuple[np.ndarray, float]:
    """Sides N and proven weight of one lattice; weight : one array of its contacts an axis."""
    *sides, gaps = weight[-1].shape
    free = (*sides, gaps - 1)
    node = np.zeros((*sides, gaps + 1), dtype=np.int32)  # the bottom plane is node 0, the top plane the last one
    node[..., 1:-1] = 1 + np.arange(np.prod(free), dtype=np.int32).reshape(free)
    node[..., -1] = np.prod(free) + 1
    ends, heavy = [], []
    for axis, values in enumerate(weight):
        inside = slice(1, -1) if axis < len(sides) else slice(None)
        joined = node[..., inside]
        ends.append(np.stack([np.delete(joined, end, axis).ravel() for end in (-1, 0)]))
        heavy.append(values[..., inside].ravel())
    at_most = weight[-1].reshape(-1, gaps).sum(axis=0).min()
    unit = np.ldexp(1.0, np.frexp(at_most)[1] - 52)
    capacity = np.floor(np.minimum(np.concatenate(heavy), 2 * at_most) / unit).astype(np.int64)
    above, flow = largest_flow(np.concatenate(ends, axis=1), capacity)
    return above[node], flow * unit


def largest_flow(ends: np.ndarray, capacity: np.ndarray) -> tuple[np.ndarray, int]:
    """A largest flow from the first to the last node of an undirected graph, and the cut that it leaves.

    ends : (2, edges) nodes, no pair twice; capacity : (edges,) int64, those of a least cut below 2^62 together.
    returns : True for the nodes beyond the cut; the flow, which equals the capacity of the cut.

    SciPy's flows have 32 bits, so the leading bits go first. What capacity is left then carries no more than the cut
    found, which fits into fewer bits, and so on: three or four rounds (capacity scaling; Gabow, J. Comput. System Sci.
    31, 1985). Edges that no flow can fill are cut down to a little more than it. A library with 64-bit flows would
    replace this one function.
    """
    nodes = int(ends.max()) + 1
    row, column = np.concatenate([ends, ends[::-1]], axis=1)
    left_over = np.tile(capacity, 2)  # of both directions
    total, at_most = 0, int(min(capacity[(ends == end).any(axis=0)].sum() for end in (0, nodes - 1)))
    while True:
        shift = max(at_most.bit_length() - BITS, 0)
        graph = (np.minimum(left_over, 2 * at_most + 1) >> shift).astype(np.int32)
        result = maximum_flow(csr_array((graph, (row, column)), shape=(nodes, nodes)), 0, nodes - 1)
        sent = np.asarray(result.flow[row, column]).ravel().astype(np.int64)
        left_over -= sent << shift
        total += int(result.flow_value) << shift
        open_ones = graph > sent
        reached = csr_array((open_ones[open_ones], (row[open_ones], column[open_ones])), shape=(nodes, nodes))
        above = np.ones(nodes, dtype=bool)
        above[breadth_first_order(reached, 0, return_predecessors=False)] = False
        if shift == 0:
            return above, total
        cut = int(left_over[~above[row] & above[column]].sum())
        at_most = min(at_most - (int(result.flow_value) << shift), cut)


__all__ = ["MinimumCut", "jump_weights", "largest_flow", "minimum_cut", "weight_of_cut"]
