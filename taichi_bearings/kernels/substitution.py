"""Solve with the factor of an elimination tree, of one matrix or of several side by side.

A vector holds the unknowns in the order of elimination and then, front after front, what each leaves for its border:
its parent takes that, and nobody writes where another does. So fronts that are not above each other can be solved at
once, and neither their order nor the number of threads or of matrices leaves a trace.
"""

from collections.abc import Callable

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.elimination import (
    BATCH_SHARE,
    BORDER,
    BRANCHES,
    CHILD,
    FIRST_ROW,
    FRONTS,
    HEADER,
    HEIGHT,
    LANES,
    NUMBERS,
    OWN,
    OWN_COLUMNS,
    PANEL,
    REST_HEIGHT,
    SIBLING,
    SLOTS,
    STEP,
    VECTORS,
    WIDTH,
    clear,
)
from taichi_bearings.kernels.memory import INTEGERS
from taichi_bearings.kernels.team import LEAST_CHUNK


@ti.func
def forward(numbers: ti.template(), vector: ti.template(), where: ti.template(), wide: ti.template()):
    """Solve for `wide` own unknowns, and take what they are from the own ones behind and from the border.

    where : place of their first pivot, and from one column to the next; row of the first, end of all own; where the
    border begins, and its length; 1.
    """
    start, height, row, end, rest, border, step = where
    value = [vector[row + c] for c in ti.static(range(wide))]
    for c in ti.static(range(wide)):
        for p in ti.static(range(c)):
            value[c] = value[c] - numbers[start + p * height + c] * value[p]
        value[c] = value[c] * numbers[start + c * height + c]
        vector[row + c] = value[c]
    i = wide
    while i < end - row:
        left = vector[row + i]
        for c in ti.static(range(wide)):
            left = left - numbers[start + c * height + i] * value[c]
        vector[row + i] = left
        i += step
    i = 0
    while i < border:
        left = vector[rest + i]
        for c in ti.static(range(wide)):
            left = left - numbers[start + c * height + end - row + i] * value[c]
        vector[rest + i] = left
        i += step


@ti.func
def backward(numbers: ti.template(), vector: ti.template(), where: ti.template(), wide: ti.template()):
    """The same the other way, once border and own unknowns behind are known."""
    start, height, row, end, rest, border, step = where
    left = [vector[row + c] for c in ti.static(range(wide))]
    i = 0
    while i < border:
        known = vector[rest + i]
        for c in ti.static(range(wide)):
            left[c] = left[c] - numbers[start + c * height + end - row + i] * known
        i += step
    i = wide
    while i < end - row:
        known = vector[row + i]
        for c in ti.static(range(wide)):
            left[c] = left[c] - numbers[start + c * height + i] * known
        i += step
    for back in ti.static(range(wide)):
        c = ti.static(wide - 1 - back)
        for p in ti.static(range(c + 1, wide)):
            left[c] = left[c] - numbers[start + c * height + p] * left[p]
        left[c] = left[c] * numbers[start + c * height + c]
        vector[row + c] = left[c]


@ti.func
def down(
    alone: ti.template(), tables: ti.template(), at, numbers: ti.template(), vector: ti.template(),
    wide: ti.template(),
):  # fmt: skip
    """A front, once its children are done; `wide` unknowns at a time, which leaves no trace in a number."""
    own, border, first, rest = tables[at + OWN], tables[at + BORDER], tables[at + FIRST_ROW], tables[at + REST_HEIGHT]
    height, step = tables[at + HEIGHT], tables[STEP]
    clear(alone, vector, rest, rest + border, step)
    next_child = tables[at + CHILD]
    while next_child >= 0:
        child = HEADER + next_child * WIDTH
        slots, left, i = tables[SLOTS] + tables[child + BATCH_SHARE], tables[child + REST_HEIGHT], 0
        while i < tables[child + BORDER]:
            to = tables[slots + i]
            vector[to] = vector[to] + vector[left + i]
            i += step
        next_child = tables[child + SIBLING]
    k = 0
    while k < own:
        start = tables[at + OWN_COLUMNS] + k * (height + 1)
        if k + wide <= own:
            forward(numbers, vector, [start, height, first + k, first + own, rest, border, step], wide)
            k += wide
        else:
            forward(numbers, vector, [start, height, first + k, first + own, rest, border, step], 1)
            k += 1


@ti.func
def up(tables: ti.template(), at, numbers: ti.template(), vector: ti.template()):
    """A front, once its parent is done."""
    own, border, first, rest = tables[at + OWN], tables[at + BORDER], tables[at + FIRST_ROW], tables[at + REST_HEIGHT]
    height, step, slots = tables[at + HEIGHT], tables[STEP], tables[SLOTS] + tables[at + BATCH_SHARE]
    i = 0
    while i < border:
        vector[rest + i] = vector[tables[slots + i]]
        i += step
    k = own
    while k > 0:
        if k % PANEL == 0:
            k -= PANEL
            start = tables[at + OWN_COLUMNS] + k * (height + 1)
            backward(numbers, vector, [start, height, first + k, first + own, rest, border, step], PANEL)
        else:
            k -= 1
            start = tables[at + OWN_COLUMNS] + k * (height + 1)
            backward(numbers, vector, [start, height, first + k, first + own, rest, border, step], 1)


def _substitution(together: bool) -> Callable:
    """Kernel that solves in place, forward and backward, on one thread."""
    kind = VECTORS if together else NUMBERS

    @ti.kernel
    def run(tables: INTEGERS, numbers: kind, vector: kind):
        ti.loop_config(serialize=True)
        for turn in range(2 * tables[FRONTS]):
            if turn < tables[FRONTS]:
                down(not together, tables, HEADER + turn * WIDTH, numbers, vector, PANEL)
            else:
                up(tables, HEADER + (2 * tables[FRONTS] - 1 - turn) * WIDTH, numbers, vector)

    return run


substitute, substitute_alone = _substitution(True), _substitution(False)


@ti.kernel
def substitute_branches(tables: INTEGERS, numbers: NUMBERS, vector: NUMBERS, forth: int, begin: int, end: int):
    """The same for one matrix on several threads, half of it: branches begin ... end-1 of the tree, each the fronts
    from one number in the table of branches to the next."""
    for item in range(begin * LEAST_CHUNK, end * LEAST_CHUNK):
        if item % LEAST_CHUNK == 0:
            branch = tables[BRANCHES] + 2 * (item // LEAST_CHUNK)
            first, last = tables[branch], tables[branch + 1]
            for n in range(first, last):
                if forth:
                    down(True, tables, HEADER + n * WIDTH, numbers, vector, LANES)
                else:
                    up(tables, HEADER + (first + last - 1 - n) * WIDTH, numbers, vector)
