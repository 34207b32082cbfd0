"""Cholesky factors of a matrix, or of several of one pattern side by side: then each number is a vector, one a matrix.

The fronts of the elimination tree one after the other, children first (numerics/cholesky/side_by_side.py). A front is
stored column by column: m columns of own unknowns with all their n rows, then the update that it leaves for its border,
b columns of b rows of which the lower triangle counts. A number goes through the same operations in the same order
whether its matrix is alone or not.

The innermost loops, and those of `gather`, step by a number that stands in the tables, be it 1: of known step LLVM
would unroll them eight times over, which takes every process seconds and makes none of them faster.
"""

from taichi_bearings.compiler import ti

PANEL = 4  # columns, and rows or vectors of rows, that are worked on together: their numbers fit into registers
LANES = 8  # matrices side by side, or rows of one alone: what an AVX-512 instruction works on at once
VALUES = ti.types.ndarray(dtype=ti.f64, ndim=1)
VECTORS = ti.types.ndarray(dtype=ti.types.vector(LANES, ti.f64), ndim=1)
TABLES = ti.types.ndarray(dtype=ti.i32, ndim=1)

# Where the tables begin in the array of integers is written at its start, after the number of fronts; then a 1
FRONTS, PLACES, MAPS, BORDERS, STEP, HEADER = 0, 1, 2, 3, 4, 5
# A row of the table of fronts: own unknowns and border, where columns and update begin, first and last entry, its first
# child and the next child of its parent, or -1, where its part of maps and borders begins, first own unknown, numbers
# from one column and one column of the update to the next, and the row at which columns of the update begin
OWN, BORDER, COLUMNS, UPDATE, ENTRIES, ENTRIES_END, CHILD, SIBLING, SHARE, FIRST = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
HEIGHT, UPDATE_HEIGHT, SKIP, WIDTH = 10, 11, 12, 13


@ti.func
def clear(alone: ti.template(), numbers: ti.template(), begin, end, step):
    i = begin
    while i < end:
        if ti.static(alone):
            numbers[i] = 0.0
        else:
            numbers[i] = ti.Vector.zero(ti.f64, LANES)
        i += step


@ti.func
def column_of(tables: ti.template(), at, column):
    """Where row 0 of a column of a front would stand."""
    start = tables[at + COLUMNS] + column * tables[at + HEIGHT]
    own = tables[at + OWN]
    if column >= own:
        start = tables[at + UPDATE] + (column - own) * tables[at + UPDATE_HEIGHT] - tables[at + SKIP]
    return start


@ti.func
def gather(alone: ti.template(), tables: ti.template(), at, entries: ti.template(), numbers: ti.template()):
    """Fill a front with its entries and with what its children leave."""
    columns, step = tables[at + COLUMNS], tables[STEP]
    column, rows = 0, tables[at + OWN] + tables[at + BORDER]
    while column < rows:
        begin, unit = column_of(tables, at, column), ti.static(LANES if alone else 1)
        clear(alone, numbers, begin + column - column % unit, begin + tables[at + HEIGHT], step)
        column += step
    entry, entries_end = tables[at + ENTRIES], tables[at + ENTRIES_END]
    while entry < entries_end:
        numbers[columns + tables[tables[PLACES] + entry]] = entries[entry]
        entry += step
    next_child = tables[at + CHILD]
    while next_child >= 0:
        child = HEADER + next_child * WIDTH
        own, length, places = tables[child + OWN], tables[child + BORDER], tables[MAPS] + tables[child + SHARE]
        j = 0
        while j < length:
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
    """The lower triangle where `wide` columns from j on meet the diagonal, row by row; of columns to eliminate it is
    factorised, with inverse pivots, which is what the substitutions need."""
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
    """Entries of `wide` columns from j on in `tall` vectors from the i-th on, less what the columns before contribute.

    first : the corner of these columns.
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

    shape : where the columns before begin and end, of which the own ones count, and numbers from one to the next; the
    same for these columns, from where row 0 would stand; whether they are own.
    """
    own, height, begin = tables[at + OWN], tables[at + HEIGHT], tables[at + COLUMNS]
    pitch = height if j < own else tables[at + UPDATE_HEIGHT]
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
    """Eliminate the own unknowns, PANEL columns at a time. vectors : the numbers, each a vector, or `unit` rows in one;
    those above the diagonal hold something that nobody reads."""
    own, rows, j = tables[at + OWN], tables[at + OWN] + tables[at + BORDER], 0
    while j < rows:
        if j + PANEL <= own or (j >= own and j + PANEL <= rows):
            panel(tables, at, numbers, vectors, unit, j, PANEL)
            j += PANEL
        else:
            panel(tables, at, numbers, vectors, unit, j, 1)
            j += 1


@ti.kernel
def eliminate(tables: TABLES, entries: VECTORS, numbers: VECTORS):
    """Factorise. A pivot that is not positive leaves an inverse that is not finite, in its matrix alone."""
    ti.loop_config(serialize=True)
    for front in range(tables[FRONTS]):
        gather(False, tables, HEADER + front * WIDTH, entries, numbers)
        reduce(tables, HEADER + front * WIDTH, numbers, numbers, 1)


@ti.kernel
def eliminate_alone(tables: TABLES, entries: VALUES, numbers: VALUES, vectors: VECTORS):
    """The same for one matrix. vectors : the numbers, LANES at a time."""
    ti.loop_config(serialize=True)
    for front in range(tables[FRONTS]):
        gather(True, tables, HEADER + front * WIDTH, entries, numbers)
        reduce(tables, HEADER + front * WIDTH, numbers, vectors, LANES)


@ti.func
def forward(
    numbers: ti.template(), solution: ti.template(), work: ti.template(), where: ti.template(), wide: ti.template()
):
    """Solve for `wide` own unknowns, and take what they are to the own ones behind and to the border.

    where : place of their first pivot, and from one column to the next; row of the first, end of all own; border; 1.
    """
    start, height, row, end, border, step = where
    value = [solution[row + c] for c in ti.static(range(wide))]
    for c in ti.static(range(wide)):
        for p in ti.static(range(c)):
            value[c] = value[c] - numbers[start + p * height + c] * value[p]
        value[c] = value[c] * numbers[start + c * height + c]
        solution[row + c] = value[c]
    i = wide
    while i < end - row:
        rest = solution[row + i]
        for c in ti.static(range(wide)):
            rest = rest - numbers[start + c * height + i] * value[c]
        solution[row + i] = rest
        i += step
    i = 0
    while i < border:
        total = work[i]
        for c in ti.static(range(wide)):
            total = total + numbers[start + c * height + end - row + i] * value[c]
        work[i] = total
        i += step


@ti.func
def backward(
    numbers: ti.template(), solution: ti.template(), work: ti.template(), where: ti.template(), wide: ti.template()
):
    """The same the other way, once border and own unknowns behind are known."""
    start, height, row, end, border, step = where
    rest = [solution[row + c] for c in ti.static(range(wide))]
    i = 0
    while i < border:
        known = work[i]
        for c in ti.static(range(wide)):
            rest[c] = rest[c] - numbers[start + c * height + end - row + i] * known
        i += step
    i = wide
    while i < end - row:
        known = solution[row + i]
        for c in ti.static(range(wide)):
            rest[c] = rest[c] - numbers[start + c * height + i] * known
        i += step
    for back in ti.static(range(wide)):
        c = ti.static(wide - 1 - back)
        for p in ti.static(range(c + 1, wide)):
            rest[c] = rest[c] - numbers[start + c * height + p] * rest[p]
        rest[c] = rest[c] * numbers[start + c * height + c]
        solution[row + c] = rest[c]


@ti.func
def substituted(
    alone: ti.template(), tables: ti.template(), numbers: ti.template(), solution: ti.template(), work: ti.template()
):
    for turn in range(2 * tables[FRONTS]):
        down = turn < tables[FRONTS]
        at = HEADER + (turn if down else 2 * tables[FRONTS] - 1 - turn) * WIDTH
        own, border, first = tables[at + OWN], tables[at + BORDER], tables[at + FIRST]
        places, height, end = tables[BORDERS] + tables[at + SHARE], tables[at + HEIGHT], first + own
        step = tables[STEP]
        if down:
            clear(alone, work, 0, border, step)
            k = 0
            while k < own:
                start = tables[at + COLUMNS] + k * (height + 1)
                if k + PANEL <= own:
                    forward(numbers, solution, work, [start, height, first + k, end, border, step], PANEL)
                    k += PANEL
                else:
                    forward(numbers, solution, work, [start, height, first + k, end, border, step], 1)
                    k += 1
            i = 0
            while i < border:
                to = tables[places + i]
                solution[to] = solution[to] - work[i]
                i += step
        else:
            i = 0
            while i < border:
                work[i] = solution[tables[places + i]]
                i += step
            k = own
            while k > 0:
                if k % PANEL == 0:
                    k -= PANEL
                    start = tables[at + COLUMNS] + k * (height + 1)
                    backward(numbers, solution, work, [start, height, first + k, end, border, step], PANEL)
                else:
                    k -= 1
                    start = tables[at + COLUMNS] + k * (height + 1)
                    backward(numbers, solution, work, [start, height, first + k, end, border, step], 1)


@ti.kernel
def substitute(tables: TABLES, numbers: VECTORS, solution: VECTORS, work: VECTORS):
    """Solve in place, forward and backward. work : as many vectors as the longest border has."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        substituted(False, tables, numbers, solution, work)


@ti.kernel
def substitute_alone(tables: TABLES, numbers: VALUES, solution: VALUES, work: VALUES):
    """The same for one matrix."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        substituted(True, tables, numbers, solution, work)
