"""The benchmark of speed: what it times, counts and reports. No time decides about anything here."""

import csv
import time
from dataclasses import replace

import numpy as np
import pytest
from taichi_bearings_studies.benchmarks import kernels, methods, scans, speed
from taichi_bearings_studies.benchmarks.machine import describe
from taichi_bearings_studies.benchmarks.speed import QUICK, Report, chosen_threads, measure, only
from taichi_bearings_studies.benchmarks.speed_report import NAMES, as_json, size, table, write
from taichi_bearings_studies.benchmarks.timing import COLUMNS, PARTS, Row, timed
from taichi_bearings_studies.plots.roofline import Ceilings
from taichi_bearings_studies.report import Files

from taichi_bearings.errors import BearingsError, FileError, InputError
from tests.scenes import make_scene

SOME = ("linear-solver", "gradient-descent", "interior-point")
TINY = replace(
    QUICK, solved=((4, 5),), seconds=0.3, scanned={(3, 3, 4): 2}, rounds=2, slice_seconds=1e-4, largest_stream=2**16
)


def test_things_are_timed_in_turns_after_a_warm_up():
    calls = []

    def sleeper(name, seconds):
        def call(number):
            calls.append(name)
            time.sleep(seconds * number)

        return call

    found = timed({"short": sleeper("short", 1e-4), "long": sleeper("long", 4e-4)}, rounds=3, slice_seconds=4e-3)
    assert calls[-6:] == ["short", "long"] * 3
    assert len(calls) > 8
    short, long = (found[name].columns for name in ("short", "long"))
    assert short["quickest"] >= 1e-4  # no sleep is shorter than asked for
    assert long["quickest"] >= 4e-4
    assert long["quickest"] <= long["seconds"] <= long["slowest"]
    assert long["seconds_processor"] < long["seconds"]  # it slept


def test_lattices_that_do_not_fit_are_left_out_before_they_are_made(monkeypatch, needs_f64):
    monkeypatch.setattr(kernels, "free_bytes", lambda: 1e9)
    monkeypatch.setattr("taichi_bearings_studies.benchmarks.kernels.Scene", None)  # nothing is made
    task = kernels.Task(((512, 512, 512),), "f64", 1, 1, 1e-3, largest_stream=0)
    assert list(kernels.measure(task)) == ["512x512x512 is left out: it needs 241.6 GB, 0.8 GB may be taken"]


def test_methods_have_their_rows_as_far_as_they_solve_a_scene(monkeypatch, needs_f64):
    few = {name: one for name, one in methods.all_methods().items() if name in SOME}
    monkeypatch.setattr(methods, "all_methods", lambda: few)
    monkeypatch.setattr(methods, "TOLERANCE", 1e-4)
    rows = list(methods.measure(methods.Task(((4, 5),), ("coulomb",), 1, rounds=2, seconds=20.0, peers=False)))
    by_name = {row.what: row for row in rows}
    assert set(by_name) == set(SOME) - {"linear-solver"}
    assert all(row.gap <= 1e-4 for row in rows)
    assert by_name["interior-point"].rounds == 2
    sweeps = by_name["gradient-descent"]
    assert sweeps.operations == 27 * 20 * sweeps.iterations  # tests/benchmarks/test_counts.py


def test_a_factorisation_is_counted_as_dense_elimination_where_nothing_is_divided():
    scene = make_scene((3, 5))  # 9 free discs: one front
    unknowns = 9
    operations, entries = methods.factorisation(scene)
    assert operations == pytest.approx(unknowns**3 / 3)
    assert entries == unknowns**2


def test_contenders_solve_the_same_samples(monkeypatch):
    samples = scans.samples_of((3, 3, 4), first=5, number=3)
    assert [sample.settings.seed for sample in samples] == [5, 6, 7]
    records = scans.solve_samples(samples)
    assert all(record["scalars"]["states_proven"] for record in records)
    here = [peer for peer in scans.find_peers()[0] if peer.name == "clarabel"]
    if here:
        found = scans.solve_by_peer(samples, here[0])
        assert [record["key"] for record in found] == [sample.key for sample in samples]
        assert {record["scalars"]["status"] for record in found} == {"certified"}
    pytest.importorskip("moreau")
    assert {record["scalars"]["status"] for record in scans.solve_by_moreau(samples)} == {"certified"}


def test_a_programme_of_a_scan_is_that_of_its_scene():
    (sample,) = scans.samples_of((3, 3, 4), first=5, number=1)
    own = scans.programme_of(sample.settings)
    assert (own.linear == scans.conic_programme(make_scene((3, 3, 4), seeds=(5,))).linear).all()


def test_parts_and_threads_that_are_not_there_are_refused():
    with pytest.raises(InputError, match="'walk' is none of"):
        speed.chosen_parts("kernels,walk")
    assert speed.chosen_parts(None) == tuple(PARTS)
    for text in ("0", "4096", "two"):
        with pytest.raises(InputError, match=f"threads is '{text}'"):
            chosen_threads(text, QUICK)
    with pytest.raises(InputError, match="shape"):
        only(QUICK, ["3"], None)
    assert only(QUICK, ["4,5,6"], "f32").moved == ((4, 5, 6),)
    assert only(QUICK, ["4,5"], "f32").precisions == ("f32",)


def test_threads_in_between_take_the_time_for_all(monkeypatch):
    monkeypatch.setattr("taichi_bearings.runtime.available_threads", lambda: 12)
    assert chosen_threads(None, QUICK) == (1, 12)
    assert chosen_threads(None, speed.FULL) == (1, 2, 4, 8, 12)
    assert chosen_threads("3,5", speed.FULL) == (3, 5)


def test_what_is_missing_is_named_for_the_parts_that_want_it(monkeypatch):
    monkeypatch.setattr(speed, "find_compiler", lambda: None)
    monkeypatch.setattr(speed, "find_peers", lambda: ([], {"clarabel": "not installed; pip install it"}))
    monkeypatch.setattr(speed.dynamics, "missing", lambda threads: {"YADE": "not installed; apt install yade"})
    monkeypatch.setattr(speed, "_work", lambda *_: [])
    named = {part: set(measure(TINY, (part,), (1,)).missing) for part in PARTS}
    assert named == {
        "memory": set(), "kernels": {"C sweep"}, "methods": {"clarabel"}, "scans": {"clarabel"}, "dynamics": {"YADE"},
    }  # fmt: skip


def test_without_a_c_compiler_the_others_are_timed(monkeypatch, tmp_path, needs_f64):
    monkeypatch.setattr("taichi_bearings_studies.benchmarks.baselines.find_compiler", lambda: None)
    monkeypatch.setattr(kernels, "_candidate", lambda name, *_: kernels.Candidate(name, None, 1))  # none is begun
    task = kernels.Task(((3, 4),), "f64", 1, 1, 1e-4, largest_stream=0)
    names = [one.name for one in kernels._candidates(make_scene((3, 4)), task, tmp_path)]
    assert kernels.NUMPY in names
    assert kernels.C not in names


def test_a_part_that_fails_costs_nothing_else(monkeypatch):
    def rows():
        yield Row(part="kernels", what="sweep", seconds=1.0)
        raise BearingsError("it broke")

    monkeypatch.setattr(speed, "_work", lambda *_: [("one", rows), ("two", rows)])
    report = measure(TINY, ("kernels",), (1,))
    assert len(report.rows) == 2
    assert report.notes == ["one is left out: it broke", "two is left out: it broke"]


def test_an_interrupt_keeps_what_was_measured(monkeypatch):
    def rows():
        yield Row(part="kernels", what="sweep", seconds=1.0)
        raise KeyboardInterrupt

    monkeypatch.setattr(speed, "_work", lambda *_: [("one", rows), ("two", rows)])
    report = measure(TINY, ("kernels",), (1,))
    assert report.interrupted
    assert len(report.rows) == 1


def some_report():
    rows = [
        Row(part="memory", what="stream", working_set=w, bandwidth=b, threads=1, seconds=1e-6, bytes=w)
        for w, b in ((2.0**14, 9e10), (2.0**20, 3e10), (2.0**28, 1e10))
    ]
    rows += [
        Row(
            part="kernels", what=name, shape=(8, 8, 8), components=2, threads=1, seconds=1e-5, quickest=9e-6,
            slowest=2e-5, bytes=1e5, operations=4e4, roots=1e3, bandwidth=1e10, working_set=1e5, bandwidth_here=4e10,
            operations_here=5e10, roof=0.25, limit="memory", contact_updates=1e8, seconds_compile=1.0,
        )
        for name in ("sweep", "Cundall-Strack step")
    ]  # fmt: skip
    rows.append(Row(part="scans", what="other", shape=(3, 3, 4), threads=2, seconds=0.1, ratio=2.5))
    report = Report(describe() | {"caches": {"L1": 2**15, "L2": 2**20}}, rows, ["128x128x128 is left out: why"])
    report.missing = {"yade": "not installed; apt install yade"}
    return report


def test_the_report_says_the_same_in_every_form(tmp_path):
    report = some_report()
    written = write(Files(tmp_path / "a", NAMES), report)
    assert [path.name for path in written] == ["speed.csv", "roofline.png"]
    assert written[1].stat().st_size > 20_000
    lines = [line for line in written[0].read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    stored = list(csv.DictReader(lines))
    assert tuple(stored[0]) == COLUMNS
    assert [float(row["seconds"]) for row in stored] == [row.seconds for row in report.rows]
    assert stored[3]["shape"] == "8x8x8"
    text = table(report)
    for words in (
        "Cundall-Strack step",
        "25% (memory)",
        "2.5 times as fast",
        "Without yade: not installed; apt",
        "why",
    ):
        assert words in text
    found = as_json(report, written)
    assert found["rows"][3]["roof"] == 0.25
    assert "ratio" not in found["rows"][3]
    assert found["peers_missing"] == report.missing
    with pytest.raises(FileError, match="already exists"):
        Files(tmp_path / "a", NAMES)


def test_levels_are_read_where_they_are_half_full():
    ceilings = Ceilings(2.0 ** np.array([14, 19, 28]), np.array([90.0, 30.0, 10.0]), 50.0, {"L1": 2**15, "L2": 2**20})
    assert ceilings.levels() == pytest.approx({"L1": 90.0, "L2": 30.0, "memory": 10.0})


def test_sizes_read_well():
    assert [size(n) for n in (12, 2048, 1.02 * 2**20)] == ["12 B", "2 KiB", "1.02 MiB"]
