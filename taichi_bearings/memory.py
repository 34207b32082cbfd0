"""Finds how much memory is free, so that what cannot fit is refused before it begins, and not killed by the system."""

import ctypes
import math
import os
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from taichi_bearings.errors import InputError

CGROUP = Path("/sys/fs/cgroup")
LITTLE_BYTES = 1e8  # if less is needed the free memory is not looked at
# options of mallopt of the GNU C library: M_MMAP_MAX, how many arrays may get memory of their own, which is given back
# at once; and in bytes M_TRIM_THRESHOLD, free memory at the end of the heap from which that is given back, and
# M_TOP_PAD, by how much the heap grows at a time
MALLOC_OPTIONS = {-4: 0, -1: 2**29, -2: 2**26}
# Advice to Linux, from 5.14 on: provide memory now, as the first write to it would (MADV_POPULATE_WRITE); and how many
# bytes at a time, as other threads that want memory wait meanwhile
POPULATE_WRITE, BYTES_AT_ONCE = 23, 2**22
ESTIMATE_MARGIN = 1.15  # factor by which estimates of the memory of large solves may be too low


class NotEnoughMemory(InputError, MemoryError):
    """Raised before work begins that needs more memory than there is."""


def free_bytes() -> float:
    """Return the memory that this process may still get, in bytes; infinite where that is not known."""
    free = bytes_by_linux("/proc/meminfo", "MemAvailable", math.inf)
    with suppress(OSError, ValueError):  # "max" is no number
        limit, used = ((CGROUP / name).read_text() for name in ("memory.max", "memory.current"))
        free = min(free, int(limit) - int(used))
    if sys.platform != "win32":
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            with suppress(OSError):
                pages = int(Path("/proc/self/statm").read_text().split()[0])
                free = min(free, most - pages * os.sysconf("SC_PAGE_SIZE"))
    return free


def bytes_by_linux(file: str, name: str, unknown: float = math.nan) -> float:
    """Return an amount of memory, bytes, that Linux reports.

    file : "/proc/meminfo", on the machine, or "/proc/self/status", on this process.
    name : name of the number there, such as "MemAvailable" or "VmHWM", the most memory that the process has had.
    unknown : what is returned where the system has no such file or number.
    """
    with suppress(OSError, StopIteration, ValueError):
        lines = Path(file).read_text().splitlines()
        return 1024.0 * int(next(line for line in lines if line.startswith(f"{name}:")).split()[1])
    return unknown


def refuse_beyond(needed: float, what: str) -> None:
    """Raise MemoryError if `needed` bytes are not free.

    what : what needs them, for the message.
    """
    free = free_bytes() if needed > LITTLE_BYTES else needed
    if needed > free:
        raise MemoryError(f"{what} needs {needed / 1e9:.1f} GB of memory; {max(free, 0) / 1e9:.1f} GB are free")


def keep_freed() -> None:
    """Have the C library keep memory that large arrays give back, for the arrays that follow.

    Otherwise the operating system takes the pages back, and has to clear them again at their next use. Without the GNU
    library nothing changes.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):  # no C library with such a function
        return
    for option, size in MALLOC_OPTIONS.items():
        mallopt(option, size)


def give_back_freed() -> None:
    """Have the C library give the memory that arrays have left free back to the system, before much is needed at once.

    Without the GNU library nothing changes.
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def refuse_before(needed: float, what: str) -> None:
    """Raise NotEnoughMemory if `needed` bytes times ESTIMATE_MARGIN are not free: the number is an estimate that may be
    too low by this factor.

    what : what needs them, for the message.
    """
    free = free_bytes() if needed > LITTLE_BYTES else np.inf
    if needed * ESTIMATE_MARGIN > free:
        words = f"needs some {needed / 1e9:.1f} GB of memory; {max(free, 0) / 1e9:.1f} GB are free"
        raise NotEnoughMemory(f"{what} {words}")


def aligned_zeros(count: int, block: int, dtype: DTypeLike = float) -> np.ndarray:
    """Return zeros, (count,), at an address that is a multiple of the size of `block` numbers, as SIMD instructions
    that write a whole block expect.

    count : number of zeros.
    block : how many numbers such an instruction writes.
    dtype : type of the numbers.
    """
    memory = np.zeros(count + block, dtype)
    start = -(memory.ctypes.data // memory.itemsize) % block
    return memory[start : start + count]


def provide(array: np.ndarray) -> None:
    """Have Linux provide the memory of an array, which the first write to each page would do otherwise. Its numbers
    stay as they are, so that other threads may use it meanwhile. Where the system cannot do so, nothing changes.

    array : any array in C order.
    """
    if sys.platform != "linux":
        return
    advise, page = ctypes.CDLL(None).madvise, os.sysconf("SC_PAGE_SIZE")
    first, end = -(-array.ctypes.data // page) * page, (array.ctypes.data + array.nbytes) // page * page
    for begin in range(first, end, BYTES_AT_ONCE):
        length = ctypes.c_size_t(min(BYTES_AT_ONCE, end - begin))
        if advise(ctypes.c_void_p(begin), length, POPULATE_WRITE):  # an older system, or no memory is left
            return
