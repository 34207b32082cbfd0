"""Pictures of spins leave out what no contact feels: how fast whole layers turn about the height."""

import numpy as np
import pytest

from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.table import fastest

pytestmark = pytest.mark.usefixtures("needs_f64")


def solved(shape, **driving):
    """The structure of a minimum."""
    scene = Scene.random(shape, seed=3, **driving)
    return structure_of(solve(scene, fastest(scene, 1e-8, on_gpu=False)().build(), initial_spin(scene, "linear")), 0)


def turned(best, by):
    """The spins of an answer with each free layer turned about the height, neighbours oppositely."""
    parity = 1 - 2 * (np.indices(best.spin.shape[:3]).sum(axis=0) % 2)
    spin = np.array(best.spin)
    spin[..., 1:-1, 2] += (parity * by)[..., 1:-1]
    return spin


@pytest.mark.parametrize("driving", [{}, {"direction": (1, 0, 0)}, {"top": (1, 0, 0.5, 0), "bottom": (0, 0, 0.5, 0)}])
def test_a_layer_that_turns_without_slip_looks_as_it_did(driving):
    structure = best = solved((4, 3, 5), **driving)
    spin = turned(best, np.array([9.0, 0.7, -0.3, 2.0, 9.0]))
    assert structure.slips_of(spin) == pytest.approx(structure.slips_of(np.array(best.spin)), abs=1e-12)
    assert np.abs(spin - best.spin).max() > 0.5
    assert structure.scene.driving.shown(spin) == pytest.approx(
        structure.scene.driving.shown(np.array(best.spin)), abs=1e-12
    )


def test_what_slips_within_a_layer_is_shown():
    best = solved((4, 3, 5))
    spin = np.array(best.spin)
    spin[1, 1, 2] += (0.0, 0.0, 1.2)
    shown = best.scene.driving.shown(spin)
    other = best.scene.driving.shown(np.array(best.spin))
    assert (shown - other)[1, 1, 2, 2] == pytest.approx(1.2 * (1 - 1 / 12))
    assert spin[..., :2] == pytest.approx(shown[..., :2])


def test_discs_are_shown_as_they_are():
    best = solved((4, 5))
    assert best.scene.driving.shown(np.array(best.spin)) == pytest.approx(best.spin)
