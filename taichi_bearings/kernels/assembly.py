"""Fill fronts of the elimination tree: original entries plus the updates of the children."""

from taichi_bearings.compiler import ti

# Passing an array to a kernel costs as much as assembling a thousand entries, so there is one of each kind. Where the
# tables begin in the array of integers is written at its start:
COLUMNS, FRONTS, ENTRY_START, ENTRY_PLACE, PLACES, HEADER = 0, 1, 2, 3, 4, 5
# a row of the table of columns: front, where row 0 of this column would be among the reals (what is above the diagonal
# is not stored, or does not count), the matching column of a child in this table, and that of the next child which has
# one with the same column of their parent, or -1
FRONT, ADDRESS, CHILD, SIBLING, COLUMN_WIDTH = 0, 1, 2, 3, 4
# a row of the table of fronts; BEGIN : its first column in the table of columns, MAP : its border in that of places
OWN, HEIGHT, FIRST, BEGIN, MAP, FRONT_WIDTH = 0, 1, 2, 3, 4, 5


@ti.kernel
def assemble(
    serial: ti.template(),
    begin: ti.i32,
    end: ti.i32,
    tables: ti.types.ndarray(dtype=ti.i32, ndim=1),
    reals: ti.types.ndarray(dtype=ti.f64, ndim=1),
):
    """Columns begin ... end-1 of the table of columns. The values of the original entries come first in `reals`."""
    if ti.static(serial):
        ti.loop_config(serialize=True)
    for item in range(begin, end):
        at = tables[COLUMNS] + item * COLUMN_WIDTH
        front = tables[FRONTS] + tables[at + FRONT] * FRONT_WIDTH
        target, column = tables[at + ADDRESS], item - tables[front + BEGIN]
        for place in range(target + column, target + tables[front + HEIGHT]):
            reals[place] = 0.0
        if column < tables[front + OWN]:
            entry = tables[ENTRY_START] + tables[front + FIRST] + column
            for e in range(tables[entry], tables[entry + 1]):
                reals[target + tables[tables[ENTRY_PLACE] + e]] = reals[e]
        child_item = tables[at + CHILD]
        while child_item >= 0:
            child_at = tables[COLUMNS] + child_item * COLUMN_WIDTH
            child, source = tables[FRONTS] + tables[child_at + FRONT] * FRONT_WIDTH, tables[child_at + ADDRESS]
            places = tables[PLACES] + tables[child + MAP] - tables[child + OWN]
            for row in range(child_item - tables[child + BEGIN], tables[child + HEIGHT]):
                place = target + tables[places + row]
                reals[place] = reals[place] + reals[source + row]
            child_item = tables[child_at + SIBLING]
