"""CPU workers that stay together for many sweeps, meeting at a barrier in memory.

Waking Taichi's thread pool for every loop costs 50 to 100 microseconds, as much as a whole sweep of 32^3 spheres. So a
launch wakes it once: each worker keeps its share of the blocks, and they wait for each other by counting arrivals
(docs/decisions/0003). The shares only decide who computes a value, never the value: any number of workers gives the
same bits, and one kernel serves them all.

Polling is wasteful when other programs want the cores: a worker that is taken off its core makes the others wait. A
team that got less processor time than its size goes on for a while with as many workers as it got processors.
"""

import time
from typing import Any

import numpy as np
import taichi as ti

from taichi_bearings.errors import DeviceError

COUNTER = ti.types.ndarray(dtype=ti.i32, ndim=1)
LEAST_CHUNK = 512  # Taichi hands loop iterations to threads in chunks of at least this many
MISSED = 0.2  # of a processor; a team that got less than its size by so much shares the cores with other programs
SHORT = 0.02  # seconds; launches too short to judge by
FIRST_REST, LONGEST_REST = 1.0, 20.0  # seconds that a smaller team goes on
PATIENCE = 2**30  # polls, about ten seconds: a partner that never comes means that the threads do not run side by side


class Team:
    """Workers for the launches of one solve; 0 stands for a GPU, which needs none."""

    def __init__(self, size: int) -> None:
        self.size, self.arrived = size, np.zeros(1, np.int32)
        self.workers, self.rest_until, self.rest = size, 0.0, FIRST_REST

    def launch(self, kernel: Any, *arguments: Any) -> None:
        """Call ``kernel(arrived, workers, *arguments)`` with as many workers as the machine has room for now."""
        if time.monotonic() >= self.rest_until:
            self.workers = self.size
        self.arrived[0] = 0
        wall, processor = time.perf_counter(), time.process_time()
        kernel(self.arrived, self.workers, *arguments)
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        if self.arrived[0] >= PATIENCE:
            raise DeviceError(f"{self.workers} threads could not run side by side here; use --threads 1")
        if self.workers < self.size or self.size == 1 or wall < SHORT:
            return
        if processor < (self.size - MISSED) * wall:
            self.workers = max(1, int(processor / wall))
            self.rest_until, self.rest = time.monotonic() + self.rest, min(2 * self.rest, LONGEST_REST)
        else:
            self.rest = FIRST_REST


@ti.func
def meet(arrived: ti.template(), target):
    """Wait until there were `target` arrivals since the launch: all workers, for the target/workers-th time."""
    ti.atomic_add(arrived[0], 1)
    polls = 0
    while polls < PATIENCE and ti.atomic_or(arrived[0], 0) < target:
        polls += 1
    if polls >= PATIENCE:
        ti.atomic_max(arrived[0], PATIENCE)  # lets everyone through; launch() reports it
