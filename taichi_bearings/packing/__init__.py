"""Any bearing that users bring: its structure, its state of least dissipation, and what is proven of it.

Shapes: N spheres (of discs D = 2, else 3), E contacts, C = 3 components of a spin, of discs 1. u = R omega, length/time.
"""

from taichi_bearings.packing.answer import PackingResult, solve_packing
from taichi_bearings.packing.packing import Packing
from taichi_bearings.packing.structure import Structure, structure

__all__ = ["Packing", "PackingResult", "Structure", "solve_packing", "structure"]
