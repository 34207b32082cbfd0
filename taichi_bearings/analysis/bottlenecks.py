"""Bottlenecks: the few links of the slipless network that carry most of what goes from bottom to top.

Three ways to look for them. *Shortest paths* (`betweenness`). *A current*: every slipless contact is a unit conductance
and each driven plane one electrode; current takes all ways at once, the short ones more, where shortest paths know only
themselves (Newman, Social Networks 27, 39, 2005, with one source and one sink). And *what parts the planes alone*, in
words of percolation theory (Stauffer and Aharony, Introduction to Percolation Theory, 1994): the *backbone* is all that
lies on some path from the bottom to the top that visits nothing twice; what hangs on it without leading through is a
dangling end. A *bridge* is a link whose removal cuts something off. A bridge in the backbone *parts* bottom from top:
every path takes it (a "red bond" of Pike and Stanley, J. Phys. A 14, L169, 1981). The same holds for spheres, with
"articulation point" for "bridge". One extra link from the bottom body to the top body closes every path through into a
cycle, so the backbone is the biconnected block that holds this link (Hopcroft and Tarjan, Comm. ACM 16, 372, 1973).

Where several links share the load there is the smallest set that parts the planes (`SliplessNetwork.parting_sets`).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import rustworkx
from scipy.sparse import csc_array
from scipy.sparse.linalg import LinearOperator, cg

from taichi_bearings.analysis.betweenness import Betweenness, betweenness
from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.numerics.graph_laplacian import factorised, graph_laplacian

LEAST_LOAD = 1e-12  # a load that is less is none
DENSE = 4.5  # links a sphere from which the factor grows too large and conjugate gradients need few steps
ITERATION_TOLERANCE = 1e-13  # of the residual, relative to the current that flows in
MOST_CURRENT_REFINEMENTS = 6  # solutions of the residual equation, each good to 1e-5

Loads = tuple[np.ndarray, np.ndarray]


class Weak(NamedTuple):
    """Bridges (E,) and articulation points (sites,) of a part of the network; driven spheres do not count."""

    links: np.ndarray
    spheres: np.ndarray


class Flow(NamedTuple):
    """Amount of the current (E,) through each link, and the resistance between the planes in units of one contact's;
    0 and infinite if they are apart."""

    current: np.ndarray
    resistance: float


@dataclass(frozen=True)
class Bottlenecks:
    """Loads and weak places of one sample; links (E,) and spheres (sites,) are those of `network`."""

    network: SliplessNetwork

    @cached_property
    def backbone(self) -> np.ndarray:
        """(E,) True for links on some path from bottom to top that visits no body twice: they alone carry current and
        shortest paths. All False if the planes are apart."""
        network, through = self.network, np.zeros(len(self.network.axis), dtype=bool)
        if network.spans:
            in_piece = network.spanning.ravel()[network.ends[0]]
            low, high = network.body[network.ends[:, in_piece]]
            block = _blocks(np.append(low, 0), np.append(high, network.bodies - 1), network.bodies)
            through[in_piece] = block[:-1] == block[-1]
        return through

    @cached_property
    def weak(self) -> Weak:
        """Of the piece that joins the planes: removal breaks it."""
        return self._weak_in(self.network.spanning.ravel()[self.network.ends[0]])

    @cached_property
    def parting(self) -> Weak:
        """Of the backbone: removal parts bottom from top."""
        return self._weak_in(self.backbone)

    def _weak_in(self, chosen: np.ndarray) -> Weak:
        """Of the graph of the `chosen` links. A bridge is a block of one link; an articulation point is in several."""
        network, bridges = self.network, np.zeros(len(chosen), dtype=bool)
        low, high = network.body[network.ends[:, chosen]]
        block = _blocks(low, high, network.bodies)
        bridges[chosen] = np.bincount(block)[block] == 1
        body_in_block = np.unique(np.stack([np.append(low, high), np.append(block, block)]), axis=1)[0]
        several = np.bincount(body_in_block, minlength=network.bodies) > 1
        several[[0, -1]] = False
        return Weak(bridges, several[network.body])

    @cached_property
    def betweenness(self) -> Betweenness:
        return betweenness(self.network, self.backbone)

    @property
    def share(self) -> np.ndarray:
        """Share (E,) of the connected pairs that each link carries; 0 without pairs."""
        return self.betweenness.link / max(1, self.betweenness.pairs)

    @property
    def visits(self) -> np.ndarray:
        """Share, shape N, of the connected pairs whose shortest paths visit each sphere."""
        shape, found = self.network.lattice.shape, self.betweenness
        return found.sphere.reshape(shape) / max(1, found.pairs)

    @cached_property
    def flow(self) -> Flow:
        """Of a current of 1 from bottom to top."""
        return current_flow(self.network, self.backbone)

    @property
    def loads(self) -> Loads:
        """Shares (E,) of the paths and of the current that each link carries, without the network."""
        return self.share, self.flow.current

    @property
    def concentration(self) -> dict[str, float]:
        """Of the shortest paths."""
        return concentration(self.share)

    @property
    def current_concentration(self) -> dict[str, float]:
        return concentration(self.flow.current)

    def most_loaded(self, number: int = 10) -> list[dict[str, Any]]:
        """The links that carry most pairs, the heaviest first, of equal ones that with more current: where they are,
        what they carry and whether they hold something together."""
        share, error = self.share, self.betweenness.link_error / max(1, self.betweenness.pairs)
        rank = np.lexsort((-self.flow.current.round(12), -share.round(12)))
        columns = {
            "contact": self.network.contact,
            "axis": self.network.axis,
            "share": share,
            "share_error": error,
            "current": self.flow.current,
            "is_bridge": self.weak.links,
            "parts_the_planes": self.parting.links,
        }
        chosen = rank[share[rank] > LEAST_LOAD][:number]
        return [{name: values[edge].tolist() for name, values in columns.items()} for edge in chosen]


def _blocks(low: np.ndarray, high: np.ndarray, bodies: int) -> np.ndarray:
    """Label of the biconnected block of each link from body `low` to body `high`; links of the same two share it."""
    graph = rustworkx.PyGraph(multigraph=False)
    graph.add_nodes_from(range(bodies))
    graph.add_edges_from_no_data(list(zip(low.tolist(), high.tolist(), strict=True)))
    found = rustworkx.biconnected_components(graph)
    pairs = np.sort(np.array(list(found.keys()), dtype=np.int64).reshape(-1, 2), axis=1) @ [bodies, 1]
    order = np.argsort(pairs)
    wanted = np.minimum(low, high).astype(np.int64) * bodies + np.maximum(low, high)
    label: np.ndarray = np.array(list(found.values()), dtype=np.int64)[order[np.searchsorted(pairs[order], wanted)]]
    return label


def current_flow(network: SliplessNetwork, links: np.ndarray) -> Flow:
    """A current of 1 from bottom to top; links : (E,) bool, those that can carry it (the backbone)."""
    flow = np.zeros(len(network.axis))
    if not links.any():
        return Flow(flow, np.inf)
    low, high = network.body[network.ends[:, links]]
    voltage = _voltages(low, high, network.bodies)
    current = voltage[low] - voltage[high]
    total = (np.bincount(low, current, network.bodies) - np.bincount(high, current, network.bodies))[0]
    flow[links] = np.abs(current) / total
    return Flow(flow, float(1 / total))


def _voltages(low: np.ndarray, high: np.ndarray, bodies: int) -> np.ndarray:
    """Voltage of each body, 1 at the first one and 0 at the last one; also 0 where no link leads.

    By a sparse factorisation with minimum degree ordering; by conjugate gradients where links are dense.
    """
    degree = np.bincount(low, minlength=bodies) + np.bincount(high, minlength=bodies)
    held = degree == 0
    held[[0, -1]] = True
    fed = np.zeros(bodies)
    fed[np.concatenate([high[low == 0], low[high == 0]])] = 1.0
    laplacian, right = graph_laplacian([(low, high, np.ones(len(low)))], bodies, held), fed[~held]
    voltage = np.zeros(bodies)
    voltage[0] = 1.0
    sparse = degree[~held].mean() < DENSE
    voltage[~held] = factorised(laplacian).solve(right) if sparse else _iterated(laplacian, degree[~held], right)
    return voltage


def _iterated(laplacian: csc_array, degree: np.ndarray, right: np.ndarray) -> np.ndarray:
    jacobi = LinearOperator(laplacian.shape, matvec=lambda values: values.ravel() / degree, dtype=float)
    solution = np.zeros(len(right))
    for _ in range(MOST_CURRENT_REFINEMENTS):
        residual = right - laplacian @ solution
        if np.linalg.norm(residual) <= ITERATION_TOLERANCE * np.linalg.norm(right):
            break
        solution += cg(laplacian, residual, atol=0.0, M=jacobi)[0]
    return solution


def concentration(load: np.ndarray) -> dict[str, float]:
    """How unevenly loads (E,) of at most 1 are spread; all 0 if nothing is loaded.

    largest : load of the top link. loaded : number of links with a load beyond rounding. effective : participation
    number (sum load)^2 / sum load^2, as many links as would bear it if they all bore the same. half : fewest links that
    together bear half the sum of the loads. nearly_all : number of links with nine tenths of all pairs or current.
    """
    if not load.any():
        return {"largest": 0.0, "loaded": 0, "effective": 0.0, "half": 0, "nearly_all": 0}
    falling = np.sort(load)[::-1]
    gathered = np.cumsum(falling)
    return {
        "largest": float(falling[0]),
        "loaded": int((load > LEAST_LOAD).sum()),
        "effective": float(gathered[-1] ** 2 / (load**2).sum()),
        "half": int(np.searchsorted(gathered, gathered[-1] / 2 * (1 - LEAST_LOAD)) + 1),
        "nearly_all": int((load >= 0.9).sum()),
    }
