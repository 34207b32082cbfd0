"""The structure of lattices whose sides close on themselves: the same wherever the ring is cut open."""

import itertools
from functools import partial

import numpy as np
import pytest
from matplotlib.collections import LineCollection

import taichi_bearings as tb
from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.lattice import Lattice
from taichi_bearings.plots.lattice import broken, draw_walls, walls_between
from taichi_bearings.plots.style import new_figure
from taichi_bearings.quantities import STRUCTURE
from taichi_bearings.scene import Scene
from tests.analysis.networks import graph_of_spheres

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
solve = partial(tb.solve, threads=1)
RINGS = [((6, 5), "x"), ((2, 4, 4), "x"), ((4, 2, 5), "y"), ((4, 4, 6), "x,y")]
DETERMINED = STRUCTURE.keys() - {"forces"}  # those of slipless contacts are one choice of many
BY_PLACE = {"most_loaded", "planes_crossed"}  # where contacts are; one of several shortest paths


def found_in(scene, threshold):
    return tb.analyse(solve(scene), threshold=threshold).structure


def same(first, second):
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[key], second[key]) for key in first)
    if isinstance(first, list | tuple) and any(isinstance(of, dict) for of in first):
        return len(first) == len(second) and all(map(same, first, second))
    if isinstance(first, str | type(None)):
        return first == second
    return np.asarray(first) == pytest.approx(np.asarray(second), rel=1e-9, abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("threshold", [None, 0.2])
@pytest.mark.parametrize(("shape", "periodic"), RINGS, ids=str)
def test_it_does_not_matter_where_a_ring_is_cut_open(shape, periodic, threshold):
    """Shifted by two spheres, which keeps their signs: every number the same, every array shifted."""
    scene = Scene.random(shape, seed=7, periodic=periodic)
    first = found_in(scene, threshold)
    for axis in map("xyz".index, periodic.split(",")):
        shifted = Scene(tuple(np.roll(values, 2, axis) for values in scene.coefficients), periodic=periodic)
        second = found_in(shifted, threshold)
        for row in itertools.chain(*(STRUCTURE[section] for section in DETERMINED)):
            if row.name not in BY_PLACE:
                assert same(row.of(first), row.of(second)), row.name
        by_axis = scene.lattice.by_axis
        for one, other in zip(*(by_axis(s.interface.contacts) for s in (first, second)), strict=True):
            assert np.array_equal(np.roll(one, 2, axis), other)
        loads = [by_axis(s.network.on_contacts(s.bottlenecks.share)) for s in (first, second)]
        for one, other in zip(*loads, strict=True):
            assert np.roll(one, 2, axis) == pytest.approx(other, abs=1e-12)
        assert np.roll(first.bottlenecks.visits, 2, axis) == pytest.approx(second.bottlenecks.visits, abs=1e-12)
        one, other = (s.domains.domain.ravel() for s in (first, second))
        pairs = set(zip(np.roll(one.reshape(shape), 2, axis).ravel().tolist(), other.tolist(), strict=True))
        assert len(pairs) == first.domains.number == second.domains.number


@pytest.mark.parametrize(("shape", "periodic"), RINGS, ids=str)
def test_a_single_path_may_go_round_the_ring(shape, periodic):
    """From the bottom at one end, over the side, to the top at the other end: two links up, one around, the rest up."""
    axis, height = "xyz".index(periodic[0]), shape[-1]
    lattice = Lattice(shape, periodic=tuple(map("xyz".index, periodic.split(","))))
    slipless = lattice.by_axis(np.zeros(lattice.all_contacts, dtype=bool))
    end = tuple(shape[a] - 1 if a == axis else 0 for a in range(lattice.height_axis))
    slipless[-1][(*end, slice(0, 1))] = True  # up to the first free layer
    slipless[axis][(*end, 1)] = True  # over the side
    slipless[-1][(*(0,) * lattice.height_axis, slice(1, height - 1))] = True
    network = SliplessNetwork(lattice, lattice.flat(slipless))
    path = [(*end, 0), (*end, 1), *((*(0,) * lattice.height_axis, z) for z in range(1, height))]
    assert network.spans
    assert network.shortest_path.tolist() == [list(place) for place in path]
    assert network.disjoint_paths == 1
    trace = broken(network.shortest_path, network.path_steps)
    assert np.isnan(trace).all(axis=1).sum() == 1
    assert np.nanmax(np.linalg.norm(np.diff(trace, axis=0), axis=1)) == 1
    assert np.nanmin(trace) == -0.5
    assert np.nanmax(trace[:, axis]) == shape[axis] - 0.5


def test_two_contacts_of_a_ring_of_two_count_as_two():
    lattice = Lattice((2, 4), periodic=(0,))
    slipless = lattice.by_axis(np.zeros(lattice.all_contacts, dtype=bool))
    slipless[1][0, 0] = slipless[1][1, 1:] = True  # up on the left, then on the right
    slipless[0][:, 1] = True  # both contacts between them
    found = SliplessNetwork(lattice, lattice.flat(slipless))
    assert graph_of_spheres(found).number_of_edges() == len(found.axis) - 1
    assert found.disjoint_paths == 1
    highest = [contacts.tolist() for contacts in lattice.by_axis(found.on_contacts(found.parting_sets[1]))]
    assert highest == [[[False] * 4] * 2, [[False] * 3, [False, False, True]]]


def test_a_wall_at_a_periodic_side_is_drawn_at_both():
    lattice = Lattice((4, 3), periodic=(0,))
    label = np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    walls = walls_between(label, lattice)
    assert [np.argwhere(of).tolist() for of in walls] == [[[0, 1], [3, 1]], [[0, 0], [0, 1]]]
    axes = new_figure(3, 3).add_subplot()
    drawn = draw_walls(axes, walls)
    assert isinstance(drawn, LineCollection)
    assert sorted({tuple(line[:, 0]) for line in drawn.get_segments()[:3]}) == [(-0.5, -0.5), (0.5, 0.5), (3.5, 3.5)]
