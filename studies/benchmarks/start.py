"""Measures how long commands take to start: the whole time in which they solve a sample of 36 spheres.

Solving it takes a few hundredths of a second. The rest is what every command takes that needs compiled kernels: loading
the program, starting the compiler, loading kernels or compiling them, writing files, and ending. In a scan a worker
takes this time, and the process that starts it takes some, too. The start of the compiler alone, which no command can
go below, is measured for comparison.
"""

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from taichi_bearings.errors import BearingsError
from taichi_bearings.interrupts import unheard_by_children

from .harness import Measurements, Times, in_turns

SHAPE = (3, 3, 4)
SCAN = f"shape = {list(SHAPE)}\nthreads = 1\n[scan]\nseed = [0]\n"
PROGRAM = ("-m", "taichi_bearings_cli")
WORDS = ("run", "--shape", ",".join(map(str, SHAPE)), "--threads", "1", "--figures", "none")
COMMANDS = {
    "bearings run": (*PROGRAM, *WORDS, "--out", "out"),
    "bearings scan": (*PROGRAM, "scan", "scan.toml", "--workers", "1", "--out", "out"),
}
"""By name, the arguments of Python that are measured."""
COMPILER = {"the compiler alone, imported and started": ("-c", "from taichi_bearings import runtime; runtime.start()")}
KEPT, NOTHING_KEPT = "kernels kept", "nothing kept"
LOADS = 2  # runs until the cache is complete: the first one compiles, the second stores what kernels are made from


def _once(arguments: tuple[str, ...], cache: Path | None, _: int = 0) -> tuple[float, float]:
    """Return wall and processor time, seconds, of a new Python with all processes that it starts and waits for. The
    processor time is not a number on Windows.

    arguments : arguments of Python.
    cache : folder of the compiler's kernels; None for a new one, so that nothing is kept.
    _ : number of the round, not used.

    Raises BearingsError if it fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "scan.toml").write_text(SCAN)
        environment = os.environ | {"XDG_CACHE_HOME": str(cache or Path(folder, "cache"))}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # else modules are compiled at every start
        before, began = _of_children(), time.perf_counter()
        with unheard_by_children():
            done = subprocess.run(
                [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True
            )
        seconds = time.perf_counter() - began
        if done.returncode:
            raise BearingsError(f"{' '.join(arguments)} failed: {done.stderr.strip()[-200:]}")
        return seconds, _of_children() - before


def _of_children() -> float:
    """Return the processor time, seconds, of all processes that this one has started and that have ended; not a number
    on Windows."""
    return sum(os.times()[2:4]) if sys.platform != "win32" else float("nan")


def measure(rounds: int) -> Measurements:
    """Yield a row with the time of a whole process: two for each of COMMANDS, with kernels kept from an earlier start
    and with none, and one for the compiler alone.

    rounds : how often each is started.

    Raises BearingsError if one fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        caches = {KEPT: Path(folder), NOTHING_KEPT: None}
        for arguments in [each for each in COMMANDS.values() for _ in range(LOADS)]:
            _once(arguments, caches[KEPT])
        calls = {
            f"{name}, {kept}": partial(_once, arguments, cache)
            for name, arguments in COMMANDS.items()
            for kept, cache in caches.items()
        }
        calls |= {name: partial(_once, arguments, caches[KEPT]) for name, arguments in COMPILER.items()}
        found = in_turns(calls, rounds)
    for name, pairs in found.items():
        yield {"what": name, "shape": SHAPE, "threads": 1} | Times(*np.array(pairs).T).row
