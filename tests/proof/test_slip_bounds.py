"""No minimum slips faster at a contact than its bound, whatever spins and friction the bound is made of."""

from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest

from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.proof.laboratory import Laboratory, by_axis, dot
from tests.proof.test_bounds import samples_of
from tests.scenes import make_scene, minima, name_of, scene_of

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
MIXED = {"law": "coulomb-viscous", "viscosity": "uniform:5,60", "spin_bottom": 0.1}


def solved(scene):
    return solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-10))


def elsewhere(samples, rng, size):
    """Other spins between those of the planes, and other friction: everything near, far, or beyond the discs."""
    friction = tuple(values + size * rng.standard_normal(values.shape) for values in samples.friction)
    spin = samples.spin + 1e-3 * size * rng.standard_normal(samples.spin.shape)
    for axis, values in enumerate(friction):
        if axis != samples.dimension - 1:
            values[(slice(None),) * samples.dimension + ([0, -1],)] = 0.0  # contacts within a plane
        if samples.dimension == 3:
            values[..., axis] = 0.0
    return replace(samples, friction=friction, spin=np.where(driven(samples), samples.spin, spin))


def driven(samples):
    mask = np.zeros(samples.spin.shape, dtype=bool)
    mask[(slice(None),) * samples.dimension + ([0, -1],)] = True
    return mask


@pytest.mark.parametrize("entry", minima((3, 3, 3), (5, 5, 5)), ids=name_of)
def test_no_minimum_slips_faster_than_its_bound(entry):
    solution, rng = solved(scene_of(entry)), np.random.default_rng(7)
    assert (solution.slip <= solution.slip_bound * (1 + 1e-9) + 1e-12).all()
    assert (solution.slip_bound[solution.state == ContactState.SLIPLESS] < 1e-6).all()  # the bound is sharp as well
    for size in (0.1, 10.0, 1e3):
        bound = Judgement(elsewhere(samples_of(solution), rng, size)).slip_bound
        assert (solution.slip <= bound + 1e-12).all()


@pytest.mark.parametrize("options", [{}, MIXED], ids=["coulomb", "coulomb-viscous"])
@pytest.mark.parametrize("shape", [(4, 5), (3, 2, 4)], ids=str)
@pytest.mark.parametrize("size", [1e-6, 0.5, 50.0])
def test_the_bound_is_where_a_contact_alone_has_all_that_is_left(shape, options, size):
    """phi(v) + phi*(F) - |F| v is the excess there, in 80 digits; none of that is shared with the verifier."""
    samples = elsewhere(samples_of(solved(make_scene(shape, **options))), np.random.default_rng(3), size)
    judgement, truth = Judgement(samples), Laboratory(samples)
    worst = max((dot(f, f).sqrt() / held for *_, held, _, f in truth.contacts()), default=Decimal(1))
    excess = truth.objective() - truth.lower_bound()
    box = samples.radius * samples.jump_size * 1.0000001
    for lower, upper, _, held, viscosity, force in truth.contacts():
        axis = next(k for k, (a, b) in enumerate(zip(lower, upper, strict=True)) if a != b)
        speed = Decimal(float(by_axis(samples, judgement.slip_bound)[axis][(0, *lower)]))
        size_of_force = dot(force, force).sqrt()
        if not viscosity:
            size_of_force /= max(worst, Decimal(1))
        conjugate = max(size_of_force - held, Decimal(0)) ** 2 / (2 * viscosity) if viscosity else Decimal(0)
        left = held * speed + viscosity * speed**2 / 2 + conjugate - size_of_force * speed
        assert speed <= box
        if float(speed) < 0.7 * box * (0.5 if samples.dimension == 3 else 1.0):  # else the planes allow no more
            assert 1 <= left / excess < Decimal("1.00001")
