"""Thresholds where one way of factorising becomes quicker than another, all measured: see docs/decisions.md, 4 and 11.

Where nothing else is said a "number" is one double, and an "operation" one addition or multiplication of doubles.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Price:
    """What a way of factorising costs beside its arithmetic, counted in operations that take as long.

    part : cost of each front, a set of unknowns that are eliminated together.
    column, update : cost of each number in the front's own columns, and in its update, what it changes in later ones.
    """

    part: float
    column: float
    update: float


LEAF_UNKNOWNS = 20  # a region of the lattice with no more unknowns is not divided
# Engines: one dense block, all in one launch, fronts by BLAS
BLOCK_UNKNOWNS = 400  # with no more unknowns an elimination tree costs more calls than it saves arithmetic
LAUNCH_UNKNOWNS = 8_000  # with fewer unknowns calls of libraries, and threads, take longer than they save
LAUNCH_PRICE = Price(part=4000, column=20, update=20)
CALLS_PRICE = Price(part=1e4, column=20, update=20)  # most fronts are small ones, in branches
# Memory
MOST_FACTOR_NUMBERS = 2**31 - 1  # most numbers of a factorisation: kernels count in 32 bits
# most in all updates of a subtree that is eliminated depth by depth (layout.py): the whole lattice at 32^3
GROVE_NUMBERS = 40_000_000
LARGE_FACTOR_NUMBERS = 10_000_000  # a factor of more numbers gives its memory back when it is not needed
# A factor of more numbers (from 40^3 on) is made only after freed memory was given back: at 64^3 the analysis of the
# pattern leaves 0.3 GB free
HUGE_FACTOR_NUMBERS = 50_000_000
# Fronts by BLAS, and below them branches by a kernel
BRANCH_OPERATIONS = 1e7  # most of a subtree that a kernel works on as a whole
SHEET_COLUMNS = 256  # columns of a front that are stored together, of an update also worked on; a multiple of LANES
PANEL_COLUMNS = 64  # own columns of a front that are worked on together; a divisor of SHEET_COLUMNS
SHARED_FRONT_OPERATIONS = 1e7  # threads share a front that takes more operations
SHARED_BATCH_OPERATIONS = 3e6  # threads share the fronts of a batch that takes more operations
SHARED_ASSEMBLY_NUMBERS = 500_000  # a team of threads assembles a batch of more numbers faster than one thread
ASSEMBLY_NUMBERS = 30_000  # most numbers that one thread fills at a time, but for single columns of large fronts
BRANCH_SHARE = 1 / 16  # most of the factor that one thread solves with; the same for any number of threads: same bits
