"""One Taichi runtime for the session, in the precision that `--precision` names; bad neighbours run in subprocesses."""

import gc
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taichi_bearings import compiler, runtime
from taichi_bearings.errors import DeviceError


def pytest_addoption(parser):
    parser.addoption("--precision", choices=runtime.PRECISIONS, default="f64")
    parser.addoption("--arch", choices=("cpu", *runtime.GPUS), default="cpu", help="skips what this device cannot do")
    parser.addoption("--compiler", choices=tuple(compiler.KERNEL_CACHES), help="that compiles the kernels")
    parser.addoption("--thorough", action="store_true", help="long sweeps, more cases, drawn anew")
    parser.addoption("--taichi-debug", action="store_true", help="bounds checks in every kernel (slow)")


def pytest_configure(config):
    settings.register_profile("quick", max_examples=20, derandomize=True, database=None, deadline=None)
    settings.register_profile("thorough", max_examples=1000, database=None, deadline=None, print_blob=True)
    settings.load_profile("thorough" if config.getoption("--thorough") else "quick")
    chosen = config.getoption("--compiler")
    if chosen:
        os.environ[compiler.VARIABLE] = chosen  # workers inherit it
        try:
            compiler.name()
        except DeviceError as error:
            pytest.exit(f"no test was run: {error}", returncode=0)


BEGUN_FIRST = "tests/test_walks.py"  # its tests are long, and share what the first of them compiles


def pytest_collection_modifyitems(config, items):
    items.sort(key=lambda item: not item.nodeid.startswith(BEGUN_FIRST))
    if not config.getoption("--thorough"):
        left_out = [item for item in items if item.get_closest_marker("thorough")]
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=left_out)


@given(st.none())
def draw_nothing(_):
    """Have Hypothesis make its own generator of random numbers."""


def pytest_collection_finish():
    draw_nothing()  # old ones look for who holds that generator, and do not find what is frozen
    gc.freeze()  # what is there by now stays, and need not be looked through again and again


@pytest.fixture(scope="session")
def thorough(request):
    """Whether long sweeps are wanted."""
    return request.config.getoption("--thorough")


@pytest.fixture(scope="session")
def precision(request):
    return request.config.getoption("--precision")


@pytest.fixture(autouse=True, scope="session")
def taichi_runtime(request, precision):
    arch = request.config.getoption("--arch")
    if arch != "cpu" and not runtime.usable(arch, precision):
        pytest.skip(f"there is no {arch} device here that computes in {precision}")
    return runtime.start(arch, precision, threads=1, debug=request.config.getoption("--taichi-debug"))


@pytest.fixture(scope="session")
def needs_f64(precision):
    if precision != "f64":
        pytest.skip("a statement about double precision")
