"""Power, torques and bounds of a stored run in 80 decimal digits, contact by contact, as the paper writes them.

Slow on purpose. Spins of the driven spheres are those of the scene, not those stored.
"""

from decimal import Decimal, getcontext

import numpy as np

getcontext().prec = 80
ZERO = Decimal(0)


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a, b):
    return sum((x * y for x, y in zip(a, b, strict=True)), ZERO)


def exactly(values):
    return tuple(Decimal(float(v)) for v in np.atleast_1d(values))


class Laboratory:
    """The sample `number` of a verifier.samples.Samples."""

    def __init__(self, samples, number=0):
        self.samples, self.number, self.flat = samples, number, samples.dimension == 2
        self.radius, self.strength = Decimal(samples.radius), Decimal(samples.normal_force)
        vector = (ZERO, ZERO, Decimal(1)) if self.flat else exactly(samples.direction)
        size = dot(vector, vector).sqrt()
        self.direction = tuple(part / size for part in vector)
        self.spin = {site: self._spin(site) for site in np.ndindex(*samples.shape)}

    def parity(self, site):
        return 1 if sum(site) % 2 == 0 else -1

    def is_driven(self, site):
        return site[-1] in (0, self.samples.shape[-1] - 1)

    def _spin(self, site):
        if self.is_driven(site):
            imposed = Decimal(self.samples.spin_bottom if site[-1] == 0 else self.samples.spin_top)
            return tuple(self.parity(site) * imposed * part for part in self.direction)
        high, low = (exactly(field[(self.number, *site)]) for field in (self.samples.spin, self.samples.spin_rounding))
        total = tuple(a + b for a, b in zip(high, low, strict=True))
        return (ZERO, ZERO, total[0]) if self.flat else total

    def contacts(self):
        """(lower site, upper site, direction, friction that it bears, viscosity, force on the upper sphere) of those
        that can slip and are not absent, which bear no force."""
        for axis, coefficient in enumerate(self.samples.coefficient):
            n = tuple(Decimal(int(k == axis)) for k in range(3))
            for lower in np.ndindex(*coefficient.shape[1:]):
                upper = tuple(x + (k == axis) for k, x in enumerate(lower))
                absent = coefficient[(self.number, *lower)] == 0
                if absent or (self.is_driven(lower) and self.is_driven(upper)):
                    continue
                force = exactly(self.samples.friction[axis][(self.number, *lower)])
                if self.flat:
                    force = tuple(force[0] * part for part in cross((ZERO, ZERO, Decimal(1)), n))
                first, second = Decimal(float(coefficient[(self.number, *lower)])), ZERO
                if self.samples.viscosity:
                    second = Decimal(float(self.samples.viscosity[axis][(self.number, *lower)]))
                held, viscosity = (ZERO, first) if self.samples.law == "viscous" else (first * self.strength, second)
                yield lower, upper, n, held, viscosity, force

    def power(self, share=Decimal(1)):
        """share : of the viscous part."""
        total = ZERO
        for lower, upper, n, held, viscosity, _ in self.contacts():
            to_upper = tuple(self.radius * part for part in n)
            to_lower = tuple(-part for part in to_upper)
            slip = tuple(
                a - b for a, b in zip(cross(self.spin[upper], to_lower), cross(self.spin[lower], to_upper), strict=True)
            )
            total += held * dot(slip, slip).sqrt() + share * viscosity * dot(slip, slip)
        return total

    def objective(self):
        """The power, or of contacts with friction and viscosity their potential."""
        return self.power(Decimal(1) / 2 if self.samples.viscosity else Decimal(1))

    def lower_bound(self):
        """Work of the driven planes against the friction, less the price of torques left over; friction scaled into
        its discs (Coulomb), or twice that work less the sum of |F|^2 / eta (viscous), or that work less the sum of
        max(|F| - mu F_n, 0)^2 / (2 eta) (both)."""
        torque = dict.fromkeys(self.spin, (ZERO, ZERO, ZERO))
        worst, cost = Decimal(1), ZERO
        for lower, upper, n, held, viscosity, force in self.contacts():
            turn = cross(tuple(-self.radius * part for part in n), force)
            for site in (lower, upper):
                torque[site] = tuple(a + b for a, b in zip(torque[site], turn, strict=True))
            size = dot(force, force).sqrt()
            if viscosity:
                cost += max(size - held, ZERO) ** 2 / (2 * viscosity)
            else:
                worst = max(worst, size / held)
        jump = Decimal(self.samples.spin_top) - Decimal(self.samples.spin_bottom)
        left = ZERO
        for site, pull in torque.items():
            for part, along in zip(pull, self.direction, strict=True):
                gain = self.parity(site) * part * jump * along  # torque times the jump of a component
                if site[-1] == self.samples.shape[-1] - 1:
                    left -= gain
                elif not self.is_driven(site):
                    left -= max(gain, ZERO)
        return (2 if self.samples.law == "viscous" else 1) * (left / worst - cost)
