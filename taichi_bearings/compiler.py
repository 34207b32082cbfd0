"""Imports Taichi, here and nowhere else, and only when it is asked for: ``from taichi_bearings.compiler import ti``.

Quadrants, its maintained fork, takes its place where Taichi is not installed or the environment variable
TAICHI_BEARINGS_COMPILER says so (docs/decisions.md, 8): it must be known before any kernel is read, and worker
processes inherit it.
"""

import contextlib
import importlib.util
import inspect
import linecache
import os
import stat
import tempfile
import time
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from taichi_bearings.errors import DeviceError, warn
from taichi_bearings.later import standing_in

VARIABLE = "TAICHI_BEARINGS_COMPILER"
LOCKED = 300.0  # seconds; an older lock of the compiler is one that a killed process has left
KERNEL_CACHES = {"taichi": "taichi/ticache", "quadrants": "quadrants/qdcache"}  # compiler -> folder below the cache
QUIET = {
    "ENABLE_TAICHI_HEADER_PRINT": "0",
    "ENABLE_QUADRANTS_HEADER_PRINT": "0",
    "TI_LOG_LEVEL": "error",
    "QD_LOG_LEVEL": "error",
    "TI_SKIP_VERSION_CHECK": "ON",  # it asks a server
}


def name() -> str:
    """Return the package that compiles the kernels of this process.

    It is the one that the environment names, else the first that is installed. DeviceError if it is unknown or missing.
    """
    installed = [compiler for compiler in KERNEL_CACHES if importlib.util.find_spec(compiler) is not None]
    chosen = os.environ.get(VARIABLE) or (installed or ["taichi"])[0]
    if chosen not in KERNEL_CACHES:
        raise DeviceError(f"{VARIABLE} is {chosen!r}; allowed are {', '.join(KERNEL_CACHES)}")
    if chosen not in installed:
        raise DeviceError(
            f"{chosen} is not installed here; pip install {chosen}, or set {VARIABLE} to another compiler"
        )
    return chosen


def cache_folder() -> Path | None:
    """Return where compiled kernels are kept.

    It is a folder below the user's cache; or a temporary folder if that cannot be written or others can write there; or
    None if the temporary folder is no better. Locks that a killed compiler has left there are removed.
    """
    home = _cache_home()
    if home is None:
        return None
    folder = home / KERNEL_CACHES[name()]
    for lock in folder.rglob("*.lock"):
        with contextlib.suppress(OSError):
            if time.time() - lock.lstat().st_mtime > LOCKED:
                lock.unlink()
    return folder


def _cache_home() -> Path | None:
    """Return the folder of the user's caches, or a temporary one, whichever is safe; None if neither is."""
    if "XDG_CACHE_HOME" in os.environ:
        home = Path(os.environ["XDG_CACHE_HOME"])
    else:
        try:
            home = Path.home() / ".cache"
        except RuntimeError:  # no home folder at all
            home = Path(os.devnull)
    if _is_ours(home / name()):
        return home
    try:
        home = Path(tempfile.gettempdir()) / f"taichi_bearings-cache-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        is_safe = not home.is_symlink() and _is_ours(home) and _is_ours(home / name())
        return home if is_safe else None
    except OSError:
        return None


def _is_ours(folder: Path) -> bool:
    """Return True if `folder` and the cache in it are the user's own, nobody else can write there, and this process
    can.

    Whether this process can write is found by writing a file, as access bits do not bind root. The folder is made if it
    is missing.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        inside = folder / Path(KERNEL_CACHES[name()]).name
        if not all(_is_private(place.stat()) for place in (folder, inside) if place.exists()):
            return False
        if os.path.lexists(inside) and not inside.is_dir():
            _warn_of_cache(inside)
            return False
        for place in (folder, inside):
            if place.exists():
                tempfile.TemporaryFile(dir=place).close()
        return True
    except OSError:
        return False


@cache
def _warn_of_cache(place: Path) -> None:
    """Warn, once in a process, that the path `place`, where compiled kernels should be kept, is no folder."""
    warn(f"{place} is no folder; compiled kernels are kept in a temporary folder instead")


def _is_private(status: os.stat_result) -> bool:
    """Return True for a file or folder into which nobody but this user can write. Its group may, if the group has the
    user's name and no other member, as on many systems.

    status : file status, as `stat` returns it.
    """
    if not hasattr(os, "getuid"):
        return True
    if status.st_uid != os.getuid() or status.st_mode & stat.S_IWOTH:
        return False
    if not status.st_mode & stat.S_IWGRP:
        return True
    import grp
    import pwd

    try:
        user, group = pwd.getpwuid(status.st_uid).pw_name, grp.getgrgid(status.st_gid)
    except KeyError:
        return False
    return group.gr_name == user and set(group.gr_mem) <= {user}


@contextlib.contextmanager
def environment() -> Iterator[None]:
    """Context in which the environment variables that the compiler reads, when it is imported and started, have the
    values that we want."""
    before, home = os.environ.copy(), _cache_home()
    cache = {"XDG_CACHE_HOME": str(home or os.devnull)}  # without a home folder it would abort
    os.environ.update(QUIET | before | cache)
    if home is None:  # dill, which Taichi imports, asks for the name of a temporary folder
        tempfile.tempdir = os.curdir
    try:
        yield
    finally:
        if home is None:
            tempfile.tempdir = None
        for key in QUIET | cache:
            os.environ.pop(key)
            os.environ.update({key: before[key]} if key in before else {})


def __getattr__(attribute: str) -> Any:
    """Return `ti`, the compiler, which is imported when it is first asked for. Python calls this for an attribute that
    the module does not have yet.
    """
    if attribute != "ti":
        raise AttributeError(f"module {__name__!r} has no attribute {attribute!r}")
    with environment(), warnings.catch_warnings(), _lines_found_quickly():  # Taichi adds filters
        warnings.simplefilter("ignore")  # Taichi uses deprecated parts of Python, even where warnings are errors
        with standing_in("dill"):  # Taichi needs dill only for kernels that were typed into an interactive Python
            globals()["ti"] = importlib.import_module(name())
        with contextlib.suppress(ImportError):
            walker: Any = importlib.import_module(f"{name()}.lang.ast.ast_transformer_utils")
            reader: Any = importlib.import_module(f"{name()}.lang.kernel_impl")
            walker.TextWrapper, reader.inspect = _Unwrapped, SimpleNamespace(**vars(inspect))
            with contextlib.suppress(AttributeError):
                _read_functions_once(reader)
    return globals()["ti"]


@contextlib.contextmanager
def _lines_found_quickly() -> Iterator[None]:
    """Context in which a quick function takes the place of `inspect.getframeinfo`.

    The compiler asks `inspect` for the line that defines each kernel, and `inspect` would go through all modules each
    time.
    """

    def line_of(frame: Any) -> tuple[None, None, None, list[str]]:
        """Return a tuple as `inspect.getframeinfo` does, with the source line of the frame alone, which is all that is
        read.
        """
        return None, None, None, [linecache.getline(frame.f_code.co_filename, frame.f_lineno)]

    before: Any = inspect.getframeinfo
    inspect.getframeinfo = line_of  # type: ignore[assignment]
    try:
        yield
    finally:
        inspect.getframeinfo = before


def _read_functions_once(reader: Any) -> None:
    """Have Taichi read each function that kernels call from its file only once. That halves the time that every process
    takes to read its kernels.

    reader : the module of Taichi that reads kernels.

    Taichi reads the source of a function anew for each kernel that calls it, and makes for every expression a text that
    says where it stands. Here the source is read once (or as often as the function calls itself), and these texts are
    kept. With Quadrants nothing changes.
    """
    read, walk, variables = reader._get_tree_and_ctx, reader.transform_tree, reader._get_global_vars
    context, found = reader.ASTTransformerContext, reader.ASTTransformerContext.get_pos_info
    free: dict[Any, list[Any]] = {}  # function -> its syntax trees that are not in use, each with file and lines

    def read_again(function: Any, **options: Any) -> tuple[Any, Any]:
        """Return the syntax tree of a function and a new context for compiling it. The tree is one of an earlier call
        that is not in use, if there is one; otherwise Taichi reads it from the file.

        function : the function, as Taichi stores it.
        options : further arguments of Taichi's reader.
        """
        if not free.get(function):
            value: tuple[Any, Any] = read(function, **options)
            return value
        tree, origin = free[function].pop()
        options |= {"func": function, "argument_data": options.pop("args"), "global_vars": variables(function.func)}
        return tree, context(**options, **origin)

    def walk_and_keep(tree: Any, used: Any) -> Any:
        """Compile a function from its syntax tree, and keep the tree for the next call.

        tree : the syntax tree.
        used : the context in which it is compiled.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of the kinds of expressions that Python 3.12 knows
            result = walk(tree, used)
        if not used.is_kernel and not used.is_real_function:
            origin = {"file": used.file, "src": used.src, "start_lineno": used.lineno_offset + 1}
            free.setdefault(used.func, []).append((tree, origin))
        return result

    def position(used: Any, node: Any) -> str:
        """Return file, line and source of an expression in Taichi's words, made once and then stored in the node.

        used : the context of the compilation.
        node : node of the syntax tree.
        """
        if not hasattr(node, "position"):
            node.position = found(used, node)
        value: str = node.position
        return value

    reader._get_tree_and_ctx, reader.transform_tree, context.get_pos_info = read_again, walk_and_keep, position


class _Unwrapped:
    """Stands in for the TextWrapper with which Taichi wraps the source lines of each expression, and wraps nothing.

    That halves the time to read a kernel, which every process does before it finds the compiled one.
    """

    def __init__(self, width: int) -> None:
        """Take the width of a line, as a TextWrapper does; it is not used."""
        pass

    def wrap(self, text: str) -> list[str]:
        """Return the text as the only line; no line for an empty text."""
        return [text] if text.strip() else []
