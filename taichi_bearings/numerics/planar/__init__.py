"""Finds minimum cuts of planar grids (cuts.py) from shortest paths of the dual graph (paths.py), and their ties
(ties.py).
"""

from taichi_bearings.numerics.planar.cuts import MinimumCuts, minimum_cuts

__all__ = ["MinimumCuts", "minimum_cuts"]
