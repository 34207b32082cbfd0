"""The least power of discs with friction, exactly, by networkx and fractions; nothing is shared with the solvers."""

from fractions import Fraction
from itertools import pairwise

import networkx as nx


def fractions_of(values):
    return [Fraction(float(value)) for value in values]


def steps_of_discs(packing):
    """For each step between imposed values, of friction alone: its size, the graph whose lightest cuts are the minima
    there, the two edges of each contact (none for those that do not count), and what the weights are divided by.

    Each disc i has the copies U = u_i and U = -u_i, each contact half its weight twice."""
    friction, normal, radius, spin = (
        fractions_of(part) for part in (packing.friction, packing.normal_force, packing.radius, packing.spin)
    )
    held = {i: spin[i] * radius[i] for i, body in enumerate(packing.driven.tolist()) if body >= 0}
    weight = [a * b for a, b in zip(friction, normal, strict=True)]
    pairs = dict(enumerate((i, j, w) for (i, j), w in zip(packing.contact.tolist(), weight, strict=True)))
    pairs = {e: (i, j, w) for e, (i, j, w) in pairs.items() if w and not (i in held and j in held)}
    whole = max([1, *(w.denominator for _, _, w in pairs.values())])
    values = sorted({sign * u for u in held.values() for sign in (1, -1)})
    for low, high in pairwise(values):

        def node(i, sign, low=low):
            return (i, sign) if i not in held else ("below" if sign * held[i] <= low else "above")

        graph, edges = nx.Graph(), {}
        graph.add_nodes_from(["below", "above"])
        for e, (i, j, w) in pairs.items():
            edges[e] = [(node(i, sign), node(j, -sign)) for sign in (1, -1)]
            for ends in edges[e]:
                if ends[0] != ends[1]:
                    before = graph.edges[ends]["capacity"] if graph.has_edge(*ends) else 0
                    graph.add_edge(*ends, capacity=before + int(w * whole))
        yield high - low, graph, edges, 2 * whole


def least_power_of_discs(packing):
    """The least sum of weighted |U - U'| is an integral of minimum cuts over the imposed values (coarea formula)."""
    return sum(
        (
            size * Fraction(nx.minimum_cut_value(graph, "below", "above"), whole)
            for size, graph, _, whole in steps_of_discs(packing)
        ),
        Fraction(0),
    )


def states_of_discs(packing):
    """By contact: 3 if it does not count, 1 if it slips at every minimum, 4 if at some, 0 if at none.

    Lightest cuts are the sets that no arc of the residual graph of a largest flow leaves (Picard and Queyranne, 1980).
    A contact rests at some minimum if at every step such a set is left once both ends of each of its edges are one."""
    slips, always = set(), set()
    for _, graph, edges, _ in steps_of_discs(packing):
        flow = nx.algorithms.flow.preflow_push(graph, "below", "above")
        arcs = nx.DiGraph()
        arcs.add_nodes_from(flow)
        arcs.add_edges_from((a, b) for a, b, of in flow.edges(data=True) if of["flow"] < of["capacity"])
        place = {v: number for number, part in enumerate(nx.strongly_connected_components(arcs)) for v in part}
        place |= {v: len(place) + 1 for v in {v for pair in edges.values() for ends in pair for v in ends} - set(place)}
        for e, pair in edges.items():
            if all(a == b or place[a] == place[b] for a, b in pair):
                continue
            slips.add(e)
            joined = arcs.copy()
            joined.add_edges_from([(a, b) for a, b in pair] + [(b, a) for a, b in pair])
            if nx.has_path(joined, "below", "above"):
                always.add(e)
    absent = (packing.driven[packing.contact] >= 0).all(axis=1) | (packing.friction * packing.normal_force == 0)
    return [3 if absent[e] else 1 if e in always else 4 if e in slips else 0 for e in range(packing.contacts)]
