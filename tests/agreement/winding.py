"""Periodic discs: the cut against the shortest ring of the dual graph, found by itself, and against a general flow.

Nothing is shared with the package but the coefficients: NetworkX finds the flow, and SciPy's Dijkstra method the
shortest way around in an unrolled dual graph.
"""

import networkx
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


def largest_flow(sideways, upward):
    """From the bottom to the top of the same lattice, each of them one node."""
    columns, gaps = upward.shape
    graph = networkx.DiGraph()

    def node(column, height):
        return "bottom" if height == 0 else "top" if height == gaps else (column % columns, height)

    def join(low, high, weight):
        for a, b in ((low, high), (high, low)):
            before = graph.get_edge_data(a, b, {"capacity": 0.0})["capacity"]
            graph.add_edge(a, b, capacity=before + weight)

    for column in range(columns):
        for height in range(gaps):
            join(node(column, height), node(column, height + 1), upward[column, height])
            if height:
                join(node(column, height), node(column + 1, height), sideways[column, height])
    return networkx.maximum_flow_value(graph, "bottom", "top")


def differences(scene):
    """Relative distances of the power and of the lower bound from either truth, in units of the power."""
    best = tb.solve(scene, threads=1)
    unit = scene.normal_force * scene.lattice.radius * scene.jump
    truths = [unit * truth(*scene.coefficients) for truth in (shortest_ring, largest_flow)]
    return [abs(said / truth - 1) for said in (best.power, best.lower_bound) for truth in truths]
