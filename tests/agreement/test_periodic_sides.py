"""Sides that close on themselves: against rings, flows, free lattices, and the symmetry that free sides break."""

from functools import partial

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
solve = partial(tb.solve, threads=1)
LATTICES = [((6, 5), "x"), ((2, 4), "x"), ((4, 3, 4), "x"), ((3, 2, 4), "y"), ((4, 4, 4), "x,y"), ((2, 2, 3), "x,y")]


SAME = 1e-12  # relative


def shortest_ring(sideways, upward):
    """Least weight of the contacts that a closed walk around the lattice crosses; the walk is unrolled five times."""
    columns, gaps = upward.shape
    turns, edges = 5, []

    def face(column, gap):  # to the right of a column of spheres
        return column * gaps + gap

    for column in range(turns * columns):
        here = column % columns
        if column:
            edges += [(face(column - 1, gap), face(column, gap), upward[here, gap]) for gap in range(gaps)]
        edges += [(face(column, gap - 1), face(column, gap), sideways[here, gap]) for gap in range(1, gaps)]
    first, second, weight = (np.array(part) for part in zip(*edges, strict=True))
    nodes = turns * columns * gaps
    graph = coo_array((weight, (first, second)), shape=(nodes, nodes)).tocsr()
    start = [face(2 * columns, gap) for gap in range(gaps)]
    distance = dijkstra(graph, directed=False, indices=start)
    return min(distance[gap, face(3 * columns, gap)] for gap in range(gaps))


def differences(scene):
    """Relative distances of the power and of the lower bound from the truth."""
    best = tb.solve(scene, threads=1)
    truth = scene.normal_force * scene.lattice.radius * scene.jump * shortest_ring(*scene.coefficients)
    return [abs(said / truth - 1) for said in (best.power, best.lower_bound)]


@pytest.mark.parametrize(("shape", "seeds"), [((10, 10), 20), ((2, 5), 5), ((4, 4), 5)], ids=str)
def test_the_cut_of_discs_is_the_shortest_ring(shape, seeds, thorough):
    for seed in range(50 * seeds if thorough else seeds):
        assert max(differences(Scene.random(shape, seed=seed, periodic=("x",)))) <= SAME, seed


def without_seam(values, axis, periodic):
    """The values of a lattice that is open there."""
    return np.delete(values, -1, axis) if "xyz"[axis] in periodic else values


@pytest.mark.parametrize(("shape", "periodic"), LATTICES, ids=str)
def test_where_the_seam_is_absent_nothing_is_periodic(shape, periodic):
    """Contacts without friction across the seam: the same power and states as without them."""
    state = {} if len(shape) == 2 else {"top": (1.0, 0.5, 0.0, 0.1)}
    closed = [np.array(values) for values in Scene.random(shape, seed=6, periodic=periodic, **state).coefficients]
    for axis in map("xyz".index, periodic.split(",")):
        np.moveaxis(closed[axis], axis, 0)[-1] = 0.0
    opened = [without_seam(values, axis, periodic) for axis, values in enumerate(closed)]
    first, second = solve(Scene(tuple(closed), periodic=periodic, **state)), solve(Scene(tuple(opened), **state))
    assert first.power == pytest.approx(second.power, rel=1e-13)
    assert second.states_proven
    for axis, (one, other) in enumerate(zip(first.state, second.state, strict=True)):
        own = without_seam(one, axis, periodic)
        assert ((own == other) | ((own == ContactState.UNDECIDED) & (len(shape) == 3))).all()


@pytest.mark.parametrize(("shape", "periodic"), LATTICES, ids=str)
def test_it_does_not_matter_where_the_ring_begins(shape, periodic):
    """A sample that is shifted by two spheres has its own answer, shifted; C then changes A."""
    scene = Scene.random(shape, seed=7, periodic=periodic)
    for name in periodic.split(","):
        axis = "xyz".index(name)
        shifted = Scene(tuple(np.roll(values, 2, axis) for values in scene.coefficients), periodic=periodic)
        first, second = solve(scene), solve(shifted)
        assert first.power == pytest.approx(second.power, rel=1e-13)
        for one, other in zip(first.state, second.state, strict=True):
            assert (np.roll(one, 2, axis) == other).all()


@pytest.mark.parametrize(
    ("shape", "periodic", "sentence"),
    [
        ((5, 6), "x", "has 5 spheres; the number must be even"),
        ((4, 6), "y", "can only be x"),
        ((4, 4, 4), "z", "among x, y, each once"),
        ((4, 4, 4), "x,x", "among x, y, each once"),
        ((4, 4, 4), 5, "periodic is 5; it must be names of axes"),
    ],
)
def test_sides_that_cannot_close_are_refused(shape, periodic, sentence):
    with pytest.raises(InputError, match=sentence):
        Scene.random(shape, periodic=periodic)
