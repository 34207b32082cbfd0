"""Cholesky factors of a matrix, or of several of one pattern side by side: then each number is a vector, one a matrix.

The fronts of the elimination tree one after the other, children first (numerics/cholesky/side_by_side.py). A front is
stored column by column: m columns of own unknowns with all their n rows, then the update that it leaves for its border,
b columns of b rows of which the lower triangle counts. A number goes through the same operations in the same order
whether its matrix is alone or not.
"""

from taichi_bearings.compiler import ti

LANES = 8  # matrices side by side, or rows of one alone: what an AVX-512 instruction works on at once
VALUES = ti.types.ndarray(dtype=ti.f64, ndim=1)
VECTORS = ti.types.ndarray(dtype=ti.types.vector(LANES, ti.f64), ndim=1)
TABLES = ti.types.ndarray(dtype=ti.i32, ndim=1)

# Where the tables begin in the array of integers is written at its start, after the number of fronts
FRONTS, PLACES, MAPS, BORDERS, HEADER = 0, 1, 2, 3, 4
# A row of the table of fronts: own unknowns and border, where columns and update begin, first and last entry, children
# or -1, where its part of maps and borders begins, first own unknown, numbers from one column and one column of the
# update to the next, and the row at which columns of the update begin
OWN, BORDER, COLUMNS, UPDATE, ENTRIES, ENTRIES_END, CHILD, SHARE, FIRST = 0, 1, 2, 3, 4, 5, 6, 8, 9
HEIGHT, UPDATE_HEIGHT, SKIP, WIDTH = 10, 11, 12, 13


@ti.func
def clear(alone: ti.template(), numbers: ti.template(), begin, end):
    for i in range(begin, end):
        if ti.static(alone):
            numbers[i] = 0.0
        else:
            numbers[i] = ti.Vector.zero(ti.f64, LANES)


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
    columns, update = tables[at + COLUMNS], tables[at + UPDATE]
    clear(alone, numbers, columns, columns + tables[at + OWN] * tables[at + HEIGHT])
    clear(alone, numbers, update, update + tables[at + BORDER] * tables[at + UPDATE_HEIGHT])
    for entry in range(tables[at + ENTRIES], tables[at + ENTRIES_END]):
        numbers[columns + tables[tables[PLACES] + entry]] = entries[entry]
    for which in ti.static(range(2)):
        if tables[at + CHILD + which] >= 0:
            child = HEADER + tables[at + CHILD + which] * WIDTH
            own, length, places = tables[child + OWN], tables[child + BORDER], tables[MAPS] + tables[child + SHARE]
            for j in range(length):
                start, source = column_of(tables, at, tables[places + j]), column_of(tables, child, own + j) + own
                for i in range(j, length):
                    to = start + tables[places + i]
                    numbers[to] = numbers[to] + numbers[source + i]


@ti.func
def reduce(tables: ti.template(), at, numbers: ti.template()):
    """Eliminate the own unknowns: each column less what those before it contribute, four rows at a time."""
    own, columns, height = tables[at + OWN], tables[at + COLUMNS], tables[at + HEIGHT]
    rows = own + tables[at + BORDER]
    for j in range(rows):
        before, start = ti.min(j, own), column_of(tables, at, j)
        i = j
        while i + 4 <= rows:
            to = start + i
            a, b, c, d = numbers[to], numbers[to + 1], numbers[to + 2], numbers[to + 3]
            for k in range(before):
                source = columns + k * height
                factor = numbers[source + j]
                a = a - numbers[source + i] * factor
                b = b - numbers[source + i + 1] * factor
                c = c - numbers[source + i + 2] * factor
                d = d - numbers[source + i + 3] * factor
            numbers[to], numbers[to + 1], numbers[to + 2], numbers[to + 3] = a, b, c, d
            i += 4
        while i < rows:
            e = numbers[start + i]
            for k in range(before):
                e = e - numbers[columns + k * height + i] * numbers[columns + k * height + j]
            numbers[start + i] = e
            i += 1
        if j < own:
            inverse = 1.0 / ti.sqrt(numbers[start + j])
            numbers[start + j] = inverse  # what the substitutions need
            for below in range(j + 1, rows):
                numbers[start + below] = numbers[start + below] * inverse


@ti.func
def reduce_alone(tables: ti.template(), at, numbers: ti.template(), vectors: ti.template()):
    """The same with LANES rows a vector; those above the diagonal hold something that nobody reads."""
    own, columns, height = tables[at + OWN], tables[at + COLUMNS], tables[at + HEIGHT]
    rows = own + tables[at + BORDER]
    end = (rows + LANES - 1) // LANES
    for j in range(rows):
        before, start = ti.min(j, own), column_of(tables, at, j)
        to, i = start // LANES, j // LANES
        while i + 4 <= end:
            a, b, c, d = vectors[to + i], vectors[to + i + 1], vectors[to + i + 2], vectors[to + i + 3]
            for k in range(before):
                factor, source = numbers[columns + k * height + j], (columns + k * height) // LANES + i
                a = a - vectors[source] * factor
                b = b - vectors[source + 1] * factor
                c = c - vectors[source + 2] * factor
                d = d - vectors[source + 3] * factor
            vectors[to + i], vectors[to + i + 1], vectors[to + i + 2], vectors[to + i + 3] = a, b, c, d
            i += 4
        while i < end:
            e = vectors[to + i]
            for k in range(before):
                e = e - vectors[(columns + k * height) // LANES + i] * numbers[columns + k * height + j]
            vectors[to + i] = e
            i += 1
        if j < own:
            inverse = 1.0 / ti.sqrt(numbers[start + j])
            for below in range(j // LANES, end):
                vectors[to + below] = vectors[to + below] * inverse
            numbers[start + j] = inverse


@ti.kernel
def eliminate(tables: TABLES, entries: VECTORS, numbers: VECTORS):
    """Factorise. A pivot that is not positive leaves an inverse that is not finite, in its matrix alone."""
    ti.loop_config(serialize=True)
    for front in range(tables[FRONTS]):
        gather(False, tables, HEADER + front * WIDTH, entries, numbers)
        reduce(tables, HEADER + front * WIDTH, numbers)


@ti.kernel
def eliminate_alone(tables: TABLES, entries: VALUES, numbers: VALUES, vectors: VECTORS):
    """The same for one matrix. vectors : the numbers, LANES at a time."""
    ti.loop_config(serialize=True)
    for front in range(tables[FRONTS]):
        gather(True, tables, HEADER + front * WIDTH, entries, numbers)
        reduce_alone(tables, HEADER + front * WIDTH, numbers, vectors)


@ti.func
def substituted(
    alone: ti.template(), tables: ti.template(), numbers: ti.template(), solution: ti.template(), work: ti.template()
):
    for turn in range(2 * tables[FRONTS]):
        forward = turn < tables[FRONTS]
        at = HEADER + (turn if forward else 2 * tables[FRONTS] - 1 - turn) * WIDTH
        own, border, columns, first = tables[at + OWN], tables[at + BORDER], tables[at + COLUMNS], tables[at + FIRST]
        places, height = tables[BORDERS] + tables[at + SHARE], tables[at + HEIGHT]
        if forward:
            clear(alone, work, 0, border)
            for k in range(own):
                start = columns + k * height
                value = solution[first + k] * numbers[start + k]
                solution[first + k] = value
                for i in range(k + 1, own):
                    solution[first + i] = solution[first + i] - numbers[start + i] * value
                for i in range(border):
                    work[i] = work[i] + numbers[start + own + i] * value
            for i in range(border):
                to = tables[places + i]
                solution[to] = solution[to] - work[i]
        else:
            for i in range(border):
                work[i] = solution[tables[places + i]]
            for back in range(own):
                k = own - 1 - back
                start = columns + k * height
                rest = solution[first + k]
                for i in range(border):
                    rest = rest - numbers[start + own + i] * work[i]
                for i in range(k + 1, own):
                    rest = rest - numbers[start + i] * solution[first + i]
                solution[first + k] = rest * numbers[start + k]


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
