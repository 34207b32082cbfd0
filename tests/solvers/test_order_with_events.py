"""Order of Gear's method where contacts begin and cease to slip, with springs that relax through their dampers.

Random spins in all components, the paper's material, measured against the finest answer, extrapolated by order 1.
"""

import numpy as np
import pytest

from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack
from tests.scenes import make_scene

DURATION = 0.01


def explicit(scene, spin, steps):
    """Free staggered spins (C, R, *free) after DURATION in so many steps of Gear's method."""
    method = CundallStrack(time_step=DURATION / steps, slipping_spring="relax").build()
    method.begin(scene, spin)
    method.advance(steps)
    return method.fields.read("gear_0")[..., 1:-1]


def slopes(steps, answers, reference):
    """Fitted order of each replica."""
    errors = [np.sqrt(((a - reference) ** 2).mean(axis=(0, *range(2, a.ndim)))) for a in answers]
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0], np.array(errors)


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("shape", [(4, 5), (3, 3, 3)])
def test_the_order_is_one(shape):
    scene = make_scene(shape, seeds=(31, 32, 33))
    spin = initial_spin(scene, "random")
    many = 2 ** np.arange(9, 16)
    courses = [explicit(scene, spin, int(n)) for n in many]
    limit = 2 * courses[-1] - courses[-2]  # order 1 extrapolated
    order, _ = slopes(many[:5], courses[:5], limit)
    np.testing.assert_allclose(order, 1.0, atol=0.15)
