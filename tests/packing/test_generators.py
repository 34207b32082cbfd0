"""Packings that are made: they touch to rounding, overlap nowhere, and are what they are said to be."""

import zlib

import networkx
import numpy as np
import pytest
from scipy.spatial import cKDTree

import taichi_bearings as tb
from taichi_bearings.analysis.topology import topology_of
from taichi_bearings.scene.generators.lattices import KINDS

OVERLAP = 1e-9  # over the sum of the radii


def copies(packing, length):
    """Places with their images across the periodic sides, (n N, D)."""
    lateral = np.stack(np.meshgrid(*[(-1, 0, 1)] * (packing.dimension - 1)), axis=-1).reshape(-1, packing.dimension - 1)
    shift = np.column_stack([lateral * length, np.zeros(len(lateral))])
    return (shift[:, None] + packing.center).reshape(-1, packing.dimension)


def gaps(packing, length):
    """Of all pairs that are near: gap over the sum of the radii, pairs (i, j) with i < j, and unit vectors."""
    places, count = copies(packing, length), packing.spheres
    near = cKDTree(places).query_ball_point(packing.center, packing.radius + packing.radius.max() * 1.1)
    first = np.repeat(np.arange(count), [len(own) for own in near])
    copy = np.concatenate(near).astype(int)
    keep = first < copy % count
    first, copy = first[keep], copy[keep]
    vector = places[copy] - packing.center[first]
    size, reach = np.linalg.norm(vector, axis=1), packing.radius[first] + packing.radius[copy % count]
    return size / reach - 1, np.column_stack([first, copy % count]), vector / size[:, None]


def check_touching(packing, length):
    """Nothing overlaps, and contacts are just the pairs that touch, with their normals."""
    gap, pairs, unit = gaps(packing, length)
    assert gap.min() > -OVERLAP
    touch = np.abs(gap) < OVERLAP
    found = {(*pair, *np.round(n, 6)) for pair, n in zip(pairs[touch].tolist(), unit[touch] + 0.0, strict=True)}
    turned = packing.contact[:, :1] > packing.contact[:, 1:]
    normal = np.where(turned, -packing.normal, packing.normal) + 0.0
    told = {(*sorted(pair), *np.round(n, 6)) for pair, n in zip(packing.contact.tolist(), normal, strict=True)}
    assert {key[:2] for key in told} == {key[:2] for key in found}
    assert len(packing.contact) == touch.sum()


@pytest.mark.parametrize("kind", KINDS)
def test_spheres_of_a_lattice_touch_and_overlap_nowhere(kind):
    check_touching(tb.Packing.lattice(kind, (3, 2, 2)[: len(KINDS[kind].size)], radius=0.7), 1e3)


@pytest.mark.parametrize(("spheres", "dimension", "seed"), [(150, 2, 1), (160, 3, 2)])
def test_random_packings_touch_overlap_nowhere_and_are_isostatic(spheres, dimension, seed):
    width = 10.0 if dimension == 2 else 6.0
    packing = tb.Packing.random(spheres, dimension, width=width, seed=seed)
    check_touching(packing, width)
    floor = int((packing.driven == 0).sum())
    assert packing.contacts == dimension * (spheres - floor)  # each is held by as many as it has ways to move
    free = packing.driven < 0
    assert np.bincount(packing.contact.ravel(), minlength=spheres)[free].min() >= dimension
    again = tb.Packing.random(spheres, dimension, width=width, seed=seed)
    other = tb.Packing.random(spheres, dimension, width=width, seed=seed + 1)
    assert np.array_equal(packing.center, again.center)
    assert np.array_equal(packing.friction, again.friction)
    assert not np.array_equal(packing.center, other.center)
    found = tb.solve(packing)
    assert found.status == "certified"
    assert found.proof == "proven"
    assert 0 < found.power < found.packing.material[0][0].sum() * np.abs(packing.driven_speed).max() * 4


@pytest.mark.parametrize(
    ("options", "contacts"),
    [
        ({"spheres": 400}, 2844425138),
        ({"spheres": 900, "dimension": 2, "ratio": 2.0, "large": 0.3, "seed": 1}, 1282990584),
    ],
    ids=["spheres", "discs"],
)
def test_a_seed_makes_the_same_packing_for_ever(options, contacts):
    """Checksums of contacts that code found which compared every place with all spheres."""
    assert zlib.crc32(tb.Packing.random(**options).contact.astype("<i8").tobytes()) == contacts


def test_a_deep_random_packing_has_the_isostatic_number_of_contacts_inside():
    packing = tb.Packing.random(1500, 3, width=8.0, seed=4)
    height = packing.center[:, 2]
    inside = (height > 0.2 * height.max()) & (height < 0.8 * height.max())
    number = np.bincount(packing.contact.ravel())[inside].mean()
    assert number == pytest.approx(6.0, abs=0.1)
    volume = (4 / 3 * np.pi * packing.radius[inside] ** 3).sum() / (64 * 0.6 * height.max())
    assert 0.57 < volume < 0.65  # between random loose and random close packing


@pytest.mark.parametrize("family", [(0, 0), (0, 1), (1, 1), pytest.param((2, 1), marks=pytest.mark.thorough), (3, 5)])
def test_space_filling_bearings_touch_fill_and_turn_without_slip(family):
    m, n = family
    packing = tb.Packing.space_filling(m, n, 0.01, periods=2)
    share_m, share_n = (np.cos(np.pi / (k + 3)) ** 2 for k in family)
    half = (1 / share_m + 1 / share_n - 1) ** -0.5  # Herrmann, Mantica and Bessis
    check_touching(packing, 4 * half)
    found = topology_of(packing)
    assert found.bipartite
    assert found.all_motions == found.parts  # each part turns in one way
    assert found.parts == 1 or (m, n) not in {(0, 0), (1, 1)}
    open_ = [
        1 - np.pi * (tb.Packing.space_filling(m, n, least).radius ** 2).sum() / (2 * half) for least in (0.005, 0.001)
    ]
    dimension = 2 - np.log(open_[0] / open_[1]) / np.log(5)  # what is open falls as least^(2 - dimension)
    assert 0 < open_[1] < open_[0] < 0.06
    assert 1.3 < dimension < 1.5  # from 1.305... of Apollonius' packing to what the paper finds
    at_top = packing.center[:, 1] + packing.radius > 1 - 1e-12
    assert np.array_equal(at_top, packing.driven == 1)


def test_m_discs_touch_both_the_line_and_the_large_disc():
    """What the numbers of the family mean: D and the upper line have m + 2 discs in common, beside the lower line."""
    for m in (0, 1, 4):
        packing = tb.Packing.space_filling(m, 1, 0.001)
        lower = np.flatnonzero(packing.driven == 0)
        large = lower[np.argmax(packing.radius[lower])]
        ends = packing.contact[(packing.contact == large).any(axis=1)]
        other = ends.sum(axis=1) - large
        assert (packing.driven[other] == 1).sum() == m + 2  # with one period the neighbour is there on both sides


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_frustrated_space_filling_bearing_is_a_minimum_cut(seed):
    """Two large discs that touch discs of the same kind of turning are driven as if they were of one kind."""
    whole = tb.Packing.space_filling(1, 1, 0.01, periods=2, seed=seed)
    kind = np.array([c for _, c in sorted(networkx.bipartite.color(networkx.Graph(whole.contact.tolist())).items())])
    largest = np.argsort(-whole.radius)[:4]
    first = largest[0]
    second = next(i for i in largest if kind[i] != kind[first])
    driven, spin = np.full(whole.spheres, -1), np.zeros(whole.spheres)
    driven[[first, second]], spin[[first, second]] = [0, 1], 1 / whole.radius[[first, second]]
    packing = tb.Packing(whole.center, whole.contact, driven, spin, whole.radius, whole.normal, friction=whole.friction)
    network = networkx.Graph()
    acts = ~(packing.driven[packing.contact] >= 0).all(axis=1)
    for (i, j), weight in zip(packing.contact[acts].tolist(), packing.friction[acts] * 50.0, strict=True):
        held = network.get_edge_data(i, j, {"capacity": 0.0})["capacity"]  # a ring of two has two contacts
        network.add_edge(i, j, capacity=held + weight)
    cut = networkx.minimum_cut_value(network, int(first), int(second))
    found = tb.solve(packing)
    assert found.power == pytest.approx(2 * cut, rel=1e-12)  # staggered surface speeds 1 and -1
    assert found.lower_bound == pytest.approx(found.power, rel=1e-12)


def test_what_cannot_be_made_is_refused():
    for make, words in [
        (lambda: tb.Packing.random(5), "spheres is '5'"),
        (lambda: tb.Packing.random(100, 4), "dimension is 4"),
        (lambda: tb.Packing.random(100, width=2.0), "width is 2"),
        (lambda: tb.Packing.random(100, ratio=0.5), "is 0.5 and large"),
        (lambda: tb.Packing.random(100, stiffness=1), "unknown argument 'stiffness'.*; allowed are "),
        (lambda: tb.Packing.space_filling(-1, 0), "m is '-1'"),
        (lambda: tb.Packing.space_filling(0, 1.5), "n is '1.5'"),
        (lambda: tb.Packing.space_filling(0, 0, 1e-9), "least_radius is 1e-09"),
        (lambda: tb.Packing.space_filling(0, 0, 0.1, radius=2), "radius is given, but the height"),
    ]:
        with pytest.raises(tb.InputError, match=words) as told:
            make()
        assert "\n" not in str(told.value)
