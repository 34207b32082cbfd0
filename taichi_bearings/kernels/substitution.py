"""Solve with the factor of an elimination tree: every front has a vector of its own, for its rows, and its parent takes
what is left of it. So fronts that are not above each other can be solved at once, and their order leaves no trace.
"""

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.elimination import LANES, TABLES, VALUES, VECTORS
from taichi_bearings.kernels.team import LEAST_CHUNK

# LANES rows, or columns, are worked on together; vectors of fronts begin at multiples of it.
# A row of the table of fronts: own unknowns, rows, where own columns, vector and the table of places begin, the place
# of the first own unknown in the order of elimination, its first child, the next child of its parent, and that, or -1
OWN, HEIGHT, COLUMNS, VECTOR, MAP, FIRST, CHILD, SIBLING, PARENT, WIDTH = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9


@ti.func
def rows_of(values: ti.template(), place):
    """LANES numbers one after the other."""
    result = ti.Vector.zero(ti.f64, LANES)
    at = place & 0x7FFFFFFF  # never negative: the loads are merged
    for m in range(LANES):
        result[m] = values[at + m]
    return result


@ti.func
def forward(
    factor: ti.template(), vector: ti.template(), blocks: ti.template(), start, height, rows, k,
    wide: ti.template(),
):  # fmt: skip
    """Solve for `wide` unknowns from the k-th on, and take what they are to the rows below.

    start : place of row 0 of the first column. rows : of the vector, first place.
    """
    value = [vector[rows + k + c] for c in ti.static(range(wide))]
    for c in ti.static(range(wide)):
        for p in ti.static(range(c)):
            value[c] = value[c] - factor[start + p * height + k + c] * value[p]
        value[c] = value[c] / factor[start + c * height + k + c]
        vector[rows + k + c] = value[c]
    i = k + wide
    while i % LANES != 0 and i < height:
        rest = vector[rows + i]
        for c in ti.static(range(wide)):
            rest = rest - factor[start + c * height + i] * value[c]
        vector[rows + i] = rest
        i += 1
    while i < height:  # the last rows may be those of no one
        left = blocks[(rows + i) // LANES]
        for c in ti.static(range(wide)):
            left = left - rows_of(factor, start + c * height + i) * value[c]
        blocks[(rows + i) // LANES] = left
        i += LANES


@ti.func
def backward(
    factor: ti.template(), vector: ti.template(), blocks: ti.template(), start, height, rows, k,
    wide: ti.template(),
):  # fmt: skip
    """The same the other way, once the rows below are known."""
    rest = [vector[rows + k + c] for c in ti.static(range(wide))]
    i = k + wide
    while i % LANES != 0 and i < height:
        for c in ti.static(range(wide)):
            rest[c] = rest[c] - factor[start + c * height + i] * vector[rows + i]
        i += 1
    sums = [ti.Vector.zero(ti.f64, LANES) for _ in ti.static(range(wide))]
    while i + LANES <= height:
        known = blocks[(rows + i) // LANES]
        for c in ti.static(range(wide)):
            sums[c] = sums[c] + rows_of(factor, start + c * height + i) * known
        i += LANES
    while i < height:
        for c in ti.static(range(wide)):
            rest[c] = rest[c] - factor[start + c * height + i] * vector[rows + i]
        i += 1
    for back in ti.static(range(wide)):
        c = ti.static(wide - 1 - back)
        for m in ti.static(range(LANES)):
            rest[c] = rest[c] - sums[c][m]
        for p in ti.static(range(c + 1, wide)):
            rest[c] = rest[c] - factor[start + c * height + k + p] * rest[p]
        rest[c] = rest[c] / factor[start + c * height + k + c]
        vector[rows + k + c] = rest[c]


@ti.func
def down(
    tables: ti.template(), at, order, maps, factor: ti.template(), right: ti.template(),
    vector: ti.template(), blocks: ti.template(),
):  # fmt: skip
    """A front, once its children are done."""
    own, height, rows = tables[at + OWN], tables[at + HEIGHT], tables[at + VECTOR]
    for i in range(own):
        vector[rows + i] = right[tables[order + tables[at + FIRST] + i]]
    for i in range(own, height):
        vector[rows + i] = ti.cast(0.0, ti.f64)
    child = tables[at + CHILD]
    while child >= 0:
        skip, places = tables[child + VECTOR] + tables[child + OWN], maps + tables[child + MAP]
        for i in range(tables[child + HEIGHT] - tables[child + OWN]):
            to = rows + tables[places + i]
            vector[to] = vector[to] + vector[skip + i]
        child = tables[child + SIBLING]
    k = 0
    while k < own:
        start = tables[at + COLUMNS] + k * height
        if k + LANES <= own:
            forward(factor, vector, blocks, start, height, rows, k, LANES)
            k += LANES
        else:
            forward(factor, vector, blocks, start, height, rows, k, 1)
            k += 1


@ti.func
def up(
    tables: ti.template(), at, order, maps, factor: ti.template(), right: ti.template(),
    vector: ti.template(), blocks: ti.template(),
):  # fmt: skip
    """A front, once its parent is done."""
    own, height, rows = tables[at + OWN], tables[at + HEIGHT], tables[at + VECTOR]
    if tables[at + PARENT] >= 0:
        above, places = tables[tables[at + PARENT] + VECTOR], maps + tables[at + MAP]
        for i in range(height - own):
            vector[rows + own + i] = vector[above + tables[places + i]]
    k = own
    while k > 0:
        if k % LANES == 0:
            k -= LANES
            backward(factor, vector, blocks, tables[at + COLUMNS] + k * height, height, rows, k, LANES)
        else:
            k -= 1
            backward(factor, vector, blocks, tables[at + COLUMNS] + k * height, height, rows, k, 1)
    for i in range(own):
        right[tables[order + tables[at + FIRST] + i]] = vector[rows + i]


@ti.kernel
def substitute(
    forth: int, tables: TABLES, begin: int, end: int, branches: int, order: int,
    maps: int, factor: VALUES, right: VALUES, vector: VALUES, blocks: VECTORS,
):  # fmt: skip
    """Branches begin ... end-1 of the tree, each the fronts from one entry of the table of branches to the next.

    right : the right-hand side, in the end the solution. branches, order, maps : where these tables begin.
    """
    for item in range(begin * LEAST_CHUNK, end * LEAST_CHUNK):
        if item % LEAST_CHUNK == 0:
            branch = branches + 2 * (item // LEAST_CHUNK)
            first, last = tables[branch], tables[branch + 1]
            for n in range(first, last):
                if forth:
                    down(tables, n * WIDTH, order, maps, factor, right, vector, blocks)
                else:
                    up(tables, (first + last - 1 - n) * WIDTH, order, maps, factor, right, vector, blocks)
