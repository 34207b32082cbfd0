"""The viscous law solved to round-off: its power is a quadratic form, so that the minimum is one linear system.

On lattices the system falls apart into planes (grid_bundles.py); that of a packing is solved as a whole
(packing_paths.py).
"""

from taichi_bearings.solvers.method import Minimiser
from taichi_bearings.solvers.part import Part


class LinearSolverMethod(Minimiser):
    """The linear solver: it finds the spins at which viscous forces balance. An iteration solves one bundle of planes
    of a lattice (layers whose contacts couple one spin component), or all samples of a packing.
    """

    def part_of(self) -> Part:
        """Return the solver of the linear systems, one for each plane of a lattice or sample of a packing, whose
        solutions are the spins at which viscous forces balance. A `Part` is the solver inside a method, chosen by the
        kind of scene: one for lattices, one for packings.
        """
        return self.contacts.linear_systems(self.start)
