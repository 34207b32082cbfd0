"""Order of both integrators where contacts begin and cease to slip, with springs that relax through their dampers.

Random spins in all components, the paper's material. The integrators share no code; so each is measured against the
other's finest answer, which the order of its own errors extrapolates.
"""

import numpy as np
import pytest

from taichi_bearings.conic.contact_system import free_spins
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, ImplicitCundallStrack
from tests.scenes import make_scene

DURATION = 0.01


def explicit(scene, spin, steps):
    """Free staggered spins (C, R, *free) after DURATION in so many steps of Gear's method."""
    method = CundallStrack(time_step=DURATION / steps, slipping_spring="relax").build()
    method.begin(scene, spin)
    method.advance(steps)
    return method.fields.read("gear_0")[..., 1:-1]


def implicit(scene, spin, steps):
    """The same by the implicit integrator."""
    method = ImplicitCundallStrack(time_step=DURATION / steps, slipping_spring="relax").build()
    method.begin(scene, spin)
    method.advance(steps)
    assert method.time == pytest.approx(DURATION, rel=1e-12)
    spins = free_spins(method.staggered)
    return np.moveaxis(spins.reshape(scene.replicas, *scene.lattice.free_shape, -1), -1, 0)


def slopes(steps, answers, reference):
    """Fitted order of each replica."""
    errors = [np.sqrt(((a - reference) ** 2).mean(axis=(0, *range(2, a.ndim)))) for a in answers]
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0], np.array(errors)


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("shape", [(4, 5), (3, 3, 3)])
def test_orders_are_one_and_two_and_the_limits_agree(shape):
    scene = make_scene(shape, seeds=(31, 32, 33))
    spin = initial_spin(scene, "random")
    many = 2 ** np.arange(9, 16)
    courses = [explicit(scene, spin, int(n)) for n in many]
    limit = 2 * courses[-1] - courses[-2]  # order 1 extrapolated
    order, _ = slopes(many[:5], courses[:5], limit)
    np.testing.assert_allclose(order, 1.0, atol=0.15)
    few = 2 ** np.arange(5, 9)
    order, errors = slopes(few, [implicit(scene, spin, int(n)) for n in few], limit)
    assert (errors[-1] < 3e-5).all(), errors
    assert (order > 1.4).all(), order
    assert np.median(order) > 1.75, order
