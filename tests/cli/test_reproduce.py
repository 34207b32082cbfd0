"""`bearings reproduce` as scripts use it."""

import itertools
import json
from functools import partial

import pytest
from taichi_bearings_studies.paper import figure_2, reproduce
from taichi_bearings_studies.paper.claims import Claim, Effort
from taichi_bearings_studies.paper.samples import TIMES, relax

from tests.cli.commands import bearings, refused
from tests.tables import rows_of

ALL = ["fig1", "fig2", "fig3", "fig4", "supplement", "network", "distributions", "drivings", "parameters"]


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    """Figure 2 of one sample, its courses recorded at fewer times and followed for fewer steps with more damping."""
    folder = tmp_path_factory.mktemp("paper") / "fig2"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figure_2, "relax", partial(relax, times=TIMES[::6]))
        patch.setattr(figure_2, "STIFFER_STEPS", 3_000)
        patch.setattr(figure_2, "LARGER", (4, 4, 4))
        return folder, bearings("reproduce", "fig2", "--samples", "1", "--out", folder, "--json")


def test_json_is_one_object_and_the_files_are_there(reproduced):
    folder, done = reproduced
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    figure = report["figures"]["fig2"]
    assert (report["refuted"], report["missing"], report["interrupted"]) == (0, [], False)
    assert len(figure["claims"]) == 9
    assert all(claim["finding"] for claim in figure["claims"])
    for claim in figure["claims"]:  # one sample checks a theorem and says nothing of others
        assert claim["verdict"] == ("confirmed" if claim["kind"] == "theorem" else "too few samples"), claim
    assert figure["files"] == [str(folder / f"fig2.{ending}") for ending in ("png", "pdf", "csv")]
    assert sorted(path.name for path in folder.iterdir()) == [
        "fig2.csv",
        "fig2.pdf",
        "fig2.png",
        "report.html",
        "report.json",
    ]
    del report["interrupted"]
    assert json.loads((folder / "report.json").read_text(encoding="utf-8")) == report
    assert (report["confirmed"], report["too_few_samples"]) == (5, 4)


def test_nothing_of_other_options_is_overwritten(reproduced):
    folder, _ = reproduced
    before = (folder / "report.json").read_bytes()
    said = refused("reproduce", "fig2", "--out", folder, "--seed", "5")
    assert "is a report with other settings (seed 0 instead of 5, samples 1 instead of 200)" in said
    assert (folder / "report.json").read_bytes() == before


def test_the_curves_are_in_the_csv(reproduced):
    folder, _ = reproduced
    rows = rows_of(folder / "fig2.csv")
    for dynamics, start in itertools.product(("cundall-strack", "rigid-limit"), ("random", "minimum-cut")):
        curve = [row for row in rows if (row["dynamics"], row["start"]) == (dynamics, start)]
        assert {row["seed"] for row in curve} == {"0"}
        time = [float(row["time"]) for row in curve]
        assert time[0] == 0
        assert time == sorted(time)
        assert float(curve[0]["power_over_initial"]) == 1
        assert float(curve[-1]["power_over_minimum"]) == pytest.approx(1, abs=2e-8)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("fig9",), "'fig9'; allowed are fig1, fig2"),
        (("--samples", "0"), "0 is not in"),
        (("--seed", "-1"), "-1 is not in"),
    ],
)
def test_bad_input_is_exit_code_2(words, expected, tmp_path):
    assert expected in refused("reproduce", *words, "--out", tmp_path / "a", cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


class Figures:
    """Stands in for the figures: notes what is computed, writes the files, is interrupted where that is asked for."""

    def __init__(self, monkeypatch):
        self.computed, self.interrupted_at, self.efforts, self.refuted = [], None, set(), []
        monkeypatch.setattr(reproduce.PaperFigure, "reproduce", lambda figure, *words: self.compute(figure, *words))

    def compute(self, figure, folder, effort, title):
        self.efforts.add(effort)
        for file in figure.files:
            (folder / file).write_text(f"{effort.seed}")
        if figure.files[0] == f"{self.interrupted_at}.png":
            raise KeyboardInterrupt
        self.computed.append(figure.files[0].removesuffix(".png"))
        return [Claim(f"{self.computed[-1]} is right.", "It is.", True), *self.refuted]


@pytest.fixture
def figures(monkeypatch):
    return Figures(monkeypatch)


def ask(folder, *words):
    done = bearings("reproduce", *words, "--out", folder, "--json")
    return done.returncode, json.loads(done.stdout) if done.stdout else done.stderr


def test_a_refuted_claim_is_exit_code_1(figures, tmp_path):
    figures.refuted = [Claim("Water runs uphill.", "It runs downhill.", False)]
    done = bearings("reproduce", "fig2", "--out", tmp_path / "a")
    assert done.returncode == 1
    assert "refuted    Water runs uphill.\n           It runs downhill." in done.stdout
    assert "fig2: 1 confirmed, 1 refuted" in done.stderr
    report = json.loads((tmp_path / "a" / "report.json").read_text(encoding="utf-8"))
    assert (report["confirmed"], report["refuted"]) == (1, 1)


def test_what_is_done_before_ctrl_c_is_kept_and_the_same_command_goes_on(figures, tmp_path):
    folder = tmp_path / "a"
    figures.interrupted_at = "fig3"
    code, report = ask(folder)
    assert (code, report["interrupted"], report["missing"]) == (130, True, ALL[2:])
    stored = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert list(stored["figures"]) == ["fig1", "fig2"] == figures.computed
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert f"Not done yet: {', '.join(ALL[2:])}." in text
    assert "fig2 is right." in text
    figures.interrupted_at = None
    code, report = ask(folder)
    assert (code, report["interrupted"], report["missing"], report["confirmed"]) == (0, False, [], len(ALL))
    assert figures.computed == ALL
    assert ask(folder) == (0, report)  # nothing is missing, nothing is computed
    assert len(figures.computed) == len(ALL)
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert str(folder / "report.html") in report["files"]
    assert all(f"{name} is right." in text and f'id="{name}-1"' in text for name in ALL)
    assert text.count("data:image/png;base64,") == len(ALL)


def test_other_figures_join_the_report_and_force_begins_anew(figures, tmp_path):
    folder = tmp_path / "a"
    ask(folder, "fig3")
    code, report = ask(folder, "fig1")
    assert (code, list(report["figures"]), figures.computed) == (0, ["fig1", "fig3"], ["fig3", "fig1"])
    code, report = ask(folder, "fig1", "--force", "--seed", "4")
    assert (code, list(report["figures"]), report["seed"]) == (0, ["fig1"], 4)
    assert (folder / "fig1.png").read_text() == "4"


def test_the_short_form_is_one_of_its_own(figures, tmp_path):
    code, report = ask(tmp_path / "a", "--quick", "--seed", "3")
    assert (code, report["quick"], report["samples"], figures.efforts) == (0, True, 20, {Effort(3, 20, True)})
    assert report["command"] == "bearings reproduce --quick --seed 3 --samples 20"
    other = ask(tmp_path / "a", "--seed", "3")[1]
    assert "is a report with other settings (samples 20 instead of 200, quick True instead of False)" in other
    assert ask(tmp_path / "b", "fig1", "--quick", "--samples", "7")[1]["samples"] == 7
    assert Effort(0, 7, True) in figures.efforts


def test_a_figure_whose_files_are_gone_is_computed_again(figures, tmp_path):
    ask(tmp_path / "a", "fig1", "fig2")
    (tmp_path / "a" / "fig1.pdf").unlink()
    assert ask(tmp_path / "a", "fig1", "fig2")[0] == 0
    assert figures.computed == ["fig1", "fig2", "fig1"]


def test_what_a_report_does_not_know_is_not_replaced(figures, tmp_path):
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / "fig2.csv").write_text("mine")
    assert "fig2.csv already exists" in ask(folder, "fig2")[1]
    assert (ask(folder, "fig1")[0], figures.computed) == (0, ["fig1"])
    assert "fig2.csv already exists" in ask(folder, "fig2")[1]
    strange = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    strange["figures"]["fig1"]["claims"][0]["kind"] = "x"
    for forged in ({}, [], strange, strange | {"figures": {"fig1": 3}}, strange | {"figures": {"fig9": {}}}):
        (folder / "report.json").write_text(json.dumps(forged))
        assert "is not a report" in ask(folder, "fig1")[1]
    assert (folder / "fig2.csv").read_text() == "mine"
