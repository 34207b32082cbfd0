"""The front door in a process of its own: nothing is written unless asked for, and nothing global is touched."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def script(text, folder, **environment):
    """Run a script of a user, who has written no guard into it, in an empty folder."""
    (folder / "script.py").write_text(text, encoding="utf-8")
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return subprocess.run(
        [sys.executable, "script.py"],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"} | environment,
        timeout=300,
    )


@pytest.mark.skipif(sys.platform == "win32", reason="has no limits for processes")
@pytest.mark.parametrize("home", ["own", "nowhere"])
def test_the_ten_lines_need_no_file(tmp_path, home):
    """With the user's cache of compiled kernels there already, and with no place for one at all."""
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "TMPDIR", "MPLCONFIGDIR"), "/proc/nowhere")
    kept = {"MPLCONFIGDIR": str(tmp_path)}  # matplotlib itself does not go without
    lines = (ROOT / "tests" / "api" / "ten_lines.py").read_text(encoding="utf-8")
    done = script(lines, tmp_path, **({} if home == "own" else nowhere | kept))
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert re.fullmatch(r"certified True \(10, 10, 10, 3\) finished (True|False) 2", first)
    assert second == "True True True"
    assert done.stderr == ""


GLOBALS = """
import logging, os, signal, sys, warnings
import matplotlib


def world():
    return (
        dict(matplotlib.rcParams), matplotlib.get_backend(auto_select=False), list(warnings.filters), os.getcwd(),
        {name: list(logger.handlers) for name, logger in logging.root.manager.loggerDict.items()
         if isinstance(logger, logging.Logger) and logger.handlers},
        logging.root.level, list(logging.root.handlers), [signal.getsignal(n) for n in (2, 15)], dict(os.environ),
        sys.modules["__main__"], sys.excepthook, os.umask(os.umask(0o22)),
    )


before = world()
import taichi_bearings as tb
assert not {"numpy.linalg", "taichi", "scipy", "h5py"} & (set(sys.modules) - known), "importing is light"
scene = tb.Scene.random((4, 4, 5), seed=1)
best = tb.solve(scene)
best.plot("spins")
tb.analyse(best).plot("network")
best.save("a")
list(tb.solve_many([tb.Scene.random((4, 5))]))
for name, (old, new) in enumerate(zip(before, world())):
    assert old == new, (name, old, new)
print("untouched")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="other signals")
def test_nothing_global_is_touched(tmp_path):
    done = script("import matplotlib, sys\nknown = set(sys.modules)\n" + GLOBALS, tmp_path)
    assert (done.returncode, done.stdout) == (0, "untouched\n"), done.stderr


def test_importing_the_package_takes_no_time_and_loads_nothing():
    code = (
        "import sys, time; began = time.perf_counter()\n"
        "import taichi_bearings as tb; took = time.perf_counter() - began\n"
        "heavy = {'numpy', 'taichi', 'matplotlib', 'scipy', 'h5py'} & set(sys.modules)\n"
        "print(took < 0.2, sorted(heavy), 'solve' in dir(tb))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert done.stdout.split("\n")[0] == "True [] True", done.stderr


@pytest.mark.parametrize("page", ["docs/python.md", "README.md"])
def test_the_examples_of_the_docs_run(tmp_path, page):
    text = (ROOT / page).read_text(encoding="utf-8")
    code = "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    done = script(code, tmp_path)
    assert done.returncode == 0, done.stderr
