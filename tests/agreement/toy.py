"""A law and a method of a user's own, in this file alone: a shear-thinning fluid, and SciPy's L-BFGS.

Its import adds both to the tables; after that they are options like any other.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.options import POSITIVE, how
from taichi_bearings.proof.certificate import largest_unbalanced_torque, lower_bound
from taichi_bearings.scene import Progress
from taichi_bearings.scene.law import LAWS, Law, Quantity
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.table import MethodOptions, register


class ShearThinning(Law):
    """F = eta v^(1/2): power eta v^(3/2), which is 3/2 of the potential; phi*(f) = f^3 / (3 eta^2)."""

    def force(self, of, slip):
        return of[0] * np.sqrt(slip)

    def power(self, of, slip):
        return of[0] * slip**1.5

    def potential(self, of, slip):
        return of[0] * slip**1.5 / 1.5

    def conjugate(self, of, force):
        return force**3 * np.divide(1 / 3, of[0] ** 2, out=np.zeros_like(of[0]), where=of[0] > 0)


LAWS["shear-thinning"] = ShearThinning(
    "shear-thinning", (Quantity("consistency", "force*(time/length)^(1/2)"),), share=1.5
)


@register
@dataclass(frozen=True, kw_only=True)
class Minimise(MethodOptions):
    """Any law with a smooth potential."""

    name = "minimise"
    implementation = "tests.agreement.toy:Minimiser"
    needs_taichi = False

    leftover: float = how(1e-12, POSITIVE, "Slope at which L-BFGS ends.")

    @staticmethod
    def solves(law):
        return law.flows and not law.holds


class Minimiser:
    """One call of L-BFGS, restarted at every iteration."""

    def __init__(self, options):
        self.options = options

    def plan(self, scene, spin):
        return ()

    def begin(self, scene, spin, fields):
        self.scene, self.axes, self.iteration = scene, scene.minimum_spin_axes, 0
        self.spins = scene.staggered_spin(spin, self.axes)

    def next_check(self, iteration):
        return iteration + 1

    def forces(self):
        scene = self.scene
        difference = contact_differences(self.spins, scene.lattice, self.axes)
        length = vector_length(difference)
        size = scene.law.force(scene.contact, scene.lattice.radius * length)
        return difference * np.divide(size, length, out=np.zeros_like(size), where=length > 0)

    def advance(self, steps):
        for _ in range(steps):
            free, scene = self.spins[..., 1:-1], self.scene

            def potential(x, free=free, scene=scene):
                free[...] = x.reshape(free.shape)
                total = float(scene.law.potential(scene.contact, scene.slips(self.spins, self.axes)).sum())
                pull = torques(self.forces(), scene.lattice, self.axes)[..., 1:-1]
                return total, -scene.lattice.radius * pull.ravel()

            options = {"gtol": self.options.leftover, "ftol": 0}
            found = minimize(potential, free.ravel().copy(), jac=True, method="L-BFGS-B", options=options)
            free[...] = found.x.reshape(free.shape)
            self.iteration += 1

    def progress(self):
        scene, force = self.scene, self.forces()
        return Progress(
            iteration=self.iteration,
            staggered=self.spins,
            spin_axes=self.axes,
            force=force,
            objective=scene.objective(self.spins, self.axes),
            lower_bound=lower_bound(scene, force, self.axes),
            resolution=0.0,
            largest_balance_residual=largest_unbalanced_torque(scene, force, self.axes),
            exhausted=self.iteration >= 20,
        )
