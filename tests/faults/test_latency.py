"""Ctrl-C ends a run soon, whatever it is at."""

import subprocess
import sys

import pytest

from tests.faults.latency import COMMANDS, SMALL

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="forks")
SOON = 1.5  # seconds


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n == SMALL else pytest.mark.thorough) for n in COMMANDS])
def test_every_stage_ends_soon(name):
    done = subprocess.run([sys.executable, "-m", "tests.faults.latency", name], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    longest = [float(line.split()[0]) for line in done.stdout.splitlines() if f" s  {name}: " in line]
    assert len(longest) >= 3
    assert max(longest) < SOON
