"""How long commands take to end after Ctrl-C, stage by stage: from the signal to the exit of the process.

Seconds of a quiet machine: of the clock or of the processor, whichever are fewer, for others may keep a processor busy.
Run as ``python -m tests.faults.test_latency`` for a table with the longest of some moments in each stage.
"""

import gc
import importlib
import os
import pkgutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest
from taichi_bearings_cli import main as command_line

from taichi_bearings import progress

HANGS = 60.0  # seconds
MOMENTS = (0.0, 0.1, 0.4, 1.0, 3.0, 8.0)  # seconds after a stage has begun
OF_RUNS = (
    "reading", "starting Taichi", "preparing", "solving", "settling contact states", "proving", "writing", "drawing",
)  # fmt: skip
STAGES = (*OF_RUNS, "analysing", "drawing figure")
SMALL = "8x8x8"  # at one moment only, and in the longer stages
LONGER = ("preparing", "solving", "settling contact states", "proving", "drawing")
COMMANDS = {
    SMALL: "run --shape 8,8,8",
    "16x16x16": "run --shape 16,16,16",
    "24x24x24": "run --shape 24,24,24",
    "32x32x32": "run --shape 32,32,32",
    "300x300": "run --shape 300,300",
    "rigid limit, 16x16x16": "run --shape 16,16,16 --method rigid-limit --initial random --duration 1e9",
    "Cundall-Strack, 32x32x32": "run --shape 32,32,32 --method cundall-strack --duration 1e9",
    "gradient descent, 32x32x32": "run --shape 32,32,32 --method gradient-descent --tolerance 1e-12",
    "splitting, 32x32x32": "run --shape 32,32,32 --method operator-splitting --tolerance 1e-12",
    "analyse 24x24x24": "analyse {}/24x24x24",
    "verify 24x24x24": "verify {}/24x24x24",
}


def strike_in(stage, after, pipe):
    """Send this process Ctrl-C so many seconds after a stage of this name has begun, and tell when."""
    begin = progress.Display.begin

    def strike():
        os.write(pipe, struct.pack("dd", time.monotonic(), time.process_time()))
        os.kill(os.getpid(), signal.SIGINT)

    def begin_and_strike(watch, new):
        begin(watch, new)
        if new.name == stage:
            progress.Display.begin = begin
            timer = threading.Timer(after, strike)
            timer.daemon = True
            timer.start()

    progress.Display.begin = begin_and_strike


def seconds_to_exit(words, stage, after):
    """(seconds, exit code) of a command that is interrupted then; None if it ended before."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(ours)
        nothing = os.open(os.devnull, os.O_RDWR)
        os.dup2(nothing, 1)
        sys.argv = ["bearings", *words]
        strike_in(stage, after, theirs)
        try:
            command_line.main()
        except SystemExit as end:
            os._exit(end.code or 0)
        os._exit(99)
    os.close(theirs)
    _, status, usage = os.wait4(child, 0)
    ends = time.monotonic(), usage.ru_utime + usage.ru_stime
    struck = os.read(ours, 16)
    os.close(ours)
    if not struck:
        return None
    seconds = [end - then for end, then in zip(ends, struct.unpack("dd", struck), strict=True)]
    assert seconds[0] < HANGS, (words, stage, after, seconds)
    return min(seconds), os.waitstatus_to_exitcode(status)


def measure(folder, name):
    """Stage -> the longest of the seconds where a command is interrupted."""
    found, moments = {}, (0.02,) if name == SMALL else MOMENTS
    words = COMMANDS[name].format(folder).split()
    words += ["--out", f"{folder}/struck", "--force"] if words[0] != "verify" else []
    for stage in LONGER if name == SMALL else OF_RUNS if words[0] == "run" else STAGES:
        for after in moments:
            took = seconds_to_exit(words, stage, after)
            if took is None:  # it is over by then, or there is no such stage
                break
            found[stage] = max(found.get(stage, 0.0), took[0])
            assert took[1] in (0, 130), (stage, after, took)
            print(f"{name:28} {stage:26} {after:4.1f} s after its start: {took[0]:5.2f} s, exit {took[1]}", flush=True)
    return found


def import_everything():
    for package in ("taichi_bearings", "taichi_bearings_studies", "taichi_bearings_cli"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    gc.freeze()  # what is shared stays shared


def main(folder, names):
    import_everything()
    child = os.fork() if any("{}" in COMMANDS[name] for name in names) else -1
    if child == 0:
        sys.argv = f"bearings run --shape 24,24,24 --out {folder}/24x24x24 --force".split()
        try:
            command_line.main()
        finally:
            os._exit(0)
    if child > 0:
        os.waitpid(child, 0)
    rows = [(took, name, stage) for name in names for stage, took in measure(folder, name).items()]
    for took, name, stage in sorted(rows, reverse=True):
        print(f"{took:6.2f} s  {name}: {stage}")


pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="forks")
SOON = 1.5  # seconds


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n == SMALL else pytest.mark.thorough) for n in COMMANDS])
def test_every_stage_ends_soon(name):
    done = subprocess.run([sys.executable, "-m", "tests.faults.test_latency", name], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    longest = [float(line.split()[0]) for line in done.stdout.splitlines() if f" s  {name}: " in line]
    assert len(longest) >= 3
    assert max(longest) < SOON


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        main(Path(scratch), sys.argv[1:] or list(COMMANDS))
