"""Cholesky factors of several matrices of one pattern side by side: each number is a vector of one entry a matrix.

The fronts of the elimination tree one after the other, children first (numerics/cholesky/side_by_side.py). A front is
stored column by column: m columns of own unknowns with all their n rows, then the update that it leaves for its border,
b columns of b rows of which the lower triangle counts.
"""

from taichi_bearings.compiler import ti

LANES = 8  # matrices; what an AVX-512 instruction works on at once
VECTORS = ti.types.ndarray(dtype=ti.types.vector(LANES, ti.f64), ndim=1)
TABLES = ti.types.ndarray(dtype=ti.i32, ndim=1)

# Where the tables begin in the array of integers is written at its start, after the number of fronts
FRONTS, PLACES, MAPS, BORDERS, HEADER = 0, 1, 2, 3, 4
# A row of the table of fronts: own unknowns and border, where columns and update begin, first and last entry, children
# or -1, where its part of maps and borders begins, first own unknown
OWN, BORDER, COLUMNS, UPDATE, ENTRIES, ENTRIES_END, CHILD, SHARE, FIRST, WIDTH = 0, 1, 2, 3, 4, 5, 6, 8, 9, 10


@ti.func
def nothing():
    return ti.Vector.zero(ti.f64, LANES)


@ti.func
def gather(tables: ti.template(), at, entries: ti.template(), numbers: ti.template()):
    """Fill a front with its entries and with what its children leave."""
    own, border, columns, update = tables[at + OWN], tables[at + BORDER], tables[at + COLUMNS], tables[at + UPDATE]
    rows = own + border
    for i in range(own * rows):
        numbers[columns + i] = nothing()
    for i in range(border * border):
        numbers[update + i] = nothing()
    for entry in range(tables[at + ENTRIES], tables[at + ENTRIES_END]):
        numbers[columns + tables[tables[PLACES] + entry]] = entries[entry]
    for which in ti.static(range(2)):
        if tables[at + CHILD + which] >= 0:
            child = HEADER + tables[at + CHILD + which] * WIDTH
            length, source, places = tables[child + BORDER], tables[child + UPDATE], tables[MAPS] + tables[child + SHARE]
            for j in range(length):
                column = tables[places + j]
                start = columns + column * rows
                if column >= own:
                    start = update + (column - own) * border - own
                for i in range(j, length):
                    to = start + tables[places + i]
                    numbers[to] = numbers[to] + numbers[source + j * length + i]


@ti.func
def reduce(numbers: ti.template(), columns, update, own, border):
    """Eliminate the own unknowns: column by column, each less what the ones before it contribute."""
    rows = own + border
    for j in range(rows):
        before, start = ti.min(j, own), columns + j * rows
        if j >= own:
            start = update + (j - own) * border - own
        i = j
        while i + 4 <= rows:
            to = start + i
            a, b, c, d = numbers[to], numbers[to + 1], numbers[to + 2], numbers[to + 3]
            for k in range(before):
                source = columns + k * rows
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
                source = columns + k * rows
                e = e - numbers[source + i] * numbers[source + j]
            numbers[start + i] = e
            i += 1
        if j < own:
            inverse = 1.0 / ti.sqrt(numbers[start + j])
            numbers[start + j] = inverse  # what the substitutions need
            for i in range(j + 1, rows):
                numbers[start + i] = numbers[start + i] * inverse


@ti.kernel
def eliminate(tables: TABLES, entries: VECTORS, numbers: VECTORS):
    """Factorise. A pivot that is not positive leaves an inverse that is not finite, in its matrix alone."""
    ti.loop_config(serialize=True)
    for front in range(tables[FRONTS]):
        at = HEADER + front * WIDTH
        gather(tables, at, entries, numbers)
        reduce(numbers, tables[at + COLUMNS], tables[at + UPDATE], tables[at + OWN], tables[at + BORDER])


@ti.kernel
def substitute(tables: TABLES, numbers: VECTORS, solution: VECTORS, work: VECTORS):
    """Solve in place, forward and backward. work : as many vectors as the longest border has."""
    ti.loop_config(serialize=True)
    for turn in range(2 * tables[FRONTS]):
        forward = turn < tables[FRONTS]
        at = HEADER + (turn if forward else 2 * tables[FRONTS] - 1 - turn) * WIDTH
        own, border, columns, first = tables[at + OWN], tables[at + BORDER], tables[at + COLUMNS], tables[at + FIRST]
        places, rows = tables[BORDERS] + tables[at + SHARE], own + border
        if forward:
            for i in range(border):
                work[i] = nothing()
            for k in range(own):
                start = columns + k * rows
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
                start = columns + k * rows
                value = solution[first + k]
                for i in range(border):
                    value = value - numbers[start + own + i] * work[i]
                for i in range(k + 1, own):
                    value = value - numbers[start + i] * solution[first + i]
                solution[first + k] = value * numbers[start + k]
