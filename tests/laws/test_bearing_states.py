"""A bearing state dissipates nothing: constant staggered spins, and in 3D any f(x), g(y), h(z) (equations.md, 1)."""

import numpy as np
import pytest

from tests.scenes import SIMPLE_LAWS, make_scene


@pytest.mark.parametrize("law", SIMPLE_LAWS)
def test_a_bearing_state_of_discs_dissipates_nothing(law):
    scene = make_scene((4, 6), law)
    assert scene.power(np.full((1, 1, 4, 6), 0.73), (2,)) == 0


@pytest.mark.parametrize("law", SIMPLE_LAWS)
def test_all_bearing_states_of_the_cubic_lattice_dissipate_nothing(law):
    scene, rng = make_scene((3, 4, 5), law), np.random.default_rng(5)
    spin = np.empty((3, 1, 3, 4, 5))
    spin[0], spin[1], spin[2] = rng.random((3, 1, 1)), rng.random((1, 4, 1)), rng.random((1, 1, 5))
    assert scene.power(spin, (0, 1, 2)) == 0
    spin[0, 0, 1, 2, 3] += 1e-3
    assert scene.power(spin, (0, 1, 2)) > 0


def test_slip_is_the_one_of_the_paper():
    """|v| from Eq. (2) in the laboratory frame, contact by contact."""
    scene, rng = make_scene((3, 4, 5)), np.random.default_rng(6)
    omega = rng.standard_normal((1, 3, 4, 5, 3))
    staggered = np.moveaxis(omega * scene.lattice.parity[..., None], -1, 0)
    slips = scene.lattice.by_axis(scene.slips(staggered, (0, 1, 2))[0])
    for axis in range(3):
        r = 0.5 * np.eye(3)[axis]
        for index in np.ndindex(scene.lattice.contact_shape(axis)):
            above = tuple(n + (a == axis) for a, n in enumerate(index))
            v = np.cross(omega[0][above], -r) - np.cross(omega[0][index], r)
            assert slips[axis][index] == pytest.approx(np.linalg.norm(v), rel=1e-13)
