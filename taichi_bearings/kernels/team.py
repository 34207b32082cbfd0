"""Runs many steps of a method in one launch of a kernel; its threads wait for each other at a barrier in memory.

Waking Taichi's thread pool for every loop costs 50 to 100 microseconds, as much as a whole sweep of 32^3 spheres. So a
launch wakes it once. Each *worker* (thread) keeps its share of the blocks of sites, and workers wait for each other by
counting arrivals (docs/decisions.md, 3). The shares only decide who computes a value, never the value, so any number of
workers gives the same bits, and one kernel serves them all. On a GPU the same kernel makes a few steps a launch, with a
thread for each site.

Waiting by reading a counter is wasteful when other programs want the cores: a worker that is taken off its core makes
the others wait. So many steps are made in several launches. If a launch gets fewer processors than it has workers, the
next ones have as many workers as it got processors; after a while a short launch tries all workers again.

A *turn* is one step of a method over all sites; it makes one or more *sweeps*, each of one or more *parts*. A *block*
is a group of neighbouring sites that are worked on together.
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
# turns, steps would be a third faster, but twice as long to compile (docs/measurements.md)
TURNS_A_LAUNCH = {"cuda": 8}
LEAST_CHUNK = 512  # Taichi hands loop iterations to threads in chunks of at least this many
MISSED_PROCESSORS = 0.2  # if a launch gets so many processors less than it has workers, other programs use them
# seconds that a launch should take: the first launch of a team, and the longest after launches went well
TRIAL_SECONDS, PIECE_SECONDS = 0.01, 0.3
SHORT_SECONDS = 0.004  # launches that take less are too short to judge by
FIRST_REST, LONGEST_REST = 1.0, 20.0  # seconds for which a smaller team goes on, at first and at most
# a worker reads the counter so often, for about ten seconds, before it gives up, as threads do not run at the same time
MOST_POLLS = 2**30


Made = TypeVar("Made")


class Team:
    """The threads (workers) that make the launches of one solve together.

    size : number of workers; 0 stands for a GPU, which needs none and gets a launch for a few steps.
    arrived : array with one number: how often workers have arrived at the barrier, where they wait for each other, in
        this launch.
    workers : how many workers the next launch has; less than `size` while other programs take the cores.
    piece : seconds that the next launch should take.
    seconds : seconds that a step took in the last launch; infinity before the first.
    rest_until : time of the clock (`time.monotonic`, seconds) at which the whole team is tried again.
    rest : seconds for which the team is made smaller the next time that it gets too few cores.
    """

    def __init__(self, size: int) -> None:
        """Begin with all workers.

        The first launch of several workers is planned to take TRIAL_SECONDS, short because the team can be made smaller
        only between launches; that of one worker, which cannot be made smaller, PIECE_SECONDS.

        size : number of workers, threads of the CPU that wait for each other; 0 on a GPU.
        """
        # `arrived` : counter of the barrier, how often workers have arrived there in this launch
        self.size, self.arrived = size, np.zeros(1, np.int32) if size else ti.ndarray(ti.i32, 1)
        # `workers` : how many work in the next launch; `piece` : seconds that it is planned to take
        self.workers, self.piece = size, TRIAL_SECONDS if size > 1 else PIECE_SECONDS
        # `rest_until` : time of the clock until which a smaller team goes on; `rest` : seconds of its next such stretch
        self.rest_until, self.rest = 0.0, FIRST_REST
        # `seconds` : seconds of one step in the last launch; infinity before the first launch
        self.seconds = math.inf

    def launch(self, kernel: Any, count: int, *arguments: Any, first: int = 0, together: int = 1) -> None:
        """Call ``kernel(arrived, workers, begin, end, *arguments)`` so often that it makes `count` steps.

        On a CPU a call has as many steps as take about `piece` seconds, and as many workers as there are processors to
        be had; on a GPU it has `together` steps.

        kernel : a kernel that makes the steps begin ... end - 1.
        count : number of steps in all calls together; 0 compiles the kernel without a step.
        first : number of the first step.
        together : steps of one call on a GPU.
        arguments : what the kernel takes besides.

        Raises DeviceError if the threads do not run at the same time.
        """
        runtime.refuse_changed()
        if self.size == 0:
            for step in range(first, first + max(count, 1), together):
                kernel(self.arrived, 0, step, min(step + together, first + count), *arguments)
            return
        begin = 0  # a GPU is done; on a CPU one launch after the other
        while begin < count or count == 0:
            if self.workers < self.size and time.monotonic() >= self.rest_until:
                self.workers, self.piece = self.size, TRIAL_SECONDS
            end = min(count, begin + max(1, int(self.piece / self.seconds))) if count else 0
            self.arrived[0] = 0  # no worker has arrived at the barrier yet
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
        """Choose how many workers (threads) the next launches have, and how long these are, by the processor time that
        the last one got.

        If the team got nearly as many processors as it has workers, the next launch may take twice as long. Else the
        team goes on with only as many workers as it got processors, for `rest` seconds; the next such pause is twice as
        long.

        processors : processor time over wall time of the last launch, the mean number of processors at work.
        """
        if processors >= self.size - MISSED_PROCESSORS:
            self.piece, self.rest = min(2 * self.piece, PIECE_SECONDS), FIRST_REST
            return
        self.workers, self.piece = max(1, int(processors)), PIECE_SECONDS
        self.rest_until, self.rest = time.monotonic() + self.rest, min(2 * self.rest, LONGEST_REST)


@ti.func
def meet(arrived: ti.template(), target):
    """Wait at a barrier until `target` arrivals have been counted since the launch, one's own included.

    arrived : array with the count of arrivals, which the caller's arrival raises by 1.
    target : number of workers times how often they have met, this time included.
    """
    ti.atomic_add(arrived[0], 1)
    polls = 0
    while polls < MOST_POLLS and ti.atomic_or(arrived[0], 0) < target:
        polls += 1
    if polls >= MOST_POLLS:
        ti.atomic_max(arrived[0], MOST_POLLS)  # lets everyone through; launch() reports it


@lru_cache
def made_once(kind: Callable[..., Made], *configuration: Any) -> Made:
    """Return kind(*configuration), the same object in every call with equal arguments, so that its kernels are compiled
    once.

    kind : a class of kernels, or a function that makes an object with kernels.
    configuration : arguments of `kind`; they must be hashable.
    """
    return kind(*configuration)


@lru_cache(maxsize=16)
def _constants(numbers: tuple[float, ...], kind: np.dtype) -> Any:
    """Return an array on the device (the CPU or GPU on which kernels run) that holds `numbers`, the constants of a
    kernel, as numbers of the type `kind`. The last 16 arrays are kept, and returned again for equal numbers."""
    return on_device(np.array(numbers, dtype=np.float64), kind)


@ti.data_oriented
class Sweeps:
    """A kernel that repeats one step of a method over all sites. Subclasses say in `at_sites` what is done with a
    block, a group of neighbouring sites that are worked on together.

    A step, called a turn, is `repeats` sweeps, each made of the same `parts` one after the other; a part is one pass
    over all blocks. A part reads nothing that it writes at other sites, so that the order of the sites does not matter.

    Some methods have two parts of this kind: the first reads, beside a block itself, only its upper neighbours; the
    second reads what the first has written at the lower neighbours. Then a worker (thread) can make both parts of a
    block before it goes on to the next one, so that large lattices are read from memory once instead of twice. Only the
    second part of its first blocks has to wait for another worker, and follows in a second sweep. Every number is
    computed from the same numbers in either order.

    parts : number of parts of a sweep; all workers wait for each other after each.
    looks_up : True for methods with two such parts.
    joined : True if both parts of a block are made one after the other. A turn then has two sweeps of one part.
    repeats : number of sweeps of a turn.
    numbers : how many constants the kernel takes.
    measures : how many integers at the begin of `Fields.tables` say where the sites are. On lattices: length of a row
        (one number of every site), numbers in it before the first site, number of blocks, distances in memory to the
        neighbours along x and y, sites of a replica (one of the samples that are solved together)."""

    parts, repeats, numbers, measures = 1, 1, 1, 6
    looks_up = False

    def __init__(self, block: int, periodic: tuple[int, ...] = ()) -> None:
        """Set the constants for which the kernel is compiled: block, periodic axes, whether it runs on a GPU, and
        `together`, how many turns (steps over all sites) one launch there makes. Choose whether both parts of a turn
        are made block by block, if the method has two.

        block : number of sites that are worked on together.
        periodic : numbers of the axes of the lattice that close on themselves."""
        self.block, self.periodic, self.on_gpu = block, periodic, runtime.current().is_gpu
        self.together = TURNS_A_LAUNCH.get(runtime.current().arch, 1)
        self.join(self.looks_up and not periodic and not self.on_gpu)  # a ring closes at a lower neighbour

    def join(self, joined: bool) -> None:
        """Choose the order of the two parts of a step, and set `joined`, `parts` and `repeats` accordingly. A sweep has
        `parts` passes over all blocks (groups of neighbouring sites), with a barrier after each; a step has `repeats`
        sweeps.

        joined : True if a worker (thread) makes both parts for a block before its next block. A step is then two sweeps
            of one pass each: the second makes up for blocks whose second part had to wait for another worker. False if
            one part is made for all blocks before the other begins; then the numbers of the class hold.
        """
        self.joined = joined
        kind = type(self)
        self.parts, self.repeats = (1, 2) if joined else (kind.parts, kind.repeats)

    def run(self, fields: Fields, team: Team, turns: int, numbers: tuple[float, ...], first: int = 0) -> None:
        """Make a number of turns, each one step of the method over all sites: in one launch or, where launches have to
        be short, in several.

        fields : the fields that are read and changed.
        team : threads that make the turns.
        turns : number of turns.
        numbers : constants of the kernel, as many as `Sweeps.numbers` says.
        first : number of the first turn, for kernels in which turns differ.
        """
        arguments = fields.values, fields.blocks, fields.tables, _constants(tuple(map(float, numbers)), fields.dtype)
        team.launch(self.turns, turns, *arguments, first=first, together=self.together)

    def compile(self, fields: Fields, team: Team) -> None:
        """Compile the kernel for some fields, without making a step.

        fields : arrays that the kernel will read and change; they stay as they are. The kernel computes with numbers of
            their type.
        team : threads that will run it.
        """
        with runtime.computing_in(fields.dtype.name):
            self.run(fields, team, 0, (0.0,) * self.numbers)

    @ti.func
    def initial_carry(self, values: ti.template(), size: ti.template(), low, numbers: ti.template(), sweep):
        """Return the list of numbers that the first block of a worker gets in a sweep. A worker is a thread with a
        share of the blocks of sites; it passes such a list from each of its blocks to the next.

        If a worker makes both parts of a step for one block before it begins the next block (`joined`), the list has
        one entry: the index of the first site whose lower neighbours all belong to this worker, so that its second part
        may follow at once. Else it is [0.0], which is not used. Methods that pass on something else override this.

        values : all fields, flat; not used here.
        size : integers; on lattices first the length of a row (one number of every site), the numbers in a row before
            the first site, the number of blocks, and the distance in memory to the neighbour along x.
        low : number of the worker's first block.
        numbers : constants of the kernel; not used here.
        sweep : number of the sweep; not used here.
        """
        if ti.static(self.joined):
            return [size[1] + (low + size[3] // self.block + 1) * self.block]
        return [0.0]

    @ti.func
    def count(self, part: ti.template(), size: ti.template()):
        """Return the number of blocks (groups of sites that are worked on together) that one part of a sweep, a pass
        over the sites, goes through: on lattices the same for all parts.

        part : number of the part, not used here.
        size : integers that say where the sites are; on lattices the third is the number of blocks."""
        return size[2]

    @ti.func
    def visit(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), tables: ti.template(),
        size: ti.template(), number, numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """Do one part of a sweep for one block of a lattice, a group of sites that are worked on together: find its
        sites, and call `at_sites`, which subclasses define. If both parts are made block by block (`joined`), even
        sweeps make the first part, and the second where it need not wait. Odd sweeps make the second parts that are
        left.

        part : number of the part; always 0 if `joined`.
        values : all fields, flat.
        blocks : the same memory as vectors, one for each block.
        tables : integers of the layout, not used here.
        size : length of a row (one number of every site), numbers in it before the first site, number of blocks,
            distances in memory to the neighbours along x and y, sites of a replica (one sample).
        number : number of the block.
        numbers : constants of the kernel.
        sweep : number of the sweep.
        carried : list that the worker's block before has left, or, for its first block, what `initial_carry` returned.

        In place of `tables`, `size` and `number`, `at_sites` gets three things: the length of a row; the index of the
        block's first site; and the strides (distances in memory to upper neighbours), with rings along periodic
        axes."""
        sides = [in_range(size[3]), in_range(size[4]), 1]
        strides = with_rings(sides, number * self.block, size[5], self.periodic)
        first = in_range(size[1] + number * self.block)
        if ti.static(self.joined):  # the first sweep makes the first part, and the second part where it can
            if sweep % 2 == 0:
                self.at_sites(0, values, blocks, size[0], first, strides, numbers, sweep, carried)
            if (sweep % 2 == 0) == (first >= carried[0]):
                self.at_sites(1, values, blocks, size[0], first, strides, numbers, sweep, carried)
        else:
            self.at_sites(part, values, blocks, size[0], first, strides, numbers, sweep, carried)

    @ti.func
    def sum_up(self, values: ti.template(), blocks: ti.template(), sums: ti.template(), new: ti.template()):
        """Add to sums that the fields hold for each site of a block (sums over the turns, not over the sites).

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        sums : list with, for each kind of sum, the index in `values` of that of the block's first site; those of the
            other sites follow.
        new : list with, for each kind of sum, a vector of what is added at each site.
        """
        for k in ti.static(range(len(sums))):
            store(values, blocks, sums[k], self.block, load(values, sums[k], self.block) + new[k])

    @ti.kernel
    def turns(
        self, arrived: INTEGERS, workers: int, begin: int, end: int, values: VALUES, blocks: BLOCKS, tables: INTEGERS,
        constants: VALUES,
    ):  # fmt: skip
        """Make the turns `begin` ... `end` - 1, each one step of the method over all blocks of sites.

        arrived : array with one number, the counter of the barrier at which threads wait for each other.
        workers : number of threads on a CPU; each takes an equal share of the blocks. Not used on a GPU.
        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        tables : integers; the first `measures` of them say where the sites are in memory.
        constants : (self.numbers,), constants of the kernel.
        """
        if ti.static(self.on_gpu):  # one loop over all blocks for each part, a thread for each block
            for turn, again, part in ti.static(ti.ndrange(self.together, self.repeats, self.parts)):
                for b in range(self.count(part, tables) * (begin + turn < end)):
                    numbers = [constants[k] for k in ti.static(range(self.numbers))]
                    size = [tables[k] for k in ti.static(range(self.measures))]
                    sweep = (begin + turn) * self.repeats + again
                    carried = self.initial_carry(values, size, b, numbers, sweep)
                    self.visit(part, values, values, tables, size, b, numbers, sweep, carried)
        else:  # one loop over the workers, which meet at the barrier after each part
            for item in range(workers * LEAST_CHUNK):
                if item % LEAST_CHUNK == 0:
                    worker, met = item // LEAST_CHUNK, 0
                    size = [tables[k] for k in ti.static(range(self.measures))]
                    numbers = [constants[k] for k in ti.static(range(self.numbers))]
                    for sweep in range(begin * self.repeats, end * self.repeats):
                        for part in ti.static(range(self.parts)):
                            count = self.count(part, size)
                            low, high = count * worker // workers, count * (worker + 1) // workers
                            carried = self.initial_carry(values, size, low, numbers, sweep)
                            for b in range(low, high):
                                self.visit(part, values, blocks, tables, size, b, numbers, sweep, carried)
                            met += workers
                            meet(arrived, met)
