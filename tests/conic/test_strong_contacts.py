"""Friction over 24 decades: strong contacts count as weaker ones that a cut cannot overload either."""

from fractions import Fraction

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.conic.strong_contacts import weakened
from taichi_bearings.lattice import Lattice
from tests.scenes import some_of

WIDE = "power-law:1e-12,1e12,-1"


def least_cut(shape, friction):
    """Least sum of friction, in fractions, between the lowest and the highest plane, of spheres that turn about
    x: contacts along x join nothing. friction : by axis."""
    networkx = pytest.importorskip("networkx")
    graph, height = networkx.Graph(), shape[2] - 1
    name = lambda site: "bottom" if site[2] == 0 else "top" if site[2] == height else site  # noqa: E731
    for axis in (1, 2):
        for site, value in np.ndenumerate(friction[axis]):
            ends = site, tuple(int(k == axis) + place for k, place in enumerate(site))
            pair = tuple(name(end) for end in ends)
            if pair[0] != pair[1]:
                known = graph.get_edge_data(*pair, {"capacity": Fraction(0)})["capacity"]
                graph.add_edge(*pair, capacity=known + Fraction(float(value)))
    return networkx.maximum_flow_value(graph, "bottom", "top")


@pytest.mark.parametrize("seed", some_of(40, 4))
def test_weaker_contacts_have_the_same_least_cut(seed):
    shape = (2, 4, 5)
    scene = tb.Scene.random(shape, seed=seed, distribution=WIDE)
    system = lattice_system(Lattice(shape, 0.5), (0,), np.ones(1))
    whole = np.concatenate([part.ravel() for part in scene.coefficients])
    less = whole.copy()
    less[system.contact] = weakened(system, whole[system.contact])
    assert (less <= whole).all()
    assert (less < whole).any()
    sizes = np.cumsum([part.size for part in scene.coefficients])[:-1]
    parts = [part.reshape(own.shape) for part, own in zip(np.split(less, sizes), scene.coefficients, strict=True)]
    assert least_cut(shape, parts) == least_cut(shape, scene.coefficients)


def test_friction_of_some_decades_stays_as_it_is():
    system = lattice_system(Lattice((3, 4, 5), 0.5), (0, 1), np.ones(2))
    friction = 10 ** np.random.default_rng(0).uniform(-1.5, 1.4, len(system.contact))
    assert weakened(system, friction) is friction
    uneven = np.linspace(1, 2, 12).reshape(1, 3, 4) * np.ones((2, 1, 1))  # what is imposed on the top
    wide = friction**9
    assert weakened(lattice_system(Lattice((3, 4, 5), 0.5), (0, 1), uneven), wide) is wide


@pytest.mark.parametrize("seed", some_of(40, 4))
def test_power_over_24_decades_is_that_of_the_cut(seed):
    shape = (2, 4, 5)
    scene = tb.Scene.random(shape, seed=seed, distribution=WIDE, direction=(1, 0, 0))
    found = tb.solve(scene, threads=1)
    least = float(least_cut(shape, scene.coefficients)) * scene.normal_force * scene.lattice.radius
    assert found.lower_bound <= least * (1 + 1e-14)
    assert found.power >= least * (1 - 1e-14)
    assert found.iterations < 200
    if found.status == "certified":
        assert found.power == pytest.approx(least, rel=1e-8)


def test_minima_over_24_decades_end_soon():
    """Where the path cannot be followed to a proof, splitting does not go on for what it cannot find."""
    found = [tb.solve(tb.Scene.random((3, 4, 5), seed=seed, distribution=WIDE), threads=1) for seed in range(12)]
    assert sum(answer.status == "certified" for answer in found) >= 6
    assert all(answer.gap < 1e-5 and answer.iterations <= 200 for answer in found)
