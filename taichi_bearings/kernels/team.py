"""CPU workers that stay together for many sweeps, meeting at a barrier in memory.

Waking Taichi's thread pool for every loop costs 50 to 100 microseconds, as much as a whole sweep of 32^3 spheres. So a
launch wakes it once: each worker keeps its share of the blocks, and they wait for each other by counting arrivals
(docs/decisions.md, 3). The shares only decide who computes a value, never the value: any number of workers gives the
same bits, and one kernel serves them all. On a GPU the same kernel makes a few steps a launch, a thread for each site.

Polling is wasteful when other programs want the cores: a worker that is taken off its core makes the others wait. So
many steps are made in several launches, and a team that got less processor time than its size goes on for a while with
as many workers as it got processors, before a short launch tries the whole team again.

A *turn* is one step of a method over all sites; it makes one or more *sweeps*, each of one or more *parts*.
"""

import math
import time
from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.compiler import ti
from taichi_bearings.errors import DeviceError
from taichi_bearings.fields import Fields, on_device
from taichi_bearings.kernels.memory import BLOCKS, INTEGERS, VALUES, in_range, load, store, with_rings

# turns that a GPU makes in one launch: Python takes 90 microseconds for a launch, CUDA 6 for each part of it; with 16
# turns a launch, steps would be a third faster and take twice as long to compile (docs/methods.md)
TURNS_A_LAUNCH = {"cuda": 8}
LEAST_CHUNK = 512  # Taichi hands loop iterations to threads in chunks of at least this many
# processors; a team that got so much less processor time than its size shares the cores with other programs
MISSED_PROCESSORS = 0.2
# seconds that a launch should take: the first launch of a team, and the longest after launches went well
TRIAL_SECONDS, PIECE_SECONDS = 0.01, 0.3
SHORT_SECONDS = 0.004  # launches that take less are too short to judge by
FIRST_REST, LONGEST_REST = 1.0, 20.0  # seconds for which a smaller team goes on, at first and at most
MOST_POLLS = (
    2**30
)  # polls, about ten seconds: a partner that never comes means that the threads do not run side by side


Made = TypeVar("Made")


class Team:
    """Workers for the launches of one solve.

    size : their number; 0 stands for a GPU, which needs none and gets a launch for a few steps.
    """

    def __init__(self, size: int) -> None:
        self.size, self.arrived = size, np.zeros(1, np.int32) if size else ti.ndarray(ti.i32, 1)
        self.workers, self.piece = size, TRIAL_SECONDS if size > 1 else PIECE_SECONDS
        self.rest_until, self.rest = 0.0, FIRST_REST
        self.seconds = math.inf  # that a step took lately

    def launch(self, kernel: Any, count: int, *arguments: Any, first: int = 0, together: int = 1) -> None:
        """Call ``kernel(arrived, workers, begin, end, *arguments)`` for `count` steps from the number `first` on.

        It takes one or more launches, with as many workers as there are processors to be had. A count of 0 compiles the
        kernel. together : steps of one launch on a GPU.

        Raises DeviceError if the threads do not run side by side.
        """
        runtime.refuse_changed()
        if self.size == 0:
            for step in range(first, first + max(count, 1), together):
                kernel(self.arrived, 0, step, min(step + together, first + count), *arguments)
            return
        begin = 0
        while begin < count or count == 0:
            if self.workers < self.size and time.monotonic() >= self.rest_until:
                self.workers, self.piece = self.size, TRIAL_SECONDS
            end = min(count, begin + max(1, int(self.piece / self.seconds))) if count else 0
            self.arrived[0] = 0
            wall, processor = time.perf_counter(), time.process_time()
            kernel(self.arrived, self.workers, first + begin, first + end, *arguments)
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            if count == 0:
                return
            if self.arrived[0] >= MOST_POLLS:
                raise DeviceError(f"{self.workers} threads could not run side by side here; use --threads 1")
            self.seconds, begin = wall / (end - begin), end
            if self.workers == self.size > 1 and wall >= SHORT_SECONDS:
                self._judge(processor / wall)

    def _judge(self, processors: float) -> None:
        """Reduce the team to as many workers as it got processors, if it did not get all. processors : their mean
        number.
        """
        if processors >= self.size - MISSED_PROCESSORS:
            self.piece, self.rest = min(2 * self.piece, PIECE_SECONDS), FIRST_REST
            return
        self.workers, self.piece = max(1, int(processors)), PIECE_SECONDS
        self.rest_until, self.rest = time.monotonic() + self.rest, min(2 * self.rest, LONGEST_REST)


@ti.func
def meet(arrived: ti.template(), target):
    """Wait until there were `target` arrivals since the launch: all workers, for the target/workers-th time."""
    ti.atomic_add(arrived[0], 1)
    polls = 0
    while polls < MOST_POLLS and ti.atomic_or(arrived[0], 0) < target:
        polls += 1
    if polls >= MOST_POLLS:
        ti.atomic_max(arrived[0], MOST_POLLS)  # lets everyone through; launch() reports it


@lru_cache
def made_once(kind: Callable[..., Made], *configuration: Any) -> Made:
    """Return kind(*configuration), the same object for equal configurations, so that its kernels are compiled once."""
    return kind(*configuration)


@lru_cache(maxsize=16)
def _constants(numbers: tuple[float, ...]) -> Any:
    """Return numbers that all sites share in memory that kernels read."""
    return on_device(np.array(numbers, dtype=np.float64))


@ti.data_oriented
class Sweeps:
    """A kernel that makes turns over all sites; subclasses say in `walk` what is done with one block of sites.

    A turn is `repeats` sweeps, each of the same `parts` one after the other. A part reads nothing that it writes at
    other sites.

    numbers : how many constants it takes.
    measures : how many integers at the begin of `Fields.tables` say where the sites are; see `Layout.measures`.
    """

    parts, repeats, numbers, measures = 1, 1, 1, 6

    def __init__(self, block: int, periodic: tuple[int, ...] = ()) -> None:
        """block : sites that are worked on together. periodic : axes that close on themselves."""
        self.block, self.periodic, self.on_gpu = block, periodic, runtime.current().is_gpu
        self.together = TURNS_A_LAUNCH.get(runtime.current().arch, 1)

    def run(self, fields: Fields, team: Team, turns: int, numbers: tuple[float, ...], first: int = 0) -> None:
        """Make `turns` turns, numbered from `first` on: in one launch, or on a GPU in one for a few of them.

        numbers : constants of the kernel.
        """
        arguments = fields.values, fields.blocks, fields.tables, _constants(tuple(map(float, numbers)))
        team.launch(self.turns, turns, *arguments, first=first, together=self.together)

    def compile(self, fields: Fields, team: Team) -> None:
        """Compile the kernel, without a turn."""
        self.run(fields, team, 0, (0.0,) * self.numbers)

    @ti.func
    def enter(self, values: ti.template(), size: ti.template(), low, numbers: ti.template(), sweep):
        """Return what a worker carries from block to block, at its first block, which is number `low`. size : the
        measures.
        """
        return [0.0]

    @ti.func
    def count(self, part: ti.template(), size: ti.template()):
        """Return the number of blocks of a part."""
        return size[2]

    @ti.func
    def visit(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), tables: ti.template(),
        size: ti.template(), number, numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """Do one part of a sweep for the block of this number.

        Subclasses define `walk`, which works on the sites from `first` on; row : length of a row of numbers; strides :
        see `with_rings`.
        """
        sides = [in_range(size[3]), in_range(size[4]), 1]
        strides = with_rings(sides, number * self.block, size[5], self.periodic)
        first = in_range(size[1] + number * self.block)
        self.walk(part, values, blocks, size[0], first, strides, numbers, sweep, carried)

    @ti.func
    def sum_up(self, values: ti.template(), blocks: ti.template(), sums: ti.template(), new: ti.template()):
        """Add numbers of a block of sites to those at the places `sums`."""
        for k in ti.static(range(len(sums))):
            store(values, blocks, sums[k], self.block, load(values, sums[k], self.block) + new[k])

    @ti.kernel
    def turns(
        self, arrived: INTEGERS, workers: int, begin: int, end: int, values: VALUES, blocks: BLOCKS, tables: INTEGERS,
        constants: VALUES,
    ):  # fmt: skip
        """Make the turns `begin` ... `end` - 1 over all blocks.

        arrived, workers : counter of the barrier, and number of workers. values, blocks, tables : see `Fields`.
            constants : see the class.
        """
        if ti.static(self.on_gpu):
            for turn, again, part in ti.static(ti.ndrange(self.together, self.repeats, self.parts)):
                for b in range(self.count(part, tables) * (begin + turn < end)):
                    numbers = [constants[k] for k in ti.static(range(self.numbers))]
                    size = [tables[k] for k in ti.static(range(self.measures))]
                    sweep = (begin + turn) * self.repeats + again
                    carried = self.enter(values, size, b, numbers, sweep)
                    self.visit(part, values, values, tables, size, b, numbers, sweep, carried)
        else:
            for item in range(workers * LEAST_CHUNK):
                if item % LEAST_CHUNK == 0:
                    worker, met = item // LEAST_CHUNK, 0
                    size = [tables[k] for k in ti.static(range(self.measures))]
                    numbers = [constants[k] for k in ti.static(range(self.numbers))]
                    for sweep in range(begin * self.repeats, end * self.repeats):
                        for part in ti.static(range(self.parts)):
                            count = self.count(part, size)
                            low, high = count * worker // workers, count * (worker + 1) // workers
                            carried = self.enter(values, size, low, numbers, sweep)
                            for b in range(low, high):
                                self.visit(part, values, blocks, tables, size, b, numbers, sweep, carried)
                            met += workers
                            meet(arrived, met)
