"""A process that ends by SIGKILL before each of its steps in the file system in turn, and what the next one finds.

Run as ``python -m tests.runs.kills FOLDER exchange|rename|complete``; prints the number of kills as the last line.
"""

import os
import signal
import sys
from pathlib import Path

from taichi_bearings.runs import run_directory as module
from taichi_bearings.runs.run_directory import completed, in_use, run_directory

STEPS = {"open", "os.rename", "os.mkdir", "os.rmdir", "os.remove", "shutil.rmtree", "ctypes.call_function", "swap"}
FILES = ("history.png", "run.h5", "summary.json")
steps = [0, 0]  # taken, and the one that is not taken


def kill_before_a_step(event, _):
    if event in STEPS:
        steps[0] += 1
        if steps[0] == steps[1]:
            os.kill(os.getpid(), signal.SIGKILL)


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


def killed_at(step, work, path):
    """True if the process came as far as that step."""
    path.mkdir()
    write(path, "old")
    (path / "old.png").touch()
    child = os.fork()
    if child == 0:
        steps[:] = [0, step]
        work(path)
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    assert status in (0, signal.SIGKILL), status
    return status != 0


def main(folder, kind):
    swap = module._swap
    module._swap = {"rename": lambda *_: False}.get(kind, lambda *names: sys.audit("swap") or swap(*names))
    sys.addaudithook(kill_before_a_step)
    work, seen = complete if kind == "complete" else replace, []
    for step in range(1, 200):
        path = folder / f"{step}"
        killed = killed_at(step, work, path)
        if kind == "exchange":
            content(path)  # at any time
        with run_directory(folder / "another"), in_use(path):  # the next call beside it, and the next one in it
            seen.append(content(path))
        assert {file.name for file in path.iterdir()} <= {*FILES, "old.png"}, list(path.iterdir())
        assert not [name for name in os.listdir(folder) if name.startswith(".")], os.listdir(folder)
        if not killed:
            assert seen == sorted(seen, reverse=True), seen  # old, then new
            assert set(seen) == {"old", "new"}
            print(len(seen) - 1)
            return


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
