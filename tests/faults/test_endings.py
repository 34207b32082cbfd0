"""Signals at each line of our own files that a run comes through, from its start to its end.

Wherever a signal comes: if there is a result, it is stored and reported, once and whole; else the run says that nothing
is kept. Run as ``python -m tests.faults.test_endings FOLDER STRIDE FIGURES``: a signal at every STRIDE-th line; prints
the exit codes.
"""

import io
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest
import taichi_bearings_cli
from taichi_bearings_cli import __main__ as program

import taichi_bearings
from taichi_bearings import interrupts, leaving, progress
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.solvers import drive

OURS = tuple(str(Path(package.__file__).parent) for package in (taichi_bearings, taichi_bearings_cli))
LONG = tuple(os.path.join(OURS[0], name) for name in ("proof", "conic", "numerics", "lattice", "scene"))
WORDS = ("run", "--shape", "4,5", "--json", "--out")


class Strikes:
    """Sends signals to this process when it comes to a line of our files, of those that it has not yet come to.

    moments : (number of the line, signal). lines : how many it has come to.
    """

    def __init__(self, moments):
        self.moments, self.lines, self.seen, self.files = dict(moments), 0, set(), {}

    def __call__(self, frame, event, _):
        file = frame.f_code.co_filename
        if file not in self.files:
            self.files[file] = file.startswith(OURS) and not file.startswith(LONG)
        return self.line if self.files[file] else None

    def line(self, frame, event, _):
        where = frame.f_code, frame.f_lineno
        if event == "line" and where not in self.seen:
            self.seen.add(where)
            self.lines += 1
            if self.lines in self.moments:
                signal.raise_signal(self.moments[self.lines])
        return self.line


def ended(folder, words, moments=(), prepare=lambda: None):
    """(exit code, stdout, stderr, lines) of a run in a process of its own, in a new folder."""
    folder.mkdir()
    said = [folder / "stdout", folder / "stderr", folder / "lines"]
    child = os.fork()
    if child:
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        lines = said[2].read_text() if said[2].exists() else ""
        return code, said[0].read_text(), said[1].read_text(), int(lines or 0)
    for number, file in enumerate(said[:2], 1):
        os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT), number)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(io.BufferedWriter(io.FileIO(number, "w")), line_buffering=True) for number in (1, 2)
    )
    sys.argv, strikes, code = ["bearings", *words, str(folder / "run")], Strikes(moments), 99
    for number in interrupts.SIGNALS:
        signal.signal(number, program._end)
    prepare()
    sys.settrace(strikes)
    try:
        program.main()
    except SystemExit as end:
        code = end.code or 0
    finally:
        sys.settrace(None)
        said[2].write_text(str(strikes.lines))
        sys.stdout.flush()
        os._exit(code)


def judged(folder, code, out, err):
    """The exit code, if it and what was written agree."""
    assert "Traceback" not in err, err
    assert "ignored" not in err.replace("-ignored", ""), err
    assert code in (0, 130), (code, err)
    if (folder / "run").exists():
        assert read_run(folder / "run").solution.power > 0
        assert out.count("\n") == 1, (code, out, err)
        assert json.loads(out)["run"] == str(folder / "run")
        return code
    assert (code, out) == (130, ""), err
    assert err.rpartition("bearings: ")[2].startswith("interrupted"), err
    assert not [name for name in os.listdir(folder) if name.startswith(".")]
    return code


def main(folder, stride, figures):
    words = ("run", "--figures", figures, *WORDS[1:])
    ended(folder / "first", words)
    load(folder / "loaded", words)
    code, out, err, lines = ended(folder / "whole", words)
    assert (judged(folder / "whole", code, out, err), err) == (0, "")
    draw, codes = random.Random(stride), Counter()
    for number in range(1 + draw.randrange(stride), lines + 1, stride):
        moments = [(number, draw.choice(interrupts.SIGNALS))]
        if draw.random() < 0.5:  # and a second one
            moments.append((number + draw.randint(1, 60), draw.choice(interrupts.SIGNALS)))
        place = folder / f"{number}"
        code, out, err, _ = ended(place, words, moments)
        try:
            codes[judged(place, code, out, err), bool(out)] += 1
        except AssertionError as error:
            raise AssertionError(f"at {moments}: {error}") from None
    print(json.dumps([lines, codes[0, True], codes[130, True], codes[130, False]]))


def load(folder, words):
    """Run it here, so that no process of its own has to load its modules again."""
    kept = sys.stdout, sys.argv, [signal.getsignal(number) for number in interrupts.SIGNALS]
    sys.argv = ["bearings", *words, str(folder)]
    with open(os.devnull, "w") as sys.stdout:
        from taichi_bearings_cli.main import main as bearings

        with pytest.raises(SystemExit) as end:
            bearings()
    assert not end.value.code
    sys.stdout, sys.argv, handlers = kept
    for number, handler in zip(interrupts.SIGNALS, handlers, strict=True):
        signal.signal(number, handler)


pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="forks")


@pytest.mark.parametrize(("figures", "share"), [("none", 17), ("all", 41)])
def test_a_result_is_reported_whole_wherever_a_signal_comes(tmp_path, figures, share, thorough):
    words = [sys.executable, "-m", "tests.faults.test_endings", tmp_path, str(1 if thorough else share), figures]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines, whole, interrupted, nothing = json.loads(done.stdout.splitlines()[-1])
    assert lines > 500
    assert min(whole + interrupted, nothing) > 3  # some before there is a result, some after
    assert interrupted > 0


@pytest.mark.parametrize("what", interrupts.SIGNALS)
def test_a_report_that_takes_long_is_awaited(tmp_path, what):
    """On a busy machine the last steps may take longer than a command has to end."""

    def prepare():
        leaving.GRACE, leaving.GLANCE = 0.1, 0.01
        keep, end = drive.keep, progress.Display.__exit__
        drive.keep = lambda: (keep(), signal.raise_signal(what))
        progress.Display.__exit__ = lambda *given: (end(*given), time.sleep(0.6))[0]

    code, out, err, _ = ended(tmp_path / "a", (WORDS[0], "--figures", "none", *WORDS[1:]), prepare=prepare)
    assert judged(tmp_path / "a", code, out, err) == 130


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
