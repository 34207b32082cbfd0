"""Makes graphs, and finds their connected pieces and which of these have loops of odd length, by SciPy's searches.

SciPy is loaded when they are first called: it takes a third of a second, and scenes on lattices do without them.
"""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy import sparse


def graph_of(nodes: int, first: np.ndarray, second: np.ndarray, length: np.ndarray | None = None) -> "sparse.csr_array":
    """Return a graph for the searches of SciPy, (nodes, nodes). Its indices have 32 bits, the only ones that the older
    versions take.

    nodes : number of nodes.
    first, second : (edges,), the two ends of each edge; it leads from the first to the second.
    length : (edges,), length of each edge; None for 1.
    """
    from scipy import sparse

    ends = first.astype(np.int32), second.astype(np.int32)
    return sparse.csr_array((np.ones(len(first)) if length is None else length, ends), shape=(nodes, nodes))


def pieces(nodes: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return for each node of a graph the number (nodes,) of the connected piece that it belongs to. Pieces are
    numbered from 0 on, in the order of their first nodes.

    nodes : number of nodes.
    first, second : (edges,), the two ends of each edge.
    """
    from scipy import sparse
    from scipy.sparse import csgraph

    # rows in their order, as SciPy would spend half of the time on sorting them
    order = np.argsort(first, kind="stable")
    begin = np.searchsorted(first[order], np.arange(nodes + 1)).astype(np.int32)
    graph = sparse.csr_array((np.ones(len(first)), second[order].astype(np.int32), begin), shape=(nodes, nodes))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1])


def odd_pieces(nodes: int, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the connected pieces of a graph that have a loop of an odd number of edges, and alternating signs in all
    others.

    nodes : number of nodes.
    first, second : (edges,), the two ends of each edge.
    returns : two arrays (nodes,): True for nodes of pieces with such a loop; and signs, +1 or -1, which are opposite at
        nodes that an edge joins, in all other pieces.

    A piece has an odd loop if its two copies in the double cover are joined: the graph with two copies of each node, in
    which an edge joins the first copy of either end with the second copy of the other end.
    """
    ends = np.concatenate([first, second]), np.concatenate([second, first]) + nodes
    label = pieces(2 * nodes, *ends)
    odd, mirrored = label[:nodes] == label[nodes:], label[:nodes] > label[nodes:]
    return odd, np.where(mirrored, -1, 1)
