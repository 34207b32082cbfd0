"""Slipless networks drawn by hand or at random, and the same ones as graphs of networkx, which knows no lattice."""

from itertools import pairwise

import networkx
import numpy as np

from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.lattice import Lattice
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene.network import Network


def drawn(shape, *paths, periodic=()):
    """The network whose links are the steps of these paths; a path is a list of neighbouring positions, in rings of
    more than two also over a periodic side."""
    lattice = Lattice(shape, periodic=periodic)
    slipless = np.zeros(lattice.all_contacts, dtype=bool)
    of_axis = lattice.by_axis(slipless)
    for path in paths:
        for here, there in pairwise(path):
            step = np.subtract(there, here)
            axis = int(np.abs(step).argmax())
            ring = shape[axis] if axis in periodic else 0
            assert np.abs(step).sum() in {1, ring - 1}, f"{here} and {there} do not touch"
            of_axis[axis][tuple((np.maximum if np.abs(step).sum() > 1 else np.minimum)(here, there))] = True
    return SliplessNetwork(Network.of(lattice), slipless)


def random_network(shape, share, seed, periodic=()):
    """Every contact that can slip is a link with probability `share`."""
    lattice, random = Lattice(shape, periodic=periodic), np.random.default_rng(seed)
    return SliplessNetwork(Network.of(lattice), (random.random(lattice.all_contacts) < share) & ~lattice.between_driven)


def network_of(lattice, state):
    """The network of the contacts in state SLIPLESS."""
    return SliplessNetwork(Network.of(lattice), state == ContactState.SLIPLESS)


def numbered(network, values):
    """Values (E,) of the links as a dictionary, each link named by its two positions."""
    places = [[tuple(map(int, np.unravel_index(i, network.lattice.shape))) for i in end] for end in network.ends]
    return {(low, high): value for low, high, value in zip(*places, values.tolist(), strict=True)}


def graph_of_spheres(network):
    graph = networkx.Graph()
    graph.add_nodes_from(range(network.lattice.sites))
    graph.add_edges_from(network.ends.T.tolist())
    return graph


def graph_of_bodies(network):
    """Each driven plane is one node: "bottom" or "top"; the others are positions. An edge knows its `link`; in a
    ring of two spheres two edges may join the same nodes."""

    def name(sphere):
        place = tuple(map(int, np.unravel_index(sphere, network.lattice.shape)))
        return {0: "bottom", network.lattice.shape[-1] - 1: "top"}.get(place[-1], place)

    graph = networkx.MultiGraph()
    graph.add_nodes_from(map(name, range(network.lattice.sites)))
    for link, (low, high) in enumerate(network.ends.T.tolist()):
        graph.add_edge(name(low), name(high), link=link)
    return graph


CHAIN = drawn((3, 5), [(1, height) for height in range(5)])
TWO_CHAINS = drawn((3, 4), [(0, height) for height in range(4)], [(2, height) for height in range(4)])
LADDER = drawn((2, 4), [(0, h) for h in range(4)], [(1, h) for h in range(4)], [(0, 1), (1, 1)], [(0, 2), (1, 2)])
SQUARE = drawn((2, 4), [(0, 0), (0, 1), (1, 1), (1, 2), (1, 3)], [(0, 1), (0, 2), (1, 2)])
HEXAGONS = drawn(  # three paths from corner to corner of a cube that share no sphere
    (2, 2, 5),
    [(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (1, 1, 2), (1, 1, 3), (1, 1, 4)],
    [(0, 0, 1), (0, 1, 1), (0, 1, 2), (1, 1, 2)],
    [(0, 0, 1), (0, 0, 2), (1, 0, 2), (1, 1, 2)],
)
DUMBBELL = drawn(  # two squares, a bridge between them and a dangling end
    (3, 6),
    [(0, 0), (0, 1), (1, 1), (1, 2), (1, 3), (2, 3), (2, 4), (2, 5)],
    [(0, 1), (0, 2), (1, 2)],
    [(1, 3), (1, 4), (2, 4)],
    [(0, 2), (0, 3)],
)
APART = drawn((3, 5), [(0, 0), (0, 1), (1, 1)], [(1, 4), (1, 3), (1, 2)])
EMPTY = drawn((2, 3, 4))
RANDOM = [
    random_network((7, 9), 0.7, 11),
    random_network((4, 12), 0.8, 12),
    random_network((4, 5, 6), 0.42, 17),
    random_network((6, 3, 5), 0.5, 15),
    random_network((3, 4, 9), 0.5, 14),
    random_network((6, 8), 0.6, 18, (0,)),
    random_network((2, 7), 0.7, 20, (0,)),
    random_network((2, 3, 7), 0.55, 22, (0,)),
    random_network((4, 2, 6), 0.4, 23, (0, 1)),
    random_network((4, 6, 5), 0.35, 24, (0, 1)),
]
