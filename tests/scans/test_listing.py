"""`bearings list` says of every folder what it holds, damaged ones too, and is fast."""

import json
import os
import shutil

import pytest

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.files.scan_journal import Journal
from taichi_bearings.runs.run import run as run_packing
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.listing import entries
from taichi_bearings.scans.plan import count_samples, read_plan
from tests.cli.commands import bearings, refused

SCAN = """law = "coulomb"
[scan]
seed = { start = 0, stop = 4 }
shape = [[4, 4], [5, 5], [6, 6]]
[[scan.zip]]
spin_top = [1, 2]
spin_bottom = [0, 0.5]
"""


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("outputs")
    one = tb.solve(tb.Scene.random((4, 5), seed=7), "planar-cut", threads=1)
    one.save(folder / "one")
    tb.solve(tb.Scene.random((4, 5), seed=3, replicas=2), "planar-cut", threads=1).save(folder / "two")
    (folder / "scan").mkdir()
    (folder / "scan" / "scan.toml").write_text(SCAN)
    samples = read_plan(folder / "scan" / "scan.toml").samples
    for name, part, status in (
        ("samples.jsonl", samples[:5], "certified"),
        ("part-1-of-2.jsonl", samples[5:7], "failed"),
    ):
        with Journal(folder / "scan" / name) as journal:
            journal.append([{"key": s.key, "scalars": {"power": 1.0, "status": status}, "bins": {}} for s in part])
    with Journal(folder / "scan" / "samples.jsonl") as journal:  # one that failed was tried again
        journal.append([{"key": samples[5].key, "scalars": {"power": 1.0, "status": "failed"}, "bins": {}}])
    with (folder / "scan" / "samples.jsonl").open("ab") as file:
        file.write(b'{"crc32": "00000000", "sample": {"key": "torn", "scalars": {"status": "certified"')
    (folder / "figures").mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "stress").mkdir()  # a report of `bearings stress`, which is neither a run nor a scan
    for name in ("summary.json", "stress.csv", "cells.jsonl"):
        (folder / "stress" / name).write_text("{}")
    for age, name in enumerate(("one", "two", "scan")):
        for file in (folder / name).iterdir():
            os.utime(file, (1e9 - age, 1e9 - age))
    return folder


def test_runs_and_scans_are_told_newest_first(outputs):
    one, two, scan = entries(outputs)
    assert [entry.path for entry in (one, two, scan)] == [str(outputs / name) for name in ("one", "two", "scan")]
    summary = json.loads((outputs / "one" / "summary.json").read_text())
    assert all(one.values[key] == summary[key] for key in ("power", "gap", "status", "seed", "shape", "states_proven"))
    assert "4x5 coulomb, planar-cut, seed 7: certified; P = " in one.words()
    assert "states proven" in one.words()
    assert "seeds 3-4: 2 certified; mean P = " in two.words()
    wanted = {"samples_asked": 24, "samples_done": 5, "samples_failed": 2, "statuses": {"certified": 5}}
    assert {key: scan.values[key] for key in wanted} == wanted
    assert scan.values["scanned"] == ["seed", "shape", "spin_top", "spin_bottom"]
    assert "5 of 24 samples, 2 failed; 5 certified" in scan.words()
    assert entries(outputs / "one")[0] == one
    assert count_samples(outputs / "scan" / "scan.toml")[0] == len(read_plan(outputs / "scan" / "scan.toml").samples)


def test_a_run_with_some_states_proven_is_not_said_to_have_none(tmp_path):
    early = tb.solve(tb.Scene.random((4, 4), seed=0), "gradient-descent", iterations=4, threads=1)
    assert 0 < early.unproven < early.contacts
    early.save(tmp_path / "early")
    (entry,) = entries(tmp_path)
    assert entry.words().endswith(", not all states proven")


def test_a_line_names_what_closes_and_drives_a_run_where_that_is_unusual(outputs, tmp_path):
    scene = tb.Scene.random((4, 4, 4), seed=1, periodic="x,y", top=(1.0, -0.5, 0.0, 0.2))
    tb.solve(scene, threads=1).save(tmp_path / "a")
    run_packing(RunSettings(shape=(4, 4, 4), driven="walls", bottom=(0.5, 0.0, 0.0), figures="none"), tmp_path / "b")
    walls, sides = entries(tmp_path)
    assert ", seed 1, periodic x,y, top 1,-0.5,0;0.2, bottom 0,0,0;0: certified; P = " in sides.words()
    assert ", seed 0, bottom 0.5,0,0;0, driven walls: certified; P = " in walls.words()
    assert sides.as_dict()["periodic"] == ["x", "y"]
    assert (sides.values["top"], sides.values["driven"], walls.values["driven"]) == ([1, -0.5, 0, 0.2], None, "walls")
    report = tb.analyse(tb.load(tmp_path / "a")).report
    assert (report["periodic"], report["top"], report["bottom"]) == (["x", "y"], [1, -0.5, 0, 0.2], [0, 0, 0, 0])
    assert set(report) >= {"winds_x", "winds_y", "spanning_winds_x", "spanning_winds_y"}
    assert "winds_x" not in tb.analyse(tb.load(outputs / "one")).report
    assert "periodic x,y, top 1" in bearings("analyse", tmp_path / "a", "--no-figures").stdout.splitlines()[0]


DAMAGE = {
    "summary.json is not JSON": ("summary.json", b'{"power": 1.'),
    "does not hold a JSON object": ("summary.json", b"[1, 2]"),
    "method in summary.json is missing": (
        "summary.json",
        b'{"shape": [3], "law": "a", "seed": 1, "status": "c", "power": 1.0}',
    ),
    "summary.json is not JSON: 'utf-8'": ("summary.json", b"\xff\xfe"),
    "gap in summary.json is missing": ("summary.json", {"gap": [[1]]}),
    "power in summary.json is missing": ("summary.json", {"power": 10**400}),
    "power in summary.json is missing ": ("summary.json", {"power": float("nan")}),
    "seed in summary.json is missing": ("summary.json", {"seed": "one"}),
    "maximum recursion": ("summary.json", b"[" * 100_000),
    "not valid TOML": ("scan.toml", b"= ["),
    "does not exist": ("scan.toml", None),
    "no run.h5": ("run.h5", None),
    "no summary.json": ("summary.json", None),
}


@pytest.mark.parametrize("sentence", DAMAGE)
def test_a_damaged_folder_is_named_in_its_line(sentence, outputs, tmp_path):
    name, content = DAMAGE[sentence]
    for folder in ("one", "scan"):
        shutil.copytree(outputs / folder, tmp_path / folder)
    broken = tmp_path / ("scan" if name == "scan.toml" else "one")
    if content is None:
        (broken / name).unlink()
    elif isinstance(content, dict):
        summary = json.loads((broken / name).read_text())
        (broken / name).write_text(json.dumps(summary | content))
    else:
        (broken / name).write_bytes(content)
    found = {entry.path: entry for entry in entries(tmp_path)}
    assert len(found) == 2
    words = found.pop(str(broken)).words()
    assert words.startswith("cannot be read: ")
    assert sentence.strip() in words or (sentence == "maximum recursion" and "recursion" in words)
    assert "\n" not in words
    assert next(iter(found.values())).problem == ""


def test_the_command_lists_them_for_people_and_programs(outputs, tmp_path):
    done = bearings("list", outputs, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["entries"]
    assert [entry["kind"] for entry in found] == ["run", "run", "scan"]
    assert found[0]["modified"].startswith("2001-09-")
    told = bearings("list", outputs)
    assert len(told.stdout.splitlines()) == 3
    assert "2 runs and 1 scan" in told.stderr
    refused("list", tmp_path / "nowhere")
    with pytest.raises(InputError):
        entries(outputs / "notes.txt")
