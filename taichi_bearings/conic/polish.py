"""The minimum with just some contacts slipping, in twice the precision.

Slips reach down to 1e-15 of the jump and below, where spins are rounded. A proof that they are slips, and not what
rounding has made of nothing, needs spins that are good to much less. Here the slipless contacts are tied exactly, the
spins left are sums of two doubles, and Newton's method, whose matrix may be a rough one, goes on until the torques are
in balance to some 1e-30 of the friction.
"""

import numpy as np

from taichi_bearings.conic.central_path import friction_stiffness
from taichi_bearings.conic.cone import length
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import Pair, add, divide, exactly, multiply, square_root, subtract

STEPS, ENOUGH = 20, 1e-31  # of Newton's method; torque, of the largest friction, that ends it
FAITHFUL = 1e-2  # change of a slip by a step, of itself, from which on the matrix is made anew
FAINT = 1e-20  # stiffness along a slip, of that across it: for motions that nothing else resists
LONGEST = 0.5  # largest such change that is allowed
VISIBLE = 1e-10  # slips below which differences are to be trusted more than spins
SPARE = 20  # bits that 2^20 numbers of one size may need in a sum without rounding


def polished(
    tied: Contraction,
    matrix: NewtonMatrix,
    friction: list[np.ndarray],
    spins: np.ndarray,
    difference: list[np.ndarray],
    top: Pair,
) -> tuple[Pair, list[np.ndarray], list[np.ndarray]] | None:
    """Spins of the whole system, slips and duals (d, n) a group near the given ones, all torques in balance.

    matrix : of the contracted system. friction (n,), spins, difference (d, n) : of the contracted system; differences
    may be more precise than those of the spins. top : (C,), imposed on the top. Returns None where some slip is lost.
    """
    system, unknown = _PreciseSystem(tied, top), exactly(spins)
    try:
        if min((float(length(z).min(initial=1.0)) for z in difference), default=1.0) < VISIBLE:
            unknown = _fitted(system, matrix, unknown, difference)
        balanced = _balanced(system, matrix, friction, unknown)
    except NotPositiveDefinite:
        return None
    if balanced is None:
        return None
    slips = system.differences(balanced)
    forces = [_along(mu, z)[0] for mu, z in zip(friction, slips, strict=True)]
    return system.expanded(balanced), [z[0] for z in slips], [-f for f in forces]


def _balanced(system: "_PreciseSystem", matrix: NewtonMatrix, friction: list[np.ndarray], unknown: Pair) -> Pair | None:
    """Newton's method until the torques do not fall any more."""
    strongest = max((float(mu.max(initial=0.0)) for mu in friction), default=0.0)
    best, least, factorised = None, np.inf, False
    for _ in range(STEPS):
        difference = system.differences(unknown)
        if any((length(z[0]) == 0).any() for z in difference):
            return best
        torques = system.torques([_along(mu, z) for mu, z in zip(friction, difference, strict=True)])
        size = float(np.abs(torques).max(initial=0.0))
        if not size < least:
            return best
        if size > least / 2 or size <= ENOUGH * strongest:
            return unknown
        best, least = unknown, size
        if not factorised:
            matrix.factorise([friction_stiffness(mu, z[0], FAINT) for mu, z in zip(friction, difference, strict=True)])
        step = matrix.solve(-torques)
        change = max(
            float((length(g.change(step)) / length(z[0])).max(initial=0.0))
            for g, z in zip(system.groups, difference, strict=True)
        )
        if not change <= LONGEST:
            return None
        factorised = change < FAITHFUL
        unknown = add(unknown, exactly(step))
    return best


def _fitted(system: "_PreciseSystem", matrix: NewtonMatrix, unknown: Pair, tracked: list[np.ndarray]) -> Pair:
    """The spins corrected so that they have the tracked differences, relative to the size of these."""
    weight = [1 / length(z) ** 2 for z in tracked]
    matrix.factorise([np.eye(len(z))[:, :, None] * w for z, w in zip(tracked, weight, strict=True)])
    for _ in range(2):
        missing = [
            (w * (z - now[0] - now[1]), np.zeros_like(z))
            for w, z, now in zip(weight, tracked, system.differences(unknown), strict=True)
        ]
        unknown = add(unknown, exactly(matrix.solve(system.torques(missing))))
    return unknown


class _PreciseSystem:
    """Differences and torques of a contracted system, in twice the precision.

    multiple : (d, n) a group, what the imposed spins add to the differences, in units of the jump: -1, 0 or 1.
    """

    def __init__(self, tied: Contraction, top: Pair) -> None:
        self.groups, self.top, self._tied, self._system = tied.system.groups, top, tied, tied.system
        self.slot = np.arange(len(tied.number)) % len(top[0])
        self.multiple, self.jump = [], []
        for before, group, kept in zip(tied.whole.groups, self.groups, tied.kept, strict=True):
            slot = np.maximum(before.below, before.above)[:, kept] % len(top[0])
            jump = (top[0][slot], top[1][slot])
            self.jump.append(jump)
            self.multiple.append(_multiples(group.offset, jump[0]))

    def differences(self, unknown: Pair) -> list[Pair]:
        """Across each contact, (d, n) a group."""
        high, low = (np.append(part, 0.0) for part in unknown)
        found = []
        for group, times, jump in zip(self.groups, self.multiple, self.jump, strict=True):
            above, below = (high[group.above], low[group.above]), (high[group.below], low[group.below])
            found.append(add(subtract(above, below), (times * jump[0], times * jump[1])))
        return found

    def torques(self, pulls: list[Pair]) -> np.ndarray:
        """Sums (unknowns,) of the pulls (d, n) a group on the spins, rounded only once they have cancelled.

        The leading bits of all numbers, multiples of one unit, are summed without any rounding, then those that follow.
        """
        largest = max((float(np.abs(p[0]).max(initial=0.0)) for p in pulls), default=0.0)
        total, rest = np.zeros(self._system.unknowns), [p[0] for p in pulls]
        for _ in range(2):
            grain = np.ldexp(1.5, int(np.frexp(largest)[1]) + SPARE)
            leading = [(r + grain) - grain for r in rest]
            total = total + self._system.torques(leading)
            rest = [r - a for r, a in zip(rest, leading, strict=True)]
            largest *= 2.0 ** (SPARE - 52)
        return total + self._system.torques([r + p[1] for r, p in zip(rest, pulls, strict=True)])

    def expanded(self, unknown: Pair) -> Pair:
        """Spins of the whole system: equal within each tied set, and just those imposed where it is tied to a plane."""
        times = _multiples(self._tied.imposed, self.top[0][self.slot])
        high, low = (np.append(part, 0.0)[self._tied.number] for part in unknown)
        return high + times * self.top[0][self.slot], low + times * self.top[1][self.slot]


def _multiples(values: np.ndarray, jump: np.ndarray) -> np.ndarray:
    return np.rint(np.divide(values, jump, out=np.zeros_like(values), where=jump != 0))


def _along(friction: np.ndarray, difference: Pair) -> Pair:
    """Friction along the slip, (d, n)."""
    size = (np.abs(difference[0][0]), np.sign(difference[0][0]) * difference[1][0])
    if len(difference[0]) == 2:
        squares = multiply(difference, difference)
        size = square_root(add((squares[0][0], squares[1][0]), (squares[0][1], squares[1][1])))
    return multiply(exactly(friction), divide(difference, size))


__all__ = ["polished"]
