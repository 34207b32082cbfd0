"""The interface of two rigid domains as contacts: hand-made surfaces, its power, and what slips at a minimum."""

from itertools import product

import networkx as nx
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.analysis.structure import find_interface
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS, Quantity
from taichi_bearings.solvers import PlanarCut
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.own_laws import Bounded, PowerLaw
from tests.scenes import SIMPLE_LAWS, make_scene


def carved(above, law="coulomb", **driving):
    """A scene whose contacts are weak exactly where the two sides N meet."""
    coefficient = tuple(np.where(np.diff(above, axis=axis), 0.01, 1.0)[None] for axis in range(above.ndim))
    return Scene(coefficient, law, **driving)


def overhanging():
    """A surface over 4x5 columns of 6 spheres at varied height, with one sphere that juts out sideways."""
    height = np.random.default_rng(2).integers(2, 4, (4, 5))
    above = np.arange(6) >= height[..., None]
    above[1, 2] = [False, False, False, False, True, True]
    above[2, 2] = [False, False, True, False, True, True]
    above[3, 2] = [False, False, True, True, True, True]
    return above


@pytest.mark.parametrize("law", SIMPLE_LAWS)
@pytest.mark.parametrize("above", [overhanging(), overhanging()[1]], ids=["3D", "2D"])
def test_a_carved_surface_is_found_with_its_power(above, law):
    scene = carved(above, law, spin_top=0.7, spin_bottom=-0.5, normal_force=3.0)
    found = find_interface(scene)
    assert (found.above == above).all()
    for axis, contacts in enumerate(scene.lattice.by_axis(found.contacts)):
        assert (contacts == np.diff(above, axis=axis)).all()
    across = [0.5, 0.5, 1.0] if above.ndim == 3 else [1.0, 1.0]  # |d x n|^2
    sizes = [int(contacts.sum()) for contacts in scene.lattice.by_axis(found.contacts)]
    if law == "coulomb":
        expected = 3.0 * 0.5 * 1.2 * 0.01 * sum(np.sqrt(part) * size for part, size in zip(across, sizes, strict=True))
    else:
        expected = (0.5 * 1.2) ** 2 * 0.01 * sum(part * size for part, size in zip(across, sizes, strict=True))
    assert found.power == pytest.approx(expected, rel=1e-13)
    assert found.lower_bound == pytest.approx(expected, rel=1e-13)
    assert found.contacts.sum() == sum(sizes)
    assert not found.between.any()


def test_contacts_along_the_driven_axis_cost_nothing_and_do_not_slip():
    scene = make_scene((4, 3, 5), direction=(1, 0, 0))
    found = find_interface(scene)
    assert np.diff(found.above, axis=0).any()
    assert not scene.lattice.by_axis(found.contacts)[0].any()
    assert np.array_equal(scene.slips(*start_of(scene))[0] > 0, found.contacts)


def start_of(scene):
    axes = scene.lattice.all_spin_axes
    return scene.staggered_spin(initial_spin(scene, "minimum-cut"), axes), axes


@pytest.mark.parametrize("law", SIMPLE_LAWS)
def test_the_interface_is_what_slips_at_the_minimum_cut_start_of_any_sample(law):
    scene = make_scene((3, 4, 5), law, seeds=(5, 6))
    slips, power = scene.slips(*start_of(scene)), scene.power(*start_of(scene))
    for replica in range(2):
        found = find_interface(scene, replica)
        assert np.array_equal(slips[replica] > 0, found.contacts)
        assert found.power == pytest.approx(power[replica], rel=1e-13)


def test_equal_coefficients_tie():
    for shape in ((4, 5), (3, 4, 5)):
        scene = make_scene(shape, distribution="constant:0.3")
        found = find_interface(scene)
        assert found.contacts.sum() == np.prod(shape[:-1])
        assert found.between[..., 1:-1].all()
    flat = find_interface(make_scene((4, 5), distribution="constant:0.3"))
    assert flat.next_over == pytest.approx(1.0, rel=1e-15)


def test_planar_minima_slip_at_the_interface_alone():
    scene = make_scene((9, 8), seeds=range(5))
    solution = solve(scene, PlanarCut().build(), initial_spin(scene, "zero"), StopRule(1e-12))
    for replica in range(5):
        slipping = solution.state[replica] == ContactState.SLIPPING
        found = find_interface(scene, replica)
        assert np.array_equal(slipping, found.contacts)
        assert solution.power[replica] == pytest.approx(found.power, rel=1e-13)
        ratio = solution.findings["next_cut_over_minimum"][replica]
        assert found.next_over == pytest.approx(ratio, rel=1e-13)


OWN_LAWS = {
    "bounded": Bounded("bounded", (Quantity("damping", "force*time/length"),), minimises="potential"),
    "cubic": PowerLaw("cubic", (Quantity("damping", "force*time^3/length^3"),), share=4.0),
}


@pytest.fixture
def own_laws(monkeypatch):
    for name, law in OWN_LAWS.items():
        monkeypatch.setitem(LAWS, name, law)


def surfaces(shape):
    """Every division of the free spheres into those that turn with the bottom and those that turn with the top."""
    *sides, height = shape
    for bits in product((False, True), repeat=int(np.prod(sides)) * (height - 2)):
        above = np.zeros(shape, dtype=bool)
        above[..., -1], above[..., 1:-1] = True, np.reshape(bits, (*sides, height - 2))
        yield above


def in_one_piece(above):
    """True if the spheres above and those below are one piece each."""
    grid = nx.grid_graph(above.shape[::-1])
    return all(nx.is_connected(grid.subgraph(map(tuple, np.argwhere(side).tolist()))) for side in (above, ~above))


@pytest.mark.parametrize("law", [*LAWS, *OWN_LAWS])
def test_lightest_and_second_lightest_surface_of_discs_are_those_of_all_that_there_are(law, own_laws):
    scene = make_scene((3, 4), law, spin_top=1.3, spin_bottom=-0.4, normal_force=3.0, radius=0.7)
    slip, weights, powers = np.full(scene.coefficient.shape, 0.7 * 1.7), [], []
    objective, power = scene.law.objective(scene.material, slip)[0], scene.law.power(scene.material, slip)[0]
    for above in filter(in_one_piece, surfaces((3, 4))):
        low, high = above.ravel()[scene.lattice.ends]
        weights.append(objective[low != high].sum())
        powers.append(power[low != high].sum())
    first, second = np.argsort(weights)[:2]
    found = find_interface(scene)
    assert found.power == pytest.approx(powers[first], rel=1e-13)
    assert found.lower_bound == pytest.approx(weights[first], rel=1e-13)
    assert found.next_over == pytest.approx(weights[second] / weights[first], rel=1e-13)


@pytest.mark.parametrize("law", [*LAWS, *OWN_LAWS])
def test_the_surface_of_spheres_whose_imposed_spins_grow_is_the_lightest_of_all(law, own_laws):
    driving = {"top": (0.3, -0.2, 0.1, 2.0), "bottom": (0.0, 0.1, 0.0, 0.5)}
    scene = make_scene((2, 3, 4), law, normal_force=3.0, radius=0.7, **driving)
    x, y = np.indices((2, 3, 4))[:2] * 2 * 0.7
    jump = np.stack([0.3 + 1.5 * x, -0.3 + 1.5 * y])  # without its component along the height
    axis, low = scene.lattice.axis, scene.lattice.ends[0]
    lateral = jump.reshape(2, -1)[:, low]
    slip = 0.7 * np.where(axis == 0, abs(lateral[1]), np.where(axis == 1, abs(lateral[0]), np.hypot(*lateral)))
    objective = scene.law.objective(scene.material, slip[None])[0]
    sides = [above.ravel()[scene.lattice.ends] for above in surfaces((2, 3, 4))]
    least = min(objective[low != high].sum() for low, high in sides)
    found = find_interface(scene)
    assert found.lower_bound == pytest.approx(least, rel=1e-12)
    assert objective[found.contacts].sum() == pytest.approx(least, rel=1e-12)


def test_a_cut_that_is_unique_by_the_last_digit_is_the_lightest_one():
    """Two rings of two discs each: 0.25 and 0.25 (1 + 2^-52) with 1 each add up to the same double, not to the same
    number. The lighter pair is the only minimum, and the one that slips."""
    more = float(np.nextafter(0.25, 1.0))
    x = np.array([[0.25, 0.25, 0.25, 0.25], [1.0, 1.0, 0.5, 1.0]])
    y = np.array([[more, 1.0, 1.0], [1.0, 1.0, 0.25]])
    best = tb.solve(tb.Scene(coefficients=(x, y), periodic=("x",)), threads=1)
    numbers = tb.analyse(best).structure.numbers
    assert best.minimum_is_unique
    assert numbers["cut_is_unique"]
    assert numbers["slipping_contacts_are_the_cut"]
    assert sum(int((of == ContactState.SLIPPING).sum()) for of in best.state) == 2


@pytest.mark.parametrize("value", [0.1, 0.3, 0.7])
@pytest.mark.parametrize("shape", [(2, 4), (3, 4), (4, 4), (3, 5)])
def test_the_second_lightest_cut_is_never_lighter_than_the_lightest(shape, value):
    """With equal friction everywhere many cuts tie, whatever the rounding of the sums of their weights."""
    found = find_interface(Scene.random(shape, seed=0, distribution=f"constant:{value}"))
    assert not found.unique
    assert found.next_over == 1.0
