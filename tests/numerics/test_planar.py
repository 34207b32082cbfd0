"""Minimum cuts of planar grids against counting all of them, and against scipy's maximum flow; ties, exactly."""

from fractions import Fraction
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.ndimage import label

from taichi_bearings.numerics.planar import MinimumCuts, minimum_cuts
from taichi_bearings.solvers.grid_cuts import ring_cuts
from tests.cuts import all_cuts
from tests.exact_interfaces import contacts, lightest, slipping_in_some_and_every
from tests.scenes import some_of


def cuts_of(sideways, upward):
    """The cuts of all bundles as one."""
    parts = [cuts for _, cuts in minimum_cuts(sideways, upward)]
    fields = MinimumCuts.__dataclass_fields__
    return MinimumCuts(*(np.concatenate([getattr(cuts, name) for cuts in parts]) for name in fields))


def random_weights(columns, rows, seed, batch=1, decades=1.0):
    rng = np.random.default_rng(seed)
    shapes = (batch, columns - 1, rows), (batch, columns, rows - 1)
    sideways, upward = (10.0 ** rng.uniform(-decades, 0, shape) for shape in shapes)
    sideways[..., 0] = sideways[..., -1] = 0
    return sideways, upward


def weight_of(above, sideways, upward):
    """Weight of the interface of one grid, sides (w, h)."""
    return sideways[np.diff(above, axis=0)].sum() + upward[np.diff(above, axis=1)].sum()


def all_interfaces(sideways, upward):
    """Weight and sides of every choice of sides that leaves both in one piece, lightest first."""
    _, columns, gaps = upward.shape
    found = []
    for choice in product([False, True], repeat=columns * (gaps - 1)):
        above = np.zeros((columns, gaps + 1), dtype=bool)
        above[:, 1:-1] = np.reshape(choice, (columns, gaps - 1))
        above[:, -1] = True
        if label(above)[1] == label(~above)[1] == 1:
            found.append((weight_of(above, sideways[0], upward[0]), above))
    return sorted(found, key=lambda entry: entry[0])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("columns", "rows"), [(3, 4), (2, 6), (8, 3), (3, 5)])
def test_least_and_next_weight_are_those_of_all_interfaces(columns, rows, seed):
    sideways, upward = random_weights(columns, rows, seed, decades=2.0)
    (least, above), (second, _), *_ = all_interfaces(sideways, upward)
    cuts = cuts_of(sideways, upward)
    assert cuts.weight[0] == pytest.approx(least, rel=1e-14)
    assert cuts.next_weight[0] == pytest.approx(second, rel=1e-14)
    assert cuts.unique[0]
    assert (cuts.above[0] == above).all()


@cache
def interfaces(columns, rows):
    """Sides (K, w, h) of all interfaces that leave either side in one piece, and the contacts (K, n) of each."""
    even = np.ones((1, columns - 1, rows)), np.ones((1, columns, rows - 1))
    sides = np.array([above for _, above in all_interfaces(*even)])
    contacts = [np.diff(sides, axis=axis).reshape(len(sides), -1) for axis in (1, 2)]
    return sides, np.concatenate(contacts, axis=1)


def exact(sideways, upward):
    """Weights (n,) of one grid as Python's whole numbers, in one unit."""
    return np.array([int(Fraction(w) * 2**1074) for w in np.append(sideways, upward)], dtype=object)


def check_against_all_interfaces(sideways, upward):
    """Everything that is said of ties, grid by grid; returns how many grids have any."""
    cuts = cuts_of(sideways, upward)
    columns, gaps = upward.shape[1:]
    sides, contacts = interfaces(columns, gaps + 1)
    for n in range(len(upward)):
        weights = contacts.astype(object) @ exact(sideways[n], upward[n])
        lightest = weights == weights.min()
        assert any((cuts.above[n] == above).all() for above in sides[lightest])
        some, every = contacts[lightest].any(axis=0), contacts[lightest].all(axis=0)
        tied = np.append(cuts.sideways_tied[n], cuts.upward_tied[n])
        assert (tied == some & ~every).all()
        assert cuts.tied[n] == tied.sum()
        assert cuts.unique[n] == (lightest.sum() == 1)
        assert (cuts.next_weight[n] > cuts.weight[n]) == cuts.unique[n]
        second = float(Fraction(np.partition(weights, 1)[1], 2**1074))
        assert cuts.next_weight[n] == pytest.approx(second, rel=1e-13)
    return int((~cuts.unique).sum())


NEAR_ONE = 1 + np.spacing(1.0) * np.arange(3)
TIE_RICH = {
    "whole": [1.0, 2.0, 3.0],
    "dyadic": [0.5, 1.0],
    "decimal": [0.1, 1.0],
    "tenths": [0.1, 0.2, 0.3, 0.1 + 0.2],
    "last digits": NEAR_ONE,
    "five decades": [1e-5, 0.1, 0.1 + 1e-5, 0.2],
    "lost digits": [1.0, 1e-17, 3e-17, 1e-34, 3e-34],
    "far apart": [1.0, 2.0, 2.0**-60, 2.0**-59, 2.0**-120, 3 * 2.0**-120, 2.0**-400],
}


@pytest.mark.parametrize("values", TIE_RICH.values(), ids=TIE_RICH)
@pytest.mark.parametrize(("columns", "rows"), [(2, 4), (3, 3), (3, 4), (4, 4), (5, 3)])
def test_ties_are_those_of_all_interfaces_exactly(columns, rows, values):
    rng = np.random.default_rng(29)
    sideways, upward = (rng.choice(values, shape) for shape in ((60, columns - 1, rows), (60, columns, rows - 1)))
    sideways[..., 0] = sideways[..., -1] = 0
    assert check_against_all_interfaces(sideways, upward) > 0


def level_cuts(*levels, sideways=1e3):
    """The cut of a grid in which it does not pay to change the level; levels : weights (w,) from the bottom up."""
    upward = np.stack(levels, axis=-1)[None]
    return cuts_of(np.full((1, upward.shape[1] - 1, upward.shape[2] + 1), sideways), upward)


def test_ten_tenths_are_more_than_one():
    """In binary, 0.1 is a little more than a tenth: the other level weighs 1 exactly, and less."""
    tenths, one = np.full(10, 0.1), np.array([*[1 / 16] * 9, 7 / 16])
    assert sum(map(Fraction, tenths)) > sum(map(Fraction, one)) == 1
    for levels, level in [((tenths, one), 1), ((one, tenths), 0)]:
        cuts = level_cuts(*levels)
        assert cuts.unique[0]
        assert np.diff(cuts.above[0], axis=1)[:, level].all()
        assert cuts.next_weight[0] > cuts.weight[0]


@pytest.mark.parametrize("columns", [2_000, 20_000])
def test_what_rounding_takes_from_many_contacts_decides_nothing(columns):
    """Rounded to the unit, one level is lighter by half a unit a contact; with what rounding took, it is heavier."""
    unit = 2.0 ** (int(columns).bit_length() - 52)
    heavier, lighter = np.full(columns, 1 + 0.99 * unit), 1 + unit * (np.arange(columns) % 2)
    assert sum(map(Fraction, heavier)) > sum(map(Fraction, lighter))
    assert np.floor(heavier / unit).sum() < np.floor(lighter / unit).sum()
    for levels, level in [((heavier, lighter), 1), ((lighter, heavier), 0)]:
        cuts = level_cuts(*levels)
        assert cuts.unique[0]
        assert np.diff(cuts.above[0], axis=1)[:, level].all()


def test_a_last_digit_among_many_decides():
    rng = np.random.default_rng(31)
    level = rng.uniform(0.1, 1.0, 20_000)
    other, equal = rng.permutation(level), rng.permutation(level)
    tie = level_cuts(level, other, equal)
    assert not tie.unique[0]
    assert tie.tied[0] == 3 * 20_000
    assert tie.next_weight[0] == tie.weight[0]
    level[777] = np.nextafter(level[777], 1)
    two = level_cuts(level, other, equal)
    assert two.upward_tied[0].all(axis=0).tolist() == [False, True, True]
    assert two.tied[0] == 2 * 20_000
    equal[778] = np.nextafter(equal[778], 0)
    one = level_cuts(level, other, equal)
    assert one.unique[0]
    assert np.diff(one.above[0], axis=1)[:, 2].all()


def test_a_tie_in_one_place_leaves_the_rest_of_the_cut_in_no_doubt():
    rng = np.random.default_rng(37)
    level, heavy = rng.uniform(0.1, 1.0, 5_000), np.full(5_000, 2.0)
    heavy[4_000], level[4_000] = 0.25, 0.75
    cuts = level_cuts(heavy, level, sideways=0.25)  # down, across and up again weigh as much as straight on
    assert cuts.upward_tied[0].nonzero()[0].tolist() == [4_000, 4_000]
    assert cuts.tied[0] == 4


@pytest.mark.parametrize("weight", [0.3, 1.0])
def test_without_disorder_every_level_cut_ties(weight):
    cuts = cuts_of(weight * np.ones((1, 60, 80)), weight * np.ones((1, 61, 79)))
    assert cuts.weight[0] == pytest.approx(61 * weight, rel=1e-13)
    assert not cuts.unique[0]
    assert cuts.upward_tied.all()
    assert not cuts.sideways_tied.any()
    assert cuts.next_weight[0] == cuts.weight[0]


@pytest.mark.parametrize("decades", [1.0, 6.0, 15.0, 30.0])
@pytest.mark.parametrize(("columns", "rows"), [(2, 3), (2, 40), (40, 3), (25, 20)])
def test_flows_balance_and_are_admissible_without_any_rounding(columns, rows, decades):
    sideways, upward = random_weights(columns, rows, 3, batch=3, decades=decades)
    cuts = cuts_of(sideways, upward)
    assert (abs(cuts.sideways_flow) <= sideways).all()
    assert (abs(cuts.upward_flow) <= upward).all()
    pull = np.diff(cuts.upward_flow, axis=2)
    pull[:, :-1] += cuts.sideways_flow[..., 1:-1]
    pull[:, 1:] -= cuts.sideways_flow[..., 1:-1]
    assert (pull == 0).all()
    for n in range(3):
        assert cuts.upward_flow[n, :, 0].sum() == cuts.weight[n]
        least = weight_of(cuts.above[n], sideways[n], upward[n])
        assert least == pytest.approx(cuts.weight[n], rel=1e-14)
        assert cuts.weight[n] <= least * (1 + 1e-15)
    assert (cuts.next_weight >= cuts.weight).all()


@pytest.mark.parametrize("number", some_of(140, 5))
def test_absent_contacts_leave_cuts_and_ties_exact(number):
    """Weights of 0 anywhere, up to a bottom and a top that nothing joins; over thirty decades, too."""
    rng = np.random.default_rng([number, 7])
    columns, rows = [(2, 3), (3, 4), (4, 4), (5, 4), (3, 5), (2, 6), (4, 5)][number % 7]
    draw = [
        lambda shape: rng.integers(1, 4, shape).astype(float),
        lambda shape: 10.0 ** rng.integers(-15, 16, shape),
        lambda shape: rng.choice([0.1, 0.2, 0.3], shape),
        lambda shape: rng.uniform(0.1, 1.0, shape),
    ][number // 7 % 4]
    weight, absent = [draw((columns - 1, rows)), draw((columns, rows - 1))], rng.choice([0.1, 0.3, 0.6])
    for values in weight:
        values[rng.random(values.shape) < absent] = 0.0
    least, expected = all_cuts(weight)
    ((_, cut),) = minimum_cuts(*(values[None] for values in weight))
    for values, (some, every), tied in zip(weight, expected, (cut.sideways_tied, cut.upward_tied), strict=True):
        assert np.array_equal(tied[0], some & ~every & (values > 0))
    sides = [cut.above[0, 1:] != cut.above[0, :-1], cut.above[0, :, 1:] != cut.above[0, :, :-1]]
    assert sum(Fraction(v) for of, cuts in zip(weight, sides, strict=True) for v in of[cuts].tolist()) == least
    assert least * (1 - Fraction(1, 10**12)) <= Fraction(cut.weight[0]) <= least


@pytest.mark.parametrize("number", some_of(150, 5))
def test_ties_of_rings_are_those_that_networkx_finds_in_whole_numbers(number):
    """Grids that close on themselves, with absent contacts and up to thirty decades: cut, bound and all ties."""
    rng = np.random.default_rng([number, 17])
    columns, rows = [(2, 4), (4, 5), (6, 6), (2, 7), (8, 5), (4, 9)][number % 6]
    draw = [
        lambda shape: rng.integers(1, 4, shape).astype(float),
        lambda shape: 10.0 ** rng.integers(-15, 16, shape),
        lambda shape: rng.choice([0.1, 0.2, 0.3], shape),
        lambda shape: np.full(shape, 0.3),
        lambda shape: rng.uniform(0.1, 1.0, shape),
    ][number // 6 % 5]
    weight, absent = [draw((columns, rows)), draw((columns, rows - 1))], rng.choice([0.0, 0.1, 0.3, 0.6])
    for values in weight:
        values[rng.random(values.shape) < absent] = 0.0
    exact = {(a, place): Fraction(v) for a, of in enumerate(weight) for place, v in np.ndenumerate(of)}
    unit = max(value.denominator for value in exact.values())
    whole = {contact: int(value * unit) for contact, value in exact.items()}
    least, expected = (
        lightest((columns, rows), whole, (0,))[0],
        slipping_in_some_and_every((columns, rows), whole, (0,)),
    )
    ((_, cut),) = ring_cuts(*(values[None] for values in weight))
    tied = cut.sideways_tied[0], cut.upward_tied[0]
    for (axis, place), (some, every) in expected.items():
        assert tied[axis][place] == (some and not every)
    assert cut.tied[0] == sum(some and not every for some, every in expected.values())
    above = cut.above[0]
    parted = [(a, place) for a, place, low, high in contacts((columns, rows), (0,)) if above[low] != above[high]]
    assert least == sum(whole[contact] for contact in parted)
    assert Fraction(cut.weight[0]) * unit <= least
