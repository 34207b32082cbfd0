"""A law and a method of a user's own, in this file alone: a shear-thinning fluid, and SciPy's L-BFGS.

Its import adds both to the tables; after that they are options like any other.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from taichi_bearings.options import Kind, bounded, how, integer
from taichi_bearings.scene.law import LAWS, Law, Quantity
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.method import Method
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

    corrections: int = how(
        10, Kind(bounded(integer, 1), "a positive whole number", "N"), "Changes that it remembers the curvature by."
    )

    @staticmethod
    def solves(law):
        return law.has_viscosity and not law.has_friction


class Minimiser(Method):
    """One call of L-BFGS, restarted at every iteration."""

    def begin(self, scene, spin):
        super().begin(scene, spin)
        self.iteration, self.spins = 0, scene.staggered_spin(spin, self.spin_axes)

    def forces(self):
        scene = self.scene
        difference = self.differences(self.spins)
        length = vector_length(difference)
        size = scene.law.force(scene.material, scene.lattice.radius * length)
        return difference * np.divide(size, length, out=np.zeros_like(size), where=length > 0)

    def advance(self, steps):
        for _ in range(steps):
            free, scene = self.spins[..., 1:-1], self.scene

            def potential(x, free=free, scene=scene):
                free[...] = x.reshape(free.shape)
                total = float(scene.law.potential(scene.material, scene.slips(self.spins, self.spin_axes)).sum())
                pull = self.pulls(self.forces())[..., 1:-1]
                return total, -scene.lattice.radius * pull.ravel()

            options = {"gtol": 1e-12, "ftol": 0, "maxcor": self.options.corrections}
            found = minimize(potential, free.ravel().copy(), jac=True, method="L-BFGS-B", options=options)
            free[...] = found.x.reshape(free.shape)
            self.iteration += 1

    def progress(self):
        ended = self.iteration >= 20
        return self.judged(self.spins, self.forces(), iteration=self.iteration, resolution=0.0, exhausted=ended)
