"""`bearings benchmark` as scripts use it."""

import json

import pytest

from tests.cli.commands import bearings, refused

KERNELS = [
    ("sweep", 2), ("sweep with momentum", 2), ("Cundall-Strack step", 2), ("Cundall-Strack step", 3),
    ("splitting iteration", 2),
]  # fmt: skip


def test_throughput_is_one_object_and_the_files_are_there(tmp_path):
    tiny = ("--quick", "--shape", "4,5,6", "--threads", "1", "--precision", "f64", "--out", tmp_path / "a")
    done = bearings("benchmark", "throughput", *tiny, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    ours = [(row["what"], row["components"]) for row in report["kernels"] if "ratio" not in row]
    assert ours == KERNELS
    for row in report["kernels"]:
        assert row["contact_updates"] * row["seconds_processor"] == pytest.approx(224)  # 3 5 4 + 4 4 4 + 4 5 5
        assert row["quickest"] <= row["seconds"] <= row["slowest"]
    assert {row["what"] for row in report["kernels"] if row.get("ratio", 0) > 0} >= {"NumPy sweep"}
    assert report["files"] == [str(tmp_path / "a" / name) for name in ("report.md", "kernels.csv", "kernels.png")]
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["kernels.csv", "kernels.png", "report.md"]
    assert "already exists" in refused("benchmark", "speed", "--out", tmp_path / "a")


def test_options_of_parts_that_are_not_measured_are_refused():
    assert "--largest belongs to the part growth, which is not" in refused("benchmark", "accuracy", "--largest", "8")
    said = refused("benchmark", "throughput", "--seed", "1")
    assert "--seed belongs to the parts methods and growth, which are not measured here" in said
    both = refused("benchmark", "growth", "--largest", "8", "--shape", "4,4,4")
    assert "--largest and --shape both choose lattices" in both
