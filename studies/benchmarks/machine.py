"""What this machine is and what it can do at most, measured by the compiler and the teams that our kernels have."""

import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import CPU_BLOCK
from taichi_bearings.fields.fields import number_type
from taichi_bearings.kernels.team import Team
from taichi_bearings.memory import aligned_zeros, free_bytes
from taichi_bearings.version import VERSION

from ..report import load, processor
from . import probe

CACHES = Path("/sys/devices/system/cpu/cpu0/cache")
SIZES = tuple(2**k for k in (14, 16, 18, 19, 20, 21, 22, 23, 24, 25, 26, 28, 30))  # bytes of working sets
CONFLICTS = 512  # numbers: rows so far apart beyond a multiple of that do not compete for places in a cache


class Stream:
    """Passes over three rows of numbers, `total_bytes` in all: what memory or the cache that holds them delivers."""

    def __init__(self, total_bytes: float, threads: int, memory: np.ndarray | None = None) -> None:
        """memory : that it may use, of a stream at least as large."""
        dtype = number_type()
        self.count = max(threads, int(total_bytes) // (probe.ROWS * CPU_BLOCK * dtype.itemsize))
        sites = self.count * CPU_BLOCK
        self.row = sites + (5 * CPU_BLOCK - sites) % CONFLICTS
        needed = probe.ROWS * self.row
        self.values = aligned_zeros(needed, CPU_BLOCK, dtype) if memory is None else memory[:needed]
        self.values[:] = 1.0
        self.bytes = probe.ROWS * sites * dtype.itemsize  # moved by a pass, and held
        self.team = Team(threads)
        self.repeat(0)

    def repeat(self, passes: int) -> None:
        blocks = self.values.reshape(-1, CPU_BLOCK)
        self.team.launch(probe.stream, passes, self.values, blocks, self.row, self.count, CPU_BLOCK)


def streams(sizes: Sequence[float], threads: int) -> list[Stream]:
    """Streams of these sizes, which take turns in the memory of the largest."""
    if not sizes:
        return []
    largest = Stream(max(sizes), threads)
    return [Stream(size, threads, largest.values) for size in sizes]


class Chains:
    """Chains of arithmetic, or of roots, on a block of numbers for each thread."""

    def __init__(self, kernel: Any, each: int, threads: int) -> None:
        """each : what one call does a number."""
        dtype = number_type()
        self.kernel, self.team, self.number = kernel, Team(threads), each * CPU_BLOCK * threads
        self.values = aligned_zeros(threads * CPU_BLOCK, CPU_BLOCK, dtype)
        self.repeat(0)

    def repeat(self, calls: int) -> None:
        self.team.launch(self.kernel, calls, self.values, self.values.reshape(-1, CPU_BLOCK), CPU_BLOCK)


def chains(threads: int) -> dict[str, Chains]:
    """The two limits of reckoning: operations and roots a second."""
    return {
        "operations": Chains(probe.arithmetic, probe.ARITHMETIC_FLOPS, threads),
        "roots": Chains(probe.roots, probe.ROOTS, threads),
    }


def sizes_below(most: float) -> list[int]:
    """Working sets for the measured bandwidths, in bytes: at most so large, and at most a quarter of what is free."""
    return [size for size in SIZES if size <= min(most, free_bytes() / 4)]


def describe() -> dict[str, Any]:
    """The machine, its caches in bytes a processor sees, how busy it is, and what runs on it."""
    free = free_bytes()
    return {
        "processor": processor(),
        "threads": runtime.available_threads(),
        "caches": _caches(),
        "free_bytes": free if np.isfinite(free) else None,
        "load": load(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "version": VERSION,
    }


def _caches() -> dict[str, int]:
    """Level -> bytes, of the caches that hold data; empty where the system does not tell."""
    found = {}
    for folder in sorted(CACHES.glob("index*")):
        texts = [folder / name for name in ("level", "type", "size")]
        level, kind, size = (text.read_text().strip() if text.exists() else "" for text in texts)
        if size and kind != "Instruction":
            found[f"L{level}"] = int(size.rstrip("KM")) * (2**20 if size.endswith("M") else 2**10)
    return found
