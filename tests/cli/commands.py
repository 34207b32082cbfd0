"""`bearings` and scripts of users within this process: imports cost nothing, and no kernel is compiled twice.

They compute on one thread, and a scan of one worker is solved here. With keywords of `subprocess.run` (an environment,
limits) `bearings` is started anew.
"""

import contextlib
import logging
import os
import re
import runpy
import signal
import subprocess
import sys
import tempfile
import traceback
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from taichi_bearings_cli.main import main

from taichi_bearings import interrupts, runtime
from taichi_bearings.kernels.contact import FORCES
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers.table import METHODS
from tests.here import one_worker_is_here

LONGEST = 300  # seconds
MEMORY = 300_000_000  # bytes that reading a small file may take beyond what the process has before


@dataclass(frozen=True)
class Answer:
    """grown : bytes of memory that this process took meanwhile at its height."""

    words: tuple[str, ...]
    returncode: int
    stdout: str
    stderr: str
    grown: int = 0

    @property
    def sentences(self) -> list[str]:
        """Lines of the errors but those that say how to call it."""
        return [line for line in self.stderr.splitlines() if not line.startswith(("Usage: ", "Try ")) and line]

    @property
    def fault(self) -> str:
        """What is wrong with it; empty if it is a result or one clear sentence."""
        if "Traceback (most recent call last)" in self.stderr or "not enough memory" in self.stderr:
            return self.stderr
        if self.returncode not in (0, 1, 2):
            return f"exit code {self.returncode}"
        if self.grown > MEMORY:
            return f"{self.grown:,} bytes of memory"
        if self.returncode == 2 and self.stderr.startswith("Usage: ") and "\nError: " in self.stderr:  # user's words
            return ""
        clear = [line.startswith("Error: ") or (line.startswith("bearings: ") and len(line) <= 2000)
                 for line in self.sentences]  # fmt: skip
        if self.returncode == 2 and not (clear and all(clear)):
            return f"no clear sentence: {self.stderr!r}"
        return "control characters" if re.search(r"[\x00-\x09\x0b-\x1f\x7f]", self.stderr) else ""


def bearings(*words, cwd=None, **settings):
    """What `bearings` makes of the words."""
    words = tuple(map(str, words))
    if settings:
        return _anew(("-m", "taichi_bearings_cli", *words), cwd, **settings)
    return _answer(main, ("bearings", *words), cwd)


def refused(*words, cwd=None, **settings):
    """The one clear sentence with which `bearings` refuses the words; how to call it may stand before."""
    done = bearings(*words, cwd=cwd, **settings)
    assert (done.returncode, done.stdout, done.fault) == (2, "", ""), done
    (sentence,) = done.sentences
    return sentence


def script(path, *words, cwd=None, alone=False):
    """What a script of a user makes of the words. alone : in a process of its own, as one that starts Taichi itself.

    Laws and methods that it adds are forgotten afterwards, as with its process."""
    if alone:
        return _anew((str(path), *words), cwd)
    with contextlib.ExitStack() as patches:
        for table in (METHODS, LAWS, FORCES):
            patches.enter_context(mock.patch.dict(table))
        patches.enter_context(mock.patch.object(sys, "path", [str(Path(path).parent), *sys.path]))
        return _answer(lambda: runpy.run_path(str(path), run_name="__main__"), (str(path), *words), cwd)


def _anew(words, cwd, **settings):
    command = [sys.executable, *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=LONGEST, **settings)
    return Answer(words, done.returncode, done.stdout, done.stderr)


def _answer(call, words, cwd):
    """Of a call that takes its words from `sys.argv` and may end the process."""
    handlers, place = {number: signal.getsignal(number) for number in interrupts.SIGNALS}, os.getcwd()
    alone = mock.patch.object(runtime, "available_threads", return_value=1)
    with _caught(1) as out, _caught(2) as err, alone, one_worker_is_here(), mock.patch.object(sys, "argv", list(words)):
        start, code, log = _start_of_memory(), 0, logging.StreamHandler(err)
        log.setLevel(logging.WARNING)  # as Python tells warnings where nobody keeps a log
        logging.getLogger().addHandler(log)
        try:
            os.chdir(cwd or place)
            call()
        except SystemExit as end:
            code = end.code or 0
        except Exception:
            traceback.print_exc()
            code = 1
        finally:
            logging.getLogger().removeHandler(log)
            os.chdir(place)
            for number, handler in handlers.items():
                signal.signal(number, handler)
        grown = _memory("VmHWM") - start
        texts = [_text_of(stream) for stream in (out, err)]
    return Answer(words[1:], code, *texts, grown)


@contextlib.contextmanager
def _caught(number):
    """A file that takes what is written to the stream of that number, by processes that are started meanwhile, too."""
    name = {1: "stdout", 2: "stderr"}[number]
    kept = os.dup(number)
    with tempfile.TemporaryFile("w+", encoding="utf-8", newline="") as file:
        os.dup2(file.fileno(), number)
        try:
            with mock.patch.object(sys, name, file):
                yield file
        finally:
            os.dup2(kept, number)
            os.close(kept)


def _text_of(file):
    file.flush()
    file.seek(0)
    return file.read()


def _start_of_memory() -> int:
    """Bytes in use now, the mark of the height set back to them."""
    if not Path("/proc/self/clear_refs").exists():
        return 0
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as marks:
        marks.write("5")
    return _memory("VmRSS")


def _memory(name: str) -> int:
    if not os.path.exists("/proc/self/status"):
        return 0
    return 1024 * int(re.search(rf"{name}:\s+(\d+)", Path("/proc/self/status").read_text())[1])
