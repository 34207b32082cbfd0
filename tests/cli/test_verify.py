"""`bearings verify` as a referee runs it: exit codes, one JSON object, one sentence for what cannot be read."""

import json
import shutil

import h5py
import pytest

from tests.cli.commands import bearings, refused


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("verify") / "run"
    done = bearings("run", "--shape", "3,4,5", "--seed", 8, "--out", out, "--verify")
    assert done.returncode == 0, done.stderr
    assert "verified" in done.stdout
    return out


def test_a_run_is_verified_from_its_file(folder, tmp_path):
    alone = tmp_path / "alone.h5"
    shutil.copy(folder / "run.h5", alone)
    for path in (folder, folder / "run.h5", alone):
        done = bearings("verify", path, "--json")
        assert done.returncode == 0
        report = json.loads(done.stdout)
        assert {
            "power", "lower_bound", "gap", "balanced", "inside_discs", "states_proven", "contradictions", "arithmetic",
        } <= set(report)  # fmt: skip
        assert report["contradictions"] == []
        assert report["balanced"] is report["inside_discs"] is True
        assert report["states_proven"]["unproven"] == 0
        assert report["lower_bound"] <= report["power"]
    text = bearings("verify", folder).stdout
    assert "<= least power <=" in text
    assert "no other slips have the least power" in text


@pytest.mark.parametrize(
    ("law", "words", "least"),
    [
        ("coulomb", "friction", "power"),
        ("viscous", "damping", "power"),
        ("coulomb-viscous", "friction and damping", "potential"),
    ],
)
def test_forces_and_minimum_are_named_as_the_law_has_them(law, words, least, tmp_path):
    out = tmp_path / "run"
    assert bearings("run", "--shape", "3,3,3", "--law", law, "--figures", "none", "--out", out).returncode == 0
    text = bearings("verify", out).stdout
    assert f"\n  {words}: in balance" in text
    assert f"<= least {least} <=" in text
    assert f"no other slips have the least {least}\n" in text


def test_a_changed_number_ends_with_one(folder, tmp_path):
    path = tmp_path / "run.h5"
    shutil.copy(folder / "run.h5", path)
    with h5py.File(path, "r+") as file:
        file["contact/z/friction"][1, 1, 2, 0] *= 1.01
    done = bearings("verify", path)
    assert done.returncode == 1
    assert "contradiction: " in done.stdout
    assert "NOT verified" in done.stdout
    assert json.loads(bearings("verify", path, "--json").stdout)["verified"] is False


@pytest.mark.parametrize("content", [None, b"", b"no HDF5 file"])
def test_what_cannot_be_read_is_one_sentence(tmp_path, content):
    path = tmp_path / "run.h5"
    if content is not None:
        path.write_bytes(content)
    assert refused("verify", path).startswith("bearings: ")
