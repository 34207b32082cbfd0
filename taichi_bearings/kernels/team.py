"""CPU workers that stay together for many sweeps, meeting at a barrier in memory.

Waking Taichi's thread pool for every loop costs 50 to 100 microseconds, as much as a whole sweep of 32^3 spheres. So a
launch wakes it once: each worker keeps its share of the blocks, and they wait for each other by counting arrivals
(docs/decisions/0003). The shares only decide who computes a value, never the value: any number of workers gives the
same bits.
"""

import taichi as ti

from taichi_bearings.errors import DeviceError

LEAST_CHUNK = 512  # Taichi hands loop iterations to threads in chunks of at least this many
PATIENCE = 2**30  # polls, about ten seconds: a partner that never comes means that the threads do not run side by side


@ti.data_oriented
class Team:
    """Base of kernels that run alone or as a team. A launch of a team begins by setting `arrived` to 0."""

    def __init__(self, fields, workers: int):
        self.arrived, self.workers, self.items = fields["arrived"], workers, LEAST_CHUNK * workers

    @ti.func
    def meet(self, target):
        """Wait until there were `target` arrivals since the launch: all workers, for the target/workers-th time."""
        ti.atomic_add(self.arrived[None], 1)
        polls = 0
        while polls < PATIENCE and ti.atomic_or(self.arrived[None], 0) < target:
            polls += 1
        if polls >= PATIENCE:
            ti.atomic_max(self.arrived[None], PATIENCE)  # lets everyone through; check() reports it

    def check(self):
        """Raise DeviceError if a worker of the last launch waited in vain."""
        if self.arrived[None] >= PATIENCE:
            raise DeviceError(f"{self.workers} threads could not run side by side here; use --threads 1")
