"""The network of slipless contacts: what it reaches, whether it joins the driven bodies, and by which paths.

Nodes are spheres, edges are slipless contacts. Each driven body, of a lattice a plane, is one node, because its spheres
turn as one bearing, so contacts between two of its spheres are not edges and a path starts where it leaves the body.
Graph searches and flows are SciPy's.
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

MOST_BODIES = 50  # between which paths are looked for


@dataclass(frozen=True)
class SliplessNetwork:
    """Spheres of one sample and the slipless contacts that join them.

    whole : all spheres and contacts. slipless : (contacts,) bool, of all contacts, False between two driven spheres.
    Spheres have their shape N, where there is no lattice (sites,); as indices they are in C order.
    """

    whole: Network
    slipless: np.ndarray

    @property
    def lattice(self) -> Lattice:
        """The lattice whose contacts these are, where there is one."""
        assert self.whole.lattice is not None
        return self.whole.lattice

    @cached_property
    def body(self) -> np.ndarray:
        """Node (sites,) of each sphere in the graph of bodies: 0 the first driven body, then the free spheres, then the
        other driven bodies, of a lattice the top plane."""
        return number_bodies(self.whole.body)

    @cached_property
    def ends(self) -> np.ndarray:
        """First and second, of a lattice lower and upper, sphere (2, E) of each edge, as indices."""
        return np.asarray(self.whole.contact[:, self.slipless])

    @cached_property
    def axis(self) -> np.ndarray:
        """Of a lattice: axis (E,) of each edge: all x-contacts first, then y (then z), each in C order."""
        return np.asarray(self.lattice.axis[self.slipless])

    @cached_property
    def contact(self) -> np.ndarray:
        """Of a lattice: position (E, dimension) of each edge's lower sphere, which names the contact along `axis`."""
        return self.places(self.ends[0])

    @property
    def names(self) -> dict[str, np.ndarray]:
        """What tells people which edges these are, (E, ...)."""
        if self.whole.lattice is None:
            return {"contact": np.flatnonzero(self.slipless), "spheres": self.ends.T}
        return {"contact": self.contact, "axis": self.axis}

    def places(self, spheres: np.ndarray) -> np.ndarray:
        """Of a lattice: positions (n, dimension) of spheres (n,)."""
        return np.stack(np.unravel_index(spheres, self.shape), axis=1)

    @property
    def shape(self) -> tuple[int, ...]:
        """N."""
        return self.whole.shape

    @property
    def free(self) -> np.ndarray:
        """True for free spheres, shape N."""
        return self.whole.free.reshape(self.shape)

    @cached_property
    def touched(self) -> np.ndarray:
        """True for spheres that touch a slipless contact, shape N."""
        return (np.bincount(self.ends.ravel(), minlength=len(self.body)) > 0).reshape(self.shape)

    @property
    def bodies(self) -> int:
        return int(self.body.max(initial=-1)) + 1

    @cached_property
    def held(self) -> np.ndarray:
        """Nodes of the driven bodies."""
        return np.unique(self.body[~self.free.ravel()])

    def touched_of(self, body: int) -> np.ndarray:
        """Spheres of a body that touch a slipless contact, as indices."""
        return np.flatnonzero(self.touched.ravel() & (self.body == body))

    def graph(self, chosen: np.ndarray | None = None) -> csr_array:
        """Adjacency matrix (bodies, bodies) of int32 ones, symmetric; chosen : (E,) bool, edges that take part."""
        ends = self.body[self.ends if chosen is None else self.ends[:, chosen]]
        both = np.concatenate([ends, ends[::-1]], axis=1)
        ones = np.ones(both.shape[1], dtype=np.int32)
        return csr_array((ones, (both[0], both[1])), shape=(self.bodies, self.bodies))

    def pieces(self, chosen: np.ndarray | None = None) -> np.ndarray:
        """Label (bodies,) of the connected piece of each body, 0 that of the bottom plane. chosen : as of `graph`."""
        label: np.ndarray = connected_components(self.graph(chosen), directed=False)[1]
        return label

    @cached_property
    def component(self) -> np.ndarray:
        """Label, shape N, of the connected piece of each sphere; 0 is the piece of the first driven body."""
        return self.pieces()[self.body].reshape(self.shape)

    @property
    def components(self) -> int:
        """Pieces that hold a slipless contact."""
        return len(np.unique(self.component[self.touched]))

    @property
    def spans(self) -> bool:
        """True if slipless contacts join two driven bodies, of a lattice the bottom and the top plane."""
        return bool(self.spanning.any())

    @cached_property
    def spanning(self) -> np.ndarray:
        """True for the spheres of pieces that join driven bodies, shape N."""
        label = self.pieces()
        several = np.bincount(label[self.held], minlength=len(label)) > 1
        return np.asarray(several[self.component])

    def _share(self, chosen: np.ndarray) -> Any:
        return float(chosen[self.free].mean()) if self.free.any() else None

    @property
    def reached_fraction(self) -> Any:
        """Share of the free spheres that touch a slipless contact; None without any."""
        return self._share(self.touched)

    @property
    def spanning_fraction(self) -> Any:
        """Share of the free spheres that belong to pieces that join driven bodies; None without any."""
        return self._share(self.spanning)

    @property
    def disjoint_paths(self) -> Any:
        """Number of paths between the two driven bodies that share no contact, as many as there are, and the fewest
        contacts whose removal parts them (Menger); None with more or fewer bodies."""
        return int(maximum_flow(self.graph(), *self.held).flow_value) if len(self.held) == 2 else None

    def on_contacts(self, values: np.ndarray) -> np.ndarray:
        """Values (E,) of the edges spread over all contacts, 0 elsewhere."""
        spread = np.zeros(self.slipless.shape, dtype=values.dtype)
        spread[self.slipless] = values
        return spread

    @cached_property
    def path(self) -> np.ndarray:
        """Spheres (L,), as indices, along one of the shortest paths between driven bodies, of a lattice from bottom to
        top; (0,) if there is none, or more than MOST_BODIES bodies. Of equally short ones the first that a
        breadth-first search finds."""
        if not self.spans or len(self.held) > MOST_BODIES:
            return np.empty(0, dtype=int)
        graph, (start, stop) = self.graph(), self.held[[0, -1]]
        if len(self.held) > 2:
            far = dijkstra(graph, unweighted=True, indices=self.held)[:, self.held]
            np.fill_diagonal(far, np.inf)
            start, stop = self.held[list(np.unravel_index(far.argmin(), far.shape))]
        before, nodes = breadth_first_order(graph, start, directed=False)[1], [stop]
        while nodes[-1] != start:
            nodes.append(before[nodes[-1]])
        inner = [int(np.flatnonzero(self.body == node)[0]) for node in nodes[-2:0:-1]]
        return np.array([self._beside(inner[0], start), *inner, self._beside(inner[-1], stop)])

    def _beside(self, sphere: int, body: int) -> int:
        """A sphere of a body to which this sphere has a link."""
        first, second = self.ends
        others = np.concatenate([second[first == sphere], first[second == sphere]])
        return int(others[self.body[others] == body][0])

    @property
    def shortest_path(self) -> np.ndarray:
        """Of a lattice: positions (L, dimension) of these spheres."""
        return self.places(self.path)

    @cached_property
    def on_path(self) -> np.ndarray:
        """True (contacts,) for those of the shortest path; of two between the same spheres, in a ring of two, the first
        is."""
        place, path = np.full(len(self.body), -2), self.path
        place[path] = np.arange(len(path))
        low, high = place[self.ends]
        steps = np.flatnonzero(np.abs(low - high) == 1)
        first = np.unique(np.minimum(low, high)[steps], return_index=True)[1]
        return self.on_contacts(np.isin(np.arange(len(low)), steps[first]))

    @property
    def path_planes(self) -> Any:
        """Number of lattice planes across each sideways axis that this path visits; None of a packing."""
        if self.whole.lattice is None:
            return None
        return [len(np.unique(places)) for places in self.shortest_path.T[:-1]]

    def winding(self, axis: int) -> np.ndarray:
        """Of a lattice: True, shape N, for spheres of pieces in which a closed way of slipless contacts goes around
        this axis. No way leads along a driven plane, which would go around in any case."""
        over_the_side = (self.axis == axis) & (self.contact[:, axis] == self.shape[axis] - 1)
        return winding(len(self.body), self.ends, over_the_side.astype(int)).reshape(self.shape)

    def winds_around(self, axis: int, spanning: bool = False) -> bool | None:
        """Whether slipless contacts, or those of the piece that joins the planes, go around this axis; None where it is
        not a periodic one of a lattice."""
        if self.whole.lattice is None or axis not in self.whole.lattice.periodic:
            return None
        return bool((self.winding(axis) & (self.spanning if spanning else True)).any())


def winding(nodes: int, ends: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """True (nodes,) for those of pieces of a graph with a closed way along which the turns do not add up to 0.

    ends : (2, E) of the edges. turns : (E,) whole numbers, how often an edge goes around from its first end to the
    second. A piece without such a way can be unrolled: its nodes have places whose differences are the turns.
    """
    still = turns == 0
    pairs = (np.ones(still.sum()), tuple(ends[:, still]))
    pieces, piece = connected_components(coo_array(pairs, shape=(nodes, nodes)), directed=False)
    above, place, winds = list(range(pieces)), [0] * pieces, [False] * pieces

    def root_of(one: int) -> tuple[int, int]:
        """Root of a piece in the tree of those that are joined already, and its place as that root has it."""
        way = []
        while above[one] != one:
            way.append(one)
            one = above[one]
        total = 0
        for passed in reversed(way):
            total += place[passed]
            above[passed], place[passed] = one, total
        return one, total

    for first, second, turn in zip(*piece[ends[:, ~still]].tolist(), turns[~still].tolist(), strict=True):
        (one, at_one), (other, at_other) = root_of(first), root_of(second)
        off = at_one + turn - at_other
        if one == other:
            winds[one] |= off != 0
        else:
            above[other], place[other] = one, off
            winds[one] |= winds[other]
    return np.array([winds[root_of(one)[0]] for one in range(pieces)])[piece]
