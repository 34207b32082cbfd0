"""The viscous law solved to round-off: its power is a quadratic form, so that the minimum is one linear system.

On lattices the system falls apart into planes (grid_bundles.py); that of a packing is solved as a whole
(packing_paths.py).
"""

from taichi_bearings.solvers.method import Minimiser
from taichi_bearings.solvers.part import Part


class LinearSolverMethod(Minimiser):
    """The linear solver. An iteration is one bundle of planes of a lattice, or all samples of a packing."""

    def part_of(self) -> Part:
        """Return what solves the linear systems of this scene, in which viscous forces balance."""
        return self.contacts.linear_systems(self.start)
