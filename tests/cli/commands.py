"""`bearings` in a process that has imported everything and stays: imports cost nothing, no kernel is compiled twice.

It computes on one thread. With keywords of `subprocess.run` (an environment, limits) `bearings` is started anew.
"""

import atexit
import contextlib
import gc
import importlib
import json
import os
import pkgutil
import runpy
import subprocess
import sys
import tempfile
import traceback
from functools import cache
from pathlib import Path

from taichi_bearings import runtime

LONGEST = 300  # seconds
ANOTHER_RUNTIME = {"--arch", "--precision"}  # a process has one


def bearings(*words, cwd=None, **settings):
    """What `bearings` makes of the words: a CompletedProcess with its texts."""
    words = list(map(str, words))
    stays = not ANOTHER_RUNTIME.intersection(words)
    return _call(["-m", "taichi_bearings_cli", *words], cwd, stays, **settings)


def script(path, *words, cwd=None):
    """What a script of a user makes of the words, in the same way."""
    return _call([str(path), *map(str, words)], cwd, stays=True)


def _call(words, cwd, stays, **settings):
    if settings or not hasattr(os, "fork"):
        command = [sys.executable, *words]
        return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=LONGEST, **settings)
    with tempfile.TemporaryDirectory() as folder:
        out, err = Path(folder, "out"), Path(folder, "err")
        request = {"words": words, "cwd": str(cwd or os.getcwd()), "out": str(out), "err": str(err)}
        server = _server(stays)
        server.stdin.write(json.dumps(request) + "\n")
        server.stdin.flush()
        code = server.stdout.readline()
        if not code:  # it has ended
            _server.cache_clear()
            code = server.wait()
        return subprocess.CompletedProcess(words, int(code), out.read_text(), err.read_text())


@cache
def _server(stays):
    command = [sys.executable, "-m", __name__, *(["stays"] if stays else [])]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    atexit.register(process.communicate)  # its input ends, and so does it
    return process


def _serve(stays):
    """Do what each line of the input asks for, here or in a fork of it; the exit code is a line of the output."""
    import_everything()
    requests, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    if stays:
        runtime.available_threads = lambda: 1
    for line in requests:
        if stays:
            code = _done_here(json.loads(line))
        elif child := os.fork():
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        else:
            _become(json.loads(line))
            return
        print(code, file=answers, flush=True)


def import_everything():
    for package in ("taichi_bearings", "taichi_bearings_studies", "taichi_bearings_cli"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    gc.freeze()  # what is shared stays shared


def _done_here(request):
    place = sys.path[0]
    try:
        _become(request)
        code = 0
    except SystemExit as end:
        code = end.code or 0
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.path[0] = place
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    return code


def _become(request):
    os.chdir(request["cwd"])
    for path, number in ((os.devnull, 0), (request["out"], 1), (request["err"], 2)):
        opened = os.open(path, os.O_RDWR | os.O_CREAT)
        os.dup2(opened, number)
        os.close(opened)
    first, *rest = request["words"]
    if first == "-m":
        sys.argv[1:] = rest[1:]
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    else:
        sys.argv, sys.path[0] = [first, *rest], str(Path(first).parent)
        runpy.run_path(first, run_name="__main__")


if __name__ == "__main__":
    _serve(sys.argv[1:] == ["stays"])
