"""CPU workers that stay together for many sweeps, meeting at a barrier in memory.

Waking Taichi's thread pool for every loop costs 50 to 100 microseconds, as much as a whole sweep of 32^3 spheres. So a
launch wakes it once: each worker keeps its share of the blocks, and they wait for each other by counting arrivals
(docs/decisions/0003). The shares only decide who computes a value, never the value: any number of workers gives the
same bits.

Polling is wasteful when other programs want the cores: a worker that is taken off its core makes the others wait. A
team notices that it got less processor time than its size, and lets one worker go on alone for a while.
"""

import time

import taichi as ti

from taichi_bearings.errors import DeviceError

LEAST_CHUNK = 512  # Taichi hands loop iterations to threads in chunks of at least this many
FAIR_SHARE = 0.7  # of the processor time a team could use; with less, others are using the cores
SHORT = 0.02  # seconds; launches too short to judge by
FIRST_REST, LONGEST_REST = 1.0, 20.0  # seconds that one worker goes on alone
PATIENCE = 2**30  # polls, about ten seconds: a partner that never comes means that the threads do not run side by side


@ti.data_oriented
class Team:
    """Base of kernels that run alone or as a team. A launch of a team begins by setting `arrived` to 0."""

    def __init__(self, fields, workers: int):
        self.arrived, self.workers, self.items = fields["arrived"], workers, LEAST_CHUNK * workers
        self.rest_until, self.rest = 0.0, FIRST_REST

    def launch(self, alone, by_team, count, *arguments):
        """Call the kernel `alone` or `by_team` with `count` and `arguments`, whichever suits the machine now.

        A count of 0 compiles the kernel that will be used, and judges nothing.
        """
        if count == 0 and self.workers > 1:
            by_team(count, *arguments)
            return
        if self.workers == 1 or time.monotonic() < self.rest_until:
            alone(count, *arguments)
            return
        wall, processor = time.perf_counter(), time.process_time()
        by_team(count, *arguments)
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        if self.arrived[None] >= PATIENCE:
            raise DeviceError(f"{self.workers} threads could not run side by side here; use --threads 1")
        if wall < SHORT:
            return
        if processor < FAIR_SHARE * self.workers * wall:
            self.rest_until, self.rest = time.monotonic() + self.rest, min(2 * self.rest, LONGEST_REST)
        else:
            self.rest = FIRST_REST

    @ti.func
    def meet(self, target):
        """Wait until there were `target` arrivals since the launch: all workers, for the target/workers-th time."""
        ti.atomic_add(self.arrived[None], 1)
        polls = 0
        while polls < PATIENCE and ti.atomic_or(self.arrived[None], 0) < target:
            polls += 1
        if polls >= PATIENCE:
            ti.atomic_max(self.arrived[None], PATIENCE)  # lets everyone through; launch() reports it
