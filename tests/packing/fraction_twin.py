"""The least power of discs with friction, exactly, by networkx and fractions; nothing is shared with the solvers."""

from fractions import Fraction
from itertools import pairwise

import networkx as nx


def fractions_of(values):
    return [Fraction(float(value)) for value in values]


def least_power_of_discs(packing):
    """Of friction alone. Each disc i has the copies U = u_i and U = -u_i, each contact half its weight twice, and the
    least sum of weighted |U - U'| is an integral of minimum cuts over the imposed values (coarea formula)."""
    friction, normal, radius, spin = (
        fractions_of(part) for part in (packing.friction, packing.normal_force, packing.radius, packing.spin)
    )
    held = {i: spin[i] * radius[i] for i, body in enumerate(packing.driven.tolist()) if body >= 0}
    weight = [a * b for a, b in zip(friction, normal, strict=True)]
    pairs = [(i, j, w) for (i, j), w in zip(packing.contact.tolist(), weight, strict=True)]
    pairs = [(i, j, w) for i, j, w in pairs if w and not (i in held and j in held)]
    whole = max([1, *(w.denominator for _, _, w in pairs)])
    values = sorted({sign * u for u in held.values() for sign in (1, -1)})
    total = Fraction(0)
    for low, high in pairwise(values):

        def node(i, sign, low=low):
            return (i, sign) if i not in held else ("below" if sign * held[i] <= low else "above")

        graph = nx.Graph()
        graph.add_nodes_from(["below", "above"])
        for i, j, w in pairs:
            for sign in (1, -1):
                ends = node(i, sign), node(j, -sign)
                if ends[0] != ends[1]:
                    before = graph.edges[ends]["capacity"] if graph.has_edge(*ends) else 0
                    graph.add_edge(*ends, capacity=before + int(w * whole))
        total += (high - low) * Fraction(nx.minimum_cut_value(graph, "below", "above"), 2 * whole)
    return total
