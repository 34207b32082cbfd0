"""Cholesky factorisation of one sparse matrix, or of LANES matrices with one pattern at a time. In the second case each
number in memory is a vector with one number of each matrix.

The factorisation is multifrontal. A *front* is a dense matrix for a group of unknowns that are eliminated together, its
*own* unknowns, and for the later unknowns that they are coupled to, its *border*. The elimination leaves a matrix for
the border, the *update*, which is added to the front of the parent in the elimination tree. So children are eliminated
before their parents; numerics/cholesky/layout.py says where the numbers of each front stand.

A front is stored column by column: m columns of own unknowns with all their n rows, then the update, b columns in
panels of SHEET columns, each panel from its diagonal down; only lower triangles are used. Small matrices are eliminated
here, in one launch. Fronts of large matrices are only assembled here, and then eliminated by BLAS; their own columns
are in such panels, too. The operations on a matrix, and their order, do not depend on the number of matrices.

The functions share these arguments: `tables`, the array of integers that says where everything stands; `at`, where the
row of a front begins in it; `numbers`, the entries of all fronts; `unit`, how many rows make a vector.

The innermost loops, and those of `gather`, step by a number that stands in the tables, although it is 1: if LLVM knew
the step it would unroll the loops eight times over, which takes every process seconds and makes none of them faster.
"""

from collections.abc import Callable

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.memory import INTEGERS
from taichi_bearings.kernels.team import LEAST_CHUNK

PANEL = 4  # columns, and rows or vectors of rows, that are worked on together: their numbers fit into registers
LANES = 8  # matrices, or rows of a single one, that one AVX-512 instruction works on
NUMBERS = ti.types.ndarray(dtype=ti.f64, ndim=1)
VECTORS = ti.types.ndarray(dtype=ti.types.vector(LANES, ti.f64), ndim=1)

# Positions in the header of the tables, the array of integers: the number of fronts; where the other tables begin
# (PLACES of entries within their fronts; MAPS, the rows of each border in the front of the parent; RUNS, how many rows
# of a border, from each one on, are neighbours there as well; SLOTS, where they are in vectors; ITEMS of work for
# `assemble`; BRANCHES for substitutions); columns of a panel of an update; and a 1
FRONTS, PLACES, MAPS, RUNS, SLOTS, ITEMS, BRANCHES, SHEET, STEP, HEADER = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
# Positions in a row of the table of fronts: number of own unknowns and of the border; where columns and update begin;
# first and last entry; its first child, and the next child of its parent, or -1; where its part of maps and slots
# begins; first own unknown; distance from one own column, and from one column of the update, to the next; the row at
# which columns of the update begin; where its border begins in vectors; and how many own columns are in a panel
OWN, BORDER, OWN_COLUMNS, UPDATE, ENTRIES, ENTRIES_END, CHILD, SIBLING, BATCH_SHARE, FIRST_ROW = range(10)
HEIGHT, UPDATE_HEIGHT, SKIP, REST_HEIGHT, OWN_SHEET, WIDTH = 10, 11, 12, 13, 14, 15


@ti.func
def clear(alone: ti.template(), numbers: ti.template(), begin, end, step):
    """Set the entries begin ... end-1 of an array to zero.

    alone : True if an entry is a number, False if it is a vector of LANES numbers.
    numbers : the array, flat.
    step : 1, from memory: if the compiler knew it, it would unroll the loop, which takes long and gains nothing."""
    i = begin
    while i < end:
        if ti.static(alone):
            numbers[i] = 0.0
        else:
            numbers[i] = ti.Vector.zero(ti.f64, LANES)
        i += step


@ti.func
def columns_before(column, width):
    """Return how many columns of a matrix are stored in panels before the panel that holds a given column.

    column : number of the column.
    width : columns of a panel.
    """
    before = 0
    if column >= width:  # hardly ever: no division in small fronts
        before = column // width * width
    return before


@ti.func
def begin_of_column(column, height, width):
    """Return the index, counted from the first number of a matrix, of row 0 of one of its columns. The matrix is stored
    in panels of columns, each panel from its diagonal down, so that row 0 itself is stored in the first panel only.

    column : number of the column.
    height : distance from one column to the next in the first panel; in each later panel it is smaller by `width`.
    width : columns of a panel.
    """
    before = columns_before(column, width)
    begin = column * (height - before)
    if before > 0:
        begin += before * (before - 1) - before * (before - width) // 2
    return begin


@ti.func
def column_of(tables: ti.template(), at, column, packed: ti.template()):
    """Return the index of row 0 of a column of a front among the entries of all fronts. Columns that are stored from
    the diagonal down only have other entries there; the index then only serves to find the rows that are stored.

    A front is the dense matrix of unknowns that are eliminated together, its *own* unknowns, and of later unknowns; its
    update is the matrix that elimination leaves for the later unknowns.

    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    column : number of the column within the front, own columns first.
    packed : True if own columns are stored in panels as well, each from its diagonal down."""
    own, start, width = tables[at + OWN], tables[at + OWN_COLUMNS], tables[SHEET]
    if column >= own:
        start = tables[at + UPDATE] - tables[at + SKIP]
        start += begin_of_column(column - own, tables[at + UPDATE_HEIGHT], width)
    elif ti.static(packed):
        start += begin_of_column(column, tables[at + HEIGHT], width)
    else:
        start += column * tables[at + HEIGHT]
    return start


@ti.func
def add_vectors(vectors: ti.template(), to, end, source, shift: ti.template()):
    """Add to the vectors `to` ... `end`-1, LANES numbers each, as many numbers that stand one after the other elsewhere
    in the same array.

    vectors : the array, as vectors of LANES numbers; changed in place.
    to, end : indices of vectors.
    source, shift : the first number to add is number `shift`, 0 to LANES - 1, of the vector `source`. `shift` is known
        to the compiler, so that each vector to add is put together from two of memory in one instruction."""
    left = vectors[source]
    while to < end:
        source += 1
        right, added = vectors[source], ti.Vector.zero(ti.f64, LANES)
        for k in ti.static(range(LANES)):
            if ti.static(k + shift < LANES):
                added[k] = left[k + shift]
            else:
                added[k] = right[k + shift - LANES]
        vectors[to] = vectors[to] + added
        left = right
        to += 1


@ti.func
def add_run(numbers: ti.template(), vectors: ti.template(), to, source, length, step):
    """Add `length` numbers of an array that follow each other, from index `source` on, to those from index `to` on.

    numbers, vectors : the array, number by number, and the same memory as vectors of LANES numbers; changed in place.
    step : 1, from memory: if the compiler knew it, it would unroll the loops, which takes long and gains nothing."""
    end = to + length
    first, last = (to + LANES - 1) // LANES, end // LANES
    if last > first:
        while to < first * LANES:
            numbers[to] = numbers[to] + numbers[source]
            to, source = to + step, source + step
        for shift in ti.static(range(LANES)):
            if source % LANES == shift:
                add_vectors(vectors, first, last, source // LANES, shift)
        to, source = last * LANES, source + (last - first) * LANES
    while to < end:
        numbers[to] = numbers[to] + numbers[source]
        to, source = to + step, source + step


@ti.func
def gather(
    in_runs: ti.template(), unit: ti.template(), packed: ti.template(), tables: ti.template(), at, first, end,
    entries: ti.template(), numbers: ti.template(), vectors: ti.template(),
):  # fmt: skip
    """Fill some columns of a front with the entries of the matrix, and add the updates that its children leave.

    A front is the dense matrix of unknowns that are eliminated together, and of later unknowns; its update is the
    matrix that elimination leaves for the later unknowns. Children are fronts whose updates are added to this one.

    in_runs : True to add neighbouring numbers as vectors: for one matrix with large fronts, as it takes 20 ms to load.
    unit : number of rows that make a vector in `vectors`, 1 for LANES matrices; columns are cleared from a multiple of
        it on.
    packed : True if own columns are stored in panels, each from its diagonal down.
    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    first, end : the columns first ... end-1 are filled.
    entries : entries of the sparse matrix, flat, in the order of the tables.
    numbers : entries of all fronts, flat, one by one; read and written.
    vectors : the same entries as vectors of `unit` rows."""
    # set the columns to zero, from the diagonal down
    columns, height, step, width = tables[at + OWN_COLUMNS], tables[at + HEIGHT], tables[STEP], tables[SHEET]
    column = first
    while column < end:
        begin = column_of(tables, at, column, packed)
        clear(False, vectors, (begin + column) // unit, (begin + height) // unit, step)
        column += step
    # put the entries of the matrix where the table of places says
    entry, entries_end, least, most = tables[at + ENTRIES], tables[at + ENTRIES_END], first * height, end * height
    if ti.static(packed):
        low, high = ti.min(first, tables[at + OWN]), ti.min(end, tables[at + OWN])
        least, most = low + begin_of_column(low, height, width), high + begin_of_column(high, height, width)
    while entry < entries_end:
        place = tables[tables[PLACES] + entry]
        if least <= place and place < most:
            numbers[columns + place] = entries[entry]
        entry += step
    # add the update of each child; its column j belongs to the column places[j] here
    next_child = tables[at + CHILD]
    while next_child >= 0:
        child = HEADER + next_child * WIDTH
        own, length, places = tables[child + OWN], tables[child + BORDER], tables[MAPS] + tables[child + BATCH_SHARE]
        runs, j = tables[RUNS] + tables[child + BATCH_SHARE], 0
        while j < length and tables[places + j] < first:
            j += step
        while j < length and tables[places + j] < end:
            start = column_of(tables, at, tables[places + j], packed)
            source = own + column_of(tables, child, own + j, packed)
            i = j
            while i < length:
                if ti.static(in_runs):
                    run = tables[runs + i]
                    add_run(numbers, vectors, start + tables[places + i], source + i, run, step)
                    i += run
                else:
                    to = start + tables[places + i]
                    numbers[to] = numbers[to] + numbers[source + i]
                    i += step
            j += step
        next_child = tables[child + SIBLING]


@ti.func
def corner(numbers: ti.template(), shape: ti.template(), j, wide: ti.template()):
    """Return the lower triangle where `wide` neighbouring columns of a front (a dense block of the factorisation) meet
    the diagonal, row by row in a list.

    What the columns before contribute is subtracted. If these are own columns (of unknowns that this front eliminates)
    the triangle is factorised; its diagonal then holds the inverse pivots, which the substitutions need.

    numbers : entries of all fronts, flat; not changed. An entry is a number, or a vector of LANES matrices.
    shape : list [source, end, height, start, pitch, own]: indices in `numbers` where the own columns before these begin
        and end, and the distance from one to the next; index where row 0 of the first of these columns would stand, and
        the distance from one to the next; True if these are own columns.
    j : number of the first of the columns.
    wide : how many they are.
    """
    source, end, height, start, pitch, own = shape
    found = [numbers[start + c * pitch + j + r] for r in ti.static(range(wide)) for c in ti.static(range(r + 1))]
    # subtract what the own columns before contribute, one after the other
    while source < end:
        left = [numbers[source + j + r] for r in ti.static(range(wide))]
        for r in ti.static(range(wide)):
            for c in ti.static(range(r + 1)):
                found[r * (r + 1) // 2 + c] = found[r * (r + 1) // 2 + c] - left[r] * left[c]
        source += height
    # factorise row by row; entry (r, c) of the triangle stands at r (r + 1) / 2 + c
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
    """Finish `wide` columns of a front, in `tall` vectors of rows below the diagonal, in place: subtract what the
    columns before contribute, and divide own columns (of unknowns that are eliminated here) by their triangle at the
    diagonal.

    numbers : entries of all fronts (dense blocks of the factorisation), one by one.
    vectors : the same entries as vectors of `unit` rows.
    unit : rows that make a vector; 1 if each entry is a vector of LANES matrices.
    shape : list [source, end, height, start, pitch, own]: indices in `numbers` where the own columns before these begin
        and end, and the distance from one to the next; index where row 0 of the first of these columns would stand, and
        the distance from one to the next; True if these are own columns.
    j : number of the first of the columns in the front.
    i : number of the first vector of rows.
    first : the lower triangle of these columns at the diagonal, row by row in a list; for own columns that of the
        factor, with inverse pivots.
    wide, tall : number of columns, and of vectors of rows, that are finished."""
    source, end, height, start, pitch, own = shape
    to = [(start + c * pitch) // unit + i for c in ti.static(range(wide))]
    found = [vectors[to[c] + r] for c in ti.static(range(wide)) for r in ti.static(range(tall))]
    # subtract what the own columns before contribute, one after the other
    while source < end:
        left = [vectors[source // unit + i + r] for r in ti.static(range(tall))]
        for c in ti.static(range(wide)):
            factor = numbers[source + j + c]
            for r in ti.static(range(tall)):
                found[c * tall + r] = found[c * tall + r] - left[r] * factor
        source += height
    # solve with the triangle of these columns, whose diagonal holds inverse pivots
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
    """Finish `wide` columns of a front from column j on, in place: eliminate them if they are own columns, else
    subtract from them what the own columns contribute. Either all of them are own, or none.

    Own columns are those of unknowns that are eliminated in this front; the others belong to its update, which is left
    for later unknowns.

    tables : integers that say where the entries of all fronts (dense blocks of the factorisation) stand.
    at : position in `tables` of the row of integers of this front.
    numbers : entries of all fronts, one by one.
    vectors : the same entries as vectors of `unit` rows.
    unit : rows that make a vector; 1 if each entry is a vector of LANES matrices.
    j : number of the first of the columns in the front.
    wide : how many columns, PANEL or 1."""
    own, height, begin = tables[at + OWN], tables[at + HEIGHT], tables[at + OWN_COLUMNS]
    pitch = height if j < own else tables[at + UPDATE_HEIGHT] - columns_before(j - own, tables[SHEET])
    start = column_of(tables, at, j, False)
    shape = [begin, begin + ti.min(j, own) * height, height, start, pitch, j < own]
    # the triangle at the diagonal first, then the rows below it, PANEL vectors at a time
    first = corner(numbers, shape, j, wide)
    i, end = (j + wide) // unit, (own + tables[at + BORDER] + unit - 1) // unit
    if ti.static(wide > 1):  # few columns come alone: no more code for them, which takes every process time to load
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
    """Eliminate the own unknowns of one front in place (Cholesky), PANEL columns at a time, and leave its update.

    A front is the dense matrix of unknowns that are eliminated together, its *own* unknowns, and of later unknowns that
    they are coupled to; its update is the matrix that elimination leaves for the later unknowns.

    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    numbers : entries of all fronts, one by one; only lower triangles are used.
    vectors : the same entries as vectors of `unit` rows.
    unit : rows that make a vector: LANES for a single matrix; 1 for LANES matrices at a time, where each entry is
        itself a vector with a lane for each matrix, and `vectors` is `numbers`."""
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
    """Compute the Cholesky factors of LANES sparse matrices with the same pattern of entries: each number in memory is
    a vector with one number of each matrix.

    If a pivot of a matrix is not positive, its inverse is not finite. Other matrices are not affected.

    tables : integers that say where all entries stand, made in numerics/cholesky/layout.py.
    entries : entries of the sparse matrices, flat, in the order of these tables; each a vector of LANES numbers.
    numbers : entries of all fronts (dense matrices of unknowns that are eliminated together), flat, such vectors too;
        overwritten by the factors.
    """
    ti.loop_config(serialize=True)
    for front in range(tables[FRONTS]):
        at = HEADER + front * WIDTH
        gather(False, 1, False, tables, at, 0, tables[at + OWN] + tables[at + BORDER], entries, numbers, numbers)
        reduce(tables, at, numbers, numbers, 1)


@ti.kernel
def eliminate_alone(tables: INTEGERS, entries: NUMBERS, numbers: NUMBERS, vectors: VECTORS):
    """Find the Cholesky factor of one sparse matrix.

    tables : integers that say where all entries stand, made in numerics/cholesky/layout.py.
    entries : entries of the matrix, in the order of these tables.
    numbers : entries of all fronts (dense matrices of unknowns that are eliminated together), one by one; overwritten
        by the factor.
    vectors : the same memory as vectors of LANES rows."""
    ti.loop_config(serialize=True)
    for front in range(tables[FRONTS]):
        at = HEADER + front * WIDTH
        rows = tables[at + OWN] + tables[at + BORDER]
        gather(False, LANES, False, tables, at, 0, rows, entries, numbers, vectors)
        reduce(tables, at, numbers, vectors, LANES)


@ti.kernel
def eliminate_branches(
    tables: INTEGERS, entries: NUMBERS, numbers: NUMBERS, vectors: VECTORS, begin: int, end: int
):  # fmt: skip
    """Eliminate all fronts of some branches of the elimination tree of one matrix, each branch on a thread.

    A branch is a subtree: a sequence of fronts (dense matrices of unknowns that are eliminated together).

    tables : integers that say where the entries of all fronts stand; its table of branches holds, for each branch, the
        index of its first front and of the front after its last.
    entries : entries of the matrix, in the order of these tables.
    numbers : entries of all fronts, one by one, overwritten by the factor.
    vectors : the same memory as vectors of LANES rows.
    begin, end : the branches begin ... end-1 of the table are worked on.
    """
    for item in range(begin * LEAST_CHUNK, end * LEAST_CHUNK):
        if item % LEAST_CHUNK == 0:
            branch = tables[BRANCHES] + 2 * (item // LEAST_CHUNK)
            for n in range(tables[branch], tables[branch + 1]):
                at = HEADER + n * WIDTH
                rows = tables[at + OWN] + tables[at + BORDER]
                gather(True, LANES, False, tables, at, 0, rows, entries, numbers, vectors)
                reduce(tables, at, numbers, vectors, LANES)


def _assembly(serial: bool) -> Callable:
    """Return a kernel that fills fronts (dense matrices of unknowns that are eliminated together) of one matrix.

    serial : True to do so on one thread, False on several.
    """
    chunk = 1 if serial else LEAST_CHUNK

    @ti.kernel
    def run(tables: INTEGERS, entries: NUMBERS, numbers: NUMBERS, vectors: VECTORS, begin: int, end: int):
        """Fill columns of fronts with entries of the matrix and with what the fronts below them leave.

        tables : integers that say where the entries of all fronts stand. Its table of work items has three integers for
            each: index of a front, first column, and the column after the last.
        entries : entries of the matrix, in the order of the tables.
        numbers : entries of all fronts, one by one; columns of the fronts are overwritten.
        vectors : the same memory as vectors of LANES rows.
        begin, end : the work items begin ... end-1 are done.
        """
        if ti.static(serial):
            ti.loop_config(serialize=True)
        for turn in range(begin * chunk, end * chunk):
            if turn % chunk == 0:
                item = tables[ITEMS] + 3 * (turn // chunk)
                at = HEADER + tables[item] * WIDTH
                gather(True, LANES, True, tables, at, tables[item + 1], tables[item + 2], entries, numbers, vectors)

    return run


assemble, assemble_serially = _assembly(False), _assembly(True)
