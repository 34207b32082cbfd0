"""Fill the fronts of one depth of the elimination tree: original entries plus the updates of the children."""

import taichi as ti

ints = ti.types.ndarray(dtype=ti.i32, ndim=1)
table = ti.types.ndarray(dtype=ti.i32, ndim=2)
offsets = ti.types.ndarray(dtype=ti.i64, ndim=2)
reals = ti.types.ndarray(dtype=ti.f64, ndim=1)

# columns of `front_table`
OWN, BORDER, ENTRIES, CHILD_A, CHILD_B, MAP = 0, 1, 2, 3, 4, 5
# columns of `front_offset`
DIAGONAL, BELOW, UPDATE = 0, 1, 2


@ti.kernel
def assemble(
    serial: ti.template(),
    begin: ti.i32,
    end: ti.i32,
    columns: table,
    front_table: table,
    front_offset: offsets,
    entry_start: ints,
    entry_place: ints,
    place_in_parent: ints,
    values: reals,
    factor: reals,
    updates_below: reals,
    updates: reals,
):
    """Columns begin ... end-1 of the list `columns` (front, column of the front, column of child a and b, -1 for none).

    A front is stored in column order as its diagonal block and the block below it (both in `factor`) and, for the
    border, the update block (in `updates`); only lower triangles count.
    """
    if ti.static(serial):
        ti.loop_config(serialize=True)
    for item in range(begin, end):
        front, column = columns[item, 0], columns[item, 1]
        own, border = front_table[front, OWN], front_table[front, BORDER]
        # where row `own` and row 0 of this column are stored
        below = ti.i64(0)
        diagonal = ti.i64(0)
        if column < own:
            diagonal = front_offset[front, DIAGONAL] + ti.i64(column) * own
            below = front_offset[front, BELOW] + ti.i64(column) * border
            for row in range(own):
                factor[diagonal + row] = 0.0
            for row in range(border):
                factor[below + row] = 0.0
            entry = front_table[front, ENTRIES] + column
            for e in range(entry_start[entry], entry_start[entry + 1]):
                row = entry_place[e]
                if row < own:
                    factor[diagonal + row] = values[e]
                else:
                    factor[below + row - own] = values[e]
        else:
            below = front_offset[front, UPDATE] + ti.i64(column - own) * border
            for row in range(column - own, border):
                updates[below + row] = 0.0
        for which in ti.static(range(2)):
            child_column = columns[item, 2 + which]
            if child_column >= 0:
                child = front_table[front, CHILD_A + which]
                length = front_table[child, BORDER]
                source = front_offset[child, UPDATE] + ti.i64(child_column) * length
                places = front_table[child, MAP]
                for i in range(child_column, length):
                    row = place_in_parent[places + i]
                    if row < own:
                        factor[diagonal + row] = factor[diagonal + row] + updates_below[source + i]
                    elif column < own:
                        factor[below + row - own] = factor[below + row - own] + updates_below[source + i]
                    else:
                        updates[below + row - own] = updates[below + row - own] + updates_below[source + i]
