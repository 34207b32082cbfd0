"""First steps of a new user: coefficients of one's own, and how the program is called after `make run`."""

import re
import shutil
import subprocess
import sys
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
    assert "drawn" not in done.stderr
    again = bearings("run", "a", "--coefficients", "mine.npz", "--seed", "4", "--out", "b", cwd=tmp_path)
    idle = "seed is 4, but mine.npz holds all coefficients, so nothing is drawn from it"
    assert idle in " ".join(again.stderr.split())
    start = ("--method", "gradient-descent", "--initial", "random", "--iterations", "3")
    drawn = bearings("run", "a", "--seed", "4", *start, "--out", "c", cwd=tmp_path)
    assert "warning: seed" not in drawn.stderr


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


def test_functions_that_others_registered_before_are_called_at_the_end():
    """As those of a tool that counts the lines of a command."""
    code = "import atexit, sys; atexit.register(print, 'counted'); sys.argv[1:] = ['--version']\n"
    code += "from taichi_bearings_cli.__main__ import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("counted\n")
