"""Periodic discs: the cut against the shortest ring of the dual graph.

Nothing is shared with the package but the coefficients: SciPy's Dijkstra method finds the shortest way around in an
unrolled dual graph.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

import taichi_bearings as tb

SAME = 1e-12  # relative


def shortest_ring(sideways, upward):
    """Least weight of the contacts that a closed walk around the lattice crosses; the walk is unrolled five times."""
    columns, gaps = upward.shape
    turns, edges = 5, []

    def face(column, gap):  # to the right of a column of spheres
        return column * gaps + gap

    for column in range(turns * columns):
        here = column % columns
        if column:
            edges += [(face(column - 1, gap), face(column, gap), upward[here, gap]) for gap in range(gaps)]
        edges += [(face(column, gap - 1), face(column, gap), sideways[here, gap]) for gap in range(1, gaps)]
    first, second, weight = (np.array(part) for part in zip(*edges, strict=True))
    nodes = turns * columns * gaps
    graph = coo_array((weight, (first, second)), shape=(nodes, nodes)).tocsr()
    start = [face(2 * columns, gap) for gap in range(gaps)]
    distance = dijkstra(graph, directed=False, indices=start)
    return min(distance[gap, face(3 * columns, gap)] for gap in range(gaps))


def differences(scene):
    """Relative distances of the power and of the lower bound from the truth."""
    best = tb.solve(scene, threads=1)
    truth = scene.normal_force * scene.lattice.radius * scene.jump * shortest_ring(*scene.coefficients)
    return [abs(said / truth - 1) for said in (best.power, best.lower_bound)]
