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


def by_axis(samples, values):
    """Of (..., E) an array (..., *contacts) an axis."""
    shapes = [of.shape[1:] for of in samples.coefficient]
    ends = np.cumsum([np.prod(shape) for shape in shapes])[:-1]
    return [of.reshape(*values.shape[:-1], *n) for of, n in zip(np.split(values, ends, -1), shapes, strict=True)]


def exactly(values):
    return tuple(Decimal(float(v)) for v in np.atleast_1d(values))


class Laboratory:
    """The sample `number` of tests.proof.samples.Samples."""

    def __init__(self, samples, number=0):
        self.samples, self.number, self.flat = samples, number, samples.dimension == 2
        self.radius, self.strength = Decimal(samples.radius), Decimal(samples.normal_force)
        self.bottom, self.top = (
            self._state(state, spin)
            for state, spin in ((samples.bottom, samples.spin_bottom), (samples.top, samples.spin_top))
        )
        self.spin = {site: self._spin(site) for site in np.ndindex(*samples.shape)}

    def _state(self, state, spin):
        """(A_x, A_y, A_z, C) of a plane; without one its spin along the direction."""
        if self.samples.top is not None:
            return (ZERO, ZERO, *exactly(state), ZERO) if self.flat else exactly(state)
        vector = (ZERO, ZERO, Decimal(1)) if self.flat else exactly(self.samples.direction)
        size = dot(vector, vector).sqrt()
        return (*(Decimal(spin) * part / size for part in vector), ZERO)

    def imposed(self, state, site):
        """Signed spin of a state at a sphere."""
        at = [2 * self.radius * step for step in (*site, 0)[:3]]
        return tuple(a + state[3] * x for a, x in zip(state[:3], at, strict=True))

    def jump(self, site):
        """State of the top less that of the bottom, in the layers of a sphere, along the height as on the top."""
        above = (*site[:-1], self.samples.shape[-1] - 1)
        return tuple(a - b for a, b in zip(*(self.imposed(s, above) for s in (self.top, self.bottom)), strict=True))

    def parity(self, site):
        return 1 if sum(site) % 2 == 0 else -1

    def is_driven(self, site):
        return site[-1] in (0, self.samples.shape[-1] - 1)

    def _spin(self, site):
        if self.is_driven(site):
            imposed = self.imposed(self.bottom if site[-1] == 0 else self.top, site)
            return tuple(self.parity(site) * part for part in imposed)
        high, low = (exactly(field[(self.number, *site)]) for field in (self.samples.spin, self.samples.spin_rounding))
        total = tuple(a + b for a, b in zip(high, low, strict=True))
        return (ZERO, ZERO, total[0]) if self.flat else total

    def contacts(self):
        """(lower site, upper site, direction, friction that it bears, viscosity, force on the upper sphere) of those
        that can slip and are not absent, which bear no force."""
        for axis, coefficient in enumerate(self.samples.coefficient):
            n = tuple(Decimal(int(k == axis)) for k in range(3))
            for lower in np.ndindex(*coefficient.shape[1:]):
                upper = tuple((x + (k == axis)) % self.samples.shape[k] for k, x in enumerate(lower))
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
        left = ZERO
        for site, pull in torque.items():
            for part, jump in zip(pull, self.jump(site), strict=True):
                gain = self.parity(site) * part * jump  # torque times the jump of a component
                if site[-1] == self.samples.shape[-1] - 1:
                    left -= gain
                elif not self.is_driven(site):
                    left -= max(gain, ZERO)
        return (2 if self.samples.law == "viscous" else 1) * (left / worst - cost)


class OfPacking:
    """Power and bounds of spins and friction on a packing whose components do not mix: discs, or normals along axes."""

    def __init__(self, packing, spin, rounding, friction):
        self.law, self.flat, self.free = packing.law, packing.dimension == 2, packing.driven < 0
        self.pairs = packing.contact.tolist()
        self.normal = [exactly(n) for n in packing.normal]
        pressed = np.broadcast_to(packing.normal_force, len(self.pairs))
        first, second = exactly(packing.friction), exactly(pressed)
        self.held, self.viscosity = [a * b for a, b in zip(first, second, strict=True)], [ZERO] * len(self.pairs)
        if self.law.name == "viscous":
            self.held, self.viscosity = self.viscosity, first
        elif packing.viscosity is not None:
            self.viscosity = exactly(packing.viscosity)
        self.radius = exactly(packing.radius)
        given = zip(np.where(self.is_driven(packing.spin), packing.spin, spin), rounding, strict=True)
        self.u = [
            tuple(r * (a + b) for a, b in zip(exactly(high), exactly(np.where(free, low, 0.0)), strict=True))
            for (high, low), r, free in zip(given, self.radius, self.free, strict=True)
        ]
        self.force = [exactly(f) for f in friction]

    def is_driven(self, like):
        return np.reshape(~self.free, (-1, *(1,) * (like.ndim - 1)))

    def turned(self, vector, normal):
        """vector x n; of discs the vector."""
        return vector if self.flat else cross(vector, normal)

    def slips(self):
        """|v| of every contact."""
        for (i, j), n in zip(self.pairs, self.normal, strict=True):
            both = self.turned(tuple(a + b for a, b in zip(self.u[i], self.u[j], strict=True)), n)
            yield dot(both, both).sqrt()

    def acting(self):
        """Numbers of contacts with a coefficient and a free end."""
        ends = enumerate(self.pairs)
        return [e for e, (i, j) in ends if (self.free[i] or self.free[j]) and self.held[e] + self.viscosity[e] > 0]

    def power(self, share=Decimal(1)):
        """share : of the viscous part."""
        slip = list(self.slips())
        return sum((self.held[e] * slip[e] + share * self.viscosity[e] * slip[e] ** 2 for e in self.acting()), ZERO)

    def objective(self):
        """The power, or of contacts with friction and viscosity their potential."""
        return self.power(Decimal(1) / 2 if self.law.has_friction and self.law.has_viscosity else Decimal(1))

    def lower_bound(self):
        """Work of the driven spheres less the price of torques that are left over at the largest imposed u by
        component, friction scaled into its limits (Coulomb), less the conjugates of the forces (else)."""
        torque = [[ZERO] * len(u) for u in self.u]
        worst, cost = Decimal(1), ZERO
        for e in self.acting():
            moment = tuple(-part for part in self.turned(self.force[e], self.normal[e]))
            moment = self.force[e] if self.flat else moment  # n x F
            for i in self.pairs[e]:
                torque[i] = [a + b for a, b in zip(torque[i], moment, strict=True)]
            size = dot(self.force[e], self.force[e]).sqrt()
            if self.viscosity[e]:
                cost += max(size - self.held[e], ZERO) ** 2 / (2 * self.viscosity[e])
            else:
                worst = max(worst, size / self.held[e])
        driven = [u for u, free in zip(self.u, self.free, strict=True) if not free]
        box = [max(abs(u[k]) for u in driven) for k in range(len(driven[0]))]
        gained = ZERO
        for pull, u, free in zip(torque, self.u, self.free, strict=True):
            gained += -sum((abs(p) * b for p, b in zip(pull, box, strict=True)), ZERO) if free else dot(pull, u)
        return (1 if self.law.has_friction else 2) * (gained / worst - cost)
