"""`bearings benchmark speed`, `throughput` and `peers` as scripts use them."""

import json

import pytest

from tests.cli.commands import bearings

KERNELS = [
    ("sweep", 2), ("sweep with momentum", 2), ("Cundall-Strack step", 2), ("Cundall-Strack step", 3),
    ("splitting iteration", 2),
]  # fmt: skip
TINY = ("--quick", "--shape", "4,5,6", "--threads", "1", "--precision", "f64")


def test_json_is_one_object_and_the_files_are_there(tmp_path):
    done = bearings("benchmark", "throughput", *TINY, "--out", tmp_path / "a", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    streams, timed = ([row for row in report["rows"] if row["part"] == part] for part in ("memory", "kernels"))
    assert [row["working_set"] for row in streams] == pytest.approx([2**k for k in (14, 16, 18)], rel=0.05)
    kernels = [row for row in timed if "bytes" in row]
    assert [(row["what"], row["components"]) for row in kernels] == KERNELS
    for row in timed:
        assert row["contact_updates"] * row["seconds"] == pytest.approx(224)  # 3 5 4 + 4 4 4 + 4 5 5
        assert row["quickest"] <= row["seconds"] <= row["slowest"]
    for row in kernels:
        assert row["bandwidth"] * row["seconds"] == pytest.approx(row["bytes"])
        assert row["limit"] in ("memory", "operations", "roots")
        assert row["roof"] > 0
    assert kernels[0]["bytes"] == 120 * 8 * 9  # tests/benchmarks/test_counts.py
    assert all(row["ratio"] > 0 for row in timed if "bytes" not in row)
    assert report["files"] == [str(tmp_path / "a" / name) for name in ("speed.csv", "roofline.png")]
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["roofline.png", "speed.csv"]
    again = bearings("benchmark", "speed", "--out", tmp_path / "a")
    assert again.returncode == 2
    assert "already exists" in again.stderr


BAD = {
    "shape": (("--shape", "3"), "two or three whole numbers"),
    "threads": (("--threads", "0"), "this process may use 1 to"),
    "precision": (("--precision", "f16"), "f64, f32"),
    "parts": (("--parts", "magic"), "'magic' is none of"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_and_exit_code_2(name, tmp_path):
    words, expected = BAD[name]
    done = bearings("benchmark", "speed", *words, "--out", tmp_path / "a", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert expected in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_all_four_words_are_there():
    done = bearings("benchmark", "--help")
    for word in ("accuracy", "throughput", "speed", "peers"):
        assert f"  {word} " in done.stdout
        assert "bearings benchmark" in bearings("benchmark", word, "--help").stdout
