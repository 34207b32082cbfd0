"""How much memory there is, so that what cannot fit is refused before it is begun and not ended by the system."""

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
LITTLE_BYTES = 1e8  # bytes
# options of mallopt of the GNU C library: bytes from which memory is taken for itself and given back at once, of free
# memory at the end of the heap from which that is given back, and taken with each growth of the heap
MALLOC_OPTIONS = {-3: 2**25, -1: 2**29, -2: 2**26}
TOLD_WITHIN = 1.15  # factor by which what is told of large solves may be too low


class NotEnoughMemory(InputError, MemoryError):
    """What is asked for needs more memory than there is, as is known before it is begun."""


def free_bytes() -> float:
    """Memory that this process may still get, bytes; infinite where that is not known."""
    room = math.inf
    with suppress(OSError, StopIteration, ValueError):
        lines = Path("/proc/meminfo").read_text().splitlines()
        room = 1024.0 * int(next(line for line in lines if line.startswith("MemAvailable:")).split()[1])
    with suppress(OSError, ValueError):  # "max" is no number
        limit, used = ((CGROUP / name).read_text() for name in ("memory.max", "memory.current"))
        room = min(room, int(limit) - int(used))
    if sys.platform != "win32":
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            with suppress(OSError):
                pages = int(Path("/proc/self/statm").read_text().split()[0])
                room = min(room, most - pages * os.sysconf("SC_PAGE_SIZE"))
    return room


def refuse_beyond(needed: float, what: str) -> None:
    """MemoryError if so many bytes are not there; little is not worth a look."""
    room = free_bytes() if needed > LITTLE_BYTES else needed
    if needed > room:
        raise MemoryError(f"{what} needs {needed / 1e9:.1f} GB; {max(room, 0) / 1e9:.1f} GB are free")


def keep_freed() -> None:
    """Have the C library keep what arrays of some megabytes give back for those that follow: a page that the system has
    taken back is cleared, and faulted in, each time it is used again. Elsewhere than with the GNU library nothing is
    changed."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):  # no C library with such a function
        return
    for option, size in MALLOC_OPTIONS.items():
        mallopt(option, size)


def refuse_before(needed: float, what: str) -> None:
    """NotEnoughMemory if so many bytes, told before the work is begun, are not there; they may be told too low."""
    room = free_bytes() if needed > LITTLE_BYTES else np.inf
    if needed * TOLD_WITHIN > room:
        words = f"needs some {needed / 1e9:.1f} GB of memory; {max(room, 0) / 1e9:.1f} GB are free"
        raise NotEnoughMemory(f"{what} {words}")


def aligned_zeros(count: int, block: int, dtype: DTypeLike = float) -> np.ndarray:
    """Zeros (count,) at an address that is a multiple of a block of them, as SIMD writes of whole blocks expect."""
    memory = np.zeros(count + block, dtype)
    start = -(memory.ctypes.data // memory.itemsize) % block
    return memory[start : start + count]
