"""Scans as they are read back, killed, grown and complete ones alike; and what figures say of samples they lack."""

import csv
import shutil

import numpy as np
import pytest

from taichi_bearings.errors import FileError
from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.scans.figure import Request, columns_of, look_of, plot_scan, points_of
from taichi_bearings.scans.histogram import histogram, pooled, read_source
from taichi_bearings.scans.scan import scan
from taichi_bearings.scans.stored_scans import open_scan
from tests.scans.scan_faults import Here, asking

LAWS = "shape = [4, 5]\n[scan]\nlaw = ['coulomb', 'viscous']\nseed = { start = 0, stop = 6 }\n"


def lacking(stored):
    """How many samples are not computed yet."""
    return stored.reasons.tolist().count("not computed yet")


@pytest.fixture
def folder(plan_of, tmp_path):
    scan(plan_of(LAWS), tmp_path / "scan", engine=Here())
    return tmp_path / "scan"


def killed(folder, lines):
    """The scan as a kill would have left it, when so many samples were done and no table was written."""
    journal = folder / "samples.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:lines]) + b'{"crc32": "0')
    (folder / "scan.h5").unlink()
    (folder / "scan.csv").unlink()


def told(folder, y, x="law", **more):
    lines = []
    files = plot_scan(folder, Request(y, x, **more), tell=lines.append)
    with files[1].open() as file:
        return lines, list(csv.DictReader(file))


def test_a_killed_scan_opens_with_what_it_has(folder):
    killed(folder, 8)
    stored = open_scan(folder)
    assert lacking(stored) == 4
    assert stored.table["law"].tolist() == ["coulomb"] * 6 + ["viscous"] * 6
    assert np.isfinite(stored.table["power"]).sum() == 8
    lines, rows = told(folder, "power")
    assert lines == ["8 of 12 samples (4 not computed yet)"]
    assert [(row["law"], row["number"], row["asked"], row["left_out"]) for row in rows] == [
        ("coulomb", "6", "6", ""),
        ("viscous", "2", "6", "4 not computed yet"),
    ]
    report = histogram([folder], folder.parent / "h", by="law")
    assert report["left_out"] == {"not computed yet": 4}
    assert report["groups"][1]["census"] == "2 of 6 samples (4 not computed yet)"
    text = (folder.parent / "h" / "power_histogram.csv").read_text()
    assert "# law viscous: slip_threshold " in text
    assert "samples 2 of 6 (4 not computed yet)" in text
    assert {file.name for file in folder.iterdir()} == {
        "samples.jsonl", "scan.toml", "power_against_law.pdf", "power_against_law.csv",
    }  # fmt: skip


def test_a_table_that_is_older_than_the_journal_or_the_scan_is_not_used(folder, plan_of):
    complete = folder / "scan.h5"
    assert open_scan(folder).attributes.keys() == read_scan(folder).attributes.keys()  # schema, and so from the file
    old = complete.read_bytes()
    larger = plan_of(LAWS.replace("6", "7"))
    (folder / "scan.toml").write_text(larger.text)  # grown, and killed before the first new sample
    assert lacking(open_scan(complete)) == 2
    scan(larger, folder, engine=Here())
    complete.write_bytes(old)
    assert (open_scan(folder).samples, lacking(open_scan(folder))) == (14, 0)
    complete.write_bytes(b"damaged")
    assert open_scan(folder).samples == 14


def test_no_figure_in_the_folder_is_older_than_the_scan(folder, plan_of):
    plan = plan_of(LAWS)
    _, figures = told(folder, "power"), sorted(folder.glob("power_against_law.*"))
    (folder / "mine_against_yours.csv").write_text("x,y\n")
    assert scan(plan, folder, engine=Here())["removed"] == []
    assert all(file.is_file() for file in figures)
    assert sorted(scan(plan_of(LAWS.replace("6", "7")), folder, engine=Here())["removed"]) == sorted(map(str, figures))
    assert not any(file.exists() for file in figures)
    assert (folder / "mine_against_yours.csv").is_file()


def test_a_scan_whose_file_is_gone_is_read_from_its_table_or_refused(folder, caplog):
    with (folder / "samples.jsonl").open("ab") as journal:
        journal.write(b"torn")
    (folder / "scan.toml").unlink()
    assert open_scan(folder).samples == 12
    assert "is out of date and the journals beside it cannot be read" in caplog.text
    shutil.copy(folder / "scan.h5", folder.parent)
    assert open_scan(folder.parent / "scan.h5").samples == 12
    (folder / "scan.h5").unlink()
    with pytest.raises(FileError, match=r"scan\.toml does not exist"):
        open_scan(folder)


def test_what_does_not_span_has_no_path_and_is_not_averaged_in(plan_of, tmp_path):
    plan = plan_of('shape = [4, 4, 4]\ndistribution = "lognormal:0.4,0.8"\n[scan]\nseed = { start = 0, stop = 6 }\n')
    scan(asking(plan, analyse=True), tmp_path / "scan", engine=Here(analyse=True))
    table = open_scan(tmp_path / "scan").table
    spans = table["spans"]
    assert 0 < spans.sum() < 6
    lines, (row,) = told(tmp_path / "scan", "shortest_path", "L")
    assert lines == [f"{spans.sum()} of 6 samples ({6 - spans.sum()} that do not span)"]
    assert float(row["mean"]) == table["shortest_path"][spans].mean() >= 3


def test_one_seed_at_two_values_of_an_irrelevant_parameter_is_one_sample(plan_of, tmp_path):
    """A minimisation uses no stiffness, as scans of earlier versions could have it."""
    once = plan_of("shape = [4, 4]\n[scan]\nseed = { start = 0, stop = 8 }\n")
    thrice = plan_of("shape = [4, 4]\n[scan]\nstiffness = [1e4, 1e5, 1e6]\nseed = { start = 0, stop = 8 }\n")
    (tmp_path / "thrice").mkdir()
    (tmp_path / "thrice" / "scan.toml").write_text(thrice.text)
    found = []
    for name, plan in (("once", once), ("thrice", thrice)):
        scan(plan, tmp_path / name, engine=Here())
        _, (row,) = told(tmp_path / name, "power", "L")
        _, (ratio,) = told(tmp_path / name, "power/slipping", "L")
        pool = pooled([read_source(tmp_path / name)])[None]
        numbers = [float(row[key]) for key in ("number", "mean", "standard_error", "low", "high")]
        found.append(([*numbers, float(ratio["low"]), *pool.density_error], pool.standard_error))
    assert found[1][0] == pytest.approx(found[0][0], rel=1e-12)
    assert found[1][1] == pytest.approx(3 * found[0][1])
    both = pooled([read_source(tmp_path / "once"), read_source(tmp_path / "thrice")])[None]
    assert (both.samples, both.density_error.tolist()) == (32, pytest.approx(found[0][0][6:]))


SHAPES = "[scan]\nshape = [[3, 6], [6, 6], [3, 2, 6]]\nseed = { start = 0, stop = 3 }\n"


def test_one_seed_in_different_systems_is_as_many_samples_and_the_figure_says_so(plan_of, tmp_path):
    folder = tmp_path / "scan"
    scan(plan_of(SHAPES), folder, engine=Here())
    power = open_scan(folder).table["power"]
    lines, (row,) = told(folder, "power", "L")
    assert lines == ["all 9 samples"]
    assert (row["number"], row["used"]) == ("9", "9")
    assert float(row["mean"]) == pytest.approx(power.mean())
    assert float(row["standard_error"]) == pytest.approx(power.std(ddof=1) / 3)
    _, (ratio,) = told(folder, "power/slipping", "L")
    assert ratio["number"] == "9"
    stored, request = open_scan(folder), Request("power", "L")
    columns = columns_of(stored, request)
    assert look_of(stored, columns, points_of(columns, request), request).title.startswith("all 9 samples over ")
    assert pooled([read_source(folder)])[None].density_error.any()
    lines, rows = told(folder, "power", "L", by=("shape",))
    assert (lines, [row["number"] for row in rows]) == (["all 9 samples"], ["3", "3", "3"])


def test_the_title_of_a_figure_over_sizes_names_the_shape_if_there_is_but_one(plan_of, tmp_path):
    for shapes, named in (("[[3, 2, 6]]", True), ("[[3, 6], [3, 2, 6]]", False)):
        folder = tmp_path / f"scan {named}"
        scan(plan_of(f"[scan]\nshape = {shapes}\nseed = {{ start = 0, stop = 2 }}\n"), folder, engine=Here())
        stored, request = open_scan(folder), Request("power", "L")
        columns = columns_of(stored, request)
        assert ("3x2x6" in look_of(stored, columns, points_of(columns, request), request).title) == named
