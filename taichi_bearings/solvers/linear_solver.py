"""The viscous law solved to round-off: its power is a quadratic form, so that the minimum is one linear system.

On lattices the system falls apart into planes (grid_bundles.py); that of a packing is solved as a whole
(packing_paths.py).
"""

from taichi_bearings.solvers.method import Minimiser
from taichi_bearings.solvers.part import Part


class LinearSolverMethod(Minimiser):
    """The linear solver: it finds the spins at which viscous forces balance. On a lattice an iteration solves some of
    its planes (layers whose contacts couple one spin component); in a packing it solves all samples.
    """

    def part_of(self) -> Part:
        """Return the solver of the linear systems whose solutions are the spins at which viscous forces balance. There
        is one solver for lattices and one for packings.
        """
        return self.contacts.linear_systems(self.start)
