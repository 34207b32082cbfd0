"""Cholesky factors of one matrix, or of several of one pattern side by side: then each number is a vector, one lane
each.

The fronts of the elimination tree are worked on children before parents; numerics/cholesky/layout.py says where they
lie. A front is stored column by column: m columns of own unknowns with all their n rows, then the update that it leaves
for its border, b columns in panels of SHEET columns, each from its diagonal down; only lower triangles are used. Small
matrices are eliminated here, in one launch; fronts of large ones are assembled here, and eliminated by BLAS. A number
goes through the same operations in the same order whether its matrix is alone or not.

The innermost loops, and those of `gather`, step by a number that stands in the tables, although it is 1: if LLVM knew
the step it would unroll the loops eight times over, which takes every process seconds and makes none of them faster.
"""

from collections.abc import Callable

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.memory import INTEGERS
from taichi_bearings.kernels.team import LEAST_CHUNK

PANEL = 4  # columns, and rows or vectors of rows, that are worked on together: their numbers fit into registers
LANES = 8  # matrices side by side, or rows of one alone: what an AVX-512 instruction works on at once
NUMBERS = ti.types.ndarray(dtype=ti.f64, ndim=1)
VECTORS = ti.types.ndarray(dtype=ti.types.vector(LANES, ti.f64), ndim=1)

# Positions in the header of the tables, the array of integers: the number of fronts; where the other tables begin
# (PLACES of entries within their fronts; MAPS, the rows of each border in the front of the parent; SLOTS, where they
# are in vectors; ITEMS of work for `assemble`; BRANCHES for substitutions); columns of a panel of an update; and a 1
FRONTS, PLACES, MAPS, SLOTS, ITEMS, BRANCHES, SHEET, STEP, HEADER = 0, 1, 2, 3, 4, 5, 6, 7, 8
# Positions in a row of the table of fronts: number of own unknowns and of the border; where columns and update begin;
# first and last entry; its first child, and the next child of its parent, or -1; where its part of maps and slots
# begins; first own unknown; distance from one own column, and from one column of the update, to the next; the row at
# which columns of the update begin; and where its border begins in vectors
OWN, BORDER, OWN_COLUMNS, UPDATE, ENTRIES, ENTRIES_END, CHILD, SIBLING, BATCH_SHARE, FIRST_ROW = range(10)
HEIGHT, UPDATE_HEIGHT, SKIP, REST_HEIGHT, WIDTH = 10, 11, 12, 13, 14


@ti.func
def clear(alone: ti.template(), numbers: ti.template(), begin, end, step):
    """Set the numbers begin ... end-1 to zero."""
    i = begin
    while i < end:
        if ti.static(alone):
            numbers[i] = 0.0
        else:
            numbers[i] = ti.Vector.zero(ti.f64, LANES)
        i += step


@ti.func
def sheets_before(tables: ti.template(), at, column):
    """Return how many columns of the update stand in the panels before that of a column of the front."""
    before, width = 0, tables[SHEET]
    if column - tables[at + OWN] >= width:  # hardly ever: no division in small fronts
        before = (column - tables[at + OWN]) // width * width
    return before


@ti.func
def column_of(tables: ti.template(), at, column):
    """Return where row 0 of a column of a front would stand."""
    own, start = tables[at + OWN], tables[at + OWN_COLUMNS] + column * tables[at + HEIGHT]
    if column >= own:
        before, pitch = sheets_before(tables, at, column), tables[at + UPDATE_HEIGHT]
        start = tables[at + UPDATE] + (column - own) * (pitch - before) - tables[at + SKIP] - before
        if before > 0:
            start += before * before - before * (before - tables[SHEET]) // 2
    return start


@ti.func
def gather(
    alone: ti.template(), unit: ti.template(), tables: ti.template(), at, first, end, entries: ti.template(),
    numbers: ti.template(),
):  # fmt: skip
    """Fill the columns first ... end-1 of a front with its entries and with what its children leave.

    alone : one matrix, not LANES. unit : rows that make a vector. at : where the front stands in the tables.
    """
    columns, height, step = tables[at + OWN_COLUMNS], tables[at + HEIGHT], tables[STEP]
    column = first
    while column < end:
        begin = column_of(tables, at, column)
        clear(alone, numbers, begin + column - column % unit, begin + height, step)
        column += step
    entry, entries_end = tables[at + ENTRIES], tables[at + ENTRIES_END]
    while entry < entries_end:
        place = tables[tables[PLACES] + entry]
        if first * height <= place and place < end * height:
            numbers[columns + place] = entries[entry]
        entry += step
    next_child = tables[at + CHILD]
    while next_child >= 0:
        child = HEADER + next_child * WIDTH
        own, length, places = tables[child + OWN], tables[child + BORDER], tables[MAPS] + tables[child + BATCH_SHARE]
        j = 0
        while j < length and tables[places + j] < first:
            j += step
        while j < length and tables[places + j] < end:
            start, source = column_of(tables, at, tables[places + j]), column_of(tables, child, own + j) + own
            i = j
            while i < length:
                to = start + tables[places + i]
                numbers[to] = numbers[to] + numbers[source + i]
                i += step
            j += step
        next_child = tables[child + SIBLING]


@ti.func
def corner(numbers: ti.template(), shape: ti.template(), j, wide: ti.template()):
    """Return the lower triangle where `wide` columns from j on meet the diagonal, row by row.

    What the columns before contribute is taken off. If these are own columns the triangle is factorised, with inverse
    pivots, which is what the substitutions need. shape : see :func:`panel`.
    """
    source, end, height, start, pitch, own = shape
    found = [numbers[start + c * pitch + j + r] for r in ti.static(range(wide)) for c in ti.static(range(r + 1))]
    while source < end:
        left = [numbers[source + j + r] for r in ti.static(range(wide))]
        for r in ti.static(range(wide)):
            for c in ti.static(range(r + 1)):
                found[r * (r + 1) // 2 + c] = found[r * (r + 1) // 2 + c] - left[r] * left[c]
        source += height
    if own:
        for r in ti.static(range(wide)):
            row = ti.static(r * (r + 1) // 2)
            for c in ti.static(range(r + 1)):
                for p in ti.static(range(c)):
                    found[row + c] = found[row + c] - found[row + p] * found[c * (c + 1) // 2 + p]
                if ti.static(c < r):
                    found[row + c] = found[row + c] * found[c * (c + 3) // 2]
                else:
                    found[row + c] = 1.0 / ti.sqrt(found[row + c])
    return found


@ti.func
def block(
    numbers: ti.template(), vectors: ti.template(), unit: ti.template(), shape: ti.template(), j, i,
    first: ti.template(), wide: ti.template(), tall: ti.template(),
):  # fmt: skip
    """Work on `wide` columns from j on in `tall` vectors of rows from the i-th on, below their corner.

    What the columns before contribute is taken off; own columns are divided by their corner, `first`.
    """
    source, end, height, start, pitch, own = shape
    to = [(start + c * pitch) // unit + i for c in ti.static(range(wide))]
    found = [vectors[to[c] + r] for c in ti.static(range(wide)) for r in ti.static(range(tall))]
    while source < end:
        left = [vectors[source // unit + i + r] for r in ti.static(range(tall))]
        for c in ti.static(range(wide)):
            factor = numbers[source + j + c]
            for r in ti.static(range(tall)):
                found[c * tall + r] = found[c * tall + r] - left[r] * factor
        source += height
    if own:
        for c in ti.static(range(wide)):
            for r in ti.static(range(tall)):
                for p in ti.static(range(c)):
                    found[c * tall + r] = found[c * tall + r] - found[p * tall + r] * first[c * (c + 1) // 2 + p]
                found[c * tall + r] = found[c * tall + r] * first[c * (c + 3) // 2]
    for c in ti.static(range(wide)):
        for r in ti.static(range(tall)):
            vectors[to[c] + r] = found[c * tall + r]


@ti.func
def panel(
    tables: ti.template(), at, numbers: ti.template(), vectors: ti.template(), unit: ti.template(), j,
    wide: ti.template(),
):  # fmt: skip
    """Eliminate `wide` columns from j on, or update them: either all are own, or none.

    shape : index where the own columns before begin and end, and the distance between them; index where row 0 of these
        columns would stand, and the distance between them; True if they are own.
    """
    own, height, begin = tables[at + OWN], tables[at + HEIGHT], tables[at + OWN_COLUMNS]
    pitch = height if j < own else tables[at + UPDATE_HEIGHT] - sheets_before(tables, at, j)
    start = column_of(tables, at, j)
    shape = [begin, begin + ti.min(j, own) * height, height, start, pitch, j < own]
    first = corner(numbers, shape, j, wide)
    i, end = (j + wide) // unit, (own + tables[at + BORDER] + unit - 1) // unit
    while i + PANEL <= end:
        block(numbers, vectors, unit, shape, j, i, first, wide, PANEL)
        i += PANEL
    while i < end:
        block(numbers, vectors, unit, shape, j, i, first, wide, 1)
        i += 1
    for r in ti.static(range(wide)):
        for c in ti.static(range(r + 1)):
            numbers[start + c * pitch + j + r] = first[r * (r + 1) // 2 + c]


@ti.func
def reduce(tables: ti.template(), at, numbers: ti.template(), vectors: ti.template(), unit: ti.template()):
    """Eliminate the own unknowns of a front, PANEL columns at a time.

    vectors : the numbers, either each a vector, or `unit` rows in one vector; those above the diagonal hold something
        that nobody reads.
    """
    own, rows, j = tables[at + OWN], tables[at + OWN] + tables[at + BORDER], 0
    while j < rows:
        if j + PANEL <= own or (j >= own and j + PANEL <= rows):
            panel(tables, at, numbers, vectors, unit, j, PANEL)
            j += PANEL
        else:
            panel(tables, at, numbers, vectors, unit, j, 1)
            j += 1


@ti.kernel
def eliminate(tables: INTEGERS, entries: VECTORS, numbers: VECTORS):
    """Factorise LANES matrices. A pivot that is not positive leaves an inverse that is not finite, in its matrix
    alone.
    """
    ti.loop_config(serialize=True)
    for front in range(tables[FRONTS]):
        at = HEADER + front * WIDTH
        gather(False, 1, tables, at, 0, tables[at + OWN] + tables[at + BORDER], entries, numbers)
        reduce(tables, at, numbers, numbers, 1)


@ti.kernel
def eliminate_alone(tables: INTEGERS, entries: NUMBERS, numbers: NUMBERS, vectors: VECTORS):
    """Factorise one matrix. vectors : the numbers, LANES rows in one vector."""
    ti.loop_config(serialize=True)
    for front in range(tables[FRONTS]):
        at = HEADER + front * WIDTH
        gather(True, LANES, tables, at, 0, tables[at + OWN] + tables[at + BORDER], entries, numbers)
        reduce(tables, at, numbers, vectors, LANES)


def _assembly(serial: bool) -> Callable:
    """Return a kernel that fills fronts of one matrix, on one thread (`serial`) or on several."""
    chunk = 1 if serial else LEAST_CHUNK

    @ti.kernel
    def run(tables: INTEGERS, entries: NUMBERS, numbers: NUMBERS, begin: int, end: int):
        """Fill the items begin ... end-1 of the work: each is a front, its first and its last column."""
        if ti.static(serial):
            ti.loop_config(serialize=True)
        for turn in range(begin * chunk, end * chunk):
            if turn % chunk == 0:
                item = tables[ITEMS] + 3 * (turn // chunk)
                at = HEADER + tables[item] * WIDTH
                gather(True, 1, tables, at, tables[item + 1], tables[item + 2], entries, numbers)

    return run


assemble, assemble_serially = _assembly(False), _assembly(True)
