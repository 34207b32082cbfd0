"""First steps of a new user: coefficients of one's own, and how the program is called after `make run`."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from taichi_bearings.lattice import Lattice
from taichi_bearings.scene.disorder import Distribution, draw_coefficients
from tests.cli.commands import bearings

ROOT = Path(__file__).parents[2]


def test_coefficients_written_as_documented_are_read(tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/scenes.md").read_text(encoding="utf-8"), re.DOTALL)
    exec(code.replace('"mine.npz"', repr(str(tmp_path / "mine.npz"))), {})
    with np.load(tmp_path / "mine.npz") as stored:
        drawn = draw_coefficients(Lattice((10, 10)), Distribution.parse("uniform:0.1,1.0"), 3)
        assert all((stored[axis] == values).all() for axis, values in zip("xy", drawn, strict=True))
    done = bearings("run", "--shape", "10,10", "--coefficients", "mine.npz", "--out", "a", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "coefficients from mine.npz" in done.stdout


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize(("system", "call"), [("", ".venv/bin/bearings"), ("Windows_NT", r".venv\Scripts\bearings")])
def test_make_run_ends_by_saying_how_to_call_the_program(system, call):
    planned = subprocess.run(
        ["make", "--no-print-directory", "-n", "run", f"OS={system}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    last = planned.strip().splitlines()[-1]
    assert last.startswith("echo")
    assert f"From now on: {call}, or first" in last
