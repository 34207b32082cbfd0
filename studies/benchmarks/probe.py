"""What memory and caches deliver at most, with the compiler and the teams of the other kernels."""

from collections.abc import Sequence

import numpy as np

from taichi_bearings.compiler import ti
from taichi_bearings.fields import CPU_BLOCK
from taichi_bearings.fields.fields import number_type
from taichi_bearings.kernels.memory import BLOCKS, VALUES, in_range, load, store
from taichi_bearings.kernels.team import COUNTER, LEAST_CHUNK, Team
from taichi_bearings.memory import aligned_zeros

ROWS = 3  # that a stream works on: two are read and one is written in a pass
CONFLICTS = 512  # numbers: rows so far apart beyond a multiple of that do not compete for places in a cache


@ti.kernel
def stream(
    arrived: COUNTER,
    workers: int,
    begin: int,
    end: int,
    values: VALUES,
    blocks: BLOCKS,
    row: int,
    count: int,
    block: ti.template(),
):
    """Passes over `count` blocks of three rows: each row in turn becomes the mean of the other two."""
    for item in range(workers * LEAST_CHUNK):
        if item % LEAST_CHUNK == 0:
            worker = item // LEAST_CHUNK
            for turn in range(begin, end):
                to, one, other = turn % ROWS * row, (turn + 1) % ROWS * row, (turn + 2) % ROWS * row
                for b in range(count * worker // workers, count * (worker + 1) // workers):
                    first = in_range(b * block)
                    read = load(values, in_range(one + first), block), load(values, in_range(other + first), block)
                    store(values, blocks, in_range(to + first), block, 0.5 * (read[0] + read[1]))


class Stream:
    """Passes over three rows of numbers, `total_bytes` in all: what memory or the cache that holds them delivers."""

    def __init__(self, total_bytes: float, threads: int, memory: np.ndarray | None = None) -> None:
        """memory : that it may use, of a stream at least as large."""
        dtype = number_type()
        self.count = max(threads, int(total_bytes) // (ROWS * CPU_BLOCK * dtype.itemsize))
        sites = self.count * CPU_BLOCK
        self.row = sites + (5 * CPU_BLOCK - sites) % CONFLICTS
        self.values = aligned_zeros(ROWS * self.row, CPU_BLOCK, dtype) if memory is None else memory[: ROWS * self.row]
        self.values[:] = 1.0
        self.bytes = ROWS * sites * dtype.itemsize  # moved by a pass, and held
        self.team = Team(threads)
        self.repeat(0)

    def repeat(self, passes: int) -> None:
        blocks = self.values.reshape(-1, CPU_BLOCK)
        self.team.launch(stream, passes, self.values, blocks, self.row, self.count, CPU_BLOCK)


def streams(sizes: Sequence[float], threads: int) -> list[Stream]:
    """Streams of these sizes, which take turns in the memory of the largest."""
    largest = Stream(max(sizes), threads)
    return [Stream(size, threads, largest.values) for size in sizes]
