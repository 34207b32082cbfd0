"""How far a matrix that elimination finds positive can be from one, and states proven from either factorisation."""

from fractions import Fraction

import numpy as np
import pytest

from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.verifier import curvature
from taichi_bearings.verifier.judgement import Judgement
from tests.scenes import make_scene
from tests.verifier.test_bounds import samples_of


def test_what_rounding_hides_from_a_dense_elimination_is_within_its_bound():
    """Matrices ((a, b), (b, c)) with b^2 > a c: not positive, by at most (b^2 - a c) / (a + c) but for its square."""
    rng, passed = np.random.default_rng(0), 0
    for a, c in rng.uniform(0.5, 2.0, (5000, 2)):
        b = np.nextafter(np.sqrt(a * c), 2.0)
        distance = curvature._dense_distance(np.array([[a, b], [b, c]]))
        lacking = float((Fraction(b) ** 2 - Fraction(a) * Fraction(c)) / (Fraction(a) + Fraction(c)))
        if lacking > 0 and distance is not None:
            passed += 1
            assert 0.99 * lacking < distance < 1e-14
    assert passed > 20
    assert curvature._dense_distance(np.array([[1.0, 2.0], [2.0, 1.0]])) is None


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("few", [0, 1000])
def test_both_factorisations_prove_the_states(monkeypatch, few):
    solution = solve(
        scene := make_scene((6, 6, 6), seeds=(3,)),
        InteriorPoint().build(),
        initial_spin(scene, "linear"),
        StopRule(1e-9),
    )
    monkeypatch.setattr(curvature, "FEW", few)
    if few:
        monkeypatch.setattr(curvature, "_distance_from_positive", lambda factor: None)
    else:
        monkeypatch.setattr(curvature, "_dense_distance", lambda matrix: None)
    assert Judgement(samples_of(solution)).states[0].agree([state[0] for state in solution.state])
