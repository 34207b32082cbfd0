"""The weighted Laplacian of a graph as a sparse matrix, and its factorisation by SuperLU."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csc_array

from taichi_bearings.numerics.blas import SPARSE

Edges = tuple[np.ndarray, np.ndarray, np.ndarray]  # node at either end, weight: (E,) each


def graph_laplacian(edges: Iterable[Edges], nodes: int, held: np.ndarray) -> csc_array:
    """Return the weighted Laplacian (free, free) of a graph over the nodes that are not held at a fixed value, in their
    order.

    edges : groups of edges, each as three arrays (edges,): the node at either end, and the weight.
    nodes : number of nodes.
    held : (nodes,) True where the value is fixed.
    """
    rows, columns, entries = [], [], []
    for low, high, weight in edges:
        rows += [low, high, low, high]
        columns += [low, high, high, low]
        entries += [weight, weight, -weight, -weight]
    places = np.concatenate(rows), np.concatenate(columns)
    whole = coo_array((np.concatenate(entries), places), shape=(nodes, nodes)).tocsr()
    free = np.flatnonzero(~held)
    return csc_array(whole[free][:, free])


def factorised(laplacian: csc_array) -> Any:
    """Return SuperLU's factorisation of a Laplacian, by minimum degree and without pivoting; its method `solve` solves
    with it.

    laplacian : (free, free), as :func:`graph_laplacian` returns it.

    Raises RuntimeError if the matrix is singular in float64.
    """
    return SPARSE.splu(laplacian, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
