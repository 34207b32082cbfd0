"""Contacts with friction and viscosity: the least potential, found by Clarabel in the laboratory frame."""

import itertools

import numpy as np
import pytest

from taichi_bearings.analysis.structure import find_interface
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import METHODS
from tests.properties.truths import least
from tests.scenes import make_scene


def least_potential(scene):
    return float(least(scene).upper)


@pytest.mark.parametrize(("seed", "method"), [(0, "gradient-descent"), (1, "cundall-strack")])
@pytest.mark.parametrize("shape", [(5, 6), (3, 4, 5)], ids=str)
def test_methods_end_at_the_least_potential(method, seed, shape, precision):
    tolerance = 2e-5 if precision == "f64" else 3e-3
    scene = make_scene(shape, "coulomb-viscous", (seed,), viscosity="uniform:5,60", spin_bottom=0.2)
    least = least_potential(scene)
    stop = StopRule(tolerance, 400_000)
    solution = solve(scene, METHODS[method]().build(), initial_spin(scene, "random"), stop)
    assert solution.status is Status.CERTIFIED
    assert solution.lower_bound[0] <= least * (1 + 1e-9)
    assert least * (1 - 1e-9) <= solution.objective[0] <= least * (1 + tolerance)
    assert solution.power[0] > solution.objective[0]


@pytest.mark.parametrize(("shape", "viscosity"), [
    ((10, 10), "uniform:5,60"), ((4, 4, 4), "uniform:1e-4,1e-3"), ((6, 6, 6), "lognormal:1,5"),
], ids=str)  # fmt: skip
def test_the_interior_point_method_finds_the_least_potential_to_ten_digits(shape, viscosity):
    scene = make_scene(shape, "coulomb-viscous", (3,), viscosity=viscosity, spin_bottom=-0.4)
    least = least_potential(scene)
    solution = solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "random"), StopRule(1e-11))
    assert solution.status is Status.CERTIFIED
    assert solution.objective[0] == pytest.approx(least, rel=1e-10)
    assert solution.lower_bound[0] == pytest.approx(least, rel=1e-10)
    assert solution.largest_balance_residual[0] < 1e-10 * scene.normal_force
    assert solution.iterations < 25


def test_power_over_that_of_the_cut_compares_powers():
    """All cuts of a small scene by hand: the one of least potential, and its power."""
    scene = Scene.random((3, 4), seed=0, law="coulomb-viscous", viscosity="uniform:5,60", spin_bottom=0.25)
    speed, found = scene.lattice.radius * 0.75, []
    for above in itertools.product((False, True), repeat=6):
        side = np.zeros((3, 4), dtype=bool)
        side[:, 1:3], side[:, 3] = np.reshape(above, (3, 2)), True
        cut = [np.diff(side, axis=axis) for axis in range(2)]
        friction = 50 * sum(c[k].sum() for c, k in zip(scene.coefficients, cut, strict=True))
        viscosity = sum(v[k].sum() for v, k in zip(scene.viscosity, cut, strict=True))
        found.append((friction * speed + viscosity * speed**2 / 2, friction * speed + viscosity * speed**2))
    least, power = min(found)
    interface = find_interface(scene)
    assert interface.power == pytest.approx(power, rel=1e-12)
    assert interface.lower_bound == pytest.approx(least, rel=1e-12)
