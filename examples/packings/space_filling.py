"""Two discs of a space-filling bearing driven against each other: python space_filling.py M N LEAST_RADIUS FILE

The largest disc on the lower line and one on the upper line turn with surface speed 1 in the same sense. As they are of
the two kinds that turn against each other, some contacts must slip.
"""

import sys

import numpy as np

import taichi_bearings as tb

m, n, least, file = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4]
strip = tb.Packing.space_filling(m, n, least, periods=2, seed=3)
lower, upper = ((np.flatnonzero(strip.driven == body)) for body in (0, 1))
first = lower[np.argmax(strip.radius[lower])]
far = upper[strip.radius[upper] > 0.99 * strip.radius[upper].max()]
second = far[np.argmax(np.abs(strip.center[far, 0] - strip.center[first, 0]))]
driven, spin = np.full(strip.spheres, -1), np.zeros(strip.spheres)
driven[[first, second]], spin[[first, second]] = [0, 1], 1 / strip.radius[[first, second]]
tb.Packing(
    strip.center, strip.contact, driven, spin, strip.radius, strip.normal, friction=strip.friction
).save(file)  # fmt: skip
