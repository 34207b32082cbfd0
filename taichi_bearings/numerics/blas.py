"""How many threads the linear algebra libraries of NumPy and SciPy use.

They share even matrices of 100 rows among all processors and wait for the slowest. Over many small matrices that gains
nothing, and where another program keeps a processor busy every product waits for its turn: measured, 19 s instead of
4 s for one factorisation.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra on one thread inside the block."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    """Finding the libraries takes milliseconds, so it is done once, when NumPy's and SciPy's are both loaded."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()
