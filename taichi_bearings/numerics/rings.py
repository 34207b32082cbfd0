"""Finds minimum cuts of planar grids whose rows close to rings, by flows.

Letters: B grids, w columns, h rows.
"""

from collections.abc import Iterator

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.exact_cuts import cuts_between
from taichi_bearings.numerics.minimum_cut import cut_lattice, edges_of, graph_of_lattice
from taichi_bearings.numerics.planar import MinimumCuts


def ring_cuts(sideways: np.ndarray, upward: np.ndarray) -> Iterator[tuple[slice, MinimumCuts]]:
    """Yield the cuts of least weight between the bottom row and the top row of each grid, one grid at a time.

    sideways : weights (B, w, h) of contacts along the rows of B grids of w columns and h rows; the last column's are
        those with the first column.
    upward : weights (B, w, h - 1) of contacts between rows.
    yields : the number of the grid as a slice of length 1, and its cut: side of each sphere, flow, ties and weight. The
        weight of the lightest other cut, `next_weight`, is not known (NaN) where cuts do not tie.

    A flow of rounded weights shows for most spheres that they are on one side of all lightest cuts. The part of the
    grid between these is cut again with exact weights.
    """
    for grid in range(len(upward)):
        weight = sideways[grid], upward[grid]
        cut, lattice = cut_lattice(weight), Lattice.of(weight)
        node, ends = graph_of_lattice(lattice)
        above, open_ = np.zeros((2, int(node.max()) + 1), dtype=bool)
        above[node], open_[node] = cut.above, cut.between
        tied = np.zeros(ends.shape[1], dtype=bool)
        if open_.any():
            exact, place = cuts_between(ends, edges_of(weight), above, open_)
            tied, above = exact.some & ~exact.every, exact.above[place]
        # Values of the edges of the graph go back to the contacts; those along the end rows, which are no edges, stay
        # 0.
        beside, rising = np.zeros(sideways.shape[1:], dtype=bool), np.zeros(upward.shape[1:], dtype=bool)
        ring, risen = np.zeros(sideways.shape[1:]), np.zeros(upward.shape[1:])
        for along, up, values in ((ring, risen, cut.flow * cut.unit), (beside, rising, tied)):
            inner, rest = np.split(values, [along[:, 1:-1].size])
            along[:, 1:-1], up[:] = inner.reshape(along[:, 1:-1].shape), rest.reshape(up.shape)
        next_weight = np.array(cut.weight if tied.any() else np.nan)
        found = above[node], ring, risen, beside, rising, np.array(cut.weight), next_weight
        yield slice(grid, grid + 1), MinimumCuts(*(values[None] for values in found))
