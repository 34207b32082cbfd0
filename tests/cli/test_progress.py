"""What a terminal shows while commands work: phases, times left from what is left, one line. Nothing in a pipe."""

import json
import re
import sys
import time

import pytest
from taichi_bearings_cli.progress import Display

from taichi_bearings.stages import alike, each, stage
from tests.cli.commands import bearings

if sys.platform == "win32":
    pytest.skip("pseudo-terminals are of Unix", allow_module_level=True)
from tests.cli.terminal import on_terminal

CUBE = ("--shape", "10,10,10", "--threads", "1")


def test_a_run_names_its_phases_on_one_line_and_says_where_the_time_went(tmp_path):
    session = on_terminal("run", *CUBE, "--out", tmp_path / "a", columns=60)
    assert session.returncode == 0
    shown = [line for _, line in session.frames]
    assert any("drawing" in line for line in shown)
    assert all(len(line) <= 60 for line in shown)
    assert not any(" h left" in line for line in shown)
    (times,) = re.findall(r"([\d.]+) s: (.*)", session.stdout)
    parts = dict(part.rsplit(" ", 1) for part in times[1].split(", "))
    assert {"loading", "drawing"} <= parts.keys()
    assert sum(map(float, parts.values())) == pytest.approx(float(times[0]), abs=0.5)
    seen = session.frames[-1][0] - session.frames[0][0]  # without what a busy machine needs to start Python
    assert float(times[0]) > 0.8 * seen - 0.3


def test_a_packing_says_power_and_gap_on_the_way_and_nothing_in_a_pipe(tmp_path):
    words = ("run", "--threads", "1", "--figures", "none")
    session = on_terminal(
        *words, "--shape", "22,22,20", "--driven", "shaft:2", "--out", tmp_path / "a", columns=140
    )  # long enough to be seen
    assert session.returncode == 0
    told = [
        found for _, line in session.frames if (found := re.search(r"iterations?, P = ([\d.]+), gap [\d.]+e-", line))
    ]
    assert told
    assert all(float(found[1]) > 0 for found in told)
    piped = bearings(*words, "--shape", "5,5,4", "--driven", "shaft:1", "--out", tmp_path / "b")
    assert (piped.returncode, piped.stderr) == (0, "")


def test_nothing_but_the_answer_in_a_pipe(tmp_path):
    done = bearings("run", "--shape", "3,3,4", "--out", tmp_path / "a")
    assert (done.returncode, done.stderr) == (0, "")


STARTS_WITH_THE_LINE = """
import threading
from rich.live import Live
from taichi_bearings.compiler import ti
from taichi_bearings_cli.__main__ import main
shown, start, select = threading.Event(), Live.start, ti.lang.misc.adaptive_arch_select
Live.start = lambda self, *given, **named: (start(self, *given, **named), shown.set())[0]
ti.lang.misc.adaptive_arch_select = lambda *given: (shown.wait(30), select(*given))[1]
main()
"""


@pytest.mark.parametrize("as_json", [True, False])
def test_the_report_is_written_also_where_the_line_appears_while_taichi_starts(tmp_path, as_json):
    words = ("run", "--shape", "3,3", "--method", "gradient-descent", "--figures", "none", "--out", tmp_path / "a")
    program = ("-c", STARTS_WITH_THE_LINE)
    session = on_terminal(*words, *["--json"][: int(as_json)], program=program, report=not as_json, columns=300)
    assert session.returncode == 0, session.raw
    assert "[Taichi]" not in session.stdout + session.raw.decode()
    if as_json:
        assert json.loads(session.stdout)["status"] == "certified"
    else:
        assert f"run: {tmp_path / 'a'}".encode() in session.raw


def test_stages_in_parts_foretell_their_end_from_the_parts_that_are_done():
    display, seen = Display(), []
    with display:
        for number in each(range(12), "sample", alike):
            time.sleep(0.2 if number == 0 else 0.02)  # the first one compiles
            with stage("solving"):
                seen.append(display.line())
    assert seen[0] == "sample 1 of 12 · solving"
    assert seen[6] == "sample 7 of 12, 0 s left · solving"


def test_the_line_of_a_scan_fits_its_terminal(tmp_path):
    file = tmp_path / "scan.toml"
    file.write_text(
        'shape = [10, 10, 10]\nlaw = "coulomb"\n[scan]\nseed = { start = 0, stop = 12 }\nspin_bottom = [0.1, 0.25]\n'
        'distribution = ["uniform:0.1,1.0", "lognormal:0.4,1.0"]\ndirection = [[1, 1, 0], [1, 0, 0]]\n'
    )
    session = on_terminal("scan", file, "--out", tmp_path / "s", "--workers", "1", columns=60, stop="now")
    assert session.returncode == 130
    lines = [line for _, line in session.frames if "samples" in line]
    assert lines
    assert all(len(line) <= 60 for line in lines)
    assert any(line.endswith("…") for line in lines)
