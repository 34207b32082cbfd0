"""Where one way of factorising becomes quicker than another, all measured: see docs/decisions 4 and 11.

A number is one of double precision, an operation one addition or multiplication of them.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Price:
    """What a part of the elimination tree costs beside its arithmetic, in operations: as such, a number of its columns,
    one of its update."""

    part: float
    column: float
    update: float


LEAF_UNKNOWNS = 20  # of a region of the lattice that is not divided
# Engines: one dense block, all in one launch, fronts by BLAS
BLOCK_UNKNOWNS = 400  # up to which an elimination tree costs more calls than it saves arithmetic
LAUNCH_UNKNOWNS = 8_000  # below which calls of libraries and threads are not worth their while
LAUNCH_PRICE = Price(part=4000, column=20, update=20)
CALLS_PRICE = Price(part=1e5, column=40, update=80)  # a call costs as much as a thousand numbers that are copied
# Memory
MOST_FACTOR_NUMBERS = 2**31 - 1  # of a factorisation: kernels count in 32 bits
GROVE_NUMBERS = 40_000_000  # in all updates of a subtree that is worked on depth by depth: at 32^3 the whole lattice
LARGE_FACTOR_NUMBERS = 10_000_000  # from which the memory of a factor that is not needed is given back
# Fronts by BLAS
SHEET_COLUMNS = 256  # of an update that are stored and worked on together; a multiple of LANES
PANEL_COLUMNS = 64  # own ones of a front that are worked on together
SHARED_FRONT_OPERATIONS = 1e7  # from which several threads share a front
SHARED_BATCH_OPERATIONS = 3e6  # from which several threads share the fronts of a batch
SHARED_ASSEMBLY_NUMBERS = 500_000  # of a batch from which a team assembles it faster than one thread
ASSEMBLY_NUMBERS = 30_000  # that one thread fills at a time, at least
BRANCH_SHARE = 1 / 16  # of the factor that one thread solves with; bits do not depend on the number of threads
