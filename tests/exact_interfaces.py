"""The lightest interface of a lattice in whole numbers: a twin that shares no code with the package.

Weights F |J x n| (and eta |J x n|^2) are those of exact fractions, rounded down to 2^-BITS; networkx finds the cut, and
what it leaves says which other cuts are as light.
"""

from fractions import Fraction
from math import isqrt

import networkx as nx
import numpy as np

BITS = 600


def contacts(shape, periodic=()):
    """(axis, place in the array of that axis, lower sphere, upper sphere) of every contact."""
    for axis, side in enumerate(shape):
        places = [range(n - (a == axis and a not in periodic)) for a, n in enumerate(shape)]
        for place in _product(places):
            upper = list(place)
            upper[axis] = (upper[axis] + 1) % side
            yield axis, place, place, tuple(upper)


def _product(ranges):
    places = [()]
    for one in ranges:
        places = [(*place, i) for place in places for i in one]
    return places


def jump_at(place, top, bottom, radius):
    """The lateral jump (J_x, J_y, 0), or that of discs (0, 0, J), as fractions. top, bottom : A and C, of discs A."""
    if len(place) == 2:
        return [Fraction(0), Fraction(0), Fraction(top[0]) - Fraction(bottom[0])]
    a, b = ([Fraction(v) for v in (*state, 0.0)[:4]] for state in (top, bottom))
    return [a[k] - b[k] + (a[3] - b[3]) * 2 * Fraction(radius) * place[k] for k in range(2)] + [Fraction(0)]


def squared_slip(place, axis, top, bottom, radius):
    """|J x n|^2 at a contact, n along an axis."""
    return sum(part**2 for k, part in enumerate(jump_at(place, top, bottom, radius)) if k != axis or len(place) == 2)


def whole_weights(arrays, top, bottom, radius, law, viscosity=None, periodic=()):
    """{(axis, place): weight} in units of 2^-BITS, and exact ones by what is beside the root: the friction coefficient
    counts by |J x n|, a damping by its square, half of it beside a friction."""
    shape = shape_of(arrays)
    found = {}
    for axis, place, low, _ in contacts(shape, periodic):
        square = squared_slip(low, axis, top, bottom, radius)
        mu = Fraction(float(arrays[axis][place]))
        if law == "viscous":
            found[axis, place] = int(mu * square * 2**BITS)
        else:
            root = mu**2 * square * 4**BITS
            found[axis, place] = isqrt(root.numerator // root.denominator)
            if law == "coulomb-viscous":
                eta = Fraction(float(viscosity[axis][place]))
                found[axis, place] = 50 * found[axis, place] + int(eta * square * Fraction(radius) / 2 * 2**BITS)
    return shape, found


def shape_of(arrays):
    return (*arrays[-1].shape[:-1], arrays[-1].shape[-1] + 1)


def graph_of(shape, weights, periodic=()):
    """Bottom and top are one node each; of contacts between the same two nodes the weights add up."""
    graph, last = nx.DiGraph(), shape[-1] - 1
    graph.add_nodes_from(["bottom", "top"])
    for axis, place, low, high in contacts(shape, periodic):
        ends = ["bottom" if end[-1] == 0 else "top" if end[-1] == last else end for end in (low, high)]
        weight = weights[axis, place]
        if ends[0] != ends[1] and weight:
            for one, other in (ends, ends[::-1]):
                before = graph[one][other]["capacity"] if graph.has_edge(one, other) else 0
                graph.add_edge(one, other, capacity=before + weight)
    return graph


def lightest(shape, weights, periodic=(), slack=None):
    """Weight of the lightest cut, whether every other set of slipping contacts is heavier by more than `slack`
    (default: what rounding down can take), and the residual graph."""
    graph = graph_of(shape, weights, periodic)
    flow = nx.algorithms.flow.preflow_push(graph, "bottom", "top")
    value, left = flow.graph["flow_value"], nx.DiGraph()
    slack = len(weights) if slack is None else slack
    left.add_nodes_from(graph)
    for one, other, what in flow.edges(data=True):
        if what["capacity"] - what["flow"] > slack:
            left.add_edge(one, other)
    reach = nx.descendants(left, "bottom") | {"bottom"}
    back = nx.ancestors(left, "top") | {"top"}
    joined = nx.node_connected_component(nx.Graph(graph), "bottom") | nx.node_connected_component(
        nx.Graph(graph), "top"
    )
    return value, not (joined - reach - back), left


def power_of_sides(scene, top, bottom, above):
    """Power of a state in the laboratory whose spheres turn as the top where `above` says so, else as the bottom, but
    about the height alike: slips are added up contact by contact, from cross products."""
    shape, total = scene.lattice.shape, 0.0
    a, b = (np.array((*state, 0.0)[:4]) for state in (top, bottom))
    values = scene.lattice.by_axis(scene.coefficient[0])
    for axis, place, low, high in contacts(shape, scene.lattice.periodic):
        if low[-1] == high[-1] and low[-1] in (0, shape[-1] - 1):
            continue
        spins = []
        for site in (low, high):
            state = a if above[site] else b
            x = 2 * scene.radius * np.array(low if site is high and site[axis] < low[axis] else site)
            spins.append((-1) ** sum(site) * (state[:3] + state[3] * x) * [1, 1, 0])
        slip = scene.radius * np.linalg.norm(np.cross(spins[0] + spins[1], np.eye(3)[axis]))
        total += values[axis][place] * scene.strength * (slip if scene.law.has_friction else slip**2)
    return total


def slipping_in_some_and_every(shape, weights, periodic=()):
    """{(axis, place): (in some, in every) lightest cut} of the contacts with weight, of whole weights: what a largest
    flow of networkx leaves open says it. Contacts between two spheres of bottom or top are left out."""
    _, _, left = lightest(shape, weights, periodic, slack=0)
    near = nx.descendants(left, "bottom") | {"bottom"}
    far = nx.ancestors(left, "top") | {"top"}
    label = {node: number for number, part in enumerate(nx.strongly_connected_components(left)) for node in part}
    found, last = {}, shape[-1] - 1
    for axis, place, low, high in contacts(shape, periodic):
        ends = ["bottom" if end[-1] == 0 else "top" if end[-1] == last else end for end in (low, high)]
        if weights[axis, place] and ends[0] != ends[1]:
            every = any(one in near and other in far for one, other in (ends, ends[::-1]))
            found[axis, place] = label[ends[0]] != label[ends[1]], every
    return found
