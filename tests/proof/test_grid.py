"""What the proofs find of lattices by slices is what lists of contacts say; large arrays are worked on in parts."""

import itertools

import numpy as np
import pytest

from taichi_bearings.proof.enclosure import IN_CACHE, Enclosure, in_cache
from taichi_bearings.proof.on_lattice import OnLattice
from taichi_bearings.proof.slices import Grid
from taichi_bearings.scene import Scene

REPLICAS = 3
LATTICES = [((3, 4, 5), ()), ((4, 3, 5), (0,)), ((2, 4, 3), (0, 1)), ((4, 5), ()), ((4, 5), (0,))]


def listed(shape, periodic):
    """First and second sphere and axis of each contact, one by one: axis by axis, in C order of the first."""
    number = np.arange(np.prod(shape)).reshape(shape)
    for axis in range(len(shape)):
        for place in itertools.product(*map(range, shape)):
            other = list(place)
            other[axis] += 1
            if other[axis] < shape[axis] or axis in periodic:
                other[axis] %= shape[axis]
                yield number[place], number[tuple(other)], axis


@pytest.fixture(params=LATTICES, ids=str)
def case(request):
    """A grid, and its contacts one by one, sample after sample: first sphere, second sphere, axis."""
    shape, periodic = request.param
    rng, cubic = np.random.default_rng(len(shape)), (3,) * (len(shape) == 3)
    sizes = [tuple(n - (a == b and a not in periodic) for b, n in enumerate(shape)) for a in range(len(shape))]
    scene = Scene(
        tuple(rng.random((REPLICAS, *size)) + 0.1 for size in sizes), direction=(1.0, 2.0, 3.0), normal_force=1.0,
        radius=1.0, periodic=tuple("xyz"[axis] for axis in periodic),
    )  # fmt: skip
    spin = rng.standard_normal((REPLICAS, *shape, *cubic))
    friction = rng.standard_normal((REPLICAS, scene.lattice.all_contacts, *cubic))
    samples = OnLattice(scene, spin, 1e-18 * spin, friction)
    one = np.array(list(listed(shape, periodic))).T
    count = np.array([[np.prod(shape)], [np.prod(shape)], [0]])
    return Grid(samples), np.concatenate([one + r * count for r in range(REPLICAS)], axis=1)


def test_contacts_are_where_lists_have_them(case):
    grid, (first, second, axis) = case
    np.testing.assert_array_equal(grid.contact, [first, second])
    np.testing.assert_array_equal(grid.normal, np.eye(grid.samples.lattice.dimension)[axis])
    mask = np.random.default_rng(0).random(grid.spheres) < 0.5
    np.testing.assert_array_equal(grid.any_end(mask), mask[first] | mask[second])


def test_moments_and_torques_are_sums_over_contacts(case):
    grid, (first, second, axis) = case
    acts = np.random.default_rng(1).random(grid.contacts) < 0.7
    friction = grid.samples.friction.reshape(grid.contacts, -1) / grid.samples.force_unit
    normal = np.eye(grid.samples.lattice.dimension)[axis]
    turned = friction if grid.samples.lattice.dimension == 2 else np.cross(normal, friction)
    moments = grid.moment(acts)
    for part, expected in zip(moments, np.where(acts[:, None], turned, 0.0).T, strict=True):
        np.testing.assert_array_equal(part.high, expected)
    for part, torque in zip(moments, grid.torques(moments), strict=True):
        expected = np.zeros(grid.spheres)
        for end in (first, second):
            np.add.at(expected, end, part.high)
        np.testing.assert_allclose(torque.value, expected, rtol=0, atol=1e-14)


def test_slips_are_lengths_of_differences_across_contacts(case):
    grid, (first, second, axis) = case
    spin = list(grid.samples.signed_spin.values())
    shift = [Enclosure.exact(1e-20 * (np.arange(grid.spheres) % 5 == 0)) for _ in spin]
    still = np.arange(grid.contacts) % 7 == 0
    felt = np.array([axis != k for k in grid.samples.components])
    moved = [np.longdouble(a.high) + a.low + b.high for a, b in zip(spin, shift, strict=True)]
    apart = np.array([part[second] - part[first] for part in moved]) * felt
    found = grid.slips(spin, shift, still)
    np.testing.assert_allclose(found.value, np.sqrt((apart**2).sum(axis=0)).astype(float), rtol=1e-15, atol=1e-18)
    np.testing.assert_array_equal(grid.slips_with, felt)
    alike = [((part.high[first] == part.high[second]) & (part.low[first] == part.low[second])) for part in spin]
    np.testing.assert_array_equal(grid.still(spin), (np.array(alike) | ~felt).all(axis=0))


def test_a_torque_whose_sign_rounding_hides_is_paid_for():
    """It is at least -2^-54, but in doubles the sum of both errors is 1."""
    grid, only = Grid(None), np.ones(1, dtype=bool)
    torque = Enclosure(np.array([1.0]), np.array([-(2.0**-54)]), np.array([1.0]))
    assert grid.power_lost(torque, Enclosure.exact([1.0]), only).high > 0
    surely_above = Enclosure(torque.high, torque.low, np.array([0.5]))
    assert grid.power_lost(surely_above, Enclosure.exact([1.0]), only).high == 0


@pytest.mark.parametrize("shape", [(5 * IN_CACHE + 3,), (2, 3 * IN_CACHE + 1), (3, 7, IN_CACHE), (2 * IN_CACHE, 3, 2)])
def test_large_arrays_are_worked_on_in_parts_with_the_same_bits(shape):
    rng, sizes = np.random.default_rng(2), []
    one, two = (Enclosure.exact(rng.standard_normal(shape), 1e-20 * rng.standard_normal(shape)) for _ in range(2))

    @in_cache
    def made(first, second, factor):
        sizes.append(first.high.size)
        return (first * second - first).times(factor)

    found, factor = made(one, two, np.array([3.0])), np.array([3.0])
    assert len(sizes) > 1
    assert max(sizes) <= 2 * IN_CACHE
    assert sum(sizes) == one.high.size
    for place in rng.integers(one.high.size, size=50):
        first, second = (Enclosure(*(part.reshape(-1)[place : place + 1] for part in of.parts)) for of in (one, two))
        for part, expected in zip(found.parts, made(first, second, factor).parts, strict=True):
            assert part.reshape(-1)[place] == expected[0]
