"""The elimination tree of a Cholesky factor: the parent of each column, its length, and which columns are joined into a
front, a group of columns that is eliminated as a dense matrix.
"""

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.memory import INTEGERS


@ti.func
def add_up_the_tree(parent: ti.template(), values: ti.template(), step):
    """Add to the value of each column those of all columns below it in the elimination tree, in place.

    parent : (n,), the parent of each of n columns, a later one; -1 for none.
    values : (n,), the values.
    step : 1, as in :func:`grow`.
    """
    k = 0
    while k < parent.shape[0]:
        if parent[k] >= 0:
            values[parent[k]] += values[k]
        k += step


@ti.func
def order_visits(
    parent: ti.template(), taken: ti.template(), size: ti.template(), first: ti.template(), visit: ti.template(), step
):
    """Find an order of visits to the columns of a factor in which the columns below each one in the elimination tree
    come directly before it (a postorder).

    parent : (n,), the parent of each of n columns, a later one; -1 for none.
    taken : (n,) scratch.
    size : (n,), 1 for each column; replaced by the number of columns at or below it.
    first : (n,) result: the number of columns that are visited before those at or below each column.
    visit : (n,) result: the columns in the order of the visits.
    step : 1, as in :func:`grow`.
    """
    add_up_the_tree(parent, size, step)
    # from the last column down, each takes the next visits of its parent; `taken` is the first one that is free there
    k, free = parent.shape[0], 0
    while k > 0:
        k -= step
        if parent[k] >= 0:
            first[k] = taken[parent[k]]
            taken[parent[k]] += size[k]
        else:
            first[k] = free
            free += size[k]
        taken[k], visit[first[k] + size[k] - 1] = first[k], k


@ti.func
def count_leaf(
    row, column, first: ti.template(), count: ti.template(), above: ti.template(), most: ti.template(),
    leaf: ti.template(),
):  # fmt: skip
    """Add 1 to the count of a column that is a leaf of a row. If the row has an earlier leaf, subtract 1 from the count
    of the *joint*, the column where the paths up the tree from both leaves meet.

    row : number of the row.
    column : number of the column that is the leaf.
    first, count, above, most, leaf : arrays of :func:`grow`, which describes them.
    """
    before, joint = leaf[row], leaf[row]
    most[row], leaf[row] = first[column], column
    count[column] += 1
    if before >= 0:
        while joint != above[joint]:
            joint = above[joint]
        while before != joint:  # paths from here on lead to the joint at once
            further = above[before]
            above[before] = joint
            before = further
        count[joint] -= 1


@ti.func
def grow(
    starts: ti.template(), rows: ti.template(), begins: ti.template(), later: ti.template(), parent: ti.template(),
    count: ti.template(), above: ti.template(), size: ti.template(), first: ti.template(), visit: ti.template(),
    most: ti.template(), leaf: ti.template(), step,
):  # fmt: skip
    """Find the elimination tree of a symmetric matrix (Liu, SIMAX 1990) and the number of entries of each column of its
    factor, in a time that grows with the number of entries of the matrix (Gilbert, Ng, Peyton, SIMAX 1994).

    Row i of the factor has entries in the columns of a subtree of the elimination tree. Its leaves are columns in which
    the matrix has an entry in row i; the paths up from two successive leaves meet in a *joint*. The number of entries
    of a column is a sum over the columns at or below it: each contributes 1 for itself if nothing is below it, 1 for
    each row of which it is a leaf, -1 for each row of which it is a joint, and -1 for its parent if it has one.

    starts, rows : (n + 1,), (entries,), where the entries of each of the n columns of the matrix begin, and their rows.
    begins, later : (n + 1,), (entries,), the same entries row by row: where each row begins, and their columns.
    parent : (n,) result: the first row below the diagonal in which each column of the factor has an entry; -1 for none.
    count : (n,) result: number of entries of each column of the factor, the diagonal included.
    above : (n,) scratch: a column further up the tree, by which paths up are shortened.
    size : (n,) scratch: the number of columns at or below each column.
    first : (n,) scratch: the number of columns that are visited before those at or below each column.
    visit : (n,) scratch: the columns in the order of the visits, each after all those below it.
    most : (n,) scratch: for each row the largest value of `first` among its leaves so far.
    leaf : (n,) scratch: for each row its last leaf so far, -1 for none.
    step : 1; if the compiler knew it, it would unroll the loops, and the kernel would take 55 ms more to load.
    """
    # the tree: from each entry in row k of the matrix the path up to row k
    k, end = 0, parent.shape[0]
    while k < end:
        parent[k], above[k], size[k], most[k], leaf[k] = -1, -1, 1, -1, -1
        entry = starts[k]
        while entry < starts[k + 1]:
            column = rows[entry]
            while column >= 0 and column < k:
                further = above[column]
                above[column] = k
                if further < 0:
                    parent[column] = k
                column = further
            entry += step
        k += step
    order_visits(parent, above, size, first, visit, step)
    while k > 0:
        k -= step
        above[k], count[k] = k, ti.select(size[k] == 1, 1, 0)
    while k < end:
        column = visit[k]
        entry = begins[column]
        while entry < begins[column + 1]:
            row = later[entry]
            if row > column and first[column] > most[row]:
                count_leaf(row, column, first, count, above, most, leaf)
            entry += step
        if parent[column] >= 0:
            count[parent[column]] -= 1
            above[column] = parent[column]
        k += step
    add_up_the_tree(parent, count, step)


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
    home: ti.template(), own: ti.template(), child: ti.template(), sibling: ti.template(), step,
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
    step : 1, as in :func:`grow`.
    """
    # at first each column is a front of its own; children are listed by their links, the smallest first
    k, end = parent.shape[0], parent.shape[0]
    while k > 0:
        k -= step
        home[k], own[k], child[k], sibling[k] = k, 1, -1, -1
        if parent[k] >= 0:
            sibling[k], child[parent[k]] = child[parent[k]], k
    # from the leaves up: a column takes in fronts below it one by one, if both cost less together than apart
    while k < end:
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
        k += step
    # a front that was taken in may have been taken on: from the last column down, each finds the last home
    while k > 0:
        k -= step
        home[k] = home[home[k]]


@ti.kernel
def divide(
    part: ti.f64, column: ti.f64, update: ti.f64, starts: INTEGERS, rows: INTEGERS, begins: INTEGERS, later: INTEGERS,
    parent: INTEGERS, count: INTEGERS, home: INTEGERS, own: INTEGERS, child: INTEGERS, sibling: INTEGERS,
    most: INTEGERS, leaf: INTEGERS, step: int,
):  # fmt: skip
    """Find the elimination tree of a symmetric matrix, and divide the columns of its factor into fronts: groups that
    are eliminated together. All is one task of one kernel, since a process takes 15 ms to load another kernel, however
    short it is.

    The arguments are those of :func:`grow` and :func:`join`; the results of the latter are scratch of the former.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        grow(starts, rows, begins, later, parent, count, home, own, child, sibling, most, leaf, step)
        join(part, column, update, parent, count, home, own, child, sibling, step)
