"""What power obeys whatever the spins: scaling, symmetry, and the balance of work at the minimum."""

import numpy as np
import pytest

from taichi_bearings.lattice.incidence import torques
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import GradientDescent
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene


@pytest.mark.parametrize(("law", "factor"), [("coulomb", 2), ("viscous", 4)])
@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5)])
def test_doubling_every_spin(law, factor, shape):
    scene = make_scene(shape, law)
    axes = scene.lattice.all_spin_axes
    spin = np.random.default_rng(1).standard_normal((len(axes), 1, *shape))
    assert scene.power(2 * spin, axes) == pytest.approx(factor * scene.power(spin, axes), rel=1e-14)


@pytest.mark.parametrize("law", ["coulomb", "viscous"])
def test_a_mirrored_sample_has_the_same_power(law):
    scene = make_scene((3, 4, 5), law)
    spin = np.random.default_rng(2).standard_normal((3, 1, 3, 4, 5))
    mirrored = Scene(tuple(c[:, ::-1] for c in scene.coefficient), law)
    assert mirrored.power(spin[:, :, ::-1], (0, 1, 2)) == pytest.approx(scene.power(spin, (0, 1, 2)), rel=1e-13)


def test_swapping_the_horizontal_axes_changes_nothing(needs_f64):
    """x <-> y of sample and spins together, at the minimum: catches any axis that is treated differently."""
    scene = make_scene((3, 5, 4))
    swapped = Scene(tuple(scene.coefficient[a].swapaxes(1, 2) for a in (1, 0, 2)))
    powers = [
        solve(s, GradientDescent().build(), initial_spin(s, "linear"), StopRule(1e-6)).power[0]
        for s in (scene, swapped)
    ]
    assert powers[0] == pytest.approx(powers[1], rel=2e-6)


@pytest.mark.parametrize("law", ["coulomb", "viscous"])
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
    force = method._force_at(staggered)
    top = -torques(force, scene.lattice, axes)[..., -1]
    work = scene.lattice.radius * (top * scene.driven_values(axes)[1].reshape(-1, 1, 1, 1)).sum()
    assert work == pytest.approx(solution.power[0], rel=accuracy)
