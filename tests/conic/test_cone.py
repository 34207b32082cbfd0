"""The algebra of second-order cones against its definitions."""

import numpy as np
import pytest

from taichi_bearings.conic.cones import determinant, length, longest_step


def interior(rng, d, n=200, spread=6):
    """Points inside the cone, some far out and some very close to its surface."""
    tail = rng.standard_normal((d, n)) * 10 ** rng.uniform(-spread / 2, spread / 2, n)
    return length(tail) * (1 + 10 ** rng.uniform(-spread, 1, n)), tail


@pytest.mark.parametrize("d", [1, 2])
def test_the_longest_step_ends_on_the_surface(d):
    rng = np.random.default_rng(d)
    for _ in range(50):
        point = interior(rng, d, n=1, spread=2)
        step = (rng.standard_normal(1), rng.standard_normal((d, 1)))
        longest = longest_step(point, step)
        if np.isinf(longest):
            far = (point[0] + 1e6 * step[0], point[1] + 1e6 * step[1])
            assert far[0] >= length(far[1]) * (1 - 1e-9)
            continue
        inside = [(point[0] + a * step[0], point[1] + a * step[1]) for a in (0.5 * longest, 0.999 * longest)]
        assert all(p[0] > length(p[1]) for p in inside)
        outside = (point[0] + 1.001 * longest * step[0], point[1] + 1.001 * longest * step[1])
        assert outside[0] < length(outside[1])


def test_determinant_keeps_its_digits_next_to_the_surface():
    tail = np.array([[0.6], [0.8]])
    assert determinant((np.array([1 + 1e-12]), tail))[0] == pytest.approx(2e-12, rel=1e-3)
