"""Which unknowns are eliminated together: the supernodes of an elimination tree.

Columns of the factor that have the same rows make up a dense block. Few have quite the same: blocks are joined if the
zeros that are then stored cost less than the calls and copies that are saved (relaxed supernodes: Ashcraft & Grimes,
TOMS 1989). The planes of a dissection, each as a block of its own, would be a quarter to almost half zeros.
"""

from dataclasses import astuple, dataclass

import numpy as np
from scipy import sparse

from taichi_bearings import runtime
from taichi_bearings.kernels import elimination_tree
from taichi_bearings.numerics.cholesky.tuning import Price


@dataclass(frozen=True)
class Parts:
    """Unknowns that are eliminated together, part by part, children before parents and a branch before the next.

    order : the places of their columns in the order before. own : how many a part has. parent : the part above, or -1.
    """

    order: np.ndarray
    own: np.ndarray
    parent: np.ndarray


def supernodes(pattern: sparse.csr_matrix, price: Price) -> Parts:
    """Parts of the elimination tree of a symmetric pattern in its order."""
    runtime.current()  # starts it
    size = pattern.shape[0]
    parent, count, home, own, child, sibling = np.zeros((6, size), dtype=np.int32)
    elimination_tree.grow(pattern.indptr.astype(np.int32), pattern.indices.astype(np.int32), parent, count, home)
    elimination_tree.join(*astuple(price), parent, count, home, own, child, sibling)
    first, following = child.tolist(), sibling.tolist()
    lasts, waiting = list[int](), np.flatnonzero(parent < 0).tolist()
    while waiting:
        lasts.append(waiting.pop())
        below = first[lasts[-1]]
        while below >= 0:
            waiting.append(below)
            below = following[below]
    lasts.reverse()
    number = np.zeros(size, dtype=np.int64)
    number[lasts] = np.arange(len(lasts))
    above = np.where(parent[lasts] >= 0, number[home[parent[lasts]]], -1)
    return Parts(np.argsort(number[home], kind="stable"), own[lasts].astype(np.int64), above)
