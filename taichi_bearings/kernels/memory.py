"""Reads and writes the numbers of sites, which stand row by row in one array, a block of neighbouring sites at a time.

Sweeps, splitting and Cundall-Strack steps work with vectors: they `load` a block, apply a law to it, and `store` the
result. On a GPU a block is one site, and a vector its number. (Taichi's vectors have no unary minus, and no abs.)

The laws of Newton steps are functions of one site; :func:`fill` applies them to each site of a block. Their results go
to local vectors, which are then written as a whole. The compiler would not turn a loop that writes to memory into SIMD
instructions, as such a loop might change its own input (docs/decisions.md, 2).
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

    index : from 0 to 2^30 - 1.
    """
    return index & INDEX_MASK


@ti.func
def places(rows: ti.template(), length, site):
    """Return a list: for each of some rows the index, in the flat array of all rows, of the number that a site has
    there.

    rows : numbers of the rows (a row has one number of every site), known when the kernel is compiled.
    length : length of a row.
    site : index of the site within a row. The numbers of the site m further on stand m further on."""
    # as `in_range`, without a call for each row: those would take a sixth of the time to read a pass of a Newton step
    return [(row * length + site) & INDEX_MASK for row in ti.static(rows)]


@ti.func
def load(values: ti.template(), place, block: ti.template()):
    """Return `block` neighbouring numbers of `values` as a vector; one number if `block` is 1.

    values : flat array.
    place : index of the first of them. It need not be a multiple of the block.
    block : how many numbers, known when the kernel is compiled.

    LLVM takes the loop for a copy, and loads the vector with few instructions.
    """
    if ti.static(block == 1):
        return values[place]
    result = ti.Vector.zero(float, block)
    for m in range(block):
        result[m] = values[place + m]
    return result


@ti.func
def store(values: ti.template(), blocks: ti.template(), place, block: ti.template(), new):
    """Write the numbers of a whole block of sites (a group of neighbours in memory).

    values, blocks : the flat array, and the same memory as vectors of `block` numbers, which is written to unless
        `block` is 1.
    place : index of the first number in the flat array, a multiple of the block.
    block : number of sites of a block.
    new : a vector, or one number if block is 1."""
    if ti.static(block == 1):
        values[place] = new
    else:
        blocks[place // block] = new


@ti.func
def load_each(values: ti.template(), at: ti.template(), block: ti.template()):
    """Return a list with an entry for each place: the `block` numbers from there on as a vector, one number if block is
    1.

    values : the flat array.
    at : list of places, which are indices in it; for instance of the first site of a block in several rows.
    block : number of sites of a block, known when the kernel is compiled.
    """
    return [load(values, place, block) for place in ti.static(at)]


@ti.func
def store_each(
    values: ti.template(), blocks: ti.template(), to: ti.template(), block: ti.template(), new: ti.template()
):
    """Write a list of blocks of numbers: new[k] from the index to[k] on.

    values, blocks : the flat array, and the same memory as vectors of `block` numbers.
    to : list of indices in the flat array, each a multiple of `block`.
    block : number of sites of a block.
    new : list of vectors, of numbers if block is 1.
    """
    for k in ti.static(range(len(to))):
        store(values, blocks, to[k], block, new[k])


@ti.func
def with_rings(strides: ti.template(), site, ring, periodic: ti.template()):
    """Return where the neighbours of a site are, as a list: the strides along three axes and, on lattices with periodic
    axes, two more triples: for each axis the length in memory of a ring along it, and the position of the site in its
    ring. So the list has 3 or 9 entries; list[axis::3] is what :func:`load_neighbours` takes as `side`.

    The length of a ring in memory is its number of spheres times the stride of the axis. An axis that is not periodic
    has a ring so long that it never closes.

    strides : list of three: distance in memory to the upper neighbour along each axis.
    site : number of the site among all.
    ring : number of sites of a replica (one of the samples solved together), which is the length of a ring along x.
    periodic : numbers of the axes that close on themselves.
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
    """Return the numbers of the neighbours of a block of sites along an axis: a list of vectors, one for each row.

    values : the flat array.
    rows : numbers of the rows that are read.
    row : length of a row, which has one number of every site.
    first : index of the first site of the block within a row.
    side : list with the stride of the axis, the distance in memory to the upper neighbour. On lattices with periodic
        axes two entries follow: the length in memory of a ring along the axis, and the position of `first` in its ring.
    way : 1 for upper neighbours, -1 for lower ones.
    block : number of sites of a block.
    """
    if ti.static(len(side) == 1):
        return load_each(values, places(rows, row, first + way * side[0]), block)
    return [load_around(values, place, way * side[0], side[1], side[2], block) for place in places(rows, row, first)]


@ti.func
def load_differences(
    values: ti.template(), rows: ti.template(), row, first, side: ti.template(), block: ti.template()
):  # fmt: skip
    """Return the numbers of the upper neighbours of a block of sites along an axis, less those of the sites themselves:
    a list of vectors, one for each row.

    values : the flat array.
    rows : numbers of the rows that are read.
    row : length of a row, which has one number of every site.
    first : index of the first site of the block within a row.
    side : list with the distance in memory to the upper neighbour. On lattices with periodic axes two entries follow:
        the length in memory of a ring along the axis, and the position of `first` in its ring.
    block : number of sites of a block.
    """
    up = load_neighbours(values, rows, row, first, side, 1, block)
    return minus(up, load_each(values, places(rows, row, first), block))


@ti.func
def load_neighbour(values: ti.template(), place, side: ti.template(), way: ti.template(), block: ti.template()):
    """Return one number of the neighbour along an axis of each site of a block: a vector, one number if block is 1.

    values : the flat array.
    place : index in it of the same number of the block's first site itself.
    side : list with the stride of the axis, the distance in memory to the upper neighbour. On lattices with periodic
        axes two entries follow: the length in memory of a ring along the axis, and the position of the block's first
        site in its ring.
    way : 1 for upper neighbours, -1 for lower ones.
    block : number of sites of a block.
    """
    if ti.static(len(side) == 1):
        return load(values, in_range(place + way * side[0]), block)
    return load_around(values, place, way * side[0], side[1], side[2], block)


@ti.func
def load_around(values: ti.template(), place, step, ring, position, block: ti.template()):
    """Return, for each site of a block, the number of the site that is `step` further on in the same ring along a
    periodic axis: a vector, one number if block is 1.

    values : the flat array.
    place : index in it of the number of the block's first site itself.
    step : distance in memory, negative for lower neighbours.
    ring : length of a ring in memory; behind its end it goes on at its begin.
    position : place of the block's first site in its ring, 0 to ring - 1.
    block : number of sites of a block.
    """
    if ti.static(block == 1):
        return values[place + (position + step) % ring - position]
    result = load(values, in_range(place + step), block)
    # where the ring closes within the block or its neighbours, site by site
    if ti.min(position, position + step) < 0 or ti.max(position, position + step) + block > ring:
        at, end = position, values.shape[0] - 1  # a block may go on behind the last site
        for m in range(block):
            around = ti.select(at + step < 0, ring, 0) - ti.select(at + step >= ring, ring, 0)
            result[m] = values[ti.min(place + m + step + around, end)]
            at = ti.select(at + 1 == ring, 0, at + 1)
    return result


@ti.func
def minus(upper: ti.template(), lower: ti.template()):
    """Return the list of the differences upper[k] - lower[k].

    upper, lower : lists of the same length, of numbers or of vectors over the sites of a block."""
    return [upper[k] - lower[k] for k in ti.static(range(len(upper)))]


@ti.func
def zero(block: ti.template()):
    """Return zeros for a block of sites: a vector of `block` numbers, or 0.0 if block is 1."""
    if ti.static(block == 1):
        return 0.0
    return ti.Vector.zero(float, block)


@ti.func
def reversed_block(vector, block: ti.template()):
    """Return the numbers of a block of sites in the opposite order.

    vector : the numbers of the block; one number if block is 1.
    block : number of sites of a block."""
    if ti.static(block == 1):
        return vector
    return ti.Vector([vector[block - 1 - m] for m in ti.static(range(block))])


@ti.func
def pushed(vector, first, block: ti.template()):
    """Return a block of numbers moved up by one site: `first`, then all numbers of `vector` but the last. As the height
    runs along memory, each site then has the number of the site below it; `first` is that of the site below the block.

    vector : the numbers of the block; one number if block is 1, and the result is `first` alone.
    first : number of the site below the block.
    block : number of sites of a block."""
    if ti.static(block == 1):
        return first
    return ti.Vector([first] + [vector[m] for m in ti.static(range(block - 1))])


@ti.func
def last(vector, block: ti.template()):
    """Return the last number of a block of sites.

    vector : the numbers of the block; one number if block is 1.
    block : number of sites of a block."""
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
    """Set rows[k][m] to the k-th number that a law returns for the m-th site of a block (a group of neighbours in
    memory).

    rows : list of vectors of the length of a block, which are overwritten.
    values : flat array of all numbers, which the law reads.
    block : number of sites of a block.
    law : function ``law(values, at, numbers, m)`` of one site that returns a list as long as `rows`.
    at : lists of indices in `values`, by which the law finds the numbers of the block's first site.
    numbers : array of constants that the law takes."""
    for m in range(block):
        new = law(values, at, numbers, m)
        for k in ti.static(range(len(rows))):
            rows[k][m] = new[k]
