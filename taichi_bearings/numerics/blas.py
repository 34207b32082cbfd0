"""Loads SciPy's linear algebra when it is first used, and sets how many threads it and NumPy's use.

Loading it takes a twentieth of a second, which small lattices do without.

By default these libraries share even matrices of 100 rows among all processors and wait for the slowest one. Over many
small matrices that gains nothing, and where another program keeps a processor busy every product waits for its share of
that processor: measured, 19 s instead of 4 s for one factorisation.
"""

import importlib
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from typing import Any

from threadpoolctl import ThreadpoolController

_blocks: list[ExitStack] = []  # limits of the blocks of `one_thread` that are being executed, outer ones first


class LinearAlgebra:
    """A module of SciPy's linear algebra, which is loaded when one of its functions is first asked for."""

    def __init__(self, name: str) -> None:
        """Note the name of the module, which is not loaded yet."""
        self._name = name

    def __getattr__(self, function: str) -> Any:
        """Return the function of this name from the module, and load that if need be. Python calls this once for each
        name."""
        is_new = "scipy.linalg" not in sys.modules
        found = getattr(importlib.import_module(self._name), function)
        if is_new:  # blocks of `one_thread` that are being executed limit the threads of SciPy's library, too
            for limits in _blocks:
                limits.enter_context(_controller(True).limit(limits=1, user_api="blas"))
        setattr(self, function, found)
        return found


DENSE, BLAS, LAPACK = (
    LinearAlgebra("scipy.linalg"),
    LinearAlgebra("scipy.linalg.blas"),
    LinearAlgebra("scipy.linalg.lapack"),
)
COMPILED_BLAS = LinearAlgebra("scipy.linalg.cython_blas")
COMPILED_LAPACK = LinearAlgebra("scipy.linalg.cython_lapack")
SPARSE = LinearAlgebra("scipy.sparse.linalg")


@contextmanager
def one_thread() -> Iterator[None]:
    """Let linear algebra run on one thread inside the `with` block: NumPy's, and SciPy's if it is loaded before, or
    inside by a :class:`LinearAlgebra`."""
    with ExitStack() as limits:
        limits.enter_context(_controller("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas"))
        _blocks.append(limits)
        try:
            yield
        finally:
            _blocks.remove(limits)


@lru_cache(maxsize=2)
def _controller(with_scipy: bool) -> ThreadpoolController:
    """Return the object that sets how many threads the loaded libraries of NumPy and SciPy use. It is made once, as it
    takes milliseconds to find these libraries, and once more when that of SciPy is loaded.

    with_scipy : True if SciPy's is loaded.
    """
    return ThreadpoolController()
