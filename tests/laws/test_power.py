"""The balance of work at the minimum. What power obeys whatever the spins is in tests/properties."""

import pytest

from taichi_bearings.lattice.incidence import torques
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import GradientDescent
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import SIMPLE_LAWS, make_scene


@pytest.mark.parametrize("law", SIMPLE_LAWS)
def test_at_the_minimum_power_in_is_power_dissipated(law, precision):
    """The top plane does all the work when the bottom rests."""
    scene = make_scene((4, 3, 5), law)
    # work is linear in the error of the spins, the gap is linear (Coulomb) or quadratic (viscous)
    tolerance, accuracy = {"coulomb": (1e-6, 1e-4), "viscous": (1e-12, 1e-5)}[law]
    if precision == "f32":
        tolerance, accuracy = max(tolerance, 1e-4), 1e-2
    method = GradientDescent().build()
    solution = solve(scene, method, initial_spin(scene, "zero"), StopRule(tolerance))
    axes = scene.minimum_spin_axes
    staggered = scene.staggered_spin(solution.spin, axes)
    force = method.forces_at(staggered, method.width)
    top = -torques(force, scene.lattice, axes)[..., -1]
    work = scene.lattice.radius * (top * scene.top_spin(axes)[:, None]).sum()
    assert work == pytest.approx(solution.power[0], rel=accuracy)
