"""Force, power, potential and conjugate of every law belong together, checked against each other numerically."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.scene.law import COULOMB, COULOMB_VISCOUS, LAWS, VISCOUS
from tests.scenes import make_scene

RNG = np.random.default_rng(77)
SLIP = np.linspace(0.0, 3.0, 30_001)


def coefficients_of(law):
    return tuple(RNG.uniform(0.2, 2.0, 1) for _ in law.quantities)


@pytest.fixture(params=LAWS.values(), ids=str)
def law(request):
    return request.param


def test_the_force_is_the_slope_of_the_potential_and_makes_the_power(law):
    of = coefficients_of(law)
    slip = SLIP[1:-1]
    slope = (law.potential(of, SLIP[2:]) - law.potential(of, SLIP[:-2])) / (SLIP[2:] - SLIP[:-2])
    assert law.force(of, slip) == pytest.approx(slope, rel=1e-9)
    assert law.power(of, slip) == pytest.approx(law.force(of, slip) * slip, rel=1e-14)
    assert law.potential(of, np.zeros(1)) == law.power(of, np.zeros(1)) == 0


def test_the_conjugate_is_the_largest_work_less_the_potential(law):
    """phi*(f) = max_v (f v - phi(v)), found by trying all slips, and Fenchel's equality at the force of a slip."""
    of = coefficients_of(law)
    held = law.holding_force(of)
    for force in np.linspace(0.0, 1.5, 7):
        if law.is_rate_independent:
            expected = 0.0 if force <= held[0] else np.inf
        else:
            expected = (force * SLIP * 4 - law.potential(of, SLIP * 4)).max()
        assert law.conjugate(of, np.array([force]))[0] == pytest.approx(expected, abs=1e-6)
    if law.has_viscosity:
        for slip in (0.1, 0.7, 2.0):
            force = law.force(of, np.array([slip]))
            assert law.conjugate(of, force) + law.potential(of, np.array([slip])) == pytest.approx(force * slip)


def test_both_coefficients_fall_back_on_the_law_with_one():
    friction, viscosity = RNG.uniform(0.1, 1.0, (2, 5))
    slip, nothing = RNG.uniform(0.0, 2.0, 5), np.zeros(5)
    assert (COULOMB_VISCOUS.power((friction, nothing), slip) == COULOMB.power((friction,), slip)).all()
    assert (COULOMB_VISCOUS.power((nothing, viscosity), slip) == VISCOUS.power((viscosity,), slip)).all()
    assert (2 * COULOMB_VISCOUS.objective((nothing, viscosity), slip) == VISCOUS.objective((viscosity,), slip)).all()


def test_a_scene_has_the_coefficients_of_its_law():
    scene = make_scene((3, 4), "coulomb-viscous")
    assert list(scene.named_coefficients) == ["coefficient", "viscosity"]
    assert scene.law is COULOMB_VISCOUS
    with pytest.raises(InputError, match="coulomb, viscous, coulomb-viscous"):
        replace(scene, law="stribeck")
    with pytest.raises(InputError, match="2 coefficients a contact; viscosities must be given"):
        replace(scene, viscosity=())
    with pytest.raises(InputError, match="1 coefficients a contact; viscosities must not be given"):
        replace(scene, law="coulomb")
    with pytest.raises(InputError, match=r"viscosity -1.0 at \[0, 0\] along x is not allowed"):
        replace(scene, viscosity=tuple(-np.ones_like(values) for values in scene.viscosity))


def test_the_second_coefficient_comes_from_its_own_stream():
    scene, rng = make_scene((3, 4, 5), "coulomb-viscous"), np.random.default_rng([4711, 2])
    for axis, values in enumerate(scene.viscosity):
        assert (values[0] == rng.uniform(0.1, 1.0, scene.lattice.contact_shape(axis))).all()
    assert all((a == b).all() for a, b in zip(scene.coefficient, make_scene((3, 4, 5)).coefficient, strict=True))
