"""Friction alone where each contact couples one spin component, solved exactly by minimum cuts.

On lattices the cuts are those of planar grids (grid_cuts.py), in packings those of a graph of any kind
(nested_cuts.py).
"""

from taichi_bearings.solvers.method import Minimiser
from taichi_bearings.solvers.part import Part


class PlanarCutMethod(Minimiser):
    """The planar cut: minimum cuts give the exact least power of friction. Its only iteration cuts all planes of a
    lattice, or the networks of all samples of a packing.
    """

    def part_of(self) -> Part:
        """Return the solver that finds the minimum cuts of the contacts. There is one solver for lattices and one for
        packings.
        """
        return self.contacts.cuts(self.start)
