"""Which decades of power are real: counting, verdicts, and a small study from beginning to end."""

from dataclasses import replace

import numpy as np
import pytest
from taichi_bearings_studies.paper import reproduce, supplement
from taichi_bearings_studies.paper.claims import Effort, judge
from taichi_bearings_studies.paper.samples import solved
from taichi_bearings_studies.paper.supplement import Ending

from taichi_bearings.scene import Scene
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.stopping import StopRule
from tests.tables import rows_of


def ending(*power):
    power = np.array(power, dtype=float)
    return Ending(power, power > 0, total=1.0, iterations=10**6, slip_error=1e-12)


def judged(name, minima, *descents):
    return judge(f"supplement.{name}", **supplement.names_of(descents, minima))


MINIMUM = ending(3e-1, 2e-1, 5e-3, 0.0, 0.0, 0.0)


def test_contacts_are_counted_by_decades():
    descent = ending(4e-1, 2e-2, 3e-2, 5e-2, 2e-4, 1e-4)
    found = supplement.by_decade(descent, MINIMUM).only("exponent contacts slipping at_minimum")
    assert list(zip(*found.values(), strict=True)) == [(-4, 2, 0, 0), (-3, 0, 0, 1), (-2, 3, 2, 0), (-1, 1, 1, 2)]
    assert descent.decades == pytest.approx(np.log10(4e3))
    assert "decades, 2 of 3 real" in judged("real", [MINIMUM], descent).ours


def test_one_sample_can_refute_that_decades_are_real_and_not_confirm_it():
    unreal, real = ending(4e-1, 2e-1, 1e-1, 1e-4, 2e-4, 1e-4), ending(4e-1, 2e-1, 3e-3, 1e-1, 2e-1, 1e-1)
    assert judged("real", [MINIMUM], unreal).verdict == "refuted"
    for minimum, descent in (
        (MINIMUM, replace(unreal, iterations=10**5)),
        (replace(MINIMUM, slip_error=None), unreal),
        (real, real),
    ):
        assert judged("real", [minimum], descent).verdict == "too few samples"


def test_the_range_is_judged_over_samples():
    eleven, eight = ending(1.0, 1e-11), ending(1.0, 1e-8)
    assert judged("range", [eleven] * 5).verdict == "confirmed"
    assert judged("range", [eight] * 40).verdict == "refuted"
    assert judged("range", [eight] * 10).verdict == "too few samples"
    assert judged("range", [eight] * 4 + [eleven] * 4).verdict == "refined"
    unknown = replace(eleven, slip_error=None)
    assert judged("range", [*[unknown] * 40, eight]).samples == 1
    assert judged("range", [unknown]).verdict == judged("broad", [unknown]).verdict == "too few samples"
    spread = ending(*np.geomspace(1e-8, 1, 100))
    assert spread.central_decades == pytest.approx(0.9 * 8)
    assert judged("broad", [spread] * 5).verdict == "confirmed"
    assert judged("broad", [spread] * 4 + [ending(*np.linspace(0.5, 1, 100))]).verdict == "refuted"
    assert judged("broad", [spread] * 4).verdict == "too few samples"


def test_slips_are_known_as_closely_as_is_said(taichi_runtime, needs_f64):
    """Against the same minimum solved in another frame, mirrored and shifted: both errors cover the difference."""
    scenes = [Scene.random((3, 4, 4), 5, **driving) for driving in ({}, {"spin_top": -2.0, "spin_bottom": 1.0})]
    found = [solved(scene, InteriorPoint(), StopRule(1e-9)) for scene in scenes]
    slips = [of.slip[0] / of.scene.jump for of in found]
    moves = slips[0] > 0
    assert moves.any()
    errors = [supplement.largest_slip_error(of) for of in found]
    assert 0 < max(errors) < 1e-6
    apart = np.abs(slips[1][moves] / slips[0][moves] - 1).max()
    assert apart <= sum(errors) + 8 * np.finfo(float).eps
    assert supplement.largest_slip_error(replace(found[0], proven=np.zeros_like(found[0].proven))) is None


def test_a_small_study(tmp_path, monkeypatch, taichi_runtime, needs_f64):
    monkeypatch.setattr(supplement, "SHAPE", (4, 3, 5))
    monkeypatch.setattr(supplement, "ITERATIONS", (200, 2000))
    claims = reproduce.FIGURES["supplement"].reproduce(tmp_path, Effort(2, 3))
    assert {path.name for path in tmp_path.iterdir()} == {"supplement.png", "supplement.pdf", "supplement.csv"}
    assert all(claim.paper and claim.ours and claim.uncertainty for claim in claims)
    assert {claim.verdict for claim in claims} == {"too few samples"}
    state = solved(supplement.scene_of(2), InteriorPoint(), StopRule(1e-9)).state
    rows = rows_of(tmp_path / "supplement.csv")
    for iterations in ("200", "2000"):
        own = [row for row in rows if row["iterations"] == iterations]
        assert sum(int(row["contacts"]) for row in own) == 45 + 40 + 48 - 2 * (9 + 8)
        assert sum(int(row["slipping"]) for row in own) == int((state == 1).sum())
