"""The file that a Dask scheduler writes names its address; what is no such file is one sentence."""

import json

import pytest

from tests.cli.commands import refused

SCAN = "shape = [4, 4]\n[scan]\nseed = [0]\n"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "file.json cannot be read"),
        ("{", "file.json is not JSON"),
        (json.dumps({"type": "Scheduler"}), "file.json has no address of a Dask scheduler"),
        (json.dumps([]), "file.json has no address of a Dask scheduler"),
        (
            json.dumps({"address": "tcp://127.0.0.1:1"}),
            "no Dask scheduler can be reached at 'tcp://127.0.0.1:1': no answer within",
        ),
    ],
)
def test_a_scheduler_file_names_the_scheduler(content, words, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("taichi_bearings.scans.cluster.CONNECT", 0.5)
    (tmp_path / "scan.toml").write_text(SCAN)
    if content is not None:
        (tmp_path / "file.json").write_text(content)
    told = refused("scan", "scan.toml", "--scheduler", "file.json", "--out", "out", cwd=tmp_path)
    assert words in " ".join(told.split())
