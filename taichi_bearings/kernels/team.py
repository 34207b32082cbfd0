"""CPU workers that stay together for many sweeps, meeting at a barrier in memory.

Waking Taichi's thread pool for every loop costs 50 to 100 microseconds, as much as a whole sweep of 32^3 spheres. So a
launch wakes it once: each worker keeps its share of the blocks, and they wait for each other by counting arrivals
(docs/decisions/0003). The shares only decide who computes a value, never the value: any number of workers gives the
same bits, and one kernel serves them all.

Polling is wasteful when other programs want the cores: a worker that is taken off its core makes the others wait. So
many steps are made in several launches, and a team that got less processor time than its size goes on for a while with
as many workers as it got processors, before a short launch tries the whole team again.
"""

import math
import time
from typing import Any

import numpy as np

from taichi_bearings.compiler import ti
from taichi_bearings.errors import DeviceError

COUNTER = ti.types.ndarray(dtype=ti.i32, ndim=1)
LEAST_CHUNK = 512  # Taichi hands loop iterations to threads in chunks of at least this many
MISSED = 0.2  # of a processor; a team that got less than its size by so much shares the cores with other programs
TRIAL, PIECE = 0.01, 0.3  # seconds that a launch should take: the first of a team, and the longest after it did well
SHORT = 0.004  # seconds; launches too short to judge by
FIRST_REST, LONGEST_REST = 1.0, 20.0  # seconds that a smaller team goes on
PATIENCE = 2**30  # polls, about ten seconds: a partner that never comes means that the threads do not run side by side


class Team:
    """Workers for the launches of one solve; 0 stands for a GPU, which needs none."""

    def __init__(self, size: int) -> None:
        self.size, self.arrived = size, np.zeros(1, np.int32)
        self.workers, self.piece, self.rest_until, self.rest = size, TRIAL if size > 1 else PIECE, 0.0, FIRST_REST
        self.seconds = math.inf  # that a step took lately

    def launch(self, kernel: Any, count: int, *arguments: Any) -> None:
        """Call ``kernel(arrived, workers, begin, end, *arguments)`` for steps 0 ... count - 1, in one or more pieces,
        with as many workers as the machine has room for. A count of 0 compiles it."""
        begin = 0
        while begin < count or count == 0:
            if self.workers < self.size and time.monotonic() >= self.rest_until:
                self.workers, self.piece = self.size, TRIAL
            end = min(count, begin + max(1, int(self.piece / self.seconds))) if count else 0
            self.arrived[0] = 0
            wall, processor = time.perf_counter(), time.process_time()
            kernel(self.arrived, self.workers, begin, end, *arguments)
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            if count == 0:
                return
            if self.arrived[0] >= PATIENCE:
                raise DeviceError(f"{self.workers} threads could not run side by side here; use --threads 1")
            self.seconds, begin = wall / (end - begin), end
            if self.workers == self.size > 1 and wall >= SHORT:
                self._judge(processor / wall)

    def _judge(self, processors: float) -> None:
        """Make do with as many workers as the whole team got processors, if it did not get all."""
        if processors >= self.size - MISSED:
            self.piece, self.rest = min(2 * self.piece, PIECE), FIRST_REST
            return
        self.workers, self.piece = max(1, int(processors)), PIECE
        self.rest_until, self.rest = time.monotonic() + self.rest, min(2 * self.rest, LONGEST_REST)


@ti.func
def meet(arrived: ti.template(), target):
    """Wait until there were `target` arrivals since the launch: all workers, for the target/workers-th time."""
    ti.atomic_add(arrived[0], 1)
    polls = 0
    while polls < PATIENCE and ti.atomic_or(arrived[0], 0) < target:
        polls += 1
    if polls >= PATIENCE:
        ti.atomic_max(arrived[0], PATIENCE)  # lets everyone through; launch() reports it
