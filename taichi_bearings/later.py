"""Parts of other packages that hardly any command uses: they are loaded when something of them is first used.

SciPy takes all that NumPy names, and with it loads the tools for tests and for Fortran; Taichi loads what asks a server
for its newest version. That is a tenth of the time in which a command loads the program.
"""

import importlib
import sys
from types import ModuleType
from typing import Any

RARELY_USED = "numpy.ctypeslib", "numpy.f2py", "numpy.polynomial", "numpy.testing", "urllib.request"


class Later(ModuleType):
    """Stands in for a module of the same name, and loads it when something of it is first asked for."""

    def __getattr__(self, name: str) -> Any:
        """Return what the module has under a name; the module is loaded if it is not yet."""
        return getattr(importlib.import_module(self.__name__), name)


def postpone(names: tuple[str, ...] = RARELY_USED) -> None:
    """Replace parts of packages in this process by stand-ins of the same name, each of which loads the part when
    something of it is first used.

    names : names of the parts, such as "numpy.testing". Their packages are loaded; parts that are loaded already stay.

    The statement ``import numpy.testing`` still loads the part at once; ``from numpy import testing`` does not.
    """
    for name in names:
        if name not in sys.modules:
            package, _, part = name.rpartition(".")
            setattr(importlib.import_module(package), part, Later(name))
