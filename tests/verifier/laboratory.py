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
        """(lower site, upper site, direction, coefficient, friction on the upper sphere) of those that can slip."""
        for axis, coefficient in enumerate(self.samples.coefficient):
            n = tuple(Decimal(int(k == axis)) for k in range(3))
            for lower in np.ndindex(*coefficient.shape[1:]):
                upper = tuple(x + (k == axis) for k, x in enumerate(lower))
                if self.is_driven(lower) and self.is_driven(upper):
                    continue
                force = exactly(self.samples.friction[axis][(self.number, *lower)])
                if self.flat:
                    force = tuple(force[0] * part for part in cross((ZERO, ZERO, Decimal(1)), n))
                yield lower, upper, n, Decimal(float(coefficient[(self.number, *lower)])), force

    def power(self):
        total = ZERO
        for lower, upper, n, coefficient, _ in self.contacts():
            to_upper = tuple(self.radius * part for part in n)
            to_lower = tuple(-part for part in to_upper)
            slip = tuple(
                a - b for a, b in zip(cross(self.spin[upper], to_lower), cross(self.spin[lower], to_upper), strict=True)
            )
            if self.samples.law == "coulomb":
                total += coefficient * self.strength * dot(slip, slip).sqrt()
            else:
                total += coefficient * dot(slip, slip)
        return total

    def lower_bound(self):
        """Work of the driven planes against the friction, less the price of torques left over; friction scaled into
        its discs (Coulomb), or twice that work less the sum of |F|^2 / eta (viscous)."""
        torque = dict.fromkeys(self.spin, (ZERO, ZERO, ZERO))
        worst, cost = Decimal(1), ZERO
        for lower, upper, n, coefficient, force in self.contacts():
            turn = cross(tuple(-self.radius * part for part in n), force)
            for site in (lower, upper):
                torque[site] = tuple(a + b for a, b in zip(torque[site], turn, strict=True))
            if self.samples.law == "coulomb":
                worst = max(worst, dot(force, force).sqrt() / (coefficient * self.strength))
            else:
                cost += dot(force, force) / coefficient
        jump = Decimal(self.samples.spin_top) - Decimal(self.samples.spin_bottom)
        left = ZERO
        for site, pull in torque.items():
            for part, along in zip(pull, self.direction, strict=True):
                gain = self.parity(site) * part * jump * along  # torque times the jump of a component
                if site[-1] == self.samples.shape[-1] - 1:
                    left -= gain
                elif not self.is_driven(site):
                    left -= max(gain, ZERO)
        return left / worst if self.samples.law == "coulomb" else 2 * left - cost
