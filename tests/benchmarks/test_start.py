"""The benchmark of starts: that it starts what it names, in new processes, and reports their times."""

import sys

import pytest
from taichi_bearings_studies.benchmarks import start

from taichi_bearings.errors import BearingsError

SEES = """
import os, pathlib, time
kept = pathlib.Path(os.environ["XDG_CACHE_HOME"], "kept")
while not kept.exists() and time.process_time() < 0.3:
    pass
kept.parent.mkdir(exist_ok=True)
kept.touch()
"""


def test_each_command_is_started_with_what_is_kept_and_with_nothing(monkeypatch):
    monkeypatch.setattr(start, "COMMANDS", {"one": ("-c", SEES)})
    monkeypatch.setattr(start, "COMPILER", {"alone": ("-c", "pass")})
    rows = {row["what"]: row for row in start.measure(2)}
    assert set(rows) == {"one, kernels kept", "one, nothing kept", "alone"}
    assert all(0 < row["quickest"] <= row["seconds"] <= row["slowest"] for row in rows.values())
    if sys.platform != "win32":
        assert rows["one, nothing kept"]["seconds_processor"] >= 0.2 > rows["one, kernels kept"]["seconds_processor"]


def test_a_command_that_fails_is_no_measurement():
    with pytest.raises(BearingsError, match="no such thing"):
        start._once(("-c", "raise SystemExit('no such thing')"), None)


@pytest.mark.parametrize("name", start.COMMANDS)
def test_the_commands_are_those_of_the_program(name):
    assert start._once((*start.COMMANDS[name], "--dry-run"), None)[0] > 0
