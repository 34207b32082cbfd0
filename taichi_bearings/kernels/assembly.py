"""Fill the fronts of one depth of the elimination tree: original entries plus the updates of the children."""

from taichi_bearings.compiler import ti

# Passing an array to a kernel costs as much as assembling a thousand entries, so there is one of each kind. Where the
# tables begin in the array of integers is written at its start:
COLUMNS, FRONTS, ENTRY_START, ENTRY_PLACE, PLACES, HEADER = 0, 1, 2, 3, 4, 5
# a row of the table of columns: front, column of the front, matching columns of its two children or -1
COLUMN_WIDTH = 4
# a row of the table of fronts; the last three are places in the array of reals
OWN, BORDER, FIRST, CHILD_A, CHILD_B, MAP, DIAGONAL, BELOW, UPDATE, FRONT_WIDTH = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9


@ti.kernel
def assemble(
    serial: ti.template(),
    begin: ti.i32,
    end: ti.i32,
    tables: ti.types.ndarray(dtype=ti.i32, ndim=1),
    reals: ti.types.ndarray(dtype=ti.f64, ndim=1),
):
    """Columns begin ... end-1 of the table of columns.

    A front is stored in column order as its diagonal block, the block below it and, for the border, the update block;
    only lower triangles count. The values of the original entries come first in `reals`.
    """
    if ti.static(serial):
        ti.loop_config(serialize=True)
    for item in range(begin, end):
        at = tables[COLUMNS] + item * COLUMN_WIDTH
        column = tables[at + 1]
        front = tables[FRONTS] + tables[at] * FRONT_WIDTH
        own, border = tables[front + OWN], tables[front + BORDER]
        # rows 0 ... own-1 of this column are stored from `diagonal`, rows own ... own+border-1 from `below`
        diagonal, below = 0, 0
        if column < own:
            diagonal = tables[front + DIAGONAL] + column * own
            below = tables[front + BELOW] + column * border
            for row in range(own):
                reals[diagonal + row] = 0.0
            for row in range(border):
                reals[below + row] = 0.0
            entry = tables[ENTRY_START] + tables[front + FIRST] + column
            for e in range(tables[entry], tables[entry + 1]):
                row = tables[tables[ENTRY_PLACE] + e]
                if row < own:
                    reals[diagonal + row] = reals[e]
                else:
                    reals[below + row - own] = reals[e]
        else:
            below = tables[front + UPDATE] + (column - own) * border
            for row in range(column - own, border):
                reals[below + row] = 0.0
        for which in ti.static(range(2)):
            child_column = tables[at + 2 + which]
            if child_column >= 0:
                child = tables[FRONTS] + tables[front + CHILD_A + which] * FRONT_WIDTH
                length = tables[child + BORDER]
                source = tables[child + UPDATE] + child_column * length
                places = tables[PLACES] + tables[child + MAP]
                for i in range(child_column, length):
                    row = tables[places + i]
                    target = below + row - own
                    if row < own:
                        target = diagonal + row
                    reals[target] = reals[target] + reals[source + i]
