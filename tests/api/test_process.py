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
    assert re.fullmatch(r"certified True \(5, 5, 6, 3\) finished (True|False) 2", first)
    assert second == "True True True"
    assert done.stderr == ""


GLOBALS = """
import logging, os, signal, sys, warnings
import matplotlib


def world():
    return (
        dict(matplotlib.rcParams), matplotlib.get_backend(auto_select=False), list(warnings.filters), os.getcwd(),
        [list(logging.getLogger(name).handlers) for name in ("taichi_bearings", "matplotlib", "taichi")],
        logging.root.level, list(logging.root.handlers), [signal.getsignal(n) for n in (2, 15)], 
        {name: value for name, value in os.environ.items() if name != "KMP_DUPLICATE_LIB_OK"},  # Taichi's own
        sys.modules["__main__"], sys.excepthook, os.umask(os.umask(0o22)),
    )


before = world()
import taichi_bearings as tb
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
    done = script(GLOBALS, tmp_path)
    assert (done.returncode, done.stdout) == (0, "untouched\n"), done.stderr


LIGHT = """
import sys, time
began = time.perf_counter()
import taichi_bearings as tb
print(time.perf_counter() - began < 0.2, {'numpy', 'taichi', 'matplotlib', 'scipy', 'h5py'} & set(sys.modules))
print('solve' in dir(tb), tb.CundallStrack(stiffness=1e6).stiffness, {'taichi', 'scipy'} & set(sys.modules))
"""


def test_importing_the_package_takes_no_time_and_loads_nothing(tmp_path):
    done = script(LIGHT, tmp_path)
    assert done.stdout.splitlines() == ["True set()", "True 1000000.0 set()"], done.stderr
