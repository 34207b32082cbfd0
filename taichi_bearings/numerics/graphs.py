"""Connected pieces of a graph, and which of them have loops of odd length. SciPy's searches do the work."""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components


def pieces(nodes: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(nodes,) label of the connected piece of each node. first, second : the two ends of each edge."""
    graph = sparse.csr_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(nodes, nodes))
    return np.asarray(connected_components(graph, directed=False)[1])


def odd_pieces(nodes: int, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(nodes,) True for nodes of pieces with odd loops; and signs (nodes,) by which neighbours differ in other pieces.

    A piece has an odd loop if its two copies in the double cover are joined. first, second : the ends of each edge.
    """
    ends = np.concatenate([first, second]), np.concatenate([second, first]) + nodes
    cover = sparse.csr_array((np.ones(len(ends[0]), dtype=np.int8), ends), shape=(2 * nodes, 2 * nodes))
    label = connected_components(cover, directed=False)[1]
    odd, mirrored = label[:nodes] == label[nodes:], label[:nodes] > label[nodes:]
    return odd, np.where(mirrored, -1, 1)
