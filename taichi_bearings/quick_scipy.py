"""SciPy's sparse matrices and graphs: ``from taichi_bearings.quick_scipy import csgraph, sparse`` loads them quickly.

SciPy goes through all names of NumPy when it is loaded. Three of them, ``ctypeslib``, ``f2py`` and ``testing``, are
modules that NumPy loads only when they are asked for, and that nothing here needs. Loading them took a fifth of the
time in which a worker process starts.
"""

from typing import Any

import numpy


def _load() -> None:
    """Load SciPy's graphs while NumPy does not list the three modules; afterwards NumPy lists them again."""
    own: dict[str, Any] = vars(numpy)
    unneeded = {"ctypeslib", "f2py", "testing"} - own.keys()
    before: dict[str, Any] = {name: own[name] for name in ("__all__", "__dir__") if name in own}
    if len(before) == 2:
        names, listed = before.values()
        own["__all__"] = [name for name in names if name not in unneeded]
        own["__dir__"] = lambda: [name for name in listed() if name not in unneeded]
    try:
        import scipy.sparse.csgraph  # noqa: F401
    finally:
        own.update(before)


_load()

from scipy import sparse  # noqa: E402
from scipy.sparse import csgraph  # noqa: E402

__all__ = ["csgraph", "sparse"]
