"""Which pieces of a graph on a lattice that closes on itself go around it."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def winding(nodes: int, ends: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """True (nodes,) for those of pieces with a closed way along which the turns do not add up to 0.

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
