"""Every command that writes, ended at any step: what was there is whole, and the next call recovers the rest."""

import subprocess
import sys

import pytest

from tests.faults.kill_commands import COMMANDS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="forks")
SHARE = 61  # every so many-th step; all of them if a thorough look is wanted


def test_a_command_ended_at_any_step_leaves_whole_files_and_the_next_call_recovers(tmp_path, thorough):
    words = [sys.executable, "-m", "tests.faults.kill_commands", tmp_path, str(1 if thorough else SHARE)]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    strikes = [int(line.split()[-1]) for line in done.stdout.splitlines()]
    assert len(strikes) == 2 * len(COMMANDS)
    assert min(strikes) >= (3 if thorough else 1)
