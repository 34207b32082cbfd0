"""A torque on the top where the contacts have a law of one's own, whose power is no fixed power of the strength."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.kernels.contact import FORCES
from taichi_bearings.runs.own_law_torque import findings_with_own_law
from taichi_bearings.scene.law import LAWS, Quantity
from tests.own_laws import Bounded, Steep, bounded_force, steep_force

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
solve = partial(tb.solve, threads=1)


@pytest.fixture(autouse=True)
def table(monkeypatch):
    force = (Quantity("damping", "force*(time/length)**1.5"),)
    monkeypatch.setitem(LAWS, "steep", Steep("steep", force, share=2.5))
    monkeypatch.setitem(FORCES, "steep", steep_force)
    bounded = Bounded("bounded", (Quantity("friction", "force"),), minimises="potential")
    monkeypatch.setitem(LAWS, "bounded", bounded)
    monkeypatch.setitem(FORCES, "bounded", bounded_force)


@pytest.mark.parametrize("shape", [(4, 5), (3, 3, 4)], ids=str)
@pytest.mark.parametrize("share", [-7.0, 0.3, 1.0])
def test_the_strength_scales_as_the_law_does(shape, share):
    """Torque ~ strength^1.5 for F ~ v^1.5: multiplying all spins by a keeps their pattern."""
    scene = tb.Scene.random(shape, seed=3, law="steep", replicas=2)
    found = solve(scene, torque=share).findings
    expected = np.sign(share) * (abs(share) / solve(scene).power) ** (1 / 1.5)
    assert found["amplitude"] == pytest.approx(expected, rel=1e-6)
    assert found["yields"].all()
    assert (found["yield_torque"] == 0).all()


@pytest.mark.parametrize("shape", [(4, 5), (3, 3, 4)], ids=str)
def test_the_torque_is_the_slope_of_the_least_potential(shape):
    scene = tb.Scene.random(shape, seed=1, law="bounded")
    torque = 0.6 * solve(scene).power
    strength = solve(scene, torque=torque).findings["amplitude"]
    moved = solve(replace(scene, spin_top=strength))
    assert moved.power == pytest.approx(torque * strength, rel=1e-6)
    low, high = (solve(replace(scene, spin_top=strength * (1 + part))).potential for part in (-1e-2, 1e-2))
    assert (high - low) / (2e-2 * strength) == pytest.approx(torque, rel=1e-4)


def test_a_torque_beyond_the_largest_of_a_bounded_force_has_no_strength():
    scene = tb.Scene.random((4, 5), seed=1, law="bounded")
    best = solve(scene, torque=2 * solve(scene.with_top(1e6), tolerance=1e-5).power / 1e6)
    assert best.findings["yields"]
    assert np.isnan(best.findings["amplitude"])
    assert sum("turns the top, but how fast is not known: no speed is proven" in text for text in best.warnings) == 1


def test_a_loose_bound_proves_no_strength():
    scene = tb.Scene.random((4, 5), seed=3, law="steep")
    found = solve(scene, torque=1.0, tolerance=1e-2)
    assert np.isnan(found.findings["amplitude"])
    assert any("the tolerance 0.01 is too large" in sentence for sentence in found.warnings)


def test_without_a_finite_slope_only_motions_prove_that_the_top_turns(monkeypatch):
    scene = tb.Scene.random((4, 5), seed=1, law="bounded")
    monkeypatch.setattr("taichi_bearings.runs.own_law_torque.moves_freely", lambda scene: False)

    def again(scene):
        return solve(scene).solution

    free = findings_with_own_law(scene, 0.3, again)
    assert free["yields"].all()
    assert 0 < free["yield_torque"][0] < 0.3
    faint = findings_with_own_law(scene, 1e-300, again)
    assert not faint["yields"].any()


def test_the_bottom_must_rest():
    for given in ({"spin_bottom": 0.3}, {"bottom": (0.3,), "top": (1.0,)}):
        with pytest.raises(InputError, match=r"with --torque and the law steep it must be at rest"):
            solve(tb.Scene.random((4, 5), law="steep", **given), torque=1.0)


def test_no_torque_turns_nothing():
    found = solve(tb.Scene.random((4, 5), law="steep"), torque=0.0).findings
    assert (found["yields"], found["amplitude"], found["yield_torque"]) == (False, 0.0, 0.0)
