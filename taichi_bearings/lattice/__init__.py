"""Lattices and their contacts. NumPy only."""

from taichi_bearings.lattice.grid import Lattice

__all__ = ["Lattice"]
