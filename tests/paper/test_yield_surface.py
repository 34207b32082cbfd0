"""The yield surface: torques of proven forces are subgradients of the proven least power, and scans find the same."""

import numpy as np
import pytest
from taichi_bearings_studies.paper import reproduce, yield_surface
from taichi_bearings_studies.paper.claims import Effort
from taichi_bearings_studies.paper.yield_surface import BESIDE, offsets, power_and_torque, settings_of

from tests.cli.commands import bearings
from tests.handbook.pages import ROOT
from tests.tables import rows_of

pytestmark = pytest.mark.usefixtures("needs_f64")
SIDE, SEED = 4, 3


def minima(*directions, seed=SEED):
    """Powers, bounds and torques of one sample, an entry a direction."""
    found = [power_and_torque(settings_of(SIDE, seed, tuple(map(float, direction)))) for direction in directions]
    return tuple(np.array([of[name] for of in found]) for name in ("power", "lower_bound", "torque"))


def test_the_torque_is_a_subgradient_of_the_least_power():
    rng = np.random.default_rng(11)
    directions = np.concatenate([rng.normal(size=(6, 3)), np.eye(3), [[1, BESIDE, 0]]])
    power, bound, torque = minima(*directions)
    work = torque @ directions.T  # (torque, direction)
    assert np.all(power - bound <= 1e-10 * power)
    assert np.all(np.diag(work) == pytest.approx(power, rel=1e-10))
    assert np.all(work <= power * (1 + 1e-10))
    between = (directions[:, None] + directions) / 2
    middle = minima(*(between[k, k + 1] for k in range(3)))[0]
    assert np.all(middle <= [(power[k] + power[k + 1]) / 2 * (1 + 1e-10) for k in range(3)])  # convex


def test_slopes_of_the_power_are_torques():
    direction, aside, step = np.array([0.8, 0.5, -0.3]), np.array([-0.2, 0.3, 0.4]), 1e-3
    power, bound, torque = minima(direction - step * aside, direction, direction + step * aside)
    gap = (power - bound).max() / step
    slopes, along = np.diff(power) / step, torque @ aside
    for k, slope in enumerate(slopes):
        assert along[k] - gap <= slope <= along[k + 1] + gap
    assert along[2] - along[0] < 0.1 * abs(along[1])  # it tells the torque, not just a range


def test_the_power_is_homogeneous_and_its_torque_is_not_changed():
    (once, thrice), _, torque = minima((0.3, 1.0, 0.4), (0.9, 3.0, 1.2))
    assert thrice == pytest.approx(3 * once, rel=1e-10)
    assert torque[1] == pytest.approx(torque[0], rel=1e-6)


def test_crossed_driving_weakens():
    (x, y, near, far), _, torque = minima((1, 0, 0), (0, 1, 0), (BESIDE, 1, 0), (0.01, 1, 0))
    assert x == pytest.approx(167.364, abs=1e-3)
    assert (far - y) / 0.01 == pytest.approx(54.59, abs=5e-3)  # "54.6 instead of 167.4"
    assert (near - y) / BESIDE <= torque[2, 0] == pytest.approx(54.098, abs=1e-3)


def test_places_of_layers_have_a_mean_square_of_one_half():
    for side in (4, 7):
        assert offsets(side).sum() == pytest.approx(0, abs=1e-12)
        assert 2 * (offsets(side) ** 2).mean() == pytest.approx(1, rel=1e-12)  # both directions of the plane together


def scanned(folder, name, *settings):
    """The rows of an example scan in a small form."""
    words = [word for setting in settings for word in ("--set", setting)]
    done = bearings(
        "scan", str(ROOT / f"examples/studies/{name}.toml"), *words, "--workers", "1", "--out", "out", cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return rows_of(folder / "out/scan.csv")


def test_example_scans_find_the_same(tmp_path):
    one = (f"scan.seed=[{SEED}]", "scan.shape=[[4,4,4]]")
    rows = scanned(tmp_path, "yield", *one)
    plane = yield_surface.PLANE
    assert [float(row["power"]) for row in rows] == pytest.approx(minima(*plane)[0], rel=1e-9)
    (tmp_path / "crossed").mkdir()
    rest, turning = (float(row["yield_torque"]) for row in scanned(tmp_path / "crossed", "yield-crossed", *one))
    power, _, torque = minima((1, 0, 0), (BESIDE, 1, 0))
    assert (rest, turning) == pytest.approx((power[0], torque[1, 0]), rel=2e-4)
    (tmp_path / "rate").mkdir()
    rows = scanned(tmp_path / "rate", "yield-rate", f"scan.seed=[{SEED}]")
    spread = (63 / 6) ** 0.5
    for row, (a, c) in zip(rows, ((1, 0), (1, 1), (3, 1), (10, 1), (0, 1)), strict=True):
        truth = power_and_torque(settings_of(8, SEED, (float(a), 0.0, c * spread)))["power"]
        assert float(row["power"]) == pytest.approx(truth, rel=1e-9)


def test_the_study_in_a_small_form(tmp_path, monkeypatch):
    sides, plane = (
        (3, 4, 5),
        [(1.0, slope, 0.0) for slope in (0.0, BESIDE, 1.0)] + [(BESIDE, 1.0, 0.0), (0.0, 1.0, 0.0)],
    )
    monkeypatch.setattr(yield_surface, "SHARES", dict.fromkeys(sides, 1.0))
    monkeypatch.setattr(yield_surface, "QUICK_SIDES", sides)
    monkeypatch.setattr(yield_surface, "FEWEST", 3)
    monkeypatch.setattr(yield_surface, "PLANE", plane)
    dilating = [(1.0, 0.0, 1.0), (BESIDE, 0.0, 1.0), (0.0, 0.0, 1.0)]
    monkeypatch.setattr(yield_surface, "DIRECTIONS", plane + dilating)
    claims = reproduce.FIGURES["yield"].reproduce(tmp_path, Effort(samples=2, quick=True))
    few = "too few samples"
    assert [claim.verdict for claim in claims] == ["confirmed", few, few, "confirmed", few]
    assert {path.name for path in tmp_path.iterdir()} == {f"yield.{ending}" for ending in ("csv", "pdf", "png")}
