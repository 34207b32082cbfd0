"""The algebra of second-order cones against its definitions."""

import numpy as np
import pytest

from taichi_bearings.conic.grouped import determinant, length, longest_step
from tests.conic.cone_twin import Scaling, clipped_towards, jordan_product


def interior(rng, d, n=200, spread=6):
    """Points inside the cone, some far out and some very close to its surface."""
    tail = rng.standard_normal((d, n)) * 10 ** rng.uniform(-spread / 2, spread / 2, n)
    return length(tail) * (1 + 10 ** rng.uniform(-spread, 1, n)), tail


@pytest.mark.parametrize("d", [1, 2])
class TestCone:
    def test_scaling_maps_both_points_to_one(self, d):
        rng = np.random.default_rng(d)
        primal, dual = interior(rng, d), interior(rng, d)
        scaling = Scaling.of(primal, dual)
        from_dual, from_primal = scaling.apply(dual), scaling.apply_inverse(primal)
        assert from_primal[0] == pytest.approx(from_dual[0], rel=1e-4)
        scale = from_dual[0]
        assert from_primal[1] / scale == pytest.approx(from_dual[1] / scale, abs=1e-4)

    def test_apply_and_its_inverse_cancel(self, d):
        rng = np.random.default_rng(d)
        scaling = Scaling.of(interior(rng, d, spread=2), interior(rng, d, spread=2))
        point = interior(rng, d, spread=2)
        back = scaling.apply_inverse(scaling.apply(point))
        assert back[0] == pytest.approx(point[0], rel=1e-9)
        assert back[1] == pytest.approx(point[1], rel=1e-7, abs=1e-9)

    def test_newton_blocks_are_those_of_the_squared_inverse(self, d):
        rng = np.random.default_rng(d)
        scaling = Scaling.of(interior(rng, d, spread=2), interior(rng, d, spread=2))
        head_head, head_tail, stiffness = scaling.newton_blocks()
        n = len(head_head)
        columns = []
        for k in range(d + 1):
            unit = (np.full(n, float(k == 0)), np.array([np.full(n, float(k == i + 1)) for i in range(d)]))
            head, tail = scaling.apply_inverse(scaling.apply_inverse(unit))
            columns.append(np.concatenate([head[None], tail]))
        inverse = np.array(columns)
        assert head_head == pytest.approx(inverse[0, 0], rel=1e-9)
        assert head_tail == pytest.approx(inverse[0, 1:], rel=1e-7, abs=1e-9 * abs(inverse).max())
        schur = inverse[1:, 1:] - inverse[0, 1:, None] * inverse[None, 0, 1:] / inverse[0, 0]
        assert stiffness == pytest.approx(schur, rel=1e-5, abs=1e-9 * abs(inverse).max())

    def test_divide_inverts_the_jordan_product(self, d):
        rng = np.random.default_rng(d)
        scaling = Scaling.of(interior(rng, d, spread=1), interior(rng, d, spread=1))
        product = interior(rng, d, spread=1)
        again = jordan_product(scaling.point, scaling.divide(product))
        assert again[0] == pytest.approx(product[0], rel=1e-8)
        assert again[1] == pytest.approx(product[1], rel=1e-8, abs=1e-9)

    def test_the_longest_step_ends_on_the_surface(self, d):
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

    def test_clipping_moves_the_eigenvalues_into_the_interval(self, d):
        rng = np.random.default_rng(d)
        head, tail = rng.uniform(0, 1.5, 100), rng.standard_normal((d, 100))
        change = clipped_towards((head, tail), 0.2, 2.0)
        new = (head + change[0], tail + change[1])
        low, high = new[0] - length(new[1]), new[0] + length(new[1])
        moved_freely = (head - length(tail) > 0.2 - 2.0) & (head + length(tail) < 4.0)
        assert (low[moved_freely] > 0.2 - 1e-12).all()
        assert (high[moved_freely] < 2.0 + 1e-12).all()


def test_determinant_keeps_its_digits_next_to_the_surface():
    tail = np.array([[0.6], [0.8]])
    assert determinant((np.array([1 + 1e-12]), tail))[0] == pytest.approx(2e-12, rel=1e-3)
