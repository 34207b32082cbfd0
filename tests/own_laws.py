"""Laws of one's own that the package does not know."""

import numpy as np

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.contact import length
from taichi_bearings.scene.law import Law

FAST = 0.05  # length/time


class Bounded(Law):
    """F = f min(v / FAST, 1); phi*(g) = FAST g^2 / (2 f) up to g = f, infinite beyond."""

    def force(self, of, slip):
        return of[0] * np.minimum(slip / FAST, 1.0)

    def power(self, of, slip):
        return self.force(of, slip) * slip

    def potential(self, of, slip):
        return of[0] * np.where(slip < FAST, slip**2 / (2 * FAST), slip - FAST / 2)

    def conjugate(self, of, force):
        share = np.divide(force, of[0], out=np.zeros_like(force), where=of[0] > 0)
        return np.where(force <= of[0], of[0] * FAST * share**2 / 2, np.inf)

    def steepest(self, of, slip):
        return of[0] / FAST


@ti.func
def bounded_force(difference: ti.template(), coefficients: ti.template(), radius):
    spin = ti.max(length(difference), 1e-30)
    size = ti.min(radius * spin / FAST, 1.0)
    return [coefficients[0] * size / spin * d for d in ti.static(difference)]


class PowerLaw(Law):
    """F = eta v^p, p being `exponent`; phi*(f) = eta p / (p + 1) (f / eta)^((p + 1) / p)."""

    exponent = 3.0

    def force(self, of, slip):
        return of[0] * slip**self.exponent

    def power(self, of, slip):
        return of[0] * slip ** (self.exponent + 1)

    def potential(self, of, slip):
        return self.power(of, slip) / (self.exponent + 1)

    def conjugate(self, of, force):
        p, share = self.exponent, np.divide(force, of[0], out=np.zeros_like(force), where=of[0] > 0)
        return of[0] * p / (p + 1) * share ** ((p + 1) / p)


class Steep(PowerLaw):
    """F = eta v^1.5, for which the power of the least motion grows as the strength to the power 2.5."""

    exponent = 1.5

    def steepest(self, of, slip):
        return of[0] * 1.5 * slip**0.5


@ti.func
def steep_force(difference: ti.template(), coefficients: ti.template(), radius):
    slip = radius * length(difference)
    return [coefficients[0] * radius * slip**0.5 * d for d in ti.static(difference)]
