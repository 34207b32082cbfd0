"""The least Coulomb power to 80 digits, and what every contact does there; shares no code with the package.

Mehrotra's predictor-corrector method with the scaling of Nesterov and Todd (Vandenberghe, "The CVXOPT linear and
quadratic cone program solvers", 2010) in numbers of 700 bits or more (python-flint). Unknowns are the staggered spins
of the free spheres from the bottom, in units of the imposed jump; only components that the minimum needs
(equations.md, 3).

    primal:  min sum_e mu_e s_e  with |d_e| <= s_e, d = A u + b      dual:  max f . b  with A' f = 0, |f_e| <= mu_e

The coefficients count exactly as the doubles they are, the direction is normalised in extended precision. The path goes
to the middle of all minimisers: a contact slips at *some* minimum just if its slip has a limit above 0 there. The slips
of all minimisers point the same way, along f_e, so the minimisers are a polyhedron: d_e = t_e f_e / |f_e|, t_e >= 0. If
it is more than a point, a linear programme for each contact tells whether t_e can be 0, and if not it slips at *every*
minimum. Its rows are in units of the slips in the middle, which makes the polyhedron round, so doubles will do.
"""

from dataclasses import dataclass

import numpy as np
from flint import arb, arb_mat, ctx

from tests.truth.cones import ball, dot, exact, length
from tests.truth.minimisers import DRIVEN, EITHER, SLIPLESS, SLIPPING, UNKNOWN, with_all_minimisers
from tests.truth.path import Path
from tests.truth.problem import Problem

TARGETS = ((-90, 700), (-150, 1100), (-220, 1500))  # log10 of the relative gap, bits; the next if limits are unclear
STEADY, FALLING = 0.5, 0.2  # a slip has its limit if it keeps this share; is zero if it falls as gap^FALLING or faster
MOST_ITERATIONS = 600
WANTED = 1e-45  # rigorous relative gap


@dataclass(frozen=True)
class Truth:
    """The minimum. Arrays: one an axis, (*contacts).

    power : arb that contains P_min (energy/time), from spins above and from balanced forces below.
    gap : (upper - lower) / upper, rigorous. slip : length/time, at the middle of the minimisers.
    margin : (mu F_n - |f|) / (mu F_n) there. state : SLIPLESS ... UNKNOWN. freedom : dimension of the minimisers.
    """

    power: arb
    gap: float
    slip: tuple[np.ndarray, ...]
    margin: tuple[np.ndarray, ...]
    state: tuple[np.ndarray, ...]
    freedom: int
    iterations: int

    @property
    def digits(self) -> str:
        return self.power.str(50, radius=False)


def solve(coefficient, normal_force, radius, spin_top, spin_bottom, direction=(1, 1, 0), perturbation=None) -> Truth:
    """The minimum of one sample; see Problem and Truth. Raises ArithmeticError if it is not known to 40 digits."""
    problem = Problem(coefficient, normal_force, radius, spin_top, spin_bottom, direction, perturbation)
    if not problem.components:
        return _at_rest(problem)
    for target, bits in TARGETS:
        before = ctx.prec
        ctx.prec = bits
        try:
            truth = _solve(problem, target)
        finally:
            ctx.prec = before
        if truth.gap < WANTED and not any((s == UNKNOWN).any() for s in truth.state):
            return truth
    if not truth.gap < WANTED:
        raise ArithmeticError(f"the relative gap is {truth.gap} after {truth.iterations} iterations")
    return truth


def _solve(problem: Problem, target: int) -> Truth:
    problem.build()
    path, seen, iterations = Path(problem), [], 0
    while True:
        gap, power = path.gap()
        relative = gap / power
        seen.append((relative, path.slips()))
        if relative.mid() < arb(10) ** target or iterations >= MOST_ITERATIONS:
            break
        path.advance()
        iterations += 1
    forces = [[-y for y in z] for z in path.dual]
    power, bound = problem.bounds(path.spins, forces)
    halfway = [(g, slips) for g, slips in seen[:-1] if g.mid() < arb(10) ** (target // 2)]
    limits = _limits(halfway[0], seen[-1]) if halfway else [UNKNOWN] * len(problem.contacts)
    direction = [
        [x / (length(d) if limit == SLIPPING else arb(1)) for x in d]
        for d, limit in zip(path.difference, limits, strict=True)
    ]
    freedom = 0
    if UNKNOWN not in limits:
        freedom, limits = with_all_minimisers(problem, limits, direction, seen[-1][1])
    unit = problem.unit()
    slip, margin, state = _empty(problem)
    speed = ball(problem.radius * abs(problem.speed))
    for c, limit, s, f in zip(problem.contacts, limits, seen[-1][1], forces, strict=True):
        slip[c.axis][c.index] = float(s * speed)
        margin[c.axis][c.index] = float((1 - length(f) / c.friction).mid())
        state[c.axis][c.index] = limit
    gap = float(((power - bound) / power).upper())
    return Truth((bound.union(power)) * unit, gap, slip, margin, state, freedom, iterations)


def _limits(early, late) -> list[int]:
    """SLIPPING or SLIPLESS at the middle of the minimisers, UNKNOWN if the slips at two gaps do not tell."""
    fall, nothing = float(((late[0] / early[0]).log() * FALLING).mid()), late[0].sqrt()
    found = []
    for before, now in zip(early[1], late[1], strict=True):
        if not now > nothing:  # all that is left is the rounding of the path
            found.append(SLIPLESS)
            continue
        ratio = float((now / before).log().mid()) if before > 0 else 0.0
        found.append(SLIPPING if abs(ratio) < -np.log(STEADY) else SLIPLESS if ratio < fall else UNKNOWN)
    return found


def _empty(problem: Problem):
    arrays = [(np.zeros(c.shape), np.ones(c.shape), np.zeros(c.shape, np.uint8)) for c in problem.coefficient]
    slip, margin, state = (tuple(parts) for parts in zip(*arrays, strict=True))
    for axis in range(problem.dimension - 1):
        state[axis][..., 0] = state[axis][..., -1] = DRIVEN
    return slip, margin, state


def _at_rest(problem: Problem) -> Truth:
    """Nothing that the minimum needs is imposed: no power, and every contact rests."""
    slip, margin, state = _empty(problem)
    return Truth(arb(0), 0.0, slip, margin, state, 0, 0)


def least_viscous_power(coefficient, radius, spin_top, spin_bottom, direction=(1, 1, 0)) -> arb:
    """Least power R^2 sum eta |d|^2 of viscous contacts, by Gaussian elimination with error bounds."""
    problem = Problem(coefficient, 1, radius, spin_top, spin_bottom, direction)
    if not problem.components:
        return arb(0)
    before = ctx.prec
    ctx.prec = 700
    try:
        problem.build()
        n = problem.unknowns
        rows, right = [[arb(0)] * n for _ in range(n)], [arb(0)] * n
        for c in problem.contacts:
            for b, low, up in zip(c.offset, c.lower, c.upper, strict=True):
                for here, sign in ((up, 1), (low, -1)):
                    if here >= 0:
                        right[here] -= sign * c.friction * b
                        rows[here][here] += c.friction
                        if min(up, low) >= 0:
                            rows[here][up + low - here] -= c.friction
        spins = arb_mat(rows).solve(arb_mat([[x] for x in right])).entries()
        total = sum(
            (c.friction * dot(d, d) for c, d in zip(problem.contacts, problem.differences(spins), strict=True)), arb(0)
        )
        return total * ball((problem.radius * problem.speed) ** 2 * problem.scale)
    finally:
        ctx.prec = before


__all__ = [
    "DRIVEN", "EITHER", "SLIPLESS", "SLIPPING", "UNKNOWN", "Problem", "Truth", "exact", "least_viscous_power", "solve",
]  # fmt: skip
