"""One Taichi runtime for the session, in the precision that `--precision` names; bad neighbours run in subprocesses."""

import os

import pytest

from taichi_bearings import compiler, runtime
from taichi_bearings.errors import DeviceError


def pytest_addoption(parser):
    parser.addoption("--precision", choices=runtime.PRECISIONS, default="f64")
    parser.addoption("--arch", choices=("cpu", *runtime.GPUS), default="cpu", help="skips what this device cannot do")
    parser.addoption("--compiler", choices=tuple(compiler.KERNEL_CACHES), help="that compiles the kernels")
    parser.addoption("--taichi-debug", action="store_true", help="bounds checks in every kernel (slow)")


def pytest_configure(config):
    chosen = config.getoption("--compiler")
    if chosen:
        os.environ[compiler.VARIABLE] = chosen  # workers inherit it
        try:
            compiler.name()
        except DeviceError as error:
            pytest.exit(f"no test was run: {error}", returncode=0)


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
