"""The only owner of the Taichi runtime: which device, which precision, how many threads.

Taichi keeps one global runtime per process; starting it twice would invalidate every field. :func:`start` is free to
repeat with the same choice and refuses a different one. Importing this module prepares the environment that Taichi
reads when *it* is imported, so every module that uses Taichi imports this one first (``kernels/__init__.py`` does).
"""

import contextlib
import io
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

from taichi_bearings.errors import DeviceError

ARCHITECTURES = ("cpu", "cuda", "auto")
PRECISIONS = ("f64", "f32")


def _writable(folder: Path) -> bool:
    """True if `folder` can be created and written to; checked by doing it, since access bits lie to root."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def cache_folder() -> Path:
    """Folder in which Taichi keeps compiled kernels: the user's cache, or a temporary one if that cannot be written."""
    if "XDG_CACHE_HOME" in os.environ:
        home = Path(os.environ["XDG_CACHE_HOME"])
    else:
        try:
            home = Path.home() / ".cache"
        except RuntimeError:  # no home folder at all
            home = Path(os.devnull)
    if _writable(home / "taichi"):
        return home
    user = os.getuid() if hasattr(os, "getuid") else "user"
    return Path(tempfile.gettempdir()) / f"taichi_bearings-cache-{user}"


def _prepare_environment() -> None:
    os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
    os.environ.setdefault("TI_LOG_LEVEL", "error")
    os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
    os.environ["XDG_CACHE_HOME"] = str(cache_folder())


_prepare_environment()


@dataclass(frozen=True)
class Runtime:
    """What the running Taichi runtime was started with."""

    arch: str
    precision: str
    threads: int
    debug: bool = False

    @property
    def is_gpu(self) -> bool:
        return self.arch != "cpu"


_current: Runtime | None = None
_owner: int | None = None


def available_threads() -> int:
    """Number of processors this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


HOST = Runtime("cpu", "f64", available_threads())  # where methods run that need no Taichi


def has_cuda() -> bool:
    """True if Taichi finds a usable CUDA device."""
    import taichi as ti

    with contextlib.redirect_stdout(io.StringIO()):
        return bool(ti.lang.misc.is_arch_supported(ti.cuda))


def current() -> Runtime:
    """The running runtime; starts the default one (cpu, f64, all threads) if there is none."""
    return _current if _current is not None else start()


def start(arch: str = "cpu", precision: str = "f64", threads: int = 0, debug: bool = False) -> Runtime:
    """Start Taichi once per process.

    arch : "cpu", "cuda" (an error where there is none, never a silent fall-back) or "auto" (cuda if present).
    precision : "f64" or "f32", the type of every field.
    threads : CPU threads, 0 for all that this process may use.

    Raises DeviceError if the device is absent, or if the runtime already runs with another choice.
    """
    global _current, _owner
    if arch not in ARCHITECTURES:
        raise DeviceError(f"arch is {arch!r}; allowed are {', '.join(ARCHITECTURES)}")
    if precision not in PRECISIONS:
        raise DeviceError(f"precision is {precision!r}; allowed are {', '.join(PRECISIONS)}")
    if threads < 0:
        raise DeviceError(f"threads is {threads}; it must be 1 or more, or 0 for all")
    import taichi as ti

    if arch == "auto":
        arch = "cuda" if has_cuda() else "cpu"
    elif arch == "cuda" and not has_cuda():
        raise DeviceError("arch is 'cuda' but no CUDA device was found here; use --arch cpu or --arch auto")
    wanted = Runtime(arch, precision, min(threads or available_threads(), available_threads()), debug)
    if _current is not None:
        if _owner != os.getpid():
            raise DeviceError("the Taichi runtime was started before this process was forked; start workers by spawn")
        if wanted != _current:
            raise DeviceError(f"the Taichi runtime already runs as {_current}; {wanted} needs a process of its own")
        return _current
    with contextlib.redirect_stdout(io.StringIO()):
        ti.init(
            arch=getattr(ti, arch),
            default_fp=getattr(ti, precision),
            default_ip=ti.i32,
            fast_math=False,  # the default breaks compensated sums and reorders the physics
            cpu_max_num_threads=wanted.threads,
            enable_fallback=False,
            debug=debug,
            log_level=ti.ERROR,
        )
    _current, _owner = wanted, os.getpid()
    return wanted
