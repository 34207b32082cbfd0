"""The network of slipless contacts: which spheres it reaches, whether it joins the driven bodies, and by which paths.

Edges are slipless contacts. Nodes are free spheres and driven *bodies*: a body is a set of driven spheres that rotate
as one bearing, for a lattice the bottom or the top plane. Contacts between two spheres of a body are not edges. A
*piece* is a connected component of this graph.

Shapes: N spheres (the shape of a lattice, else their number), `sites` their number, E edges. Indices of spheres are in
C order. Graph searches and flows are SciPy's.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, dijkstra, maximum_flow

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.minimum_cut import number_bodies
from taichi_bearings.scene.network import Network

MOST_BODIES = 50  # most driven bodies between which paths are searched for


@dataclass(frozen=True)
class SliplessNetwork:
    """The slipless contacts of one sample as a graph. Nodes are free spheres and driven bodies (bottom and top of a
    lattice); edges are slipless contacts that do not join two spheres of one body.

    whole : the network of all spheres and contacts.
    slipless : (contacts,) mask of the slipless ones among all contacts; False between two driven spheres.
    """

    whole: Network
    slipless: np.ndarray

    @property
    def lattice(self) -> Lattice:
        """The lattice of the sample, which must be one: a packing has none."""
        lattice = self.whole.lattice
        assert lattice is not None
        return lattice

    @cached_property
    def body(self) -> np.ndarray:
        """(spheres,), node of each sphere: 0 for spheres of the first driven body, then one for each free sphere, then
        one for each further driven body.

        On a lattice the first body is the bottom plane, and the last node is the top plane.
        """
        return number_bodies(self.whole.body)

    @cached_property
    def ends(self) -> np.ndarray:
        """(2, edges), numbers of the first and the second sphere of each edge; on a lattice the lower and the upper
        one.
        """
        return np.asarray(self.whole.contact[:, self.slipless])

    @cached_property
    def axis(self) -> np.ndarray:
        """(edges,), number of the axis along which each edge of a lattice lies: first all edges along x, then y (then
        z)."""
        return np.asarray(self.lattice.axis[self.slipless])

    @cached_property
    def contact(self) -> np.ndarray:
        """(edges, dimension), lattice position of each edge's lower sphere, which together with `axis` identifies the
        contact.
        """
        return self.places(self.ends[0])

    @property
    def names(self) -> dict[str, np.ndarray]:
        """Columns (edges, ...) that identify the edges (slipless contacts) in listings, by name: position of the lower
        sphere and axis on a lattice, else numbers of contact and spheres.
        """
        return self.whole.named(np.flatnonzero(self.slipless))

    def places(self, spheres: np.ndarray) -> np.ndarray:
        """Return the lattice positions of some spheres, (spheres, dimension), from their numbers (spheres,)."""
        return np.stack(np.unravel_index(spheres, self.shape), axis=1)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of arrays over the spheres: that of the lattice, or (spheres,)."""
        return self.whole.shape

    @property
    def free(self) -> np.ndarray:
        """Mask of the free spheres, in the shape of the lattice or (spheres,)."""
        return self.whole.free.reshape(self.shape)

    @cached_property
    def touched(self) -> np.ndarray:
        """Mask of the spheres that are an end of an edge (slipless contact), in the shape of the lattice or
        (spheres,).
        """
        return (np.bincount(self.ends.ravel(), minlength=len(self.body)) > 0).reshape(self.shape)

    @property
    def bodies(self) -> int:
        """Number of nodes: free spheres and driven bodies."""
        return int(self.body.max(initial=-1)) + 1

    @cached_property
    def driven_nodes(self) -> np.ndarray:
        """Numbers of the nodes that are driven bodies, in rising order."""
        return np.unique(self.body[~self.free.ravel()])

    def touched_of(self, body: int) -> np.ndarray:
        """Return the numbers of the spheres of a driven body that have a slipless contact.

        body : number of the node that stands for the body.
        """
        return np.flatnonzero(self.touched.ravel() & (self.body == body))

    def graph(self, chosen: np.ndarray | None = None) -> csr_array:
        """Return the symmetric adjacency matrix (nodes, nodes), with 1 where an edge joins two nodes.

        chosen : (edges,), mask of the edges that take part; default all.
        """
        ends = self.body[self.ends if chosen is None else self.ends[:, chosen]]
        both = np.concatenate([ends, ends[::-1]], axis=1)
        ones = np.ones(both.shape[1], dtype=np.int32)
        return csr_array((ones, (both[0], both[1])), shape=(self.bodies, self.bodies))

    def pieces(self, chosen: np.ndarray | None = None) -> np.ndarray:
        """Return the number (nodes,) of the connected piece of each node; 0 is the piece of the first driven body.

        chosen : (edges,), mask of the edges that take part; default all.
        """
        label: np.ndarray = connected_components(self.graph(chosen), directed=False)[1]
        return label

    @cached_property
    def component(self) -> np.ndarray:
        """Number of the connected piece of each sphere, in the shape of the lattice or (spheres,); 0 is the piece of
        the first driven body.
        """
        found: np.ndarray = self.pieces()[self.body].reshape(self.shape)
        return found

    @property
    def components(self) -> int:
        """Number of connected pieces with at least one edge: single spheres are not counted."""
        return len(np.unique(self.component[self.touched]))

    @property
    def spans(self) -> bool:
        """True if slipless contacts join two driven bodies; for a lattice the bottom and the top plane."""
        return bool(self.spanning.any())

    @cached_property
    def spanning(self) -> np.ndarray:
        """Mask of the spheres in connected pieces that join driven bodies, in the shape of the lattice or
        (spheres,).
        """
        piece = self.pieces()
        joins_bodies = np.bincount(piece[self.driven_nodes], minlength=len(piece)) > 1  # by number of the piece
        return np.asarray(joins_bodies[self.component])

    def _share_of_free(self, chosen: np.ndarray) -> Any:
        """Return the share of the free spheres that a mask selects; None without free spheres.

        chosen : the mask, in the shape of the lattice or (spheres,).
        """
        return float(chosen[self.free].mean()) if self.free.any() else None

    @property
    def reached_fraction(self) -> Any:
        """Share of the free spheres that have a slipless contact; None without free spheres."""
        return self._share_of_free(self.touched)

    @property
    def spanning_fraction(self) -> Any:
        """Share of the free spheres that are in pieces which join driven bodies; None without free spheres."""
        return self._share_of_free(self.spanning)

    @property
    def disjoint_paths(self) -> Any:
        """Largest number of paths between the two driven bodies that share no contact; None unless there are two.

        It is also the smallest number of contacts whose removal separates the bodies (Menger's theorem).
        """
        return int(maximum_flow(self.graph(), *self.driven_nodes).flow_value) if len(self.driven_nodes) == 2 else None

    def on_contacts(self, values: np.ndarray) -> np.ndarray:
        """Return an array (contacts,) over all contacts of the sample: the values at slipless contacts, 0 at the
        others.

        values : (edges,), one for each slipless contact.
        """
        spread = np.zeros(self.slipless.shape, dtype=values.dtype)
        spread[self.slipless] = values
        return spread

    @cached_property
    def path(self) -> np.ndarray:
        """Indices (L,) of the L spheres along one of the shortest paths between two driven bodies.

        It leads from bottom to top on a lattice; among equally short paths it is the first that a breadth-first search
        finds. It is empty if there is no path, or more than MOST_BODIES bodies.
        """
        if not self.spans or len(self.driven_nodes) > MOST_BODIES:
            return np.empty(0, dtype=int)
        # of more than two bodies the two that are nearest to each other
        graph, (start, stop) = self.graph(), self.driven_nodes[[0, -1]]
        if len(self.driven_nodes) > 2:
            distance = dijkstra(graph, unweighted=True, indices=self.driven_nodes)[:, self.driven_nodes]
            np.fill_diagonal(distance, np.inf)
            start, stop = self.driven_nodes[list(np.unravel_index(distance.argmin(), distance.shape))]
        # back along the predecessors of a breadth-first search, then from nodes to spheres
        predecessor, nodes = breadth_first_order(graph, start, directed=False)[1], [stop]
        while nodes[-1] != start:
            nodes.append(predecessor[nodes[-1]])
        inner = [int(np.flatnonzero(self.body == node)[0]) for node in nodes[-2:0:-1]]
        return np.array([self._driven_neighbour(inner[0], start), *inner, self._driven_neighbour(inner[-1], stop)])

    def _driven_neighbour(self, sphere: int, body: int) -> int:
        """Return the number of a sphere of a driven body that a slipless contact joins to a free sphere; there must be
        one.

        sphere : number of the free sphere.
        body : number of the node that stands for the driven body.
        """
        first, second = self.ends
        others = np.concatenate([second[first == sphere], first[second == sphere]])
        return int(others[self.body[others] == body][0])

    @property
    def shortest_path(self) -> np.ndarray:
        """(L, dimension), lattice positions of the L spheres along the shortest path of slipless contacts from bottom
        to top; L = 0 if there is none.
        """
        return self.places(self.path)

    @cached_property
    def on_path(self) -> np.ndarray:
        """(contacts,) mask: True for contacts between successive spheres of the shortest path `path` between two
        driven bodies.

        Two spheres in a ring of two have two contacts with each other, of which the first one is taken.
        """
        place, path = np.full(len(self.body), -2), self.path  # place along the path; -2 is next to no place on it
        place[path] = np.arange(len(path))
        low, high = place[self.ends]
        steps = np.flatnonzero(np.abs(low - high) == 1)
        first = np.unique(np.minimum(low, high)[steps], return_index=True)[1]
        return self.on_contacts(np.isin(np.arange(len(low)), steps[first]))

    @property
    def path_planes(self) -> Any:
        """Numbers of lattice planes that the shortest slipless path from bottom to top visits, as a list: of planes
        across x and, in 3D, across y. None for a packing.
        """
        return [len(np.unique(places)) for places in self.shortest_path.T[:-1]] or None

    def winding(self, axis: int) -> np.ndarray:
        """Return a mask of the spheres, in the shape of the lattice, in connected pieces that have a closed path of
        slipless contacts around a periodic axis.

        axis : number of the axis.

        Here every driven sphere is a node of its own: a driven plane as one node would always go around.
        """
        over_the_side = (self.axis == axis) & (self.contact[:, axis] == self.shape[axis] - 1)
        return winding(len(self.body), self.ends, over_the_side.astype(int)).reshape(self.shape)

    def winds_around(self, axis: int, spanning: bool = False) -> bool | None:
        """Return True if slipless contacts form a closed path around an axis; None if the axis is not periodic or there
        is no lattice.

        axis : number of the axis.
        spanning : True to count only paths in connected pieces that join bottom and top.
        """
        if axis not in self.whole.periodic:
            return None
        return bool((self.winding(axis) & (self.spanning if spanning else True)).any())


def winding(nodes: int, ends: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return a mask (nodes,) of the nodes in connected pieces of a graph that have a closed path around a periodic
    axis.

    nodes : number of nodes.
    ends : (2, edges), nodes of each edge.
    turns : (edges,), whole numbers: how often an edge goes around from its first end to the second.

    A closed path goes around if its turns do not add up to 0. A piece without such a path can be unrolled: its nodes
    get heights, whole numbers whose differences are the turns of the edges.
    """
    # edges that do not go around join nodes of one height to parts; union-find joins these parts by the other edges
    level = turns == 0
    pairs = (np.ones(level.sum()), tuple(ends[:, level]))
    parts, part = connected_components(coo_array(pairs, shape=(nodes, nodes)), directed=False)
    parent, height, winds = list(range(parts)), [0] * parts, [False] * parts  # height of a part above its parent

    def root_of(one: int) -> tuple[int, int]:
        """Return the root of a part in its tree of joined parts, and the height of the part above that root. Parts on
        the way become children of the root.

        one : number of the part.
        """
        passed = []
        while parent[one] != one:
            passed.append(one)
            one = parent[one]
        total = 0
        for child in reversed(passed):
            total += height[child]
            parent[child], height[child] = one, total
        return one, total

    for first, second, turn in zip(*part[ends[:, ~level]].tolist(), turns[~level].tolist(), strict=True):
        (one, above_one), (other, above_other) = root_of(first), root_of(second)
        difference = above_one + turn - above_other  # of the heights of the two roots, by this edge
        if one == other:
            winds[one] |= difference != 0  # the edge closes a path that goes around
        else:
            parent[other], height[other] = one, difference
            winds[one] |= winds[other]
    found: np.ndarray = np.array([winds[root_of(one)[0]] for one in range(parts)])[part]
    return found
