"""How kernels reach the numbers of a site: row by row in one array, blocks of neighbouring sites at a time.

Sweeps, splitting and Cundall-Strack steps work with vectors: they `load` a block, apply a law to it, and `store` the
result. On a GPU a block is one site, and a vector its number. (Taichi's vectors have no unary minus, and no abs.)

The laws of Newton steps are functions of one site; :func:`fill` walks them over a block. The results go to local
vectors, which are written as a whole: the compiler cannot tell a loop that writes to memory from one that changes its
own input, or even the address of the array, so it would not turn it into SIMD instructions (docs/decisions.md, 2).
"""

from taichi_bearings.compiler import ti

VALUES = ti.types.ndarray(ndim=1)
INTEGERS = ti.types.ndarray(dtype=ti.i32, ndim=1)
BLOCKS = ti.types.ndarray(dtype=ti.types.vector())  # on a CPU (blocks, sites of a block); on a GPU as VALUES
OPEN_RING = 2**30  # length that stands for an axis that does not close to a ring
INDEX_MASK = 2**30 - 1  # all indices are below 2^30


@ti.func
def in_range(index):
    """Return the index unchanged, in a form that lets the compiler rule out overflow of index + offset.

    Only then does it merge the loads of neighbouring sites into SIMD ones.
    """
    return index & INDEX_MASK


@ti.func
def places(rows: ti.template(), length, site):
    """Return where the numbers of a site stand, one in each of the rows; those of the site m further on stand m
    further on.
    """
    # as `in_range`, without a call for each row: those would take a sixth of the time to read a pass of a Newton step
    return [(row * length + site) & INDEX_MASK for row in ti.static(rows)]


@ti.func
def load(values: ti.template(), place, block: ti.template()):
    """Return the numbers of a block of neighbouring sites from any place on: a vector, or one number if a block is one
    site.

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
    """Write `new`, the numbers of a whole block of sites, from `place` on."""
    if ti.static(block == 1):
        values[place] = new
    else:
        blocks[place // block] = new


@ti.func
def load_each(values: ti.template(), at: ti.template(), block: ti.template()):
    """Return the numbers of a block of sites from each of the places `at` on."""
    return [load(values, place, block) for place in ti.static(at)]


@ti.func
def store_each(
    values: ti.template(), blocks: ti.template(), to: ti.template(), block: ti.template(), new: ti.template()
):
    """Write new[k] from the place to[k] on."""
    for k in ti.static(range(len(to))):
        store(values, blocks, to[k], block, new[k])


@ti.func
def with_rings(strides: ti.template(), site, ring, periodic: ti.template()):
    """Return the strides along the three axes; with periodic axes followed by the length of the ring along each axis,
    and by where in its ring a site is.

    :func:`load_neighbours` takes every third of these numbers for an axis. ring : sites of a replica, which are those
    of a ring along x.
    """
    if ti.static(len(periodic) == 0):
        return strides
    sites = [ring, strides[0], OPEN_RING]
    rings = [sites[axis] if ti.static(axis in periodic) else OPEN_RING for axis in ti.static(range(3))]
    places = [site % sites[axis] if ti.static(axis in periodic) else strides[axis] for axis in ti.static(range(3))]
    return strides + rings + places


@ti.func
def load_neighbours(
    values: ti.template(), rows: ti.template(), row, first, side: ti.template(), way: ti.template(),
    block: ti.template(),
):  # fmt: skip
    """Return the numbers of the neighbours of a block of sites along an axis: the upper ones (way 1) or the lower ones
    (-1).

    side : stride of the axis; on lattices with periodic axes also the sites of a ring, and where in its ring `first`
        is.
    """
    if ti.static(len(side) == 1):
        return load_each(values, places(rows, row, first + way * side[0]), block)
    return [load_around(values, place, way * side[0], side[1], side[2], block) for place in places(rows, row, first)]


@ti.func
def load_neighbour(values: ti.template(), place, side: ti.template(), way: ti.template(), block: ti.template()):
    """Return the number of one neighbour of each site of a block, of one row.

    place : where that of the block itself is.

    side, way : see :func:`load_neighbours`.
    """
    if ti.static(len(side) == 1):
        return load(values, in_range(place + way * side[0]), block)
    return load_around(values, place, way * side[0], side[1], side[2], block)


@ti.func
def load_around(values: ti.template(), place, step, ring, position, block: ti.template()):
    """Return the numbers `step` further on around rings of length `ring`, for the block of sites from `place` on.

    position : where in its ring the block begins.
    """
    if ti.static(block == 1):
        return values[place + (position + step) % ring - position]
    result = load(values, in_range(place + step), block)
    if ti.min(position, position + step) < 0 or ti.max(position, position + step) + block > ring:
        at, end = position, values.shape[0] - 1  # a block may go on behind the last site
        for m in range(block):
            around = ti.select(at + step < 0, ring, 0) - ti.select(at + step >= ring, ring, 0)
            result[m] = values[ti.min(place + m + step + around, end)]
            at = ti.select(at + 1 == ring, 0, at + 1)
    return result


@ti.func
def minus(upper: ti.template(), lower: ti.template()):
    """Return the differences upper - lower of two lists of vectors."""
    return [upper[k] - lower[k] for k in ti.static(range(len(upper)))]


@ti.func
def zero(block: ti.template()):
    """Return 0 for each site of a block."""
    if ti.static(block == 1):
        return 0.0
    return ti.Vector.zero(float, block)


@ti.func
def pushed(vector, first, block: ti.template()):
    """Return `first`, and then the numbers of a block without the last: those of the sites below, along the height."""
    if ti.static(block == 1):
        return first
    return ti.Vector([first] + [vector[m] for m in ti.static(range(block - 1))])


@ti.func
def last(vector, block: ti.template()):
    """Return the number of the last site of a block."""
    if ti.static(block == 1):
        return vector
    return vector[block - 1]


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
    for m in range(block):
        new = law(values, at, numbers, m)
        for k in ti.static(range(len(rows))):
            rows[k][m] = new[k]
