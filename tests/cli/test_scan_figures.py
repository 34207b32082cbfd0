"""`bearings histogram` and `bearings plot scan` on a scan, from the command line."""

import json

import pytest

from tests.cli.commands import bearings, refused
from tests.stored_scans import stored_scan


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return stored_scan(tmp_path_factory.mktemp("scan"), seeds=4)


def test_a_histogram_of_a_scan_by_a_parameter(scan, tmp_path):
    words = ("histogram", scan.path.parent, "--by", "shape", "--normalise", "mean", "--out", tmp_path / "h")
    done = bearings(*words, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert [group["shape"] for group in report["groups"]] == ["4x4", "8x8", "16x16"]
    assert report["slipping"] == sum(len(scan.slipping(n)) for n in range(len(scan.power)))
    assert {file.name for file in (tmp_path / "h").iterdir()} == {f"power_histogram.{e}" for e in ("csv", "h5", "png")}
    shown = bearings(*words, "--force").stdout
    assert "shape 8x8: " in shown
    assert "in units of the mean power" in shown
    assert "1, 2, 4, 5, 10 or 20" in bearings("histogram", scan.path, "--bins-per-decade", 3).stderr


def test_a_figure_of_a_scan(scan, tmp_path):
    done = bearings(
        "plot", "scan", scan.path, "--y", "power", "--x", "spin_bottom", "--by", "law",
        "--where", "spin_top=1", "--log", "y", "--out", tmp_path / "f.svg",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["all 24 samples", str(tmp_path / "f.svg"), str(tmp_path / "f.csv")]
    assert (tmp_path / "f.csv").read_text().startswith("law,spin_bottom,number,mean,")


def test_wrong_words_are_one_sentence(scan, tmp_path):
    for words, sentence in (
        (("plot", "scan", scan.path, "--y", "power"), "needs --y and --x"),
        (("plot", "scan", scan.path, "--y", "power", "--x", "L", "--out", tmp_path / "f.gif"), "must end in"),
        (("plot", "scan", tmp_path, "--y", "power", "--x", "L"), "not a scan"),
        (("plot", "power", tmp_path, "--by", "law"), "--by belongs to `bearings plot scan`"),
    ):
        assert sentence in refused(*words, cwd=tmp_path)


def test_the_title_says_what_all_samples_share_and_vectors_have_commas(tmp_path):
    (tmp_path / "s.toml").write_text(
        "spin_bottom = 0.25\n[scan]\nshape = [[3, 3, 4]]\ndirection = [[1, 0, 0], [0, 1, 0]]\n"
        "seed = { start = 0, stop = 2 }\n"
    )
    done = bearings("scan", "s.toml", "--workers", 1, "--out", "s", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = bearings(
        "plot", "scan", "s", "--y", "power", "--x", "seed", "--by", "direction", "--out", "f.svg", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    drawn = (tmp_path / "f.svg").read_text()
    for words in ("3x3x4, Coulomb, uniform:0.1,1.0, spin bottom 0.25", ">1,0,0<", ">0,1,0<"):
        assert words in drawn
    assert "1x0x0" not in drawn
    for written in ("0,1,0", "0x1x0"):
        where = f"direction={written}"
        words = ("plot", "scan", "s", "--y", "power", "--x", "L", "--where", where, "--out", "g.svg", "--force")
        assert bearings(*words, cwd=tmp_path).stdout.splitlines()[0] == "all 2 samples"
