"""Sparse Cholesky factorisation for matrices that couple the spins of touching spheres.

Every Newton step on the lattice needs one. Contacts along an axis do not couple the spin component along it. So the
other components of a plane of spheres separate the lattice: half the unknowns of an ordinary separator, and an eighth
of its cost. METIS and minimum degree do not find such separators; dissection.py does.
"""

from taichi_bearings.numerics.cholesky.dissection import dissect
from taichi_bearings.numerics.cholesky.factor import Cholesky, Engine, Factor, Memory, NotPositiveDefinite

__all__ = ["Cholesky", "Engine", "Factor", "Memory", "NotPositiveDefinite", "dissect"]
