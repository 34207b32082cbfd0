"""Run time against error: what it claims is true of the exact minima, and it says so in every form."""

import numpy as np
import pytest
from taichi_bearings_studies.benchmarks.harness import Report, text, write
from taichi_bearings_studies.benchmarks.methods import contradictions, judged, measure
from taichi_bearings_studies.benchmarks.table import BENCHMARKS

from taichi_bearings.runs.settings import RunSettings
from tests.scenes import minima
from tests.tables import rows_of

FIRST_TWO = ("gradient-descent", "cundall-strack")


@pytest.fixture(scope="module")
def rows(needs_f64):
    found = []
    for shape, law in (((3, 3, 3), "coulomb"), ((5, 4), "viscous")):
        settings = RunSettings(shape=shape, law=law, threads=1, time_limit=0.3)
        found += measure(settings, FIRST_TWO, with_peers=shape == (3, 3, 3), rounds=2)
    return found


def made_up(method, seconds, power, bound, what=""):
    columns = {"seconds": seconds, "power": power, "lower_bound": bound, "iterations": [1] * len(seconds)}
    about = {"shape": (3, 4), "law": "coulomb", "seed": 0, "status": "done"}
    return about | {"method": method, "what": what or method, "setting": ["default"] * len(seconds)} | columns


def test_errors_are_upper_bounds_and_gaps_are_proven(rows):
    exact = next(e["power_minimum"] for e in minima((3, 3, 3)) if e["seed"] == 0)
    assert contradictions(rows) == []
    assert [row["what"] for row in rows[:2]] == [row["what"] for row in rows[-2:]] == list(FIRST_TWO)
    for row in rows:
        power, bound, error = (np.array(row[name]) for name in ("power", "lower_bound", "error"))
        assert (error >= row["reference_gap"]).all()
        assert (error <= np.array(row["gap"]) + 1e-15).all()
        assert row["gap"] == pytest.approx((power - bound) / power, abs=1e-12)
        assert min(row["seconds"]) > 0
        if row["shape"] == (3, 3, 3):
            assert max(bound) <= exact <= min(power)
            assert (error >= (power - exact) / power - 1e-15).all()


def test_the_error_never_falls_below_what_the_reference_leaves_open():
    first, second = judged([made_up("a", [1, 2], [20.0, 11.0], [5.0, 9.0]), made_up("b", [1], [10.0], [9.5])])
    assert first["reference_gap"] == second["reference_gap"] == pytest.approx(0.05)
    assert first["error"] == pytest.approx([10.5 / 20, 1.5 / 11])
    assert second["error"] == pytest.approx([0.05])
    assert first["gap"] == pytest.approx([0.75, 2 / 11])
    assert first["seconds_to"] == dict.fromkeys(("1e-02", "1e-04", "1e-06", "1e-08", "1e-10"))
    (exact,) = judged([made_up("a", [1.0], [10.0], [10.0])])
    assert exact["reference_gap"] == exact["gap"][0] == np.finfo(float).eps  # round-off and not zero
    assert exact["seconds_to"]["1e-10"] == 1.0


def test_a_bound_above_a_power_is_a_contradiction():
    (line,) = contradictions([made_up("a", [1.0], [10.0], [9.0]), made_up("b", [1.0], [12.0], [11.0])])
    assert line == "3x4 coulomb: b proves 11.0, a has 10.0"


def test_files_hold_every_checkpoint(rows, tmp_path):
    chosen, report = {"methods": BENCHMARKS["methods"]}, Report({"methods": rows})
    here = {"processor": "some", "threads": "1", "load": None}
    stored, figure = write(tmp_path, chosen, report, here)[1:]
    found = rows_of(stored)
    assert len(found) == sum(len(row["seconds"]) for row in rows)
    assert [float(line["error"]) for line in found] == [value for row in rows for value in row["error"]]
    assert {line["shape"] for line in found} == {"3x3x3", "5x4"}
    assert figure.read_bytes()[:4] == b"\x89PNG"
    assert f"| {FIRST_TWO[0]} " in text(chosen, report, here)
