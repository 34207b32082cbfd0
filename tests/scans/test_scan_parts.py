"""Parts of a scan, as job arrays solve them, and their merge: every sample once, whatever runs beside it."""

import json
import math
from collections import Counter
from dataclasses import replace

import pytest

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.scans.parts import Part, part_of
from taichi_bearings.scans.scan import merge, scan
from tests.cli.commands import bearings, refused
from tests.scans.scan_faults import Here
from tests.scans.test_scan import MIXED, assert_same_but_for_the_clock


def test_parts_are_the_whole_and_alike_whatever_the_order_of_the_keys(plan_of):
    sizes, seeds = "shape = [[4, 4], [40, 40], [9, 9, 9]]", "seed = { start = 0, stop = 31 }"
    tolerances = "tolerance = [1e-4, 1e-6, 1e-8]"
    for lines in ([sizes, tolerances, seeds], [seeds, tolerances, sizes], [sizes, "law = ['coulomb', 'viscous']"]):
        plan = plan_of("[scan]\n" + "\n".join(lines))
        for of in (1, 2, 3, 7, 50):
            parts = [part_of(plan, Part(of, number)).samples for number in range(1, of + 1)]
            together = [sample.key for part in parts for sample in part]
            assert sorted(together) == sorted(sample.key for sample in plan.samples)
            sites = [sum(math.prod(sample.settings.shape) for sample in part) for part in parts]
            assert max(sites) - min(sites) <= 1600 + 729
            assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_parts_and_merge_equal_the_undisturbed_scan(plan_of, tmp_path):
    plan = plan_of(MIXED)
    for number in (2, 3, 1):
        report = scan(plan, tmp_path / "scan", engine=Here(), part=Part(3, number))
        assert (report["samples"], report["reached"], report["solved_now"]) == (4, 4, 4)
        assert report["files"] == [str(tmp_path / "scan" / f"part-{number}-of-3.jsonl")]
        if number == 2:
            early = merge(plan, tmp_path / "scan")
            assert (early["samples"], early["done"], early["missing"]) == (12, 4, 8)
            assert early["incomplete_parts"] == [{"part": "1/3", "missing": 4}, {"part": "3/3", "missing": 4}]
            assert read_scan(tmp_path / "scan").samples == 4
    journals = {file: file.read_bytes() for file in (tmp_path / "scan").glob("*.jsonl")}
    assert len(journals) == 3
    again = scan(plan, tmp_path / "scan", part=Part(3, 2))
    assert (again["reached"], again["solved_now"]) == (4, 0)
    assert scan(plan, tmp_path / "scan", part=Part(2, 1))["solved_now"] == 0  # dealt out anew: nothing is missing
    assert all(file.read_bytes() == before for file, before in journals.items())
    report = merge(plan, tmp_path / "scan")
    assert (report["reached"], report["missing"], report["incomplete_parts"]) == (12, 0, [])
    scan(plan, tmp_path / "undisturbed", engine=Here())
    assert_same_but_for_the_clock(tmp_path / "scan", tmp_path / "undisturbed")


def test_the_scan_itself_does_what_parts_have_left(plan_of, tmp_path, caplog):
    plan = plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 9 }\n")
    scan(plan, tmp_path / "scan", engine=Here(), part=Part(3, 1))
    scan(plan, tmp_path / "scan", engine=Here(), part=Part(3, 2))
    journal = tmp_path / "scan" / "part-2-of-3.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([lines[0].replace(b"power", b"pover"), lines[1], lines[2][:50]]))
    assert scan(plan, tmp_path / "scan", engine=Here())["solved_now"] == 5
    assert "line 1" in caplog.text
    scan(plan, tmp_path / "undisturbed", engine=Here())
    assert_same_but_for_the_clock(tmp_path / "scan", tmp_path / "undisturbed")


def test_a_part_is_refused_while_it_runs_and_others_are_not(plan_of, tmp_path):
    plan, tried = plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 4 }\n"), Counter()

    def try_meanwhile(progress):
        if not tried:
            with pytest.raises(FileError) as caught:
                scan(plan, tmp_path / "scan", part=Part(2, 1))
            assert str(caught.value).startswith(f"part-1-of-2 in {tmp_path / 'scan'} is in use by another process")
            assert "\n" not in str(caught.value)
            tried["refused"] += 1
            tried["other"] = scan(plan, tmp_path / "scan", engine=Here(), part=Part(2, 2))["reached"]

    assert scan(plan, tmp_path / "scan", engine=Here(), part=Part(2, 1), monitor=try_meanwhile)["reached"] == 2
    assert tried == {"refused": 1, "other": 2}
    assert merge(plan, tmp_path / "scan")["reached"] == 4


def test_folders_that_are_no_scan_cannot_be_merged(plan_of, tmp_path):
    plan = plan_of("shape = [5, 5]\n[scan]\nseed = [1, 2]\n")
    with pytest.raises(FileError, match="is not the folder of a scan"):
        merge(plan, tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="holds no samples"):
        merge(plan, tmp_path / "empty")
    scan(plan, tmp_path / "scan", engine=Here(), part=Part(2, 1))
    solved = part_of(plan, Part(2, 1)).samples
    others = tuple(sample for sample in plan.samples if sample not in solved)
    with pytest.raises(FileError, match="1 samples that this scan does not ask for"):
        merge(replace(plan, samples=others), tmp_path / "scan")


@pytest.mark.parametrize("text", ["0/3", "4/3", "2", "a/b", "1/0", "-1/3", "1/3/5", "1.0/3", "1/1000000", ""])
def test_bad_parts_are_named(text):
    with pytest.raises(InputError, match="it must be i/n with whole numbers") as caught:
        Part.parse(text)
    assert repr(text) in str(caught.value)


def test_the_command(tmp_path):
    file, folder = tmp_path / "scan.toml", tmp_path / "s"
    file.write_text("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 6 }\n")
    assert bearings("scan", file, "--part", "1/2", "--out", folder).returncode == 0
    early = bearings("scan", folder, "--merge")
    assert early.returncode == 1
    assert "3 of 6 samples have a result" in early.stdout
    assert "part 2/2 lacks 3 samples" in early.stdout
    assert bearings("scan", file, "--part", "2/2", "--out", folder).returncode == 0
    done = bearings("scan", folder, "--merge", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["reached"] == 6
    for words, expected in (
        (["--part", "3/2", "--out", folder], "--part is '3/2'"),
        (["--part", "1/2"], "need --out DIR"),
        (["--merge", "--part", "1/2", "--out", folder], "--merge only combines what is solved"),
        (["--scheduler", "tcp://node:1", "--workers", "2"], "the Dask cluster provides the workers"),
    ):
        assert expected in refused("scan", file, *words)
