import os
import subprocess
import sys

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from taichi_bearings.numerics.blas import one_thread


def threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_linear_algebra_runs_on_one_thread_inside_and_as_before_afterwards():
    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with one_thread():
            assert threads() == {1}
        assert threads() == before
        with pytest.raises(ZeroDivisionError), one_thread():
            raise ZeroDivisionError
        assert threads() == before


LOADED_INSIDE = """
import sys
from threadpoolctl import threadpool_info
from taichi_bearings.later import postpone
from taichi_bearings.numerics.blas import LAPACK, one_thread
def threads():
    return sorted(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas")
postpone()
import numpy as np
with one_thread():
    with one_thread():
        before = "scipy.linalg" in sys.modules
        factor = LAPACK.dpotrf(np.diag([4.0, 9.0]))[0]
        inside = threads()
    between = threads()
print(before, np.diag(factor).tolist(), set(inside) | set(between), set(threads()))
"""


def test_what_is_loaded_inside_has_one_thread_there_as_well():
    told = os.environ | {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2", "MKL_NUM_THREADS": "2"}
    done = subprocess.run([sys.executable, "-c", LOADED_INSIDE], capture_output=True, check=True, text=True, env=told)
    assert done.stdout == "False [2.0, 3.0] {1} {2}\n"
