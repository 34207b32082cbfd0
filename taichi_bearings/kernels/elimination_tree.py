"""The elimination tree of a Cholesky factor: the parent of each column, its length, and which columns are joined into a
front, a group of columns that is eliminated as a dense matrix.
"""

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.memory import INTEGERS


@ti.func
def grow(
    starts: ti.template(), rows: ti.template(), parent: ti.template(), count: ti.template(), mark: ti.template()
):  # fmt: skip
    """Find the elimination tree of a symmetric matrix and the length of each column of its factor (Liu, SIMAX 1990).

    Row k of the factor has entries in the columns on the paths up the tree, from the columns in which row k of the
    matrix has entries.

    starts : (n + 1,), where the entries of each of the n columns of the matrix begin in `rows`.
    rows : (entries,), row of each entry of the matrix, column by column.
    parent : (n,) result: the first row below the diagonal in which each column of the factor has an entry; -1 for none.
    count : (n,) result: number of entries of each column of the factor, the diagonal included.
    mark : (n,) scratch, which need not be set.
    """
    ti.loop_config(serialize=True)
    for k in range(parent.shape[0]):
        parent[k], count[k], mark[k] = -1, 1, k
        for entry in range(starts[k], starts[k + 1]):
            column = rows[entry]
            while column < k and mark[column] != k:
                if parent[column] < 0:
                    parent[column] = k
                count[column] += 1
                mark[column] = k
                column = parent[column]


@ti.func
def price(own, border, part, column, update):
    """Return the cost of eliminating a front, a group of columns that are eliminated together: the number of arithmetic
    operations, and measured costs of handling (numerics/cholesky/tuning.py) in the same unit.

    own : number of columns of the front.
    border : number of rows below its diagonal block.
    part : cost of handling a front, in operations.
    column : cost of handling each entry of its own columns, in operations.
    update : cost of handling each entry of its update, the matrix that it leaves for later columns, in operations."""
    m, b = ti.cast(own, ti.f64), ti.cast(border, ti.f64)
    return m * (b * (b + m) + m * m / 3.0) + part + column * m * (m + b) + update * b * b / 2.0


@ti.func
def join(
    part, column, update, parent: ti.template(), count: ti.template(),
    home: ti.template(), own: ti.template(), child: ti.template(), sibling: ti.template(),
):  # fmt: skip
    """Join each column with fronts below it in the elimination tree, one by one, where that makes the elimination
    cheaper.

    A front is a group of columns that are eliminated together, as one dense matrix.

    part : cost of handling a front, in operations.
    column : cost of handling an entry of a front's own columns, in operations.
    update : cost of handling an entry that a front leaves for later columns, in operations.
    parent : (n,), the parent in the tree of each of n columns of the factor, -1 for none; from :func:`grow`.
    count : (n,), number of entries of each column of the factor, from :func:`grow`.
    home : (n,) result: the last column of the front that each column is in.
    own : (n,) result: for the last column of a front, the number of columns in the front.
    child : (n,) result: for the last column of a front, the last column of its first child in the tree; -1 for none.
    sibling : (n,) result: for the last column of a front, the last column of the next child of its parent; -1 for none.
    """
    # at first each column is a front of its own; children are listed by their links, the smallest first
    ti.loop_config(serialize=True)
    for back in range(parent.shape[0]):
        k = parent.shape[0] - 1 - back
        home[k], own[k], child[k], sibling[k] = k, 1, -1, -1
        if parent[k] >= 0:
            sibling[k], child[parent[k]] = child[parent[k]], k
    # from the leaves up: a column takes in one front below it after the other, if both together cost less than apart
    ti.loop_config(serialize=True)
    for k in range(parent.shape[0]):
        alone, below, before = price(1, count[k] - 1, part, column, update), child[k], -1
        while below >= 0:
            after, together = sibling[below], price(own[k] + own[below], count[k] - 1, part, column, update)
            if together < alone + price(own[below], count[below] - 1, part, column, update):
                own[k], alone, home[below] = own[k] + own[below], together, k
                if child[below] >= 0:  # the children of the front that was taken in follow in its place
                    last = child[below]
                    while sibling[last] >= 0:
                        last = sibling[last]
                    sibling[last], after = after, child[below]
                if before < 0:
                    child[k] = after
                else:
                    sibling[before] = after
            else:
                before = below
            below = after
    # a front that was taken in may have been taken on: from the last column down, each finds the last home
    ti.loop_config(serialize=True)
    for back in range(parent.shape[0]):
        home[parent.shape[0] - 1 - back] = home[home[parent.shape[0] - 1 - back]]


@ti.kernel
def divide(
    part: ti.f64, column: ti.f64, update: ti.f64, starts: INTEGERS, rows: INTEGERS, parent: INTEGERS, count: INTEGERS,
    home: INTEGERS, own: INTEGERS, child: INTEGERS, sibling: INTEGERS,
):  # fmt: skip
    """Find the elimination tree of a symmetric matrix, and divide the columns of its factor into fronts: groups that
    are eliminated together. All is one kernel, since a process takes 15 ms to load another, however short it is.

    The arguments are those of :func:`grow` and :func:`join`; `home` is the scratch of the former.
    """
    grow(starts, rows, parent, count, home)
    join(part, column, update, parent, count, home, own, child, sibling)
