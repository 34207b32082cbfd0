"""How kernels reach the numbers of a site: row by row in one array, blocks of neighbouring sites at a time.

A block is computed into local vectors, which are written as a whole, by SIMD instructions. Both matter on a CPU: a loop
that writes to memory cannot be told from one that changes its own input, or even the address of the array, so it would
not be turned into SIMD; and each write by itself would look up that address again (docs/decisions/0003).
"""

import taichi as ti

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
def read(values: ti.template(), at: ti.template(), m):
    """The numbers of the m-th site of a block."""
    return [values[place + m] for place in ti.static(at)]


@ti.func
def difference(values: ti.template(), lower: ti.template(), upper: ti.template(), m):
    """The numbers that begin at `upper` minus those that begin at `lower`, of the m-th site of a block."""
    return [values[upper[k] + m] - values[lower[k] + m] for k in ti.static(range(len(lower)))]


@ti.func
def new_block(count: ti.template(), block: ti.template()):
    """Room for `count` numbers of every site of a block."""
    return [ti.Vector.zero(float, block) for _ in ti.static(range(count))]


@ti.func
def write(blocks: ti.template(), block: ti.template(), at: ti.template(), new: ti.template()):
    """Write a block: new[k] holds the numbers of its sites that begin at at[k]."""
    for k in ti.static(range(len(at))):
        if ti.static(block == 1):
            blocks[at[k]] = new[k][0]
        else:
            blocks[at[k] // block] = new[k]
