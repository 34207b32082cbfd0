"""What a machine can do at most, with the compiler and the teams of the other kernels: numbers that come from memory
and go there, additions and multiplications, square roots and divisions."""

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.memory import BLOCKS, VALUES, in_range, load, store
from taichi_bearings.kernels.team import COUNTER, LEAST_CHUNK

ROWS = 3  # that a stream works on: two are read and one is written in a pass
CHAINS = 8  # sums that do not wait for each other, enough to hide how long one takes
LENGTH, ROOTS_LENGTH = 4096, 512  # of a chain, so that a launch costs little beside one
ARITHMETIC_FLOPS = 2 * CHAINS * LENGTH  # a site of a call
ROOTS = 2 * CHAINS * ROOTS_LENGTH


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


@ti.kernel
def arithmetic(
    arrived: COUNTER, workers: int, begin: int, end: int, values: VALUES, blocks: BLOCKS, block: ti.template()
):
    """Chains of products and sums on one block of sites a worker."""
    for item in range(workers * LEAST_CHUNK):
        if item % LEAST_CHUNK == 0:
            first = in_range(item // LEAST_CHUNK * block)
            start = load(values, first, block)
            total = [start + float(chain) for chain in ti.static(range(CHAINS))]
            for _ in range((end - begin) * LENGTH):
                for chain in ti.static(range(CHAINS)):
                    total[chain] = total[chain] * 0.999 + 0.001
            for chain in ti.static(range(1, CHAINS)):
                total[0] += total[chain]
            store(values, blocks, first, block, total[0] / CHAINS)


@ti.kernel
def roots(arrived: COUNTER, workers: int, begin: int, end: int, values: VALUES, blocks: BLOCKS, block: ti.template()):
    """Chains of a square root and a division on one block of sites a worker."""
    for item in range(workers * LEAST_CHUNK):
        if item % LEAST_CHUNK == 0:
            first = in_range(item // LEAST_CHUNK * block)
            start = load(values, first, block)
            total = [start + float(chain + 1) for chain in ti.static(range(CHAINS))]
            for _ in range((end - begin) * ROOTS_LENGTH):
                for chain in ti.static(range(CHAINS)):
                    total[chain] = 2.0 / ti.sqrt(total[chain])
            for chain in ti.static(range(1, CHAINS)):
                total[0] += total[chain]
            store(values, blocks, first, block, total[0] / CHAINS)
