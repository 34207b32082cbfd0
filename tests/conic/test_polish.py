"""Pairs of doubles, and minima whose torques balance to thirty digits."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from taichi_bearings.conic import polish
from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.double_double import (
    add,
    along,
    divide,
    exactly,
    multiply,
    scaled,
    square,
    square_root,
    subtract,
)
from tests.proof.laboratory import Laboratory, dot
from tests.proof.samples import samples_of
from tests.proof.test_bounds import solved


def exact(pair, i):
    return Fraction(pair[0][i].item()) + Fraction(pair[1][i].item())


@pytest.mark.parametrize("name", ["add", "subtract", "multiply", "divide"])
def test_arithmetic_of_pairs_is_good_to_a_hundred_bits(name):
    rng = np.random.default_rng(2)
    high = rng.standard_normal((2, 300)) * 10.0 ** rng.integers(-20, 20, (2, 300))
    first, second = ((h, h * 2.0**-54 * rng.uniform(-1, 1, 300)) for h in high)
    pairs = {"add": add, "subtract": subtract, "multiply": multiply, "divide": divide}
    numbers = {
        "add": lambda a, b: a + b, "subtract": lambda a, b: a - b, "multiply": lambda a, b: a * b,
        "divide": lambda a, b: a / b,
    }  # fmt: skip
    result = pairs[name](first, second)
    for i in range(300):
        true = numbers[name](exact(first, i), exact(second, i))
        assert abs(exact(result, i) - true) <= abs(true) * Fraction(1, 2**100)


def test_vectors_of_given_sizes_along_pairs_are_good_to_a_hundred_bits():
    rng = np.random.default_rng(4)
    high, size = rng.standard_normal((2, 200)) * 10.0 ** rng.integers(-22, 1, 200), rng.uniform(0, 2, 200)
    vectors = high, high * 2.0**-54 * rng.uniform(-1, 1, (2, 200))
    found = along(size, vectors)
    for i in range(200):
        x, y = (exact((vectors[0][k], vectors[1][k]), i) for k in range(2))
        for true, k in ((x, 0), (y, 1)):
            square_of = Fraction(size[i]) ** 2 * true**2 / (x**2 + y**2)
            assert abs(exact((found[0][k], found[1][k]), i) ** 2 / square_of - 1) <= Fraction(1, 2**99)
            assert found[0][k][i] * true >= 0


def test_roots_of_pairs_are_good_to_a_hundred_bits():
    values = exactly(np.random.default_rng(3).uniform(1e-9, 1e9, 200))
    root = square_root(values)
    for i in range(200):
        assert abs(exact(root, i) ** 2 - exact(values, i)) <= exact(values, i) * Fraction(1, 2**99)


def test_squares_and_multiples_are_products():
    rng = np.random.default_rng(5)
    high, factor = rng.standard_normal((2, 300))
    pair = high, high * 2.0**-54 * rng.uniform(-1, 1, 300)
    for one, other in ((square(pair), multiply(pair, pair)), (scaled(factor, pair), multiply(exactly(factor), pair))):
        assert (one[0] == other[0]).all()
        assert (one[1] == other[1]).all()


@pytest.mark.usefixtures("needs_f64", "taichi_runtime")
@pytest.mark.parametrize("seed", [1, 6])
def test_slipping_contacts_leave_no_torque_on_any_domain(seed):
    """mu F_n along the slip of Eq. 2, in 80 digits and the laboratory frame, summed over what moves as one."""
    solution = solved((4, 3, 5), {"seeds": (seed,)}, "interior-point")
    assert solution.states_proven[0]
    laboratory = Laboratory(samples_of(solution))
    for component in (0, 1):
        label = {site: site for site in laboratory.spin}

        def root(site, label=label):
            while label[site] != site:
                site = label[site]
            return site

        pull = dict.fromkeys(laboratory.spin, Decimal(0))
        for lower, upper, n, held, _, _ in laboratory.contacts():
            coefficient = held / laboratory.strength
            turn = tuple(a + b for a, b in zip(laboratory.spin[lower], laboratory.spin[upper], strict=True))
            across = tuple(part for part, along in zip(turn, n, strict=True) if along == 0)
            size = dot(across, across).sqrt()
            if n[component] != 0:
                continue
            if size < Decimal("1e-25"):
                label[root(lower)] = root(upper)
            else:
                for site in (lower, upper):
                    pull[site] += coefficient * turn[component] / size
        total = {}
        for site, value in pull.items():
            total[root(site)] = total.get(root(site), Decimal(0)) + laboratory.parity(site) * value
        driven = {root(site) for site in laboratory.spin if laboratory.is_driven(site)}
        free = [abs(value) for domain, value in total.items() if domain not in driven]
        assert all(value < Decimal("1e-26") for value in free)


@pytest.mark.usefixtures("needs_f64", "taichi_runtime")
@pytest.mark.parametrize("seed", [2, 7])
def test_slips_have_all_their_digits_where_polishing_ends_early(seed, monkeypatch):
    """Against slips after as many steps of Newton's method as reduce the torques at all."""
    early = solved((4, 3, 5), {"seeds": (seed,)}, "interior-point")
    monkeypatch.setattr(polish, "SMALL_TORQUE", 0.0)
    late = solved((4, 3, 5), {"seeds": (seed,)}, "interior-point")
    assert (early.state == late.state).all()
    assert np.allclose(early.slip, late.slip, rtol=1e-14, atol=0)


def test_slips_have_their_digits_where_the_jump_is_no_double():
    """Spins within 1e-17 of those of the top, 1 / sqrt(2) as a sum of two doubles, against exact fractions."""
    lattice, rng = Lattice((3, 4, 5)), np.random.default_rng(4)
    jump = divide(exactly(np.ones(1)), square_root(exactly(np.full(1, 2.0))))
    system = lattice_system(lattice, (0, 1), *(np.full(2, part[0]) for part in jump))
    tied = Contraction(system, np.arange(system.unknowns), rng.uniform(size=system.offset.shape[1]) < 0.3)
    assert (tied.number < 0).any()
    assert tied.unknowns > 5
    spins = np.full(tied.unknowns, jump[0][0]), jump[1][0] + rng.uniform(-1e-19, 1e-19, tied.unknowns)
    high, low = tied.expanded(spins)
    top, found = exact(jump, 0), tied.differences(spins)
    of_sphere = dict(enumerate(zip(high.reshape(-1, 2), low.reshape(-1, 2), strict=True)))
    for contact, slips in zip(tied.kept, found.T, strict=True):
        lower, upper = (np.unravel_index(end[system.contact[contact]], lattice.shape) for end in lattice.ends)
        for component, slip in zip(system.slot[:, contact], slips, strict=True):
            ends = []
            for site in (lower, upper):
                if site[-1] in (0, lattice.shape[-1] - 1):
                    ends.append(top if site[-1] else Fraction(0))
                else:
                    ends.append(
                        exact(of_sphere[np.ravel_multi_index((*site[:2], site[2] - 1), lattice.free_shape)], component)
                    )
            along = int(np.argmax(np.subtract(upper, lower)))
            true = 0 if component == along else ends[1] - ends[0]
            assert abs(Fraction(slip) - true) <= abs(true) * Fraction(1, 10**12)


def test_contacts_that_join_both_planes_cannot_all_be_tied():
    from tests.conic.test_slipless_forces import BOTTOM, TOP, chain

    system, order = chain((BOTTOM, 0, 0.0), (0, TOP, 1.0))
    one, both = np.array([True, False]), np.array([True, True])
    tied = Contraction(system.copies(3), order, np.concatenate([one, both, one]), samples=3)
    assert tied.contradicts.tolist() == [False, True, False]
    assert tied.number.tolist() == [-1, -1, -1]
    assert (np.array(tied.imposed)[:, [0, 2]] == 0).all()
