"""Solves linear systems with a Cholesky factor, for one matrix or for LANES matrices with one pattern at a time.

A *front* is a group of unknowns that are eliminated together, its *own* unknowns, with the later unknowns to which they
are coupled, its *border* (kernels/elimination.py). The right-hand side, replaced by the solution, is a vector of the
unknowns in the order of elimination. After these it has numbers of each front for its border, which its parent in the
elimination tree reads. No two fronts write to one place. So fronts of which none is above another can be solved at
once, and neither their order nor the number of threads or matrices changes a bit of the result.
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
    OWN_SHEET,
    PANEL,
    REST_HEIGHT,
    SIBLING,
    SLOTS,
    STEP,
    VECTORS,
    WIDTH,
    begin_of_column,
    clear,
    columns_before,
)
from taichi_bearings.kernels.memory import INTEGERS
from taichi_bearings.kernels.team import LEAST_CHUNK


@ti.func
def triangle_forward(numbers: ti.template(), vector: ti.template(), where: ti.template(), wide: ti.template()):
    """Solve forward, in place, with a triangle at the diagonal of the Cholesky factor, and return the list of its
    `wide` unknowns. These are the own unknowns of a front, a group of unknowns that are eliminated together.

    An entry of an array is a number of one matrix, or a vector with one number of each of LANES matrices.

    numbers : the Cholesky factor, flat, with inverse pivots.
    vector : flat, right-hand sides, replaced by the solution.
    where : list [start, height, row]. In `numbers`: index of the first pivot, and distance from one column to the next.
        In `vector`: index of the first of these unknowns.
    wide : number of these unknowns."""
    start, height, row = where
    value = [vector[row + c] for c in ti.static(range(wide))]
    for c in ti.static(range(wide)):
        for p in ti.static(range(c)):
            value[c] = value[c] - numbers[start + p * height + c] * value[p]
        value[c] = value[c] * numbers[start + c * height + c]
        vector[row + c] = value[c]
    return value


@ti.func
def triangle_backward(
    numbers: ti.template(), vector: ti.template(), left: ti.template(), where: ti.template(), wide: ti.template()
):
    """Solve backward, from its last row up, with a triangle at the diagonal of the Cholesky factor. It belongs to the
    `wide` own unknowns of a front, a group of unknowns that are eliminated together.

    An entry of an array is a number of one matrix, or a vector with one number of each of LANES matrices.

    numbers : the Cholesky factor, flat, with inverse pivots.
    vector : flat; the solution is written here.
    left : list of the right-hand sides of these unknowns, less what later unknowns contribute; replaced by the
        solution.
    where : list [start, height, row]. In `numbers`: index of the first pivot, and distance from one column to the next.
        In `vector`: index of the first of these unknowns.
    wide : number of these unknowns."""
    start, height, row = where
    for back in ti.static(range(wide)):
        c = ti.static(wide - 1 - back)
        for p in ti.static(range(c + 1, wide)):
            left[c] = left[c] - numbers[start + c * height + p] * left[p]
        left[c] = left[c] * numbers[start + c * height + c]
        vector[row + c] = left[c]


@ti.func
def take_from_children(tables: ti.template(), at, vector: ti.template(), keeps_own: ti.template()):
    """Add to the right-hand sides of one front, and to what it stores for its border, what its children in the
    elimination tree have left for their borders. A front consists of unknowns that are eliminated together, and of the
    later unknowns that they are coupled to, its border.

    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    vector : flat, changed in place: the right-hand side of each unknown in the order of elimination; then what each
        front stores, one after the other. An entry is a number, or a vector with one number of each of LANES matrices.
    keeps_own : True if a front stores a number for each of its own unknowns, and then one for each of its border; False
        if it stores only those of its border."""
    # `step` is 1, read from memory: if the compiler knew it, it would unroll the loop, which takes long
    next_child, step = tables[at + CHILD], tables[STEP]
    while next_child >= 0:
        child = HEADER + next_child * WIDTH
        slots, left, i = tables[SLOTS] + tables[child + BATCH_SHARE], tables[child + REST_HEIGHT], 0
        if ti.static(keeps_own):
            left += tables[child + OWN]
        while i < tables[child + BORDER]:
            to = tables[slots + i]
            vector[to] = vector[to] + vector[left + i]
            i += step
        next_child = tables[child + SIBLING]


@ti.func
def copy_border(tables: ti.template(), at, vector: ti.template(), to):
    """Copy the unknowns of the border of one front, which its parent in the elimination tree has solved for, to where
    the front stores numbers for its border. A front consists of unknowns that are eliminated together, and of the later
    unknowns that they are coupled to, its border.

    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    vector : flat, changed in place: the solution for each unknown, as far as it is known; then what each front stores.
        An entry is a number, or a vector with one number of each of LANES matrices.
    to : index in `vector` of the first copy."""
    # `step` is 1, read from memory: if the compiler knew it, it would unroll the loop, which takes long
    slots, step, i = tables[SLOTS] + tables[at + BATCH_SHARE], tables[STEP], 0
    while i < tables[at + BORDER]:
        vector[to + i] = vector[tables[slots + i]]
        i += step


@ti.func
def forward(numbers: ti.template(), vector: ti.template(), where: ti.template(), wide: ti.template()):
    """Solve forward for `wide` own unknowns of a front, and subtract their contribution from its later unknowns and its
    border.

    A front consists of unknowns that are eliminated together, its *own* unknowns, and of the later unknowns that they
    are coupled to, its border. An entry of an array is a number of one matrix, or a vector with one number of each of
    LANES matrices.

    numbers : the Cholesky factor, flat.
    vector : flat, right-hand sides, replaced by the solution; and after them what each front leaves for its border.
    where : list [start, height, row, end, rest, border, step]. In `numbers`: index of the first pivot, and distance
        from one column to the next. In `vector`: index of the first of these unknowns, end of the front's own ones, and
        begin of what is left for the border. Then the length of the border, and 1, hidden from the compiler so that it
        does not unroll the loops.
    wide : number of these own unknowns, PANEL or 1."""
    start, height, row, end, rest, border, step = where
    value = triangle_forward(numbers, vector, [start, height, row], wide)
    # the later own unknowns, then the border
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
    """Solve backward for `wide` own unknowns of a front, once its later unknowns and its border are known.

    A front consists of unknowns that are eliminated together, its *own* unknowns, and of the later unknowns that they
    are coupled to, its border. An entry of an array is a number of one matrix, or a vector with one number of each of
    LANES matrices.

    numbers : the Cholesky factor, flat.
    vector : flat, results of the forward solve, replaced by the solution; and after them, for each front, a copy of the
        unknowns of its border.
    where : list [start, height, row, end, rest, border, step]. In `numbers`: index of the first pivot, and distance
        from one column to the next. In `vector`: index of the first of these unknowns, end of the front's own ones, and
        begin of the copy of its border. Then the length of the border, and 1, hidden from the compiler so that it does
        not unroll the loops.
    wide : number of these own unknowns, PANEL or 1."""
    start, height, row, end, rest, border, step = where
    # subtract what the border and the later own unknowns contribute
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
    triangle_backward(numbers, vector, left, [start, height, row], wide)


@ti.func
def down(alone: ti.template(), tables: ti.template(), at, numbers: ti.template(), vector: ti.template()):
    """Solve forward (L y = b, with the Cholesky factor L) for one front, once its children in the elimination tree are
    done.

    A front consists of unknowns that are eliminated together, its *own* unknowns, and of the later unknowns that they
    are coupled to, its border.

    alone : True for one matrix, False for LANES of them; then an entry of an array is a vector with one number of each.
    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    numbers : the Cholesky factor, flat.
    vector : flat, right-hand sides, replaced by the solution; and after them what each front leaves for its border."""
    own, border, first, rest = tables[at + OWN], tables[at + BORDER], tables[at + FIRST_ROW], tables[at + REST_HEIGHT]
    height, step = tables[at + HEIGHT], tables[STEP]
    # begin with nothing for the border, and take what the children have left for theirs
    clear(alone, vector, rest, rest + border, step)
    take_from_children(tables, at, vector, False)
    # eliminate the own unknowns
    k = 0
    while k < own:
        start = tables[at + OWN_COLUMNS] + k * (height + 1)
        if k + PANEL <= own:
            forward(numbers, vector, [start, height, first + k, first + own, rest, border, step], PANEL)
            k += PANEL
        else:
            forward(numbers, vector, [start, height, first + k, first + own, rest, border, step], 1)
            k += 1


@ti.func
def up(tables: ti.template(), at, numbers: ti.template(), vector: ti.template()):
    """Solve backward (L^T x = y, with the Cholesky factor L) for one front, once its parent in the elimination tree is
    done.

    A front consists of unknowns that are eliminated together, its *own* unknowns, and of the later unknowns that they
    are coupled to, its border.

    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    numbers : the Cholesky factor, flat. An entry of an array is a number of one matrix, or a vector with one number of
        each of LANES matrices.
    vector : flat, results of the forward solve, replaced by the solution; and after them, for each front, room for a
        copy of the unknowns of its border."""
    own, border, first, rest = tables[at + OWN], tables[at + BORDER], tables[at + FIRST_ROW], tables[at + REST_HEIGHT]
    height, step = tables[at + HEIGHT], tables[STEP]
    copy_border(tables, at, vector, rest)
    # solve for the own unknowns from the last to the first
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
    """Return a kernel that solves linear systems with a Cholesky factor, in place, on one thread.

    together : True for LANES matrices of one pattern at a time; False for one matrix.
    """
    kind = VECTORS if together else NUMBERS

    @ti.kernel
    def run(tables: INTEGERS, numbers: kind, vector: kind):
        """Solve forward for all fronts (groups of unknowns that are eliminated together), L y = b, then backward, L^T x
        = y, in place.

        tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
        numbers : the Cholesky factor, flat; an entry is a number of one matrix, or a vector of LANES matrices.
        vector : flat, with such entries: the right-hand side of each unknown, replaced by the solution, and after them
            what each front leaves for later unknowns.
        """
        ti.loop_config(serialize=True)
        for turn in range(2 * tables[FRONTS]):
            if turn < tables[FRONTS]:
                down(not together, tables, HEADER + turn * WIDTH, numbers, vector)
            else:
                up(tables, HEADER + (2 * tables[FRONTS] - 1 - turn) * WIDTH, numbers, vector)

    return run


substitute, substitute_alone = _substitution(True), _substitution(False)


@ti.func
def forward_vectors(
    memory: ti.template(), vector: ti.template(), vectors: ti.template(), where: ti.template(), wide: ti.template()
):
    """Solve forward for `wide` own unknowns of a front of one matrix, and subtract their contribution from all rows of
    the front below them.

    A front consists of unknowns that are eliminated together, its *own* unknowns, and of the later unknowns that they
    are coupled to; it has a row for each of these unknowns.

    memory : list of two arrays: the Cholesky factor of one matrix, flat, and the same memory as vectors of LANES rows.
    vector : flat, the right-hand sides of the rows of all fronts; replaced by the solution.
    vectors : the memory of `vector`, as vectors of LANES rows.
    where : list [start, height, row, end, step]. In the factor: index of the first pivot, and distance from one column
        to the next. In `vector`: index of the first of these unknowns, and end of the front's rows. Last 1, hidden from
        the compiler so that it does not unroll the loops.
    wide : number of these own unknowns, LANES or 1."""
    numbers, blocks = ti.static(memory)
    start, height, row, end, step = where
    value = triangle_forward(numbers, vector, [start, height, row], wide)
    # rows up to the next whole vector, then vectors of rows
    i, whole = wide, (row + wide + LANES - 1) // LANES
    while i < whole * LANES - row:
        left = vector[row + i]
        for c in ti.static(range(wide)):
            left = left - numbers[start + c * height + i] * value[c]
        vector[row + i] = left
        i += step
    below, last, pitch = (start + whole * LANES - row) // LANES, end // LANES, height // LANES
    while whole < last:
        rows = vectors[whole]
        for c in ti.static(range(wide)):
            rows = rows - blocks[below + c * pitch] * value[c]
        vectors[whole] = rows
        whole += step
        below += step


@ti.func
def backward_vectors(
    memory: ti.template(), vector: ti.template(), vectors: ti.template(), where: ti.template(), wide: ti.template()
):
    """Solve backward for `wide` own unknowns of a front of one matrix, once the unknowns of all rows of the front below
    them are known.

    A front consists of unknowns that are eliminated together, its *own* unknowns, and of the later unknowns that they
    are coupled to; it has a row for each of these unknowns.

    memory : list of two arrays: the Cholesky factor of one matrix, flat, and the same memory as vectors of LANES rows.
    vector : flat, what the forward solve has left in the rows of all fronts; replaced by the solution.
    vectors : the memory of `vector`, as vectors of LANES rows.
    where : list [start, height, row, end, step]. In the factor: index of the first pivot, and distance from one column
        to the next. In `vector`: index of the first of these unknowns, and end of the front's rows. Last 1, hidden from
        the compiler so that it does not unroll the loops.
    wide : number of these own unknowns, LANES or 1."""
    numbers, blocks = ti.static(memory)
    start, height, row, end, step = where
    whole = (row + wide + LANES - 1) // LANES
    below, last, pitch = (start + whole * LANES - row) // LANES, end // LANES, height // LANES
    # what vectors of rows contribute, lane by lane, then the rows between
    sums = [ti.Vector.zero(ti.f64, LANES) for c in ti.static(range(wide))]
    turn = whole
    while turn < last:
        known = vectors[turn]
        for c in ti.static(range(wide)):
            sums[c] = sums[c] + blocks[below + c * pitch] * known
        turn += step
        below += step
    left = [vector[row + c] - sums[c].sum() for c in ti.static(range(wide))]
    i = wide
    while i < whole * LANES - row:
        for c in ti.static(range(wide)):
            left[c] = left[c] - numbers[start + c * height + i] * vector[row + i]
        i += step
    triangle_backward(numbers, vector, left, [start, height, row], wide)


@ti.func
def pivot_and_pitch(tables: ti.template(), at, column):
    """Return the index of the pivot of an own column of a front in the Cholesky factor, and how far further on the next
    column of its panel stands. A front consists of unknowns that are eliminated together, its *own* unknowns, and of
    the later unknowns that they are coupled to.

    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    column : number of the own column."""
    height, width = tables[at + HEIGHT], tables[at + OWN_SHEET]
    pivot = tables[at + OWN_COLUMNS] + begin_of_column(column, height, width) + column
    return pivot, height - columns_before(column, width)


@ti.func
def down_vectors(tables: ti.template(), at, memory: ti.template(), vector: ti.template(), vectors: ti.template()):
    """Solve forward (L y = b, with the Cholesky factor L) for one front of one matrix, once its children in the
    elimination tree are done.

    A front consists of unknowns that are eliminated together, its *own* unknowns, and of the later unknowns that they
    are coupled to, its border.

    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    memory : list of two arrays: the Cholesky factor of one matrix, flat, and the same memory as vectors of LANES rows.
    vector : flat, changed in place: the right-hand side of each unknown; then for each front its *rows*, a number for
        each of its own unknowns and each of its border.
    vectors : the memory of `vector`, as vectors of LANES rows."""
    own, first, rest, height = tables[at + OWN], tables[at + FIRST_ROW], tables[at + REST_HEIGHT], tables[at + HEIGHT]
    step, i = tables[STEP], 0
    # begin with the right-hand sides and nothing for the border, and take what the children have left for theirs
    while i < own:
        vector[rest + i] = vector[first + i]
        i += step
    clear(True, vector, rest + own, rest + height, step)
    take_from_children(tables, at, vector, True)
    # eliminate the own unknowns
    k = 0
    while k < own:
        start, pitch = pivot_and_pitch(tables, at, k)
        where = [start, pitch, rest + k, rest + height, step]
        if k + LANES <= own:
            forward_vectors(memory, vector, vectors, where, LANES)
            k += LANES
        else:
            forward_vectors(memory, vector, vectors, where, 1)
            k += 1


@ti.func
def up_vectors(tables: ti.template(), at, memory: ti.template(), vector: ti.template(), vectors: ti.template()):
    """Solve backward (L^T x = y, with the Cholesky factor L) for one front of one matrix, once its parent in the
    elimination tree is done.

    A front consists of unknowns that are eliminated together, its *own* unknowns, and of the later unknowns that they
    are coupled to, its border.

    tables : integers that say where all numbers stand: a header, a row of WIDTH integers for each front, and lists.
    at : position in `tables` of the row of integers of this front.
    memory : list of two arrays: the Cholesky factor of one matrix, flat, and the same memory as vectors of LANES rows.
    vector : flat: the right-hand side of each unknown, replaced by the solution; then for each front its *rows*, a
        number for each of its own unknowns and each of its border, as the forward solve has left them.
    vectors : the memory of `vector`, as vectors of LANES rows."""
    own, first, rest, height = tables[at + OWN], tables[at + FIRST_ROW], tables[at + REST_HEIGHT], tables[at + HEIGHT]
    step = tables[STEP]
    copy_border(tables, at, vector, rest + own)
    # solve for the own unknowns from the last to the first
    k = own
    while k > 0:
        if k % LANES == 0:
            k -= LANES
            start, pitch = pivot_and_pitch(tables, at, k)
            where = [start, pitch, rest + k, rest + height, step]
            backward_vectors(memory, vector, vectors, where, LANES)
        else:
            k -= 1
            start, pitch = pivot_and_pitch(tables, at, k)
            where = [start, pitch, rest + k, rest + height, step]
            backward_vectors(memory, vector, vectors, where, 1)
    i = 0
    while i < own:
        vector[first + i] = vector[rest + i]
        i += step


@ti.kernel
def substitute_branches(
    tables: INTEGERS, numbers: NUMBERS, blocks: VECTORS, vector: NUMBERS, vectors: VECTORS,
    forth: int, begin: int, end: int,
):  # fmt: skip
    """Solve forward or backward for one matrix, in some branches of the elimination tree, each branch on a thread.

    A branch is a sequence of fronts (groups of unknowns that are eliminated together); the branches of a call do not
    depend on each other.

    tables : integers that say where the entries of all fronts stand; its table of branches holds, for each branch, the
        index of its first front and of the front after its last.
    numbers : the Cholesky factor, number by number.
    blocks : the same memory as vectors of LANES rows.
    vector : flat: the right-hand side of each unknown, replaced by the solution; then for each front its *rows*, a
        number for each of its own unknowns and each of its border (the later unknowns they are coupled to).
    vectors : the same memory as vectors of LANES rows.
    forth : 1 to solve forward, from the first front to the last; 0 to solve backward.
    begin, end : the branches begin ... end-1 are solved.
    """
    for item in range(begin * LEAST_CHUNK, end * LEAST_CHUNK):
        if item % LEAST_CHUNK == 0:
            branch = tables[BRANCHES] + 2 * (item // LEAST_CHUNK)
            first, last = tables[branch], tables[branch + 1]
            for n in range(first, last):
                if forth:
                    down_vectors(tables, HEADER + n * WIDTH, [numbers, blocks], vector, vectors)
                else:
                    up_vectors(tables, HEADER + (first + last - 1 - n) * WIDTH, [numbers, blocks], vector, vectors)
