"""`bearings benchmark accuracy` as scripts use it."""

import json

import pytest

from tests.cli.commands import bearings

TINY = ("benchmark", "accuracy", "--shape", "3,4", "--time-limit", "0.2", "--threads", "1")


def test_json_is_one_object_and_the_files_are_there(tmp_path):
    done = bearings(*TINY, "--law", "coulomb", "--law", "viscous", "--out", tmp_path / "a", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert [(scene["shape"], scene["law"]) for scene in report["scenes"]] == [([3, 4], "coulomb"), ([3, 4], "viscous")]
    for scene in report["scenes"]:
        assert {"gradient-descent", "cundall-strack"} <= {entry["method"] for entry in scene["entries"]}
        assert all(entry["true_error"] >= scene["reference_gap"] > 0 for entry in scene["entries"])
    assert report["files"] == [str(tmp_path / "a" / f"accuracy.{ending}") for ending in ("csv", "md", "png")]
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["accuracy.csv", "accuracy.md", "accuracy.png"]
    again = bearings(*TINY, "--out", tmp_path / "a")
    assert again.returncode == 2
    assert "already exists" in again.stderr


def test_the_table_is_printed(tmp_path):
    done = bearings(*TINY, "--methods", "gradient-descent", "--no-peers", "--out", tmp_path / "a")
    assert done.returncode == 0, done.stderr
    assert "| gradient-descent |" in done.stdout
    assert "cundall-strack" not in done.stdout
    assert (tmp_path / "a" / "accuracy.md").read_text(encoding="utf-8").strip() in done.stdout


BAD = {
    "shape": (("--shape", "3"), "two or three whole numbers"),
    "law": (("--law", "dry"), "one of coulomb, viscous"),
    "seed": (("--seed", "-1"), "0 or more"),
    "methods": (("--methods", "magic"), "'magic' is none of"),
    "time limit": (("--time-limit", "0"), "a positive number"),
    "time limit that is no number": (("--time-limit", "soon"), "a positive number"),
    "threads": (("--threads", "-2"), "0 or more"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_and_exit_code_2(name, tmp_path):
    words, expected = BAD[name]
    done = bearings("benchmark", "accuracy", *words, "--out", tmp_path / "a", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert expected in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
