"""Power and bounds of packings are those of the laboratory frame in 80 digits, contact by contact."""

from decimal import Decimal

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.proof.judgement import Judgement
from tests.proof.laboratory import OfPacking

MIXED = {"law": "coulomb-viscous", "viscosity": "uniform:5,60"}
PACKINGS = {
    "square": ("square", (4, 5), {"spin_bottom": 0.1}), "triangular": ("triangular", (4, 3), {}),
    "honeycomb, viscous": ("honeycomb", (3, 3), {"law": "viscous"}), "discs with both": ("triangular", (3, 3), MIXED),
    "cubic": ("cubic", (3, 3, 4), {"direction": (1.0, 2.0, 0.0), "spin_bottom": -0.3}),
    "cubic, viscous": ("cubic", (3, 2, 4), {"law": "viscous", "normal_force": 3.0}),
    "cubic with both": ("cubic", (2, 3, 4), MIXED), "walls": ("cubic", (3, 3, 4), {"driven": "walls"}),
}  # fmt: skip


@pytest.mark.parametrize("size", [0.0, 1e-3, 0.1])
@pytest.mark.parametrize("name", PACKINGS)
def test_bounds_of_packings_are_those_of_the_laboratory(name, size):
    """At a minimum, and of spins and friction far from one, out of balance and beyond the limits."""
    kind, cells, given = PACKINGS[name]
    packing, rng = tb.Packing.lattice(kind, cells, seed=2, **given), np.random.default_rng(4)
    found = tb.solve(packing)
    spin = found.spin + size * rng.standard_normal(found.spin.shape) * (packing.driven < 0).reshape(
        -1, *(1,) * (found.spin.ndim - 1)
    )
    friction = found.friction * rng.uniform(1 - size, 1 + size, found.friction.shape)
    rounding = found.spin_rounding if size == 0 else np.zeros_like(spin)
    judgement, truth = Judgement(packing, spin, rounding, friction), OfPacking(packing, spin, rounding, friction)
    objective, bound = truth.objective(), max(truth.lower_bound(), Decimal(0))
    low, high = Decimal(float(judgement.lower_bound[0])), Decimal(float(judgement.upper_bound[0]))
    assert low <= bound <= objective <= high
    assert float(high / objective - 1) < 2e-15
    assert float(low) == pytest.approx(float(bound), rel=1e-13)
    assert judgement.power[0] == pytest.approx(float(truth.power()), rel=3e-16)
    assert (judgement.gap[0] < 1e-12) == (size == 0)
