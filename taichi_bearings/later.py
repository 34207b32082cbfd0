"""Parts of other packages that hardly any command uses: they are loaded when something of them is first used.

SciPy takes all that NumPy names, and with it loads the tools for tests and for Fortran; Taichi loads what asks a server
for its newest version. That is a tenth of the time in which a command loads the program. Matplotlib describes every
setting of each of its classes, for whoever asks for help, which takes half of the time in which it is loaded.
"""

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

RARELY_USED = "numpy.ctypeslib", "numpy.f2py", "numpy.polynomial", "numpy.testing", "urllib.request"


class Later(ModuleType):
    """Stands in for a module of the same name, and loads it when something of it is first asked for."""

    def __getattr__(self, name: str) -> Any:
        """Return what the module has under a name; the module is loaded if it is not yet."""
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


_commands: list[bool] = []  # an entry if this process runs a command, and not the program of a user


def postpone(names: tuple[str, ...] = RARELY_USED) -> None:
    """Replace parts of packages in this process by stand-ins of the same name, each of which loads the part when
    something of it is first used.

    names : names of the parts, such as "numpy.testing". Their packages are loaded; parts that are loaded already stay.

    The statement ``import numpy.testing`` still loads the part at once; ``from numpy import testing`` does not.
    """
    _commands[:] = [True]
    for name in names:
        if name not in sys.modules:
            package, _, part = name.rpartition(".")
            setattr(importlib.import_module(package), part, Later(name))


def leave_out_descriptions() -> None:
    """In a process that has called :func:`postpone`, have the classes of matplotlib do without the descriptions of
    their settings, unless they are loaded already.
    """
    if _commands and "matplotlib.figure" not in sys.modules:
        artist: Any = importlib.import_module("matplotlib.artist")
        artist.kwdoc = lambda of: ""
        artist.Artist._update_set_signature_and_docstring = classmethod(lambda of: None)


@contextmanager
def standing_in(name: str) -> Iterator[None]:
    """Have modules that are loaded inside the block, and import a package, get a stand-in that loads the package when
    something of it is first used. Nothing changes if it is loaded already.

    name : name of the package.
    """
    sys.modules.setdefault(name, Later(name))
    try:
        yield
    finally:
        if isinstance(sys.modules.get(name), Later):  # for others the statement `import` loads the package
            del sys.modules[name]
