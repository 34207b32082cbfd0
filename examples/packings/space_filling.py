"""Two discs of a space-filling bearing driven against each other: python space_filling.py M N LEAST_RADIUS FILE

A large disc on the lower line and one on the upper line turn with surface speed 1 in the same sense. As they are of the
two kinds that turn against each other, some contacts must slip. Large are all as the largest one, so take M = N.
"""

import sys

import numpy as np

import taichi_bearings as tb

m, n, least, file = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4]
strip = tb.Packing.space_filling(m, n, least, periods=3, seed=3)
large = np.flatnonzero(strip.radius > 0.99 * strip.radius.max())
first, *others = large[np.argsort(strip.center[large, 0].round(9), kind="stable")]
opposite = [i for i in others if strip.driven[i] != strip.driven[first]]
second = opposite[len(opposite) // 2]  # half a strip away
driven, spin = np.full(strip.spheres, -1), np.zeros(strip.spheres)
driven[[first, second]], spin[[first, second]] = [0, 1], 1 / strip.radius[[first, second]]
tb.Packing(
    strip.center, strip.contact, driven, spin, strip.radius, strip.normal, friction=strip.friction
).save(file)  # fmt: skip
