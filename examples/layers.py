"""Friction coefficients of a 12x9 lattice of discs with a weak layer, written for `own-coefficients.toml`.

Call it with the name of the file to write: python examples/layers.py layers.npz
"""

import sys

import numpy as np

nx, ny = 12, 9  # discs along x and along the height
rng = np.random.default_rng(1)
x = rng.uniform(0.5, 1.0, (nx - 1, ny))  # entry [i, j]: contact of disc (i, j) with (i + 1, j)
y = rng.uniform(0.5, 1.0, (nx, ny - 1))  # entry [i, j]: contact of disc (i, j) with (i, j + 1)
y[:, 4] = rng.uniform(0.1, 0.3, nx)  # between the fifth and the sixth layer friction is weak
np.savez(sys.argv[1], x=x, y=y)
