"""Parts of other packages that hardly any command uses: they are loaded when something of them is first used.

SciPy takes all that NumPy names, and with it loads the tools for tests and for Fortran; Taichi loads what asks a server
for its newest version. That is a tenth of the time in which a command loads the program. SciPy's sparse matrices load
all its linear algebra, for the Laplacian of a graph, which takes another tenth. Matplotlib describes every
setting of each of its classes, for whoever asks for help, which takes half of the time in which it is loaded.
"""

import gc
import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

RARELY_USED = "numpy.ctypeslib", "numpy.f2py", "numpy.polynomial", "numpy.testing", "urllib.request"
# new objects after which Python looks for cycles among the youngest ones; how many of these searches go before one
# among older ones, and of those before one among all
COLLECTED_AFTER = 20_000, 20, 100
LAPLACIAN = "scipy.sparse.csgraph._laplacian", "laplacian"  # the module that takes SciPy's linear algebra; its function


class Later(ModuleType):
    """Stands in for a module of the same name, and loads it when something of it is first asked for."""

    def __init__(self, name: str, functions: tuple[str, ...] = ()) -> None:
        """Load nothing yet.

        name : name of the module.
        functions : names of functions in it, if it is a single file. Asking for one of these loads nothing, only
            calling it does.
        """
        super().__init__(name)
        self._is_file = bool(functions)
        for function in functions:
            setattr(self, function, self._called_later(function))

    def __getattr__(self, name: str) -> Any:
        """Return what the module has under a name; the module is loaded if it is not yet. Raises AttributeError for the
        name __path__ if the module is a single file: by this name the statement `import` asks for packages."""
        if name == "__path__" and self._is_file:
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)

    def _called_later(self, function: str) -> Callable[..., Any]:
        """Return a function that calls the one of this name in the module, which is loaded by the first call."""

        def called(*arguments: Any, **options: Any) -> Any:
            """Return what the function of the module returns for the same arguments and options."""
            return Later.__getattr__(self, function)(*arguments, **options)

        return called


_commands: list[bool] = []  # an entry if this process runs a command, and not the program of a user


def postpone(names: tuple[str, ...] = RARELY_USED) -> None:
    """Replace parts of packages in this process by stand-ins of the same name, each of which loads the part when
    something of it is first used. Unless SciPy's graphs are loaded, their Laplacian (LAPLACIAN) is replaced, too.

    names : names of the parts, such as "numpy.testing". Their packages are loaded; parts that are loaded already stay.

    The statement ``import numpy.testing`` still loads the part at once; ``from numpy import testing`` does not.
    """
    _commands[:] = [True]
    for name in names:
        if name not in sys.modules:
            package, _, part = name.rpartition(".")
            setattr(importlib.import_module(package), part, Later(name))
    module, function = LAPLACIAN
    if module.rpartition(".")[0] not in sys.modules:
        sys.modules[module] = Later(module, (function,))


def collect_cycles_seldom() -> None:
    """Have Python look for unreachable cycles of objects after 20 000 new ones only; the usual number is 700, or 2 000
    in newer versions.

    A program that loads its modules makes many objects but no unreachable cycles, and looking for them takes a tenth of
    the time to start.
    """
    gc.set_threshold(*COLLECTED_AFTER)


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
