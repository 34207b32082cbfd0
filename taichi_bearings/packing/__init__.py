"""Any bearing that users bring: its structure, its state of least dissipation, what is proven of it.

Shapes: N spheres (of discs D = 2, else 3), E contacts, C = 3 components of a spin, of discs 1; u = R omega.
"""

from taichi_bearings.packing.answer import solve_packing
from taichi_bearings.packing.packing import Packing, Packings
from taichi_bearings.packing.structure import Structure, structure_of

__all__ = ["Packing", "Packings", "Structure", "solve_packing", "structure_of"]
