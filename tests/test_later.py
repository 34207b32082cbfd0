"""Modules that are loaded when something of them is first used: the same module then, and none before."""

import subprocess
import sys
from pathlib import Path

import pytest

from taichi_bearings import compiler

ROOT = Path(__file__).parents[1]
USES = """
import sys
from taichi_bearings.later import RARELY_USED, postpone
postpone()
import scipy.sparse.csgraph, taichi
loaded = set(RARELY_USED) & set(sys.modules)
import numpy
from numpy import testing
numpy.testing.assert_allclose([1.0], [1.0])
numpy_own = sys.modules["numpy.testing"]
assert testing.assert_allclose is numpy_own.assert_allclose is numpy.testing.assert_allclose
try:
    numpy.testing.assert_allclose([1.0], [2.0])
except AssertionError:
    print("unequal", *sorted(loaded))
"""
ALL_LOADED = """
import sys
sys.argv = {words}
from taichi_bearings_cli.__main__ import main
try:
    main()
finally:
    print(*sys.modules, file=sys.stderr)
"""


def output(code: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert done.returncode == 0, done.stderr
    return done


def test_a_module_is_loaded_by_its_first_use_and_is_itself():
    assert output(USES).stdout.splitlines()[-1] == "unequal"


LAPLACIAN = """
import sys
from taichi_bearings.later import postpone
postpone()
import numpy as np
from scipy.sparse.csgraph import laplacian, maximum_flow
print("scipy.linalg" in sys.modules, laplacian(np.array([[0, 3], [3, 0]])).tolist())
import scipy.sparse.csgraph as searches
print(searches.laplacian(np.eye(2)[::-1], return_diag=True)[1].tolist(), "scipy.linalg" in sys.modules)
"""


def test_graphs_are_searched_without_linear_algebra_and_their_laplacians_are_as_ever():
    assert output(LAPLACIAN).stdout == "False [[3, -3], [-3, 3]]\n[1.0, 1.0] True\n"


DILL = """
import sys, types
from taichi_bearings.compiler import ti
print("dill" in sys.modules)
from taichi.lang import _wrap_inspect
print(_wrap_inspect.dill.source.findsource.__name__, type(_wrap_inspect.dill.loads) is types.FunctionType)
import dill
print(dill.loads(dill.dumps(lambda: 3))(), sys.modules["dill"] is dill, "Later" in repr(type(dill)))
"""


@pytest.mark.skipif(compiler.name() != "taichi", reason="looks into Taichi")
def test_taichi_loads_dill_when_it_is_used_and_others_get_the_package_itself():
    assert output(DILL).stdout.splitlines()[-3:] == ["False", "findsource True", "3 True False"]


def test_a_command_does_without_them(tmp_path):
    words = ["bearings", "run", "--shape", "3,3,4", "--figures", "none", "--out", str(tmp_path / "out")]
    loaded = set(output(ALL_LOADED.format(words=words)).stderr.split())
    assert {"scipy.sparse.csgraph", "h5py"} <= loaded
    assert (
        not {
            "dill",
            "scipy.sparse.linalg",
            "numpy.f2py",
            "numpy.testing",
            "numpy.polynomial",
            "unittest",
            "http.client",
            "ssl",
        }
        & loaded
    )


@pytest.mark.parametrize("words", ["--version", "--help"])
def test_what_needs_no_command_loads_no_arrays(words):
    assert "numpy" not in output(ALL_LOADED.format(words=["bearings", words])).stderr.split()


DESCRIBED = """
{before}
import taichi_bearings.plots.style
from matplotlib.figure import Figure
figure = Figure()
figure.set(facecolor="red", figwidth=3)
print("facecolor" in (Figure.set.__doc__ or ""), *figure.get_facecolor(), figure.get_figwidth())
"""


@pytest.mark.parametrize("in_command", [True, False])
def test_commands_leave_out_what_matplotlib_tells_of_settings_and_programs_of_users_do_not(in_command):
    before = "from taichi_bearings.later import postpone; postpone()" if in_command else ""
    assert output(DESCRIBED.format(before=before)).stdout == f"{not in_command} 1.0 0.0 0.0 1.0 3.0\n"
