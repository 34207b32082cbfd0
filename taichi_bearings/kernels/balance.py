"""Torque balance of equal springs: sines along the height, and for each of them a chain of spheres along one side.

A spin component is coupled only across the height and one other axis. The sines of a chain with held ends separate the
height. What is left is, for each sine, a chain along the other axis, whose equations are solved from end to end and
back. A ring is a chain with one more spring, which takes one more sum (docs/decisions.md, 10 counts the operations).
Every sum runs in one order, whatever the number of workers or replicas.

Letters: C spin components, R replicas (samples solved side by side), N the shape of the lattice, m free spheres along
the height (all but the driven bottom and top). A *mode* is the amplitude of one sine along the height.
"""

from taichi_bearings.compiler import ti
from taichi_bearings.fields import FieldSpec, first_slots
from taichi_bearings.kernels.memory import VALUES, in_range, load, load_each, zero
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import LEAST_CHUNK
from taichi_bearings.lattice.layout import Layout

TILE = 4  # a thread of a GPU sums so many rows and columns of a matrix product: 8 numbers read for 16 products
AHEAD = 4  # a thread of a GPU reads so many spheres of a chain before it writes the first of them; on a CPU 1


@ti.data_oriented
class BalanceKernels:
    """Kernels that solve a Poisson problem: which change of the spins cancels given torques on the spheres of a
    lattice, if all contacts are springs of the same stiffness.

    A solve has three steps: transform the torques, field `pull`, by sines along the height into `modes`, the amplitude
    of each sine; solve in each mode a chain of spheres along one side; transform back and add the result to the field
    `potential`. Driven spheres stay as they are.

    The kernels share these arguments (C spin components, R samples, N the shape of the lattice, m free spheres along
    the height):

    modes : (C, R, *N) numbers, flat, and a block more; scratch of the solve.
    sines : (m, m), the matrix of the sines along the height, flat.
    chains : (C, longest side, height + block), flat: the factors by which the elimination of a chain multiplies, for
        each component, place along the chain, and mode. With periodic axes as many numbers follow that close chains to
        rings. Each row is repeated at its end for the length of a block, so that a block may begin at any of its
        places.
    count : spheres of all samples.
    stride_x, stride_y : distance in memory, in spheres, from one to its neighbour along x and along y.
    sites : spheres of one sample.
    longest : spheres of the longest chain.
    weight : relative stiffness of the springs along the chains."""

    def __init__(self, spec: FieldSpec, stencil: Stencil):
        """Set the constants for which the kernels are compiled: rows of the fields `pull` and `potential`, spheres of a
        block (worked on together), and which spin components have chains that close to rings.

        spec : names and numbers of components of the fields, in the order of their rows (a row is one number of every
            sphere).
        stencil : spin components, dimension and periodic axes of the lattice."""
        slot = first_slots(spec)  # first row of each field by name
        self.pull, self.potential = slot["pull"], slot["potential"]
        self.stencil, self.block, self.components = stencil, stencil.block, stencil.components
        self.ahead = AHEAD if self.block == 1 else 1
        # for each spin component, whether its chains close to rings
        self.closed = tuple(side in stencil.periodic for side in stencil.coupled_sides)

    def measures(self, layout: Layout, longest: int) -> tuple[int, ...]:
        """Return the whole numbers by which the kernels find spheres in memory: spheres of all samples; distances in
        memory from a sphere to its neighbours along x and along y; spheres of one sample; and `longest`.

        layout : the order of the spheres in memory.
        longest : spheres of the longest chain."""
        _, _, _, stride_x, stride_y, sites = layout.measures
        return layout.sites, stride_x, stride_y, sites, longest

    @ti.func
    def height(self, stride_x, stride_y):
        """Return the number of spheres along the height. As the height is the last axis in memory, it is the distance
        from a sphere to its neighbour along the axis before: y in 3D, x in 2D.

        stride_x, stride_y : distance in memory, in spheres, from one to its neighbour along x and along y."""
        return stride_y if ti.static(self.stencil.dimension == 3) else stride_x

    @ti.func
    def chain(self, slot: ti.template(), stride_x, stride_y, sites):
        """Return the number of spheres in a chain (a row of spheres along one side of the lattice), and the distance in
        memory from one of them to the next.

        slot : number of the spin component, which decides whether its chains run along x or along y.
        stride_x, stride_y : distance in memory, in spheres, from one to its neighbour along x and along y.
        sites : spheres of one sample."""
        side, stride = sites // stride_x, stride_x
        if ti.static(self.stencil.coupled_sides[slot] == 1):
            side, stride = stride_x // stride_y, stride_y
        return side, stride

    @ti.func
    def sines_of_tile(
        self, given: ti.template(), found: ti.template(), sines: ti.template(), source, target, kept, item, rows, height
    ):
        """Compute one block of TILE x TILE entries of the matrix product `given` @ `sines`, and write it into `found`,
        or add it.

        given, found : flat arrays that contain the two matrices, row by row. A row has `height` numbers, one for each
            sphere of a column along the height; the first and the last belong to driven spheres and take no part.
        sines : (m, m) matrix with m = height - 2, flat.
        source, target : index of the first number of the matrix in `given` and in `found`.
        kept : factor of what `found` holds: 1 to add the product to it, 0 to replace it.
        item : number of the block. Its rows are neighbours; its columns are as far apart as there are blocks in a row,
            so that neighbouring threads read neighbouring numbers.
        rows : number of rows of `given`.
        height : spheres along the height."""
        # which rows and columns the tile has
        free = height - 2
        tile = ti.static(range(TILE))
        lanes = (free + TILE - 1) // TILE
        row, lane = item // lanes * TILE, item % lanes
        at = [ti.min(row + r, rows - 1) * height + 1 for r in tile]
        column = [ti.min(lane + c * lanes, free - 1) for c in tile]
        # sum over the free spheres along the height, in registers
        total = [[0.0 for _ in tile] for _ in tile]
        for k in range(free):
            left = [given[source + at[r] + k] for r in tile]
            right = [sines[k * free + column[c]] for c in tile]
            for r in ti.static(tile):
                for c in ti.static(tile):
                    total[r][c] += left[r] * right[c]
        # write the entries that lie within the matrix
        for r in ti.static(tile):
            for c in ti.static(tile):
                if row + r < rows and lane + c * lanes < free:
                    place = target + at[r] + column[c]
                    found[place] = kept * found[place] + total[r][c]

    @ti.kernel
    def on_gpu(
        self,
        values: VALUES,
        modes: VALUES,
        sines: VALUES,
        chains: VALUES,
        row: int,
        margin: int,
        count: int,
        stride_x: int,
        stride_y: int,
        sites: int,
        longest: int,
        weight: float,
    ):
        """Solve the Poisson problem on a GPU, in three parallel loops: transform the torques `pull` by sines along the
        height, solve the chains of spheres of each sine, and add the inverse transform to `potential`.

        values : all fields, flat; `pull` is read and `potential` changed.
        modes : (C components, R samples, *N spheres) scratch for the amplitudes of the sines, flat.
        sines : (m, m) matrix of the sines along the height of m free spheres, flat.
        chains : (C, longest, height + block), flat: factors by which the elimination of the chains multiplies.
        row : length of a row of the fields, which has one number of every sphere.
        margin : numbers of a row before the first sphere.
        count : spheres of all replicas (samples solved side by side).
        sites : spheres of one replica.
        stride_x, stride_y : distance in memory from a sphere to its neighbour along x and along y.
        longest : spheres of the longest chain.
        weight : stiffness of the springs along the chains.
        """
        for item in range(self.components * self.tiles(count, stride_x, stride_y)):
            tiles, height = self.tiles(count, stride_x, stride_y), self.height(stride_x, stride_y)
            slot, tile = item // tiles, item % tiles
            source = (self.pull + slot) * row + margin
            self.sines_of_tile(values, modes, sines, source, slot * count, 0, tile, count // height, height)
        for item in range(self.lines(count, stride_x, stride_y, sites)):
            line = item
            for slot in ti.static(range(self.components)):
                side, stride = self.chain(slot, stride_x, stride_y, sites)
                if 0 <= line < count // side:
                    height = self.height(stride_x, stride_y)
                    self.chains_of_group(modes, chains, slot, line, count, stride, side, height, longest, weight)
                line -= count // side
        for item in range(self.components * self.tiles(count, stride_x, stride_y)):
            tiles, height = self.tiles(count, stride_x, stride_y), self.height(stride_x, stride_y)
            slot, tile = item // tiles, item % tiles
            target = (self.potential + slot) * row + margin
            self.sines_of_tile(modes, values, sines, slot * count, target, 1, tile, count // height, height)

    @ti.func
    def tiles(self, count, stride_x, stride_y):
        """Return the number of tiles, blocks of TILE x TILE entries, into which the sine transform of one spin
        component is divided. It is a matrix product with a row for each column of spheres along the height.

        count : spheres of all samples.
        stride_x, stride_y : distance in memory, in spheres, from one to its neighbour along x and along y."""
        height = self.height(stride_x, stride_y)
        return (count // height + TILE - 1) // TILE * ((height - 2 + TILE - 1) // TILE)

    @ti.func
    def lines(self, count, stride_x, stride_y, sites):
        """Return the number of chains of all spin components and samples. A chain has the spheres in a row along the
        side on which contacts couple a component, for one sine along the height; a column has as many sines as spheres.

        count : spheres of all samples.
        stride_x, stride_y : distance in memory, in spheres, from one to its neighbour along x and along y.
        sites : spheres of one sample."""
        total = 0
        for slot in ti.static(range(self.components)):
            side, _ = self.chain(slot, stride_x, stride_y, sites)
            total += count // side
        return total

    @ti.func
    def write(self, modes: ti.template(), place, row: ti.template(), rest):
        """Write the first `rest` numbers of a block of neighbouring chains, one number of each, to `modes`; in one go
        if all belong to chains, which is faster.

        modes : flat array, which is changed from the index `place` on.
        row : the numbers of the block: a vector, or one number if a block is one sphere.
        rest : how many of them belong to chains; if it is larger than the block, all do."""
        if ti.static(self.block == 1):
            modes[place] = row
        elif rest >= self.block:
            for m in ti.static(range(self.block)):
                modes[place + m] = row[m]
        else:
            for m in range(rest):
                modes[place + m] = row[m]

    @ti.func
    def chains_of_group(
        self, modes: ti.template(), chains: ti.template(), slot: ti.template(), group, count, stride, side, height,
        longest, weight,
    ):  # fmt: skip
        """Solve a block of neighbouring chains in place: as many as a block has sites, fewer at the end of a row. A
        chain has the spheres along one side of the lattice, for one sine along the height.

        A chain is solved by Gaussian elimination from its first sphere to its last, and by substitution back. The
        factors are those of :func:`taichi_bearings.lattice.laplacian.chain_factors`. A ring is a chain with one more
        spring between its ends: the scalar product of the pulls with a vector z (`ring_closures` there) is summed up on
        the way, and z times this sum is subtracted on the way back.

        modes : (C components, R samples, *N spheres) pulls, flat, replaced by the solutions.
        chains : (C, longest, height + block), flat: factors by which the elimination of the chains multiplies; with
            periodic axes followed by as many numbers, the vectors z.
        slot : number of the spin component.
        group : number of the block of chains, among those of this component in all samples.
        count : spheres of all samples.
        stride : distance in memory from one sphere of a chain to the next.
        side : number of spheres of a chain.
        height : spheres along the height.
        longest : spheres of the longest chain.
        weight : relative stiffness of the springs along the chains.
        """
        # where the block begins among the modes and in the tables of factors
        across, pitch = (stride + self.block - 1) // self.block, height + self.block
        along = group % across * self.block
        first = slot * count + group // across * stride * side + along
        factors, rest = slot * longest * pitch + along % height, stride - along
        closures = factors + self.components * longest * pitch
        # forward: each sphere gets its pull and the weighted value of the sphere before, times its factor
        ahead = ti.static(range(self.ahead))
        carried, across_ends = zero(self.block), zero(self.block)
        for begin in range((side + self.ahead - 1) // self.ahead):
            s = [ti.min(begin * self.ahead + u, side - 1) for u in ahead]
            at = [in_range(first + s[u] * stride) for u in ahead]
            read = load_each(modes, at, self.block)
            factor = [load(chains, in_range(factors + s[u] * pitch), self.block) for u in ahead]
            for u in ti.static(ahead):
                carried = (read[u] + weight * carried) * factor[u]
                if begin * self.ahead + u < side:
                    self.write(modes, at[u], carried, rest)
                    if ti.static(self.closed[slot]):
                        across_ends += read[u] * load(chains, in_range(closures + s[u] * pitch), self.block)
        # back: each value and the weighted value of the sphere after it, times the factor
        carried = zero(self.block)
        for begin in range((side + self.ahead - 1) // self.ahead):
            s = [ti.max(side - 1 - begin * self.ahead - u, 0) for u in ahead]
            at = [in_range(first + s[u] * stride) for u in ahead]
            read = load_each(modes, at, self.block)
            factor = [load(chains, in_range(factors + s[u] * pitch), self.block) for u in ahead]
            for u in ti.static(ahead):
                carried = read[u] + weight * factor[u] * carried
                if begin * self.ahead + u < side:
                    new = carried
                    if ti.static(self.closed[slot]):
                        new = carried - across_ends * load(chains, in_range(closures + s[u] * pitch), self.block)
                    self.write(modes, at[u], new, rest)

    @ti.kernel
    def chains_on_cpu(
        self,
        workers: int,
        modes: VALUES,
        chains: VALUES,
        count: int,
        stride_x: int,
        stride_y: int,
        sites: int,
        longest: int,
        weight: float,
    ):
        """Solve all chains on a CPU, in place; each worker takes an equal share of the blocks of chains. A chain has
        the spheres in a row along one side of the lattice, for one sine along the height.

        workers : number of threads.
        modes : (C components, R samples, *N spheres) pulls in each mode, flat, replaced by the solutions.
        chains : (C, longest, height + block), flat: factors by which the elimination of the chains multiplies.
        count : spheres of all replicas (samples solved side by side).
        sites : spheres of one replica.
        stride_x, stride_y : distance in memory from a sphere to its neighbour along x and along y.
        longest : spheres of the longest chain.
        weight : stiffness of the springs along the chains.
        """
        for item in range(workers * LEAST_CHUNK):
            if item % LEAST_CHUNK == 0:
                worker, height = item // LEAST_CHUNK, self.height(stride_x, stride_y)
                for slot in ti.static(range(self.components)):
                    side, stride = self.chain(slot, stride_x, stride_y, sites)
                    groups = count // side // stride * ((stride + self.block - 1) // self.block)
                    for group in range(groups * worker // workers, groups * (worker + 1) // workers):
                        self.chains_of_group(modes, chains, slot, group, count, stride, side, height, longest, weight)
