"""`bearings view`, `bearings export` and `bearings movie` as people and scripts call them."""

import json

import pytest

from tests.cli.commands import bearings, refused


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    words = ("--method", "cundall-strack", "--initial", "random", "--duration", 0.01, "--snapshots", "0,0.005")
    assert bearings("run", "--shape", "4,4", *words, "--figures", "none", "--out", folder).returncode == 0
    return folder


@pytest.mark.parametrize(
    ("command", "name", "counts"),
    [
        ("view", "view.html", {"snapshots": 2, "analysed": False}),
        ("export", "run.vtkhdf", {"analysed": False, "points": 16, "lines": 24, "steps": 3}),
        ("movie", "a.gif", {"frames": 2, "fps": 4.0}),
    ],
)
def test_json_says_where_the_file_is_and_what_it_holds(run, command, name, counts):
    where = () if command != "movie" else ("--out", run / name)
    done = bearings(command, run, *where, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report == {"file": str(run / name), "bytes": (run / name).stat().st_size, **counts}
    assert done.stderr == ""  # quiet in a pipe
    plain = bearings(command, run, *where, "--force")
    assert str(run / name) in plain.stdout
    assert len(plain.stdout.splitlines()) == 1


@pytest.mark.parametrize(("command", "ending"), [("view", "html"), ("export", "vtkhdf"), ("movie", "gif")])
def test_what_stands_is_not_replaced_unasked_and_what_is_no_run_is_said_so(run, command, ending, tmp_path):
    mine = tmp_path / f"mine.{ending}"
    mine.write_text("mine")
    said = refused(command, run, "--out", mine)
    assert said == f"bearings: {mine} already exists; choose another --out or add --force"
    assert mine.read_text() == "mine"
    said = refused(command, tmp_path / "nothing")
    assert said.startswith(f"bearings: {tmp_path / 'nothing'} is not a run")
    done = bearings(command, run, "--out", tmp_path / "no" / f"where.{ending}")
    assert done.returncode != 0
    assert not done.fault
    assert len(done.sentences) == 1


def test_a_film_is_a_gif_where_ffmpeg_is_missing_and_says_so(run, monkeypatch):
    monkeypatch.setenv("PATH", "")
    done = bearings("movie", run)
    assert done.returncode == 0, done.stderr
    assert f"{run / 'movie.gif'}: 2 snapshots" in done.stdout
    assert "a GIF, because there is no ffmpeg here" in done.stdout
