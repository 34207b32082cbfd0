"""The gap of packings is its formula, and certified what has the least power, whatever the contrast of frictions."""

from fractions import Fraction

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.conic import multipliers
from tests.packing.fraction_twin import least_power_of_discs, states_of_discs
from tests.packing.twins import clarabel_least, random_packing
from tests.scenes import some_of


def chain(friction, dimension, **given):
    """Spheres in a row, the first at rest and the last turning across it."""
    count = len(friction) + 1
    center = np.zeros((count, dimension))
    center[:, 0] = np.arange(count)
    driven = np.full(count, -1)
    driven[[0, -1]] = 0, 1
    spin = np.zeros((count, 3) if dimension == 3 else count)
    spin[-1] = (0, 0.6, 0.8) if dimension == 3 else 1.0
    contact = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    given = {"friction": friction, "normal_force": 1.0} | given
    return tb.Packing(center=center, contact=contact, driven=driven, spin=spin, **given)


def check(found, least, tolerance=1e-8, certified=True):
    """The gap of the numbers that are told; a bound below the exact least power, or above it by a rounding of the
    double that the latter is told as; and certified where and only where the gap allows."""
    power, lower = Fraction(float(found.power)), Fraction(float(found.lower_bound))
    formula = (found.power - found.lower_bound) / found.power if found.power else 0.0
    assert found.gap == pytest.approx(formula, rel=1e-15)
    assert (found.status == "certified") == (found.gap <= tolerance)
    assert lower <= least
    assert power >= least * (1 - Fraction(2) ** -51)
    if found.status == "certified":
        assert power <= least * (1 + Fraction(tolerance))
    assert found.status == "certified" or not certified


@pytest.mark.parametrize("decades", [0, 6, 12, 18, 24, 30])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("method", ["auto", "interior-point"])
def test_a_chain_slips_at_its_weakest_contact(decades, dimension, method):
    half = 10.0 ** (decades / 2)
    friction = np.array([half, 3 / half, 1 / half, 2 * half / 3])
    found = tb.solve(chain(friction, dimension), method=method)
    check(found, Fraction(float(friction.min())) / 2, certified=method == "auto" or decades <= 12)


@pytest.mark.parametrize("weak", [1e-6, 1e-12, 1e-15])
@pytest.mark.parametrize("seed", range(2))
def test_a_weak_layer_across_a_strong_frame_is_the_cut(weak, seed):
    packing = tb.Packing.lattice("square", (6, 7), seed=seed)
    force = np.random.default_rng(seed).lognormal(0, 1, packing.contacts) * 100
    row = np.round(packing.center[:, 1] / 1.0).astype(int)[packing.contact]
    force[(row.min(axis=1) == 3) & (row.max(axis=1) == 4)] *= weak
    packing = tb.Packing(**packing.arrays() | {"normal_force": force})
    found = tb.solve(packing)
    check(found, least_power_of_discs(packing))
    assert found.states_proven


@pytest.mark.parametrize("seed", some_of(300, 13))
def test_discs_have_the_least_power_of_exact_cuts(seed):
    """Odd loops, several bodies with several values, floating parts, ties, 0 to 30 decades of friction."""
    draw = np.random.default_rng([54, seed])
    packing, decades = random_packing(draw, 2, spheres=int(draw.integers(4, 24))), (0, 6, 12, 18, 24, 30)[seed % 6]
    friction = np.clip(10 ** draw.uniform(-decades / 2, decades / 2, packing.contacts), 1e-15, 1e15)
    friction = friction if draw.random() < 0.7 else 10.0 ** np.round(np.log10(friction))
    normal = draw.uniform(0.5, 2, packing.contacts) if draw.random() < 0.5 else 1.0
    packing = tb.Packing(**packing.arrays() | {"friction": friction, "normal_force": normal})
    found = tb.solve(packing)
    check(found, least_power_of_discs(packing), certified=False)
    states = states_of_discs(packing)
    assert found.state[found.proven].tolist() == [of for of, known in zip(states, found.proven, strict=True) if known]
    if found.status == "certified":
        assert found.states_proven


@pytest.mark.parametrize("friction", ["constant:0.5", "uniform:0.1,1.0", "bimodal:0.1,1.0,0.5"])
@pytest.mark.parametrize("spin", [(1.0, 1.0), (1.0, 0.7), (1.0, -1.0)])
def test_around_discs_at_rest_amid_odd_loops_all_slipping_contacts_are_proven(friction, spin):
    """The two copies of a disc at rest are above or below together, so no lightest cut is the only one."""
    packing = tb.Packing.lattice("triangular", (5, 6), seed=2, distribution=friction)
    imposed = np.select([packing.driven == 0, packing.driven == 1], spin)
    packing = tb.Packing(**packing.arrays() | {"spin": imposed})
    found = tb.solve(packing)
    assert found.states_proven
    assert found.state.tolist() == states_of_discs(packing)
    assert (found.state == 1).any()


@pytest.mark.parametrize("weak", [1e-6, 1e-12, 1e-15])
def test_a_weak_layer_across_strong_spheres_is_clarabels_minimum_of_a_milder_contrast(weak):
    """Above it the strong contacts hold whatever they can bear, so the power goes with the strength of the layer."""
    pytest.importorskip("clarabel")
    packing = tb.Packing.lattice("bcc", (3, 3, 5), seed=1)
    heights = np.unique(packing.center[:, 2])
    is_weak = np.searchsorted(heights, packing.center[:, 2])[packing.contact].min(axis=1) == 4
    mild = tb.Packing(**packing.arrays() | {"normal_force": np.where(is_weak, 1.0, 50.0)})
    least, _, status = clarabel_least(mild)
    assert status == "Solved"
    found = tb.solve(tb.Packing(**packing.arrays() | {"normal_force": np.where(is_weak, weak, 1.0)}))
    assert found.status == "certified"
    assert found.power == pytest.approx(least * weak, rel=1e-7)
    assert found.gap == (found.power - found.lower_bound) / found.power


def test_a_crooked_direction_of_equal_contacts_in_a_row_is_certified():
    """All contacts of straight rows tie: any share of the jump on each is a minimum, and settling must not leave it."""
    normal = np.array([3.0, -4.0, 12.0]) / 13
    rows = [5.0 * side * np.eye(3)[0] + np.arange(5)[:, None] * normal for side in (0, 1, 2)]
    contact = np.concatenate([5 * side + np.array([[0, 1], [1, 2], [2, 3], [3, 4]]) for side in (0, 1, 2)])
    spin = np.zeros((15, 3))
    spin[4::5] = (0.3, 1.0, -0.4)
    driven = np.tile([0, -1, -1, -1, 1], 3)
    packing = tb.Packing(
        np.concatenate(rows),
        contact,
        driven,
        spin,
        normal=np.tile(normal, (12, 1)),
        friction=np.ones(12),
        normal_force=1.0,
    )
    found = tb.solve(packing)
    assert found.status == "certified"
    assert found.power == pytest.approx(3 * 0.5 * np.linalg.norm(np.cross(spin[4], normal)), rel=1e-10)


@pytest.mark.parametrize(
    ("kind", "cells", "friction", "seed"),
    [
        ("diamond", 4, "bimodal:0.1,1.0,0.5", 1),  # springs alone leave a gap of 2e-8
        ("bcc", 5, "bimodal:1,2,0.5", 2),  # 2e-9
        ("bcc", 5, "bimodal:1e-6,1.0,0.5", 0),  # 2e-2
    ],
)
def test_minima_of_two_frictions_that_tie_are_certified_and_clarabels(kind, cells, friction, seed):
    """Spheres of tied minima turn without a change of power, so no springs determine their spins."""
    pytest.importorskip("clarabel")
    packing = tb.Packing.lattice(kind, (cells,) * 3, seed=seed, distribution=friction)
    found = tb.solve(packing)
    assert found.status == "certified"
    assert found.gap < (1e-8 if "1e-6" in friction else 1e-9)
    least, _, status = clarabel_least(packing)
    assert status in ("Solved", "AlmostSolved")
    assert found.lower_bound * (1 - 1e-7) <= least <= found.power * (1 + 1e-7)


# kind and cells, decades of friction, seed, gap: stiff springs throw the first three off their minima, corrections that
# are no longer linear the last one, where slow spins alone have a bound
CONTRASTS = (
    ("bcc", 3, 12, 0, 1e-12), ("bcc", 3, 14, 0, 1e-10), ("cubic", 4, 18, 0, 1e-14), ("bcc", 3, 24, 2, 1e-9)
)  # fmt: skip


@pytest.mark.parametrize(("kind", "cells", "decades", "seed", "gap"), CONTRASTS)
def test_springs_settle_friction_over_twelve_decades_and_more(kind, cells, decades, seed, gap):
    sides = (cells, cells, cells + (kind == "cubic"))
    packing, draw = tb.Packing.lattice(kind, sides, seed=seed), np.random.default_rng([decades, seed])
    friction = 10 ** draw.uniform(-decades / 2, decades / 2, packing.contacts)
    found = tb.solve(tb.Packing(**packing.arrays() | {"friction": friction}))
    assert found.gap <= gap
    assert found.states_proven or decades == 24


STILL = {
    "discs that turn alike": lambda: tb.Packing.lattice("square", (4, 5), seed=1, spin_top=1.0, spin_bottom=1.0),
    "spheres that turn alike": lambda: tb.Packing.lattice("bcc", (3, 3, 3), seed=1, spin_top=0.3, spin_bottom=0.3),
    "a loose chain": lambda: random_chain(3),
    "nothing joins them": lambda: chain(np.array([1.0, 0.0, 1.0]), 2),
}


def test_contacts_that_rest_at_their_limit_get_other_forces_below_it(monkeypatch):
    """In seed 0 five resting contacts close loops, and springs leave them at the limit of their friction."""
    packing = tb.Packing.lattice("bcc", (10, 10, 10), seed=0)
    inside = tb.solve(packing)
    assert inside.states_proven
    monkeypatch.setattr(multipliers, "moved_inside", lambda *given: given[3])
    at_limit = tb.solve(packing)
    assert at_limit.undecided > 0
    assert inside.lower_bound <= at_limit.power
    assert at_limit.lower_bound <= inside.power


@pytest.mark.parametrize("tolerance", [1e-3, 1e-8])
@pytest.mark.parametrize(
    "packing",
    [
        tb.Packing.lattice("bcc", (5, 5, 5), seed=1),  # oblique normals
        tb.Packing.lattice("cubic", (5, 5, 5), seed=1),
        tb.Packing.random(300, seed=2),
        tb.Packing.together([tb.Packing.lattice("triangular", (6, 6), seed=seed) for seed in range(3)]),
        tb.Packing.lattice("diamond", (3, 3, 3), seed=1, law="coulomb-viscous"),
    ],
    ids=["bcc", "cubic", "random", "discs", "damped"],
)
def test_a_packing_whose_states_are_not_asked_for_ends_once_its_power_is_certified(packing, tolerance):
    method = tb.InteriorPoint(settle=False)
    whole, quick = tb.solve(packing, "interior-point"), tb.solve(packing, method, tolerance=tolerance)
    assert set(np.ravel(quick.status)) == {"certified"}
    assert (np.array(quick.gap) <= tolerance).all()
    assert (quick.solution.objective >= whole.solution.lower_bound).all()
    assert (quick.solution.lower_bound <= whole.solution.objective).all()
    assert np.max(quick.iterations) < np.max(whole.iterations) + (tolerance < 1e-3) * 2  # small samples settle early
    assert not quick.solution.proven[quick.solution.state != 3].any()


def random_chain(free):
    """Spheres of any radii in a crooked row between two driven ones: more spins than slips."""
    draw = np.random.default_rng(7)
    radius, vector = draw.uniform(0.5, 2, free + 2), draw.normal(size=(free + 1, 3))
    normal = vector / np.linalg.norm(vector, axis=1)[:, None]
    center = np.cumsum(np.vstack([np.zeros(3), normal * (radius[1:] + radius[:-1])[:, None]]), axis=0)
    driven, spin = np.append(np.append(0, np.full(free, -1)), 1), np.zeros((free + 2, 3))
    spin[0], spin[-1] = draw.normal(size=(2, 3))
    contact = np.column_stack([np.arange(free + 1), np.arange(1, free + 2)])
    return tb.Packing(center, contact, driven, spin, radius=radius, normal=normal, friction=np.ones(free + 1))


@pytest.mark.parametrize("name", STILL)
@pytest.mark.parametrize("method", ["auto", "interior-point", "gradient-descent"])
def test_where_no_slip_is_needed_power_bound_and_gap_are_0(name, method):
    packing = STILL[name]()
    found = tb.solve(packing, method=method)
    assert (found.power, found.lower_bound, found.gap, found.status) == (0.0, 0.0, 0.0, "certified")
    acts = (packing.driven[packing.contact] < 0).any(axis=1) & (packing.friction > 0)
    assert packing.slip_speeds(found.spin)[acts].max() < 1e-15
    assert (found.state[acts] == 0).all()
    assert found.states_proven
    assert any("the least power is 0" in sentence for sentence in found.warnings)


@pytest.mark.parametrize("method", ["auto", "gradient-descent", "cundall-strack"])
def test_a_packing_in_which_nothing_is_driven_says_so(method):
    packing = tb.Packing.lattice("triangular", (3, 4), seed=2)
    packing = tb.Packing(**packing.arrays() | {"driven": np.full(packing.spheres, -1)})
    found = tb.solve(packing, method=method)
    assert found.power == 0
    assert found.warnings == ["the least power is 0: no sphere is driven"]


def test_a_packing_whose_solve_ended_early_says_so():
    packing = tb.Packing.lattice("triangular", (4, 5), seed=2)
    found = tb.solve(packing, method="gradient-descent", iterations=20)
    assert found.gap > 1e-6
    words = f"the limit of iterations came with a proven gap of {found.gap:.1e}; the tolerance is 1e-08"
    assert words in found.warnings


def test_power_that_may_be_mere_rounding_is_not_certified_and_says_why():
    """A bearing state of a bcc lattice that dilates, of rounded normals: nearly without slip, and not proven to be."""
    alike = (0.0, 0.0, 0.0, 0.2)
    found = tb.solve(tb.Packing.lattice("bcc", (3, 3, 4), seed=1, top=alike, bottom=alike))
    assert 0 < found.power < 1e-11
    assert found.gap == (found.power - found.lower_bound) / found.power > 1e-8
    assert found.status == "stalled"
    assert any("may be that of rounding alone" in sentence for sentence in found.warnings)


def test_a_motion_that_has_died_out_is_at_rest_and_not_certified():
    """Its power is what its last slips dissipate, of which no bound can be a part."""
    packing = tb.Packing.lattice("square", (4, 5), seed=1, spin_top=1.0, spin_bottom=1.0)
    found = tb.solve(packing, method="cundall-strack", start="random")
    assert found.status == "stationary"
    assert found.power > 0
    assert (found.lower_bound, found.gap) == (0.0, 1.0)
