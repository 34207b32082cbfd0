"""A process that ends by a signal before a step in the file system; and what the next one finds if run directories are
killed before each of theirs in turn.

Run as ``python -m tests.runs.kills FOLDER exchange|rename|complete``; prints the number of kills as the last line.
"""

import io
import os
import signal
import sys
import traceback
from pathlib import Path

from taichi_bearings.runs import run_directory as module
from taichi_bearings.runs.run_directory import completed, in_use, run_directory

CHANGES = {"os.rename", "os.mkdir", "os.rmdir", "os.remove", "os.truncate", "shutil.rmtree", "swap", "fsync"}
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
OVER = 77  # exit code of a process that ended before its step
FILES = ("history.png", "run.h5", "summary.json")


class Strike:
    """Sends a signal to this process before a step in the file system. at : which one; 0 for none."""

    def __init__(self):
        self.what, self.at, self.steps = signal.SIGKILL, 0, 0
        sys.addaudithook(self.hear)
        fsync, swap = os.fsync, module._swap
        os.fsync = lambda file: (sys.audit("fsync"), fsync(file))[1]
        module._swap = lambda *names: (sys.audit("swap"), swap(*names))[1]

    def hear(self, event, given):
        writes = event == "open" and isinstance(given[2], int) and given[2] & WRITES and given[0] != os.devnull
        if event in CHANGES or writes:
            self.steps += 1
            if self.steps == self.at:
                os.kill(os.getpid(), self.what)


def ended(call, folder, strike=None, at=0, what=signal.SIGKILL):
    """How a process of its own ended: its exit code, or minus the signal; and whether it came to that step."""
    child = os.fork()
    if child == 0:
        code, said = 1, io.StringIO()
        sys.stdout = sys.stderr = said
        try:
            if strike is not None:
                strike.what, strike.at, strike.steps = what, at, 0
            call(folder)
            code = 0
        except SystemExit as end:
            code = end.code or 0
        except KeyboardInterrupt:
            code = 130
        except BaseException:
            code = 99
            os.write(2, traceback.format_exc().encode())
        if code not in (0, 130):
            os.write(2, said.getvalue().encode())
        os._exit(code if strike is None or strike.at == 0 or strike.steps >= at else OVER)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def write(folder, text):
    for name in FILES:
        (folder / name).write_text(text)


def replace(path):
    with run_directory(path, force=True) as directory:
        write(directory.partial, "new")
        directory.publish()


def complete(path):
    with in_use(path), completed(path, ["old.png"]) as folder:
        write(folder, "new")


def content(path):
    """Old or new; with both or neither AssertionError."""
    found = {(path / name).read_text() for name in FILES}
    assert len(found) == 1, found
    assert found == {"old"} or not (path / "old.png").exists()
    return found.pop()


def main(folder, kind):
    if kind == "rename":
        module._swap = lambda *_: False
    strike, work, seen = Strike(), complete if kind == "complete" else replace, []
    for step in range(1, 200):
        path = folder / f"{step}"
        path.mkdir()
        write(path, "old")
        (path / "old.png").touch()
        code = ended(work, path, strike, step)
        assert code in (-signal.SIGKILL, OVER), code
        if kind == "exchange":
            content(path)  # at any time
        with run_directory(folder / "another"), in_use(path):  # the next call beside it, and the next one in it
            seen.append(content(path))
        assert {file.name for file in path.iterdir()} <= {*FILES, "old.png"}, list(path.iterdir())
        assert not [name for name in os.listdir(folder) if name.startswith(".")], os.listdir(folder)
        if code == OVER:
            assert seen == sorted(seen, reverse=True), seen  # old, then new
            assert set(seen) == {"old", "new"}
            print(len(seen) - 1)
            return


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
