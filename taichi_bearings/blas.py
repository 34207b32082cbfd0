"""How many threads NumPy's linear algebra uses.

OpenBLAS shares even matrices of 100 rows among all processors and waits for the slowest. Over many small matrices that
gains nothing, and where another program keeps a processor busy every product waits for its turn: measured, 19 s
instead of 4 s for one factorisation.
"""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache

import numpy as np

NAMES = (("scipy_openblas_", "64_"), ("openblas_", "64_"), ("openblas_", ""))  # as built for NumPy 2, NumPy 1, Debian


@contextmanager
def one_thread() -> Iterator[None]:
    """NumPy's linear algebra on one thread inside the block; without effect for a library other than OpenBLAS."""
    functions = _thread_functions()
    if functions is None:
        yield
        return
    get, put = functions
    before = get()
    put(1)
    try:
        yield
    finally:
        put(before)


@lru_cache(maxsize=1)
def _thread_functions() -> tuple[Callable[[], int], Callable[[int], None]] | None:
    """OpenBLAS' functions to get and to set the number of threads, found through the module that NumPy links to it."""
    try:
        library = ctypes.CDLL(np.linalg._umath_linalg.__file__)
    except (AttributeError, OSError):
        return None
    for prefix, suffix in NAMES:
        try:
            return library[f"{prefix}get_num_threads{suffix}"], library[f"{prefix}set_num_threads{suffix}"]
        except AttributeError:
            continue
    return None
