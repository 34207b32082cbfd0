"""The elimination tree of a Cholesky factor: the parent of each column, its length, and which columns make up a
part.
"""

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.memory import INTEGERS


@ti.kernel
def grow(starts: INTEGERS, rows: INTEGERS, parent: INTEGERS, count: INTEGERS, mark: INTEGERS):
    """Find the elimination tree (Liu, SIMAX 1990): row k of the factor has entries in the columns on the paths up the
    tree from the columns in which row k of the matrix has entries.

    starts, rows : the symmetric pattern, compressed.
    parent : (n,) result: the first row below the diagonal of each column, -1 for none.
    count : (n,) result: numbers in each column, from the diagonal down.
    mark : (n,) scratch.
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
    """Return operations that a part costs: arithmetic, and what numerics/cholesky/tuning.py adds for part, columns and
    update.

    own, border : columns and later rows of the part. part, column, update : a `Price`.
    """
    m, b = ti.cast(own, ti.f64), ti.cast(border, ti.f64)
    return m * (b * (b + m) + m * m / 3.0) + part + column * m * (m + b) + update * b * b / 2.0


@ti.kernel
def join(
    part: ti.f64, column: ti.f64, update: ti.f64, parent: INTEGERS, count: INTEGERS,
    home: INTEGERS, own: INTEGERS, child: INTEGERS, sibling: INTEGERS,
):  # fmt: skip
    """Join columns with parts below them in the tree where that lowers the price.

    part, column, update : a `Price`. parent, count : see :func:`grow`.
    home : (n,) result: the last column of the part that each column is in.
    own, child, sibling : (n,) results, for last columns: columns in the part, the last column of its first child, and
        that of the next child of its parent; -1 for none.
    """
    ti.loop_config(serialize=True)
    for back in range(parent.shape[0]):
        k = parent.shape[0] - 1 - back
        home[k], own[k], child[k], sibling[k] = k, 1, -1, -1
        if parent[k] >= 0:
            sibling[k], child[parent[k]] = child[parent[k]], k
    # from the leaves up: a column takes in one part below it after the other, if both together cost less than apart
    ti.loop_config(serialize=True)
    for k in range(parent.shape[0]):
        alone, below, before = price(1, count[k] - 1, part, column, update), child[k], -1
        while below >= 0:
            after, together = sibling[below], price(own[k] + own[below], count[k] - 1, part, column, update)
            if together < alone + price(own[below], count[below] - 1, part, column, update):
                own[k], alone, home[below] = own[k] + own[below], together, k
                if child[below] >= 0:  # what is below takes its place
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
    ti.loop_config(serialize=True)
    for back in range(parent.shape[0]):
        home[parent.shape[0] - 1 - back] = home[home[parent.shape[0] - 1 - back]]
