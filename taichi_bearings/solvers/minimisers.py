"""Methods that find minima directly, by a solver (`Part`) for lattices and another one for packings.

Letters: R samples, N spheres.

**Interior point.** For laws with friction the least power is the minimum of sum_e mu_e b_e over spins and bounds
b_e >= |slip_e|; its dual maximises the work of the driven spheres over balanced contact forces with |f_e| <= mu_e F_n
(equations.md, 7). Both are followed along the central path (conic/central_path.py). It begins at b_e > |slip_e| and
zero forces, which are strictly inside the cones, so that an upper and a lower bound are known from the first step on.
Eliminating b from the Newton system leaves a weighted Laplacian over the free spins, which is factorised once a step
(taichi_bearings.numerics.cholesky). Viscosity adds half its power to what is minimised, and its stiffness to that
Laplacian. Near the end the contact states are settled: exactly where conic/resolution.py can; else by the ratio of slip
and friction margin (friction limit minus force), which on the central path goes to infinity for slipping contacts and
to 0 for slipless ones; in packings with oblique normals by stiff springs (conic/multipliers.py). Where the paths begin
and what they lead to is in lattice_paths.py and packing_paths.py.

**Planar cut.** Friction alone, where each contact couples one spin component, is solved exactly by minimum cuts: of
planar grids on lattices (grid_cuts.py), in packings of a graph of any kind (nested_cuts.py).

**Linear solver.** The power of viscous contacts is a quadratic form, so that its minimum is one linear system. On
lattices it falls apart into planes (grid_bundles.py); that of a packing is solved as a whole (packing_paths.py).
"""

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from taichi_bearings.scene import Bearing, Progress
from taichi_bearings.solvers.contacts import WithMinima
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.part import Found, Part
from taichi_bearings.solvers.table import InteriorPoint


class Minimiser(Method):
    """A method that finds minima directly. Its iterations are made by a solver (`part`), of which there is one for
    lattices and one for packings.
    """

    contacts: WithMinima
    part: Part

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare to solve a scene: choose the solver (`part`) that fits its contacts.

        spin : (R samples, *N spheres, 3), of discs (R, *N), laboratory spins to start from, 1/time; not used for
            packings.
        """
        super().begin(scene, spin)
        self.part = self.part_of()

    @abstractmethod
    def part_of(self) -> Part:
        """Return the solver of this method that fits the contacts of the scene: that for lattices or that for
        packings.
        """

    @property
    def iteration(self) -> int:  # type: ignore[override]
        """Number of iterations so far."""
        return self.part.iteration

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next.

        iteration : the one at which it was read now.
        """
        return self.part.next_check(iteration)

    def advance(self, steps: int) -> None:
        """Make `steps` iterations, by the part for lattices or that for packings."""
        self.part.advance(steps)

    def progress(self) -> Progress:
        """Return the state now, with its bounds."""
        return self.part.progress()

    def found(self) -> list[Found]:
        """Return the spins and forces that each sample of a packing has reached."""
        return self.part.found()

    def state(self) -> dict[str, np.ndarray]:
        """Return by name all arrays that the further iterations depend on, for a checkpoint."""
        return self.part.state()

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the arrays by name that `state` returned in an earlier call."""
        self.part.restore(state)


class InteriorPointMethod(Minimiser):
    """The interior-point method. An iteration is one Newton step of every sample that is not yet done."""

    resumes = True
    options: InteriorPoint

    def part_of(self) -> Part:
        """Return the solver that makes the Newton steps of all samples along their central paths."""
        return self.contacts.paths(self.options.settle, self.tolerance)


class PlanarCutMethod(Minimiser):
    """The planar cut: minimum cuts give the exact least power of friction. Its only iteration cuts all planes of a
    lattice, or the networks of all samples of a packing.
    """

    def part_of(self) -> Part:
        """Return the solver that finds the minimum cuts of the contacts."""
        return self.contacts.cuts()


class LinearSolverMethod(Minimiser):
    """The linear solver: it finds the spins at which viscous forces balance. On a lattice an iteration solves some of
    its planes (layers whose contacts couple one spin component); in a packing it solves all samples.
    """

    def part_of(self) -> Part:
        """Return the solver of the linear systems whose solutions are the spins at which viscous forces balance."""
        return self.contacts.linear_systems()
