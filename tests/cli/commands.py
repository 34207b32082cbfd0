"""`bearings` in a process of its own, forked from one that has imported everything, so that imports cost nothing.

With keywords of `subprocess.run` (an environment, limits), and where there is no fork, it is started anew.
"""

import atexit
import gc
import importlib
import json
import os
import pkgutil
import runpy
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

LONGEST = 300  # seconds


def bearings(*words, cwd=None, **settings):
    """What `bearings` makes of the words: a CompletedProcess with its texts."""
    return _call(["-m", "taichi_bearings_cli", *map(str, words)], cwd, **settings)


def script(path, *words, cwd=None):
    """What a script of a user makes of the words, in the same way."""
    return _call([str(path), *map(str, words)], cwd)


def _call(words, cwd, **settings):
    if settings or not hasattr(os, "fork"):
        command = [sys.executable, *words]
        return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=LONGEST, **settings)
    with tempfile.TemporaryDirectory() as folder:
        out, err = Path(folder, "out"), Path(folder, "err")
        request = {"words": words, "cwd": str(cwd or os.getcwd()), "out": str(out), "err": str(err)}
        server = _server()
        server.stdin.write(json.dumps(request) + "\n")
        server.stdin.flush()
        code = int(server.stdout.readline())
        return subprocess.CompletedProcess(words, code, out.read_text(), err.read_text())


@cache
def _server():
    process = subprocess.Popen(
        [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    atexit.register(process.communicate)  # its input ends, and so does it
    return process


def _serve():
    """Fork a process for each line of the input, one after the other; its exit code is a line of the output."""
    import_everything()
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            _become(json.loads(line))
            return
        _, status = os.waitpid(child, 0)
        print(os.waitstatus_to_exitcode(status), flush=True)


def import_everything():
    for package in ("taichi_bearings", "taichi_bearings_studies", "taichi_bearings_cli"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    gc.freeze()  # what is shared stays shared


def _become(request):
    os.chdir(request["cwd"])
    for stream, number in (("out", 1), ("err", 2)):
        os.dup2(os.open(request[stream], os.O_WRONLY | os.O_CREAT), number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    first, *rest = request["words"]
    if first == "-m":
        sys.argv[1:] = rest[1:]
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    else:
        sys.argv, sys.path[0] = [first, *rest], str(Path(first).parent)
        runpy.run_path(first, run_name="__main__")


if __name__ == "__main__":
    _serve()
