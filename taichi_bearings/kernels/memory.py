"""How kernels reach the numbers of a site: row by row in one array, blocks of neighbouring sites at a time.

Cundall-Strack steps reckon with vectors: `load` a block, apply a law to it, `store` what it says.

The laws of sweeps and splitting are functions of one site; :func:`each_site` walks them over a block. On a CPU the
results go to local vectors, which are written as a whole: a loop that writes to memory cannot be told from one that
changes its own input, or even the address of the array, so it would not be turned into SIMD instructions
(docs/decisions/0002).
"""

from taichi_bearings.compiler import ti

VALUES = ti.types.ndarray(ndim=1)
BLOCKS = ti.types.ndarray(dtype=ti.types.vector())  # on a CPU (blocks, sites of a block); on a GPU as VALUES


@ti.func
def in_range(index):
    """The same index (they are all below 2^30), in a form that lets the compiler rule out overflow of index + offset:
    only then does it merge the loads of neighbouring sites into SIMD ones."""
    return index & 0x3FFFFFFF


@ti.func
def places(rows: ti.template(), length, site):
    """Where the numbers of a site stand, one a row of `length`; those of the site m further on stand m further on."""
    return [in_range(row * length + site) for row in ti.static(rows)]


@ti.func
def load(values: ti.template(), place, block: ti.template()):
    """The numbers of as many neighbouring sites as a block has, from any place on: a vector, or of one site its number.

    LLVM knows the loop for a copy, and loads the vector with few instructions.
    """
    if ti.static(block == 1):
        return values[place]
    result = ti.Vector.zero(float, block)
    for m in range(block):
        result[m] = values[place + m]
    return result


@ti.func
def store(values: ti.template(), blocks: ti.template(), place, block: ti.template(), new):
    """Write the numbers of a whole block of sites."""
    if ti.static(block == 1):
        values[place] = new
    else:
        blocks[place // block] = new


@ti.func
def read(values: ti.template(), at: ti.template(), m):
    """The numbers of the m-th site of a block."""
    return [values[place + m] for place in ti.static(at)]


@ti.func
def difference(values: ti.template(), lower: ti.template(), upper: ti.template(), m):
    """The numbers that begin at `upper` minus those that begin at `lower`, of the m-th site of a block."""
    return [values[upper[k] + m] - values[lower[k] + m] for k in ti.static(range(len(lower)))]


@ti.func
def new_rows(count: ti.template(), block: ti.template()):
    """Room for `count` numbers of every site of a block."""
    return [ti.Vector.zero(float, block) for _ in ti.static(range(count))]


@ti.func
def fill(
    rows: ti.template(),
    values: ti.template(),
    block: ti.template(),
    law: ti.template(),
    at: ti.template(),
    numbers: ti.template(),
):
    """Set rows[k][m] to the k-th number that ``law(values, at, numbers, m)`` says of the m-th site of a block.

    law : a function of one site that returns a list of numbers. at, numbers : what it reads, and constants.
    """
    if ti.static(block == 1):
        new = law(values, at, numbers, 0)
        for k in ti.static(range(len(rows))):
            rows[k][0] = new[k]
    else:
        for m in range(block):
            new = law(values, at, numbers, m)
            for k in ti.static(range(len(rows))):
                rows[k][m] = new[k]


@ti.func
def each_site(
    values: ti.template(),
    blocks: ti.template(),
    block: ti.template(),
    to: ti.template(),
    law: ti.template(),
    at: ti.template(),
    numbers: ti.template(),
):
    """Write what a law says of the sites of a block, as in :func:`fill`, to the places `to`."""
    rows = new_rows(ti.static(len(to)), block)
    fill(rows, values, block, law, at, numbers)
    for k in ti.static(range(len(to))):
        if ti.static(block == 1):
            values[to[k]] = rows[k][0]
        else:
            blocks[to[k] // block] = rows[k]
