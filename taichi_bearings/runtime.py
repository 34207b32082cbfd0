"""Owns the Taichi runtime: which device, which precision, how many threads.

Taichi keeps one global runtime per process; starting it twice would invalidate every field. :func:`start` can be called
again with the same choice and refuses a different one.
"""

import contextlib
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from taichi_bearings import compiler, devices, walks
from taichi_bearings.errors import DeviceError
from taichi_bearings.words import meant

GPUS = ("cuda", "metal", "vulkan")  # in the order in which auto tries them
ARCHITECTURES = ("cpu", "cuda", "vulkan", "metal", "auto")
PRECISIONS = ("f64", "f32")
MOST_THREADS = 64  # most threads that a kernel shares its work among


@dataclass(frozen=True)
class Runtime:
    """The choice with which the running Taichi runtime was started.

    arch : "cpu", "cuda", "vulkan" or "metal".
    precision : "f64" or "f32".
    threads : number of threads on a CPU.
    debug : True if Taichi checks indices.
    """

    arch: str
    precision: str
    threads: int
    debug: bool = False

    def __str__(self) -> str:
        """Return the choice in words, for messages."""
        return f"{self.arch}, {self.precision}, threads {self.threads}{', debug' if self.debug else ''}"

    @property
    def is_gpu(self) -> bool:
        """True on a GPU."""
        return self.arch != "cpu"


_current: Runtime | None = None
_owner: int | None = None
_program: Any = None  # the compiler's own object that we have started


def available_threads() -> int:
    """Return the number of processors that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


HOST = Runtime("cpu", "f64", available_threads())  # of methods that need no Taichi


def usable(arch: str, precision: str = "f64") -> list[devices.Device]:
    """Return the GPUs that can compute in a precision; none where Taichi does not support them.

    arch : "cuda", "vulkan" or "metal", the interface by which they are used.
    precision : "f64" or "f32".
    """
    found = [device for device in devices.find(arch) if device.has_f64 or precision != "f64"]
    if not found:
        return []
    from taichi_bearings.compiler import ti

    return found if ti.lang.misc.is_arch_supported(getattr(ti, arch)) else []


def automatic_arch(precision: str = "f64") -> str:
    """Return the interface, "cuda", "metal" or "vulkan", of the first real GPU that can compute in this precision;
    "cpu" if there is none.
    """
    real = (arch for arch in GPUS if any(not device.is_software for device in usable(arch, precision)))
    return next(real, "cpu")


def current() -> Runtime:
    """Return the running runtime; if there is none, start the default one (cpu, f64, all threads).

    Raises DeviceError if other code has replaced ours.
    """
    if _current is None:
        return start()
    refuse_changed()
    return _current


def running_program() -> Any:
    """Return what the compiler runs in this process, started by us or by other code; None where nothing runs."""
    state = vars(_language().get_runtime())
    return state["_prog"] if "_prog" in state else state.get("prog")


@cache
def _language() -> Any:
    """Return the module of Taichi that holds its global runtime."""
    from taichi_bearings.compiler import ti

    return ti.lang.impl


OWN_PROCESS = "solve in a new process, or by taichi_bearings.solve_many, whose workers are processes of their own"


def refuse_changed() -> None:
    """Raise DeviceError if other code has reset or restarted the compiler since we have started it.

    Our kernels and arrays are gone then. Asking before each launch takes less than a microsecond.
    """
    if _program is not None and running_program() is not _program:
        raise DeviceError(
            f"{compiler.name()} was reset or restarted by other code in this process, after taichi_bearings had "
            f"started it with {_current}; {OWN_PROCESS}"
        )


def start(arch: str = "cpu", precision: str = "f64", threads: int = 0, debug: bool = False) -> Runtime:
    """Start Taichi once per process, and return what it was started with.

    arch : "cpu", "cuda", "vulkan" or "metal" (an error where there is none, never a silent fall-back), or "auto" (a
        real GPU if there is one).
    precision : "f64" or "f32", the type of every field.
    threads : CPU threads, 0 for all that this process may use; no more than MOST_THREADS are used.
    debug : have Taichi check indices.

    Raises DeviceError if the device is absent, or if the runtime already runs with another choice.
    """
    global _current, _owner, _program
    if precision not in PRECISIONS:
        raise DeviceError(
            f"precision is {precision!r}; allowed are {', '.join(PRECISIONS)}{meant(precision, PRECISIONS)}"
        )
    if threads < 0:
        raise DeviceError(f"threads is {threads}; it must be 1 or more, or 0 for all")
    from taichi_bearings.compiler import ti

    refuse_absent(arch, precision)
    arch = automatic_arch(precision) if arch == "auto" else arch
    wanted = Runtime(arch, precision, min(threads or available_threads(), available_threads(), MOST_THREADS), debug)
    if _current is not None:
        if _owner != os.getpid():
            raise DeviceError(
                "Taichi was started before this process was forked; start worker processes by spawn instead"
            )
        refuse_changed()
        if wanted != _current:
            raise DeviceError(
                f"Taichi already runs in this process with {_current}, and a process starts it once; solve with "
                f"{wanted} in a new one, or by taichi_bearings.solve_many, whose workers are processes of their own"
            )
        return _current
    if running_program() is not None:
        raise DeviceError(f"{compiler.name()} was already started in this process by other code; {OWN_PROCESS}")
    kept = compiler.cache_folder()
    compiled_before = kept is not None and any(kept.glob("*.tic"))
    with _without_greeting(ti.lang.misc), compiler.environment(), _out_of_memory():
        ti.init(
            arch=getattr(ti, arch),
            default_fp=getattr(ti, precision),
            default_ip=ti.i32,
            fast_math=False,  # the default breaks compensated sums and reorders the physics
            cpu_max_num_threads=wanted.threads,
            enable_fallback=False,
            real_matrix_scalarize=arch != "cpu",  # on a CPU, blocks of sites are read and written by SIMD instructions
            debug=debug,
            log_level=ti.CRITICAL,  # what goes wrong is an exception, too
            offline_cache=kept is not None,
            offline_cache_file_path=str(kept or Path(__file__).parent),  # Taichi makes it at its end if it is missing
        )
    # the number of threads is in the name of each cached kernel, so that one number serves all runs
    ti.lang.impl.current_cfg().cpu_max_num_threads = MOST_THREADS
    if kept is not None and compiler.name() == "taichi":
        walks.keep(ti, kept.parent / "walks", writes=compiled_before)
    _current, _owner, _program = wanted, os.getpid(), running_program()
    return wanted


@contextlib.contextmanager
def _without_greeting(module: Any) -> Iterator[None]:
    """Have Taichi start inside the block without printing on which device.

    module : the one of Taichi that prints. It gets a `print` of its own: another thread, which writes the line of
        progress, may replace sys.stdout meanwhile and would bring back whatever stood there.
    """
    module.print = lambda *_: None
    try:
        yield
    finally:
        del module.print


_computing = threading.RLock()


@contextlib.contextmanager
def computing_in(kind: str) -> Iterator[None]:
    """Context in which kernels are compiled for numbers of the type `kind`, "float32" or "float64", whatever the
    precision of the runtime. Other threads that compile in such a block wait."""
    from taichi_bearings.compiler import ti

    with _computing:
        state, precise = _language().get_runtime(), {"float32": ti.f32, "float64": ti.f64}[kind]
        before, state.default_fp = state.default_fp, precise
        try:
            yield
        finally:
            state.default_fp = before


def end() -> None:
    """End the runtime of this process, if we have started one: Taichi then writes what it has compiled to its cache.

    Python does this at the end of a program, but not at that of a worker process.
    """
    if _program is not None and running_program() is _program:
        from taichi_bearings.compiler import ti

        ti.reset()


def wait() -> None:
    """Wait until a GPU has done all its work; on a CPU there is nothing to wait for."""
    if _current is not None and _current.is_gpu:
        from taichi_bearings.compiler import ti

        ti.sync()


@contextlib.contextmanager
def _out_of_memory() -> Iterator[None]:
    """Context that turns what Taichi raises when memory is short into MemoryError."""
    try:
        yield
    except RuntimeError as error:
        if "allocation" not in str(error):
            raise
        raise MemoryError(str(error).partition("] ")[2] or str(error)) from None


def refuse_absent(arch: str, precision: str) -> None:
    """Raise DeviceError, with the reason in one sentence, for a device that is not here or lacks a precision.

    arch : one of ARCHITECTURES.
    precision : "f64" or "f32".
    """
    if arch not in ARCHITECTURES:
        raise DeviceError(f"arch is {arch!r}; allowed are {', '.join(ARCHITECTURES)}{meant(arch, ARCHITECTURES)}")
    if arch not in GPUS or usable(arch, precision):
        return
    lacking = [device.name for device in devices.find(arch) if not device.has_f64]
    if lacking and precision == "f64":
        reason = f"{lacking[0]} has no double precision; use --precision f32 or --arch cpu"
    else:
        make = {"cuda": "CUDA", "vulkan": "Vulkan", "metal": "Metal"}[arch]
        reason = f"no {make} device was found here; use --arch cpu or --arch auto"
    raise DeviceError(f"arch is {arch!r} but {reason}")
