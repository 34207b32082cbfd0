"""All cuts of a small square lattice, tried one after the other in exact fractions."""

from fractions import Fraction
from itertools import product

import numpy as np


def all_cuts(coefficient):
    """Least weight, and for every contact whether it is in some and in all of the lightest cuts."""
    sideways, upward = coefficient
    columns, rows = upward.shape[0], upward.shape[1] + 1
    cuts = []
    for labels in product((False, True), repeat=columns * (rows - 2)):
        above = np.zeros((columns, rows), bool)
        above[:, -1], above[:, 1:-1] = True, np.reshape(labels, (columns, rows - 2))
        crossed = [above[1:] != above[:-1], above[:, 1:] != above[:, :-1]]
        weights = np.concatenate([sideways[crossed[0]], upward[crossed[1]]])
        cuts.append((sum(map(Fraction, weights.tolist())), crossed))
    least = min(weight for weight, _ in cuts)
    lightest = [crossed for weight, crossed in cuts if weight == least]
    return least, [(np.any(c, axis=0), np.all(c, axis=0)) for c in zip(*lightest, strict=True)]
