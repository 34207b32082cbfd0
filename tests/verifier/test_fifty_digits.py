"""States that are proven of packings with friction and viscosity, against the minimum in fifty digits.

The contacts that are said to rest are held, those said to slip follow the law, and Newton's method finds the spins in
decimals, from the normals, radii and spins bit by bit. If then slips are not 0, and forces of the contacts at rest
balance the others inside all discs, this is the minimum; nothing is shared with the solvers or the verifier.
"""

from contextlib import suppress
from decimal import Decimal, getcontext
from types import SimpleNamespace

import numpy as np
import pytest

import taichi_bearings as tb
from tests.packing.twins import random_packing
from tests.scenes import some_of

DIGITS, NOTHING = 60, Decimal("1e-40")
exact = np.vectorize(lambda value: Decimal(float(value)), otypes=[object])


def solved(matrix, right):
    """A solution of matrix @ x = right by elimination with full pivots, unknowns that nothing decides being 0; and a
    basis (n, k) of the kernel. Pivots below 1e-40 count as none."""
    rows, (count, n) = np.column_stack([matrix, right]), matrix.shape
    chosen = []
    for step in range(min(count, n)):
        left = [j for j in range(n) if j not in chosen]
        sizes = np.abs(rows[step:, left])
        i, j = np.unravel_index(np.argmax(sizes), sizes.shape)
        if sizes[i, j] < NOTHING:
            break
        rows[[step, step + i]] = rows[[step + i, step]]
        chosen.append(left[j])
        rows[step] = rows[step] / rows[step, left[j]]
        for other in range(count):
            if other != step and rows[other, left[j]] != 0:
                rows[other] = rows[other] - rows[other, left[j]] * rows[step]
    x, free = np.full(n, Decimal(0)), [j for j in range(n) if j not in chosen]
    x[chosen] = rows[: len(chosen), n]
    kernel = np.full((n, len(free)), Decimal(0))
    for k, j in enumerate(free):
        kernel[j, k] = Decimal(1)
        kernel[chosen, k] = -rows[: len(chosen), j]
    if any(abs(value) > NOTHING for value in rows[len(chosen) :, n]):
        raise ArithmeticError("nothing solves that")
    return x, kernel


def slips_of(packing):
    """K (3 E, 3 F) and slips (3 E,) of what is imposed, in decimals: (u_i + u_j) x n, three numbers a contact."""
    free = np.flatnonzero(packing.driven < 0)
    number = {int(i): 3 * k for k, i in enumerate(free)}
    rows = np.full((3 * packing.contacts, 3 * len(free)), Decimal(0))
    fixed = np.full(3 * packing.contacts, Decimal(0))
    for e, pair in enumerate(packing.contact):
        x, y, z = exact(packing.normal[e])
        zero = Decimal(0)
        cross = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])
        for i in pair:
            if int(i) in number:
                rows[3 * e : 3 * e + 3, number[int(i)] : number[int(i)] + 3] += cross
            else:
                fixed[3 * e : 3 * e + 3] += cross @ exact(packing.imposed[i])
    return rows, fixed


def size(vector):
    return sum(value * value for value in vector).sqrt()


def forces_and_stiffness(slip, held, damping):
    """Force (3,) and its derivative (3, 3) of a contact with this slip."""
    length, one = size(slip), np.array([[Decimal(int(i == j)) for j in range(3)] for i in range(3)])
    along = slip / length
    return held * along + damping * slip, (held / length) * (one - np.outer(along, along)) + damping * one


def contradiction(found):
    """What is wrong with states of which all are proven; "" if nothing is."""
    getcontext().prec = DIGITS
    packing, state = found.packing, found.state
    held, damping = (exact(values) for values in packing.coefficients)
    rows, fixed = slips_of(packing)
    at = lambda chosen: np.concatenate([[3 * e, 3 * e + 1, 3 * e + 2] for e in chosen] or [[]]).astype(int)  # noqa: E731
    slipping, resting = np.flatnonzero(state == 1), np.flatnonzero(state == 0)
    still = at(resting)
    free, radius = packing.driven < 0, exact(packing.radius)
    u = ((exact(found.spin) + exact(found.spin_rounding)) * radius[:, None])[free].ravel()
    step, kernel = solved(rows[still], -(rows[still] @ u + fixed[still]))
    u = u + step  # where a part rolls at every minimum without dissipating anything, its spins may be far from that
    for _ in range(8):
        slope, bends = np.full(len(u), Decimal(0)), np.full((len(u), len(u)), Decimal(0))
        for e in slipping:
            own = rows[3 * e : 3 * e + 3]
            force, stiffness = forces_and_stiffness(own @ u + fixed[3 * e : 3 * e + 3], held[e], damping[e])
            slope, bends = slope + own.T @ force, bends + own.T @ (stiffness @ own)
        if max(map(abs, kernel.T @ slope), default=Decimal(0)) < NOTHING:
            break
        u = u - kernel @ solved(kernel.T @ bends @ kernel, kernel.T @ slope)[0]
    else:
        return "Newton's method does not come to an end"
    for e in slipping:
        slip = size(rows[3 * e : 3 * e + 3] @ u + fixed[3 * e : 3 * e + 3])
        if not NOTHING < slip <= exact(found.slip_bound[e]) * (1 + Decimal("1e-15")):
            return f"contact {e} slips by {slip}, of at most {found.slip_bound[e]}"
    force = exact(found.friction[resting]).ravel()  # on the second sphere, along (u_i + u_j) x n where it slips
    left = slope + rows[still].T @ force
    more = rows[still] @ solved(rows[still].T @ rows[still], left)[0]
    for k, e in enumerate(resting):
        if size((force - more)[3 * k : 3 * k + 3]) > held[e]:
            return f"contact {e} would bear more than its friction"
    return ""


def drawn(seed):
    """Small packings with oblique contacts: lattices and random networks, viscosities over two decades."""
    rng = np.random.default_rng([23, seed])
    if seed % 2:
        while True:
            packing = random_packing(rng, 3, "coulomb-viscous", spheres=int(rng.integers(8, 16)), contrast=1)
            if 3 <= (packing.driven < 0).sum() <= 10 and packing.contacts >= 10:
                return packing
    kind, cells = [("bcc", (2, 2, 2)), ("fcc", (1, 2, 2)), ("bcc", (2, 2, 3)), ("diamond", (1, 1, 2))][seed // 2 % 4]
    low = 10 ** rng.uniform(-1, 2)
    viscosity = f"power-law:{low},{100 * low},-1"
    return tb.Packing.lattice(kind, cells, seed=seed, law="coulomb-viscous", viscosity=viscosity, spin_bottom=0.2)


@pytest.mark.parametrize("seed", some_of(120, 9))
def test_proven_states_are_those_of_the_minimum(seed):
    found = tb.solve(drawn(seed))
    if (found.proven == 2).any():
        pytest.skip("not all states are proven")
    assert contradiction(found) == ""


@pytest.mark.parametrize("seed", [0, 4])
def test_wrong_states_contradict_the_minimum(seed):
    """A contact at rest that is said to slip, or the other way round, is found."""
    found = tb.solve(drawn(seed))
    for state in (0, 1):
        contact = int(np.flatnonzero(found.state == state)[0])
        names = ("packing", "spin", "spin_rounding", "friction", "slip_bound")
        forged = SimpleNamespace(**{name: getattr(found, name) for name in names}, state=found.state.copy())
        forged.state[contact] = 1 - state
        with suppress(ArithmeticError):  # of a rest that cannot be, or where there is no minimum
            assert contradiction(forged) != ""
