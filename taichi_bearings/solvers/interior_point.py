"""Primal-dual interior-point method for laws with friction: a proven minimum to round-off in some twenty Newton steps.

The least power is the minimum of sum_e mu_e b_e over spins and bounds b_e >= |slip_e|; its dual maximises the work of
the driven spheres over balanced contact forces with |f_e| <= mu_e F_n (equations.md, 7). Both are followed along the
central path (conic/central_path.py). It begins at b_e > |slip_e| and zero forces, which are strictly inside the cones,
so that an upper and a lower bound are known from the first step on. Eliminating b from the Newton system leaves a
weighted Laplacian over the free spins, which is factorised once a step (taichi_bearings.numerics.cholesky).

Viscosity adds half its power to what is minimised, and its stiffness to that Laplacian. Near the end the contact states
are settled: exactly where conic/resolution.py can; else by the ratio of slip and friction margin (friction limit minus
force), which on the central path goes to infinity for slipping contacts and to 0 for slipless ones; in packings with
oblique normals by stiff springs (conic/multipliers.py).

Where the paths begin and what they lead to is in lattice_paths.py and packing_paths.py.
"""

from taichi_bearings.solvers.method import Minimiser
from taichi_bearings.solvers.part import Part
from taichi_bearings.solvers.table import InteriorPoint


class InteriorPointMethod(Minimiser):
    """The interior-point method. An iteration is one Newton step of every sample that is not yet done."""

    resumes = True
    options: InteriorPoint

    def part_of(self) -> Part:
        """Return the solver that makes the Newton steps of all samples along their central paths, curves of spins and
        forces that end at the minimum. There is one solver for lattices and one for packings.
        """
        return self.contacts.paths(self.start, self.options.settle, self.tolerance)
