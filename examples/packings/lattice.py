"""A lattice of any kind between two driven layers: python lattice.py KIND CELLS FILE, such as triangular 30,17 a.npz"""

import sys

import taichi_bearings as tb

kind, cells, file = sys.argv[1:]
tb.Packing.lattice(kind, [int(number) for number in cells.split(",")], seed=3).save(file)
