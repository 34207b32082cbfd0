"""Commands that end by a signal before each of their steps in the file system in turn, and what the next call finds.

Run as ``python -m tests.faults.test_kill_commands FOLDER STRIDE [COMMAND]``: every STRIDE-th step; prints for each
command and signal how often it struck. SIGKILL must leave whole files alone, and leftovers that the next call recovers;
SIGINT none but a free lock.
"""

import io
import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from taichi_bearings_cli.main import main as bearings

import taichi_bearings as tb
from taichi_bearings import interrupts
from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.scan import scan
from tests.runs.kills import OVER, Strike, ended
from tests.scans.scan_faults import Here

SCAN = "shape = [4, 5]\n[scan]\nseed = [1, 2, 3]\n"


def command(*words):
    """Words that the command line gets, with a folder put in for each {}."""

    def call(folder):
        sys.argv = ["bearings", *(word.format(folder) for word in words)]
        bearings()

    return call


def save(folder):
    tb.load(folder / "run").save(folder / "saved", force=True)


def solve_scan(folder):
    scan(read_plan(folder / "scan.toml"), folder / "scan", engine=Here())


COMMANDS = {
    "run": command("run", "--shape", "4,5", "--seed", "1", "--figures", "none", "--out", "{}/new"),
    "run --force": command("run", "--shape", "4,5", "--figures", "none", "--out", "{}/run", "--force"),
    "analyse": command("analyse", "{}/run", "--no-figures"),
    "analyse --out": command("analyse", "{}/run", "--no-figures", "--out", "{}/found", "--force"),
    "histogram": command("histogram", "{}/run", "--out", "{}/counts", "--force"),
    "plot": command("plot", "power", "{}/run", "--out", "{}/power.png", "--force"),
    "save": save,
    "scan": solve_scan,
}


def load(call, folder):
    """Call it here, so that no process of its own has to load its modules again."""
    said, sys.stdout = sys.stdout, io.StringIO()
    try:
        call(folder)
    except SystemExit as end:
        if end.code:
            raise
    finally:
        sys.stdout = said
        for number in interrupts.SIGNALS:
            signal.signal(number, signal.default_int_handler)


def names(folder):
    return sorted(str(file.relative_to(folder)) for file in folder.rglob("*"))


def is_hidden(name):
    return any(part.startswith(".") or ".partial" in part for part in Path(name).parts)


def refuse_half_written(folder):
    """Every file that is not hidden is whole."""
    for name in names(folder):
        file = folder / name
        if is_hidden(name) or file.is_dir():
            continue
        if file.suffix == ".h5":
            h5py.File(file).close()
        elif file.suffix == ".json":
            json.loads(file.read_text())
        elif file.suffix == ".png":
            assert file.read_bytes().endswith(b"IEND\xaeB`\x82"), name
        elif file.suffix in (".csv", ".toml"):
            assert file.read_text().endswith("\n"), name
    found = read_run(folder / "run")
    assert found.solution.power.shape == (1,)
    if (folder / "scan" / "scan.h5").exists():
        read_scan(folder / "scan")


def main(folder, stride, chosen=None):
    whole, strike = folder / "whole", Strike()
    whole.mkdir()
    (whole / "scan.toml").write_text(SCAN)
    load(command("run", "--shape", "4,5", "--figures", "none", "--out", "{}/run"), whole)
    for name in [chosen] if chosen else COMMANDS:
        place = folder / "loaded"
        shutil.copytree(whole, place)
        load(COMMANDS[name], place)
        expected = names(place)
        shutil.rmtree(place)
        for what in (signal.SIGKILL, signal.SIGINT):
            print(name, what.name, sweep(folder, name, what, stride, strike, expected), flush=True)


def sweep(folder, name, what, stride, strike, expected):
    """How often the signal struck. expected : names of files after the command."""
    call, at, strikes = COMMANDS[name], 1, 0
    while True:
        place = folder / f"step-{at}"
        shutil.copytree(folder / "whole", place)
        code = ended(call, place, strike, at, what)
        refuse_half_written(place)
        if code == OVER:  # over before that step
            shutil.rmtree(place)
            return strikes
        strikes += 1
        if what == signal.SIGKILL:
            assert code == -what, (at, code)
        else:  # too late for the last steps, it ends well
            assert code in (0, 130), (at, code)
            left = [n for n in names(place) if is_hidden(n) and ".in-use" not in n]
            assert not left, (at, left)
        again = ended(call, place)
        standing = name == "run" and (code == 0 or again == 2)  # it had its name already
        assert again == (2 if standing else 0), (at, again)
        if standing:  # the next call beside it tidies up
            assert ended(command("run", "--shape", "4,5", "--figures", "none", "--out", "{}/other"), place) == 0
            shutil.rmtree(place / "other")
        refuse_half_written(place)
        assert names(place) == expected, (at, set(names(place)) ^ set(expected))
        shutil.rmtree(place)
        at += stride


pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="forks")
SHARE = 101  # every so many-th step; all of them if a thorough look is wanted


def test_a_command_ended_at_any_step_leaves_whole_files_and_the_next_call_recovers(tmp_path, thorough):
    words = [sys.executable, "-m", "tests.faults.test_kill_commands", tmp_path, str(1 if thorough else SHARE)]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    strikes = [int(line.split()[-1]) for line in done.stdout.splitlines()]
    assert len(strikes) == 2 * len(COMMANDS)
    assert min(strikes) >= (3 if thorough else 1)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
