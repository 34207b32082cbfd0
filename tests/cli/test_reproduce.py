"""`bearings reproduce` as scripts use it."""

import csv
import itertools
import json

import pytest
from click.testing import CliRunner
from taichi_bearings_cli.reproduce import command

from taichi_bearings.studies import reproduce
from taichi_bearings.studies.claims import Claim
from tests.cli.test_cli import bearings


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper") / "fig2"
    return folder, bearings("reproduce", "fig2", "--samples", "1", "--out", folder, "--json")


def test_json_is_one_object_and_the_files_are_there(reproduced):
    folder, done = reproduced
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    figure = report["figures"]["fig2"]
    assert report["refuted"] == 0
    assert report["confirmed"] == len(figure["claims"]) == 9
    assert all(claim["verdict"] == "confirmed" and claim["finding"] for claim in figure["claims"])
    assert figure["files"] == [str(folder / f"fig2.{ending}") for ending in ("png", "pdf", "csv")]
    assert sorted(path.name for path in folder.iterdir()) == [
        "fig2.csv",
        "fig2.pdf",
        "fig2.png",
        "report.json",
        "report.md",
    ]
    assert json.loads((folder / "report.json").read_text(encoding="utf-8")) == report
    text = (folder / "report.md").read_text(encoding="utf-8")
    assert text.count("**confirmed**") == 9


def test_nothing_is_overwritten(reproduced):
    folder, _ = reproduced
    before = (folder / "report.json").read_bytes()
    again = bearings("reproduce", "fig2", "--out", folder)
    assert again.returncode == 2
    assert "already exists" in again.stderr
    assert (folder / "report.json").read_bytes() == before


def test_the_curves_are_in_the_csv(reproduced):
    folder, _ = reproduced
    with (folder / "fig2.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for dynamics, start in itertools.product(("cundall-strack", "rigid-limit"), ("random", "minimum-cut")):
        curve = [row for row in rows if (row["dynamics"], row["start"]) == (dynamics, start)]
        assert {row["seed"] for row in curve} == {"0"}
        time = [float(row["time"]) for row in curve]
        assert time[0] == 0
        assert time == sorted(time)
        assert float(curve[0]["power_over_initial"]) == 1
        assert float(curve[-1]["power_over_minimum"]) == pytest.approx(1, abs=2e-8)


def test_a_refuted_claim_is_exit_code_1(tmp_path, monkeypatch):
    claims = [Claim("Water runs uphill.", "It runs downhill.", False), Claim("It is wet.", "So it is.", True)]
    monkeypatch.setattr(reproduce.PaperFigure, "reproduce", lambda *_: claims)
    done = CliRunner().invoke(command, ["fig2", "--out", str(tmp_path / "a")])
    assert done.exit_code == 1
    assert "refuted    Water runs uphill.\n           It runs downhill." in done.stdout
    report = json.loads((tmp_path / "a" / "report.json").read_text(encoding="utf-8"))
    assert (report["confirmed"], report["refuted"]) == (1, 1)
    assert "| Water runs uphill. | **refuted** | It runs downhill. |" in (tmp_path / "a" / "report.md").read_text()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("fig9",), "'fig9'; allowed are fig1, fig2"),
        (("--samples", "0"), "0 is not in"),
        (("--seed", "-1"), "-1 is not in"),
    ],
)
def test_bad_input_is_exit_code_2(words, expected, tmp_path):
    done = bearings("reproduce", *words, "--out", tmp_path / "a", cwd=tmp_path)
    assert done.returncode == 2
    assert expected in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []
