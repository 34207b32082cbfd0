"""Slips of the minimum of a packing with friction and viscosity, in decimals, contact by contact; nothing is shared
with the solvers or the proofs.

Lengths |v| are smoothed to (v^2 + m^2)^1/2, and Newton's method follows the minimum to m = 1e-50 of what is imposed. A
contact at rest then slips by about m, one that slips by 1e-16 as the rounding of normals makes it does not.
"""

from decimal import Decimal, localcontext

import numpy as np

DIGITS, LEAST, STIFF = 160, Decimal("1e-50"), Decimal("1e-70")
RESTS, SLIPS = Decimal("1e-43"), Decimal("1e-36")  # of what is imposed
exact = np.vectorize(lambda value: Decimal(float(value)), otypes=[object])


def slips_at(packing):
    """Blocks (E, p, p) of radius times the normal's cross matrix, for either end; unknown of each sphere, or None."""
    p = packing.dimension if packing.dimension == 3 else 1
    number = {int(i): p * k for k, i in enumerate(np.flatnonzero(packing.driven < 0))}
    zero = Decimal(0)
    found = []
    for (i, j), normal in zip(packing.contact.tolist(), packing.normal, strict=True):
        cross = np.array([[Decimal(1)]])
        if p == 3:
            x, y, z = exact(normal)
            cross = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])
        ends, fixed = [], np.full(p, zero)
        for sphere in (i, j):
            block = cross * Decimal(float(packing.radius[sphere]))
            if sphere in number:
                ends.append((number[sphere], block))
            else:
                fixed = fixed + block @ np.atleast_1d(exact(packing.spin[sphere]))
        found.append((ends, fixed))
    return found, p * len(number), p


def elimination(matrix, right):
    """x with matrix @ x = right, of a positive matrix."""
    rows, n = np.column_stack([matrix, right]), len(right)
    for i in range(n):
        rows[i, i:] = rows[i, i:] / rows[i, i]
        for below in range(i + 1, n):
            if rows[below, i] != 0:
                rows[below, i:] = rows[below, i:] - rows[below, i] * rows[i, i:]
    for i in reversed(range(n)):
        rows[i, n] -= rows[i, i + 1 : n] @ rows[i + 1 :, n] if i + 1 < n else Decimal(0)
    return rows[:, n]


class Smoothed:
    def __init__(self, packing):
        self.contacts, self.n, self.p = slips_at(packing)
        of, count = packing.arrays(), (packing.contacts,)
        friction, force, self.damping = (
            exact(np.broadcast_to(of.get(name, 0.0), count)) for name in ("friction", "normal_force", "viscosity")
        )
        self.held = friction * force
        self.unit = max((abs(value) for _, fixed in self.contacts for value in fixed), default=Decimal(0)) or Decimal(1)

    def slips(self, u):
        return [
            sum((block @ u[at : at + self.p] for at, block in ends), fixed) if ends else 0 * fixed
            for ends, fixed in self.contacts
        ]

    def potential(self, u, m):
        total = STIFF * (u @ u) / 2
        for slip, w, h in zip(self.slips(u), self.held, self.damping, strict=True):
            total += w * (slip @ slip + m * m).sqrt() + h * (slip @ slip) / 2
        return total

    def slope_and_curvature(self, u, m):
        p, slope, bends = self.p, STIFF * u, np.full((self.n, self.n), Decimal(0))
        bends[range(self.n), range(self.n)] = STIFF
        for (ends, _), slip, w, h in zip(self.contacts, self.slips(u), self.held, self.damping, strict=True):
            size = (slip @ slip + m * m).sqrt()
            stiff = (w / size + h) * exact(np.eye(p)) - (w / size**3) * np.outer(slip, slip)
            for at, block in ends:
                slope[at : at + p] = slope[at : at + p] + block.T @ ((w / size + h) * slip)
                for other, another in ends:
                    bends[at : at + p, other : other + p] += block.T @ stiff @ another
        return slope, bends

    def nearest(self, u, m):
        """The minimum for this m."""
        least = min((w for w in self.held if w > 0), default=Decimal(1))
        for _ in range(60):
            slope, bends = self.slope_and_curvature(u, m)
            step = -elimination(bends, slope)
            falls = -(slope @ step)
            if falls < m * least * Decimal("1e-20"):
                return u
            here, share = self.potential(u, m), Decimal(1)
            while self.potential(u + share * step, m) >= here - share * falls / 10000:
                share /= 2
                if share < Decimal("1e-20"):
                    return u
            u = u + share * step
        raise ArithmeticError("Newton's method does not come to an end")


def states(packing):
    """(E,): 0 rests, 1 slips, 2 neither for sure, 3 takes no part."""
    with localcontext() as context:
        context.prec = DIGITS
        scene = Smoothed(packing)
        before, m = None, scene.unit
        u = scene.nearest(np.full(scene.n, Decimal(0)), m)
        while m > LEAST * scene.unit:
            less = m / 8
            start = u if before is None else u + (less - m) / (m - before[1]) * (u - before[0])
            if scene.potential(start, less) > scene.potential(u, less):
                start = u
            before, m, u = (u, m), less, scene.nearest(start, less)
        sizes = np.array([(slip @ slip).sqrt() / scene.unit for slip in scene.slips(u)])
        found = np.where(sizes < RESTS, 0, np.where(sizes > SLIPS, 1, 2))
        acts = [
            bool(ends) and w + h > 0 for (ends, _), w, h in zip(scene.contacts, scene.held, scene.damping, strict=True)
        ]
        return np.where(acts, found, 3)
