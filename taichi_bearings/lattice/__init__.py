"""Lattices and their contacts, with NumPy alone."""

from taichi_bearings.lattice.grid import Lattice

__all__ = ["Lattice"]
