"""States that are proven of packings with friction and viscosity, against the minimum in fifty digits.

The contacts that are said to rest are held, those said to slip follow the law, and Newton's method finds the spins in
decimals, from the normals, radii and spins bit by bit. If then slips are not 0, and forces of the contacts at rest
balance the others inside all discs, this is the minimum; nothing is shared with the solvers or the proofs.
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
    """K (p E, p F) and slips (p E,) of what is imposed, in decimals: (u_i + u_j) x n, p = 3 numbers a contact; of discs
    u_i + u_j, p = 1."""
    free, p = np.flatnonzero(packing.driven < 0), numbers(packing)
    number = {int(i): p * k for k, i in enumerate(free)}
    rows = np.full((p * packing.contacts, p * len(free)), Decimal(0))
    fixed = np.full(p * packing.contacts, Decimal(0))
    for e, pair in enumerate(packing.contact):
        cross = np.array([[Decimal(1)]])
        if p == 3:
            (x, y, z), zero = exact(packing.normal[e]), Decimal(0)
            cross = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])
        for i in pair:
            if int(i) in number:
                rows[p * e : p * e + p, number[int(i)] : number[int(i)] + p] += cross
            else:
                fixed[p * e : p * e + p] += cross @ np.atleast_1d(exact(packing.driven_speed[i]))
    return rows, fixed


def numbers(packing):
    return 3 if packing.dimension == 3 else 1


def size(vector):
    return sum(value * value for value in vector).sqrt()


def forces_and_stiffness(slip, held, damping):
    """Force (p,) and its derivative (p, p) of a contact with this slip."""
    length, places = size(slip), range(len(slip))
    one = np.array([[Decimal(int(i == j)) for j in places] for i in places])
    along = slip / length
    return held * along + damping * slip, (held / length) * (one - np.outer(along, along)) + damping * one


def contradiction(found):
    """What is wrong with states of which all are proven; "" if nothing is."""
    getcontext().prec = DIGITS
    packing, state, p = found.packing, found.state, numbers(found.packing)
    held, *others = (exact(values[0]) for values in packing.material)
    damping = others[0] if others else 0 * held
    rows, fixed = slips_of(packing)
    slipping, resting = np.flatnonzero(state == 1), np.flatnonzero(state == 0)
    still = (p * resting[:, None] + np.arange(p)).ravel()
    free, radius = packing.driven < 0, exact(packing.radius)
    spin = (exact(found.spin) + exact(found.spin_rounding)).reshape(len(free), -1)
    u = (spin * radius[:, None])[free].ravel()
    step, kernel = solved(rows[still], -(rows[still] @ u + fixed[still]))
    u = u + step  # where a part rolls at every minimum without dissipating anything, its spins may be far from that
    for _ in range(8):
        slope, bends = np.full(len(u), Decimal(0)), np.full((len(u), len(u)), Decimal(0))
        for e in slipping:
            own = rows[p * e : p * e + p]
            force, stiffness = forces_and_stiffness(own @ u + fixed[p * e : p * e + p], held[e], damping[e])
            slope, bends = slope + own.T @ force, bends + own.T @ (stiffness @ own)
        if max(map(abs, kernel.T @ slope), default=Decimal(0)) < NOTHING:
            break
        u = u - kernel @ solved(kernel.T @ bends @ kernel, kernel.T @ slope)[0]
    else:
        return "Newton's method does not come to an end"
    for e in slipping:
        slip = size(rows[p * e : p * e + p] @ u + fixed[p * e : p * e + p])
        if not slip > NOTHING:
            return f"contact {e} slips by {slip}"
    force = exact(found.friction[resting]).ravel()  # on the second sphere, along (u_i + u_j) x n where it slips
    left = slope + rows[still].T @ force
    more = rows[still] @ solved(rows[still].T @ rows[still], left)[0]
    for k, e in enumerate(resting):
        if size((force - more)[p * k : p * k + p]) > held[e]:
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
    if not found.states_proven:
        pytest.skip("not all states are proven")
    assert contradiction(found) == ""


def drawn_discs(seed):
    """Discs with odd loops, bodies that are joined, viscosities over two decades; every fourth has contacts without."""
    rng = np.random.default_rng([29, seed])
    low = 10 ** rng.uniform(-1, 2)
    viscosity = f"power-law:{low},{100 * low},-1"
    if seed % 2:
        return tb.Packing.lattice("triangular", (4, 3), seed=seed, law="coulomb-viscous", viscosity=viscosity,
                                  spin_bottom=0.2)  # fmt: skip
    while True:
        packing = random_packing(rng, 2, "coulomb-viscous", spheres=int(rng.integers(8, 24)), contrast=1)
        if (packing.driven < 0).sum() >= 3 and packing.contacts >= 10:
            none = rng.random(packing.contacts) < (0.2 if seed % 4 else 0.0)
            return tb.Packing(**packing.arrays() | {"viscosity": np.where(none, 0.0, packing.viscosity)})


@pytest.mark.parametrize("seed", some_of(120, 12))
def test_states_of_discs_with_odd_loops_are_proven_and_those_of_the_minimum(seed):
    found = tb.solve(drawn_discs(seed))
    damped = found.packing.viscosity > 0
    assert found.states_proven or not damped.all()
    if found.states_proven:
        assert contradiction(found) == ""


@pytest.mark.parametrize("seed", some_of(48, 8))
def test_states_of_cubic_lattices_with_odd_rings_are_proven_and_those_of_the_minimum(seed):
    """Friction alone; rings of three along one or two axes, so that no signs make slips differences of spins."""
    cells, periodic = [((3, 2, 3), ("x",)), ((3, 3, 3), ("x", "y")), ((2, 3, 4), ("y",)), ((3, 2, 4), ("x",))][seed % 4]
    friction = ["uniform:0.1,1.0", "lognormal:0.5,0.8", "bimodal:1,2,0.5"][seed // 4 % 3]
    spin = {"direction": (1, 1, 0.5 * (seed % 3)), "spin_bottom": 0.25 * (seed % 2)}
    found = tb.solve(tb.Packing.lattice("cubic", cells, periodic, seed=seed, distribution=friction, **spin))
    assert found.states_proven or "bimodal" in friction
    if found.states_proven:
        assert contradiction(found) == ""


@pytest.mark.parametrize("seed", [0, 4])
def test_wrong_states_contradict_the_minimum(seed):
    """A contact at rest that is said to slip, or the other way round, is found."""
    found = tb.solve(drawn(seed))
    for state in (0, 1):
        contact = int(np.flatnonzero(found.state == state)[0])
        names = ("packing", "spin", "spin_rounding", "friction")
        forged = SimpleNamespace(**{name: getattr(found, name) for name in names}, state=found.state.copy())
        forged.state[contact] = 1 - state
        with suppress(ArithmeticError):  # of a rest that cannot be, or where there is no minimum
            assert contradiction(forged) != ""
