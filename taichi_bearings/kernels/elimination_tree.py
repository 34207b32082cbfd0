"""The tree of a Cholesky factor: which column each one leads to, how many numbers it has, and what goes together."""

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.memory import INTEGERS


@ti.kernel
def grow(starts: INTEGERS, rows: INTEGERS, parent: INTEGERS, count: INTEGERS, mark: INTEGERS):
    """parent : (n,), of every column the first row below its diagonal, -1 of none. count : (n,), numbers of a column,
    from the diagonal down. starts, rows : of the symmetric pattern, compressed. mark : (n,), to work with.

    Row k of the factor has the columns on the ways up the tree from those where row k of the matrix has entries (Liu,
    SIMAX 1990).
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
    """See numerics/cholesky/fronts.py."""
    m, b = ti.cast(own, ti.f64), ti.cast(border, ti.f64)
    return m * (b * (b + m) + m * m / 3.0) + part + column * m * (m + b) + update * b * b / 2.0


@ti.kernel
def join(
    part: ti.f64, column: ti.f64, update: ti.f64, parent: INTEGERS, count: INTEGERS,
    home: INTEGERS, own: INTEGERS, child: INTEGERS, sibling: INTEGERS,
):  # fmt: skip
    """Join columns with those below that they lead to, where that lowers the price.

    home : (n,), of every column the last one of its part. own, child, sibling : (n,), of this one how many columns
    there are, the last column of the first part below, and that of the next part with the same one above; -1 of none.
    """
    ti.loop_config(serialize=True)
    for back in range(parent.shape[0]):
        k = parent.shape[0] - 1 - back
        home[k], own[k], child[k], sibling[k] = k, 1, -1, -1
        if parent[k] >= 0:
            sibling[k], child[parent[k]] = child[parent[k]], k
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
