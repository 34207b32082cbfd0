"""A driven shaft in a cubic block: python shaft.py RADIUS WALLS FILE, with WALLS "rest" or "across".

The shaft, all spheres nearer to the axis than RADIUS spacings, turns about the axis; the four walls rest, or turn about
x. Neighbours turn against each other, so every spin has the sign of its sublattice.
"""

import sys

import numpy as np

import taichi_bearings as tb

radius, walls, file = float(sys.argv[1]), sys.argv[2], sys.argv[3]
wide, high = 11, 4
block = tb.Packing.lattice("cubic", (wide, wide, high), seed=3)
site = np.round(block.center).astype(int)  # the spacing is 1
distance = np.hypot(*(site[:, :2] - wide // 2).T)
at_wall = ((site[:, :2] == 0) | (site[:, :2] == wide - 1)).any(axis=1)
body = np.where(distance < radius, 0, np.where(at_wall, 1, -1))
sign = np.where(site.sum(axis=1) % 2, -1.0, 1.0)[:, None]
spin = sign * np.where((body == 0)[:, None], [0.0, 0.0, 1.0], [float(walls == "across"), 0.0, 0.0])
tb.Packing(block.center, block.contact, body, spin, friction=block.friction).save(file)
