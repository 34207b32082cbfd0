"""Power and lower bound against the laboratory in 80 digits; nothing shared but the numbers."""

from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest

from taichi_bearings.lattice.grid import friction_by_axis
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.verifier.judgement import Judgement
from taichi_bearings.verifier.samples import Samples
from tests.scenes import make_scene
from tests.verifier.laboratory import Laboratory

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
SCENES = [
    ((4, 5), {}, "planar-cut"),
    ((4, 5), {"law": "viscous", "spin_bottom": -0.3}, "linear-solver"),
    ((3, 2, 4), {}, "interior-point"),
    ((3, 2, 4), {"direction": (1, -2, 3), "spin_bottom": 0.25, "radius": 0.7, "normal_force": 3.0}, "interior-point"),
    ((3, 2, 4), {"law": "viscous", "direction": (1, 1, 1)}, "linear-solver"),
    ((4, 5), {"law": "coulomb-viscous", "spin_bottom": -0.3, "viscosity": "uniform:5,60"}, "interior-point"),
    (
        (3, 2, 4),
        {"law": "coulomb-viscous", "radius": 0.7, "normal_force": 3.0, "viscosity": "lognormal:3,2"},
        "interior-point",
    ),
    ((2, 3, 4), {"law": "coulomb-viscous", "direction": (1, -2, 3), "spin_bottom": 0.999999}, "interior-point"),
    ((2, 3, 4), {"spin_bottom": 0.999999999}, "interior-point"),
    ((2, 3, 4), {"spin_top": 1e-9, "spin_bottom": -1e9, "direction": (1, 1e-7, 0)}, "interior-point"),
]


def samples_of(solution):
    scene, by_axis = solution.scene, solution.scene.lattice.by_axis
    coefficient, *viscosity = map(by_axis, scene.named_coefficients.values())
    return Samples(
        scene.lattice.shape, scene.law.name, coefficient, scene.spin_top, scene.spin_bottom, scene.direction,
        scene.normal_force, scene.lattice.radius, solution.spin, solution.spin_rounding,
        friction_by_axis(solution.friction, scene.lattice), *viscosity or [()],
        scene.top, scene.bottom, scene.lattice.periodic,
    )  # fmt: skip


def solved(shape, options, method):
    from taichi_bearings.scene.initial_spins import initial_spin

    scene = make_scene(shape, **options)
    return solve(scene, METHODS[method]().build(), initial_spin(scene, "linear"), StopRule(1e-10))


@pytest.mark.parametrize(("shape", "options", "method"), SCENES, ids=str)
def test_of_a_minimum(shape, options, method):
    solution = solved(shape, options, method)
    judgement, truth = Judgement(samples_of(solution)), Laboratory(samples_of(solution))
    power, objective, bound = truth.power(), truth.objective(), truth.lower_bound()
    assert Decimal(judgement.lower_bound[0]) <= bound <= objective <= Decimal(judgement.upper_bound[0])
    assert float(Decimal(judgement.upper_bound[0]) / objective - 1) < 2e-15
    assert abs(float(Decimal(judgement.power[0]) / power - 1)) < 3e-16
    assert abs(float(Decimal(judgement.objective[0]) / objective - 1)) < 3e-16
    assert float(1 - Decimal(judgement.lower_bound[0]) / bound) < 4e-15
    assert solution.power[0] == judgement.power[0]
    assert solution.lower_bound[0] == judgement.lower_bound[0]
    assert solution.gap[0] < 1e-13


@pytest.mark.parametrize(("shape", "options", "method"), SCENES, ids=str)
def test_of_any_spins_and_friction(shape, options, method):
    """Spins and friction that are far from a minimum, out of balance and beyond the discs."""
    whole = samples_of(solved(shape, options, method))
    rng = np.random.default_rng(3)
    change = 0.1 * (whole.spin_top - whole.spin_bottom) * rng.standard_normal(whole.spin.shape)
    height = len(shape)  # the axis of the height; driven spins stay
    change[(slice(None),) * height + ([0, -1],)] = 0.0
    samples = replace(
        whole,
        spin=whole.spin + change,
        friction=tuple(f * rng.uniform(0.5, 1.3, f.shape) for f in whole.friction),
    )
    judgement, truth = Judgement(samples), Laboratory(samples)
    objective, bound = truth.objective(), truth.lower_bound()
    assert Decimal(judgement.upper_bound[0]) >= objective
    assert float(Decimal(judgement.upper_bound[0]) / objective - 1) < 2e-15
    assert Decimal(judgement.lower_bound[0]) <= max(bound, Decimal(0))
    if bound > 0:
        assert float(1 - Decimal(judgement.lower_bound[0]) / bound) < 1e-13
    assert not judgement.price[0] < 1e-6


def test_spins_without_the_jump_prove_no_upper_bound(sample_at_rest):
    judgement = Judgement(sample_at_rest)
    assert judgement.power[0] == np.inf
    assert judgement.upper_bound[0] == np.inf
    assert judgement.lower_bound[0] > 0
    assert judgement.states[0].unique is None


@pytest.fixture
def sample_at_rest():
    """All stored spins are those of the bottom."""
    whole = samples_of(solved((3, 2, 4), {}, "interior-point"))
    return replace(whole, spin=np.zeros_like(whole.spin), spin_rounding=np.zeros_like(whole.spin))
