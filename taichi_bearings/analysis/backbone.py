"""The backbone of the slipless network, and the single links and spheres that hold it together.

Words of percolation theory (Stauffer and Aharony, Introduction to Percolation Theory, 1994): the *backbone* is all that
lies on some path from the bottom to the top that visits nothing twice; what hangs on it without leading through is a
dangling end. A *bridge* is a link whose removal cuts something off. A bridge in the backbone *parts* bottom from top:
every path takes it (a "red bond" of Pike and Stanley, J. Phys. A 14, L169, 1981). The same holds for spheres, with
"articulation point" for "bridge".

Each driven plane is one body. One extra link from the bottom body to the top body closes every path through into a
cycle, so the backbone is the biconnected block that holds this link. The blocks are rustworkx's (Hopcroft and Tarjan,
Comm. ACM 16, 372, 1973): the work grows like the number of links.
"""

from dataclasses import dataclass

import numpy as np
import rustworkx

from taichi_bearings.analysis.network import SliplessNetwork


@dataclass(frozen=True)
class Backbone:
    """Which links (E,) and spheres (sites,) of a network hold bottom and top together; all False if they are apart.

    links : on some path from bottom to top that visits no body twice; they alone carry current and shortest paths.
    bridges, articulation : removal breaks the piece that joins the planes; driven spheres do not count.
    parting_links, parting_spheres : removal parts bottom from top.
    """

    links: np.ndarray
    bridges: np.ndarray
    articulation: np.ndarray
    parting_links: np.ndarray
    parting_spheres: np.ndarray


def find_backbone(network: SliplessNetwork) -> Backbone:
    """The backbone of one sample."""
    in_piece = network.spanning.ravel()[network.ends[0]]
    links = _on_a_path_through(network, in_piece)
    bridges, articulation = _bridges_and_articulation(network, in_piece)
    parting_links, parting_spheres = _bridges_and_articulation(network, links)
    return Backbone(links, bridges, articulation, parting_links, parting_spheres)


def _on_a_path_through(network: SliplessNetwork, chosen: np.ndarray) -> np.ndarray:
    """(E,) True for the `chosen` links that share a block with a link from the bottom to the top body."""
    through = np.zeros(len(network.axis), dtype=bool)
    if chosen.any():
        low, high = network.body[network.ends[:, chosen]]
        block = _blocks(np.append(low, 0), np.append(high, network.bodies - 1), network.bodies)
        through[chosen] = block[:-1] == block[-1]
    return through


def _bridges_and_articulation(network: SliplessNetwork, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bridges (E,) and articulation points (sites,) among free spheres of the graph of the `chosen` links.

    A bridge is a block of one link; an articulation point belongs to several blocks.
    """
    bridges = np.zeros(len(network.axis), dtype=bool)
    low, high = network.body[network.ends[:, chosen]]
    block = _blocks(low, high, network.bodies)
    bridges[chosen] = np.bincount(block)[block] == 1
    body_in_block = np.unique(np.stack([np.append(low, high), np.append(block, block)]), axis=1)[0]
    several = np.bincount(body_in_block, minlength=network.bodies) > 1
    several[[0, -1]] = False
    return bridges, several[network.body]


def _blocks(low: np.ndarray, high: np.ndarray, bodies: int) -> np.ndarray:
    """Label of the biconnected block of each link from a body `low` to a body `high`; no two links join the same."""
    graph = rustworkx.PyGraph(multigraph=False)
    graph.add_nodes_from(range(bodies))
    graph.add_edges_from_no_data(list(zip(low.tolist(), high.tolist(), strict=True)))
    found = rustworkx.biconnected_components(graph)
    if not found:
        return np.empty(0, dtype=np.int64)
    pairs = np.sort(np.array(list(found.keys()), dtype=np.int64), axis=1) @ [bodies, 1]
    order = np.argsort(pairs)
    wanted = np.minimum(low, high).astype(np.int64) * bodies + np.maximum(low, high)
    label: np.ndarray = np.array(list(found.values()), dtype=np.int64)[order[np.searchsorted(pairs[order], wanted)]]
    return label
