"""A random packing of two sizes between two driven walls: python random_packing.py SPHERES DIMENSION FILE"""

import sys

import taichi_bearings as tb

tb.Packing.random(int(sys.argv[1]), int(sys.argv[2]), seed=3).save(sys.argv[3])
