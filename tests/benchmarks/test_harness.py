"""The harness of the benchmarks: what it times, keeps and reports. No time decides about anything here."""

import time

import pytest
from taichi_bearings_studies.benchmarks import scans, table
from taichi_bearings_studies.benchmarks.harness import Benchmark, Report, as_json, machine, measure, text, timed, write
from taichi_bearings_studies.benchmarks.table import BENCHMARKS, QUICK, planned

from taichi_bearings.errors import BearingsError, InputError
from tests.scenes import make_scene
from tests.tables import rows_of


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
    short, long = (found[name].row for name in ("short", "long"))
    assert short["quickest"] >= 1e-4  # no sleep is shorter than asked for
    assert long["quickest"] >= 4e-4
    assert long["quickest"] <= long["seconds"] <= long["slowest"]
    assert long["seconds_processor"] < long["seconds"]  # it slept


def test_contenders_of_a_scan_solve_the_same_samples():
    samples = scans.samples_of((3, 3, 4), first=5, number=3)
    assert [sample.settings.seed for sample in samples] == [5, 6, 7]
    assert all(record["scalars"]["states_proven"] for record in scans.solve_samples(samples))
    own = scans.conic_programme(make_scene((3, 3, 4), seeds=(9,))).with_friction(make_scene((3, 3, 4), seeds=(5,)))
    assert (own.linear == scans.conic_programme(make_scene((3, 3, 4), seeds=(5,))).linear).all()
    for peer in [peer for peer in scans.find_peers()[0] if peer.name == "clarabel"][:1]:
        found = scans.solve_by_peer(samples, peer)
        assert [record["key"] for record in found] == [sample.key for sample in samples]
        assert {record["scalars"]["status"] for record in found} == {"certified"}


def test_what_is_asked_for_is_planned_and_what_is_not_there_refused():
    for given, words in (
        ({"threads": "0"}, "threads is '0'"), ({"threads": "4096"}, "threads is '4096'"),
        ({"threads": "two"}, "threads is 'two'"), ({"shape": ["3"]}, "shape"), ({"law": ["dry"]}, "law is 'dry'"),
        ({"methods": "gradient-descent,magic"}, "'magic' is none of"), ({"time_limit": "0"}, "a positive number"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            planned("quick", **given)
    plan = planned("quick", shape=["4,5,6", "4,5"], law=["viscous"], precision="f32", seed="5", time_limit="2")
    assert plan.moved == ((4, 5, 6),)
    assert plan.precisions == ("f32",)
    assert plan.scenes == (((4, 5, 6), "viscous"), ((4, 5), "viscous"))
    assert (plan.seed, plan.seconds) == (5, 2.0)
    assert {law for _, law in planned(None, law=["viscous"]).scenes} == {"viscous"}
    assert {law for _, law in planned(None).scenes} == {"coulomb", "viscous"}
    assert planned(None).seconds == table.USUAL.seconds


def broken(error):
    """A benchmark of two tasks that both end so after a row each."""

    def rows():
        yield {"what": "sweep", "seconds": 1.0}
        raise error

    absent = {"YADE": "not installed; apt install yade"}
    return {"some": Benchmark("Some", lambda plan: [("one", rows), ("two", rows)], missing=lambda: absent)}


def test_a_part_that_fails_costs_nothing_else_and_an_interrupt_keeps_what_was_measured():
    report = measure(broken(BearingsError("it broke")), QUICK)
    assert len(report.rows["some"]) == 2
    assert report.notes == ["some one left out: it broke", "some two left out: it broke"]
    assert report.missing == {"YADE": "not installed; apt install yade"}
    report = measure(broken(KeyboardInterrupt()), QUICK)
    assert report.interrupted
    assert len(report.rows["some"]) == 1


def some_report():
    kernel = {
        "what": "sweep", "shape": (8, 8, 8), "components": 2, "precision": "f64", "threads": 1, "seconds": 1e-5,
        "quickest": 9e-6, "slowest": 2e-5, "seconds_processor": 1e-5, "contact_updates": 1e8,
    }  # fmt: skip
    rows = [kernel | {"seconds_compile": 1.0}, kernel | {"what": "NumPy sweep", "ratio": 2.5}]
    return Report({"kernels": rows}, ["128x128x128 is left out: why"], {"yade": "not installed; apt install yade"})


def test_the_report_says_the_same_in_every_form(tmp_path):
    chosen, report, here = {"kernels": BENCHMARKS["kernels"]}, some_report(), machine()
    written = write(tmp_path, chosen, report, here)
    assert [path.name for path in written] == ["report.md", "kernels.csv", "kernels.png"]
    assert written[2].stat().st_size > 20_000
    stored = rows_of(written[1])
    assert [float(row["seconds"]) for row in stored] == [row["seconds"] for row in report.rows["kernels"]]
    assert (stored[0]["shape"], stored[1]["seconds_compile"]) == ("8x8x8", "")
    said = text(chosen, report, here)
    for words in ("NumPy sweep", "100 M", "2.5 times as fast", "Without yade: not installed; apt", "why"):
        assert words in said
    assert written[0].read_text(encoding="utf-8") == said
    found = as_json(report, here, written)
    assert found["kernels"][1]["ratio"] == 2.5
    assert found["peers_missing"] == report.missing
