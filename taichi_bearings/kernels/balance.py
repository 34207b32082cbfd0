"""Solves the torque balance of spheres whose contacts are equal springs, a Poisson problem.

A spin component is coupled only along the height and along one other axis. Sine transforms along the height, whose two
ends are driven, turn the problem into independent chains of spheres along the other axis, one for each sine. A chain is
solved by elimination from end to end and back. With a periodic axis it is a ring, a chain with one more spring, which
takes one more sum (docs/decisions.md, 10 counts the operations). Every sum runs in one order, whatever the number of
workers or replicas.

Letters: C spin components, R replicas (samples solved together), N the shape of the lattice, m free spheres along
the height (all but the driven bottom and top). A *mode* is the amplitude of one sine along the height.
"""

from taichi_bearings.compiler import ti
from taichi_bearings.fields import FieldSpec, first_slots
from taichi_bearings.kernels.memory import BLOCKS, VALUES, in_range, load, load_each, reversed_block, store, zero
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import LEAST_CHUNK
from taichi_bearings.lattice.layout import Layout

TILE = 4  # a thread of a GPU sums so many rows and columns of a matrix product: 8 numbers read for 16 products
AHEAD = 4  # a thread of a GPU reads so many spheres of a chain before it writes the first of them; on a CPU 1


@ti.data_oriented
class BalanceKernels:
    """Kernels that solve a Poisson problem: they find the change of the spins that cancels given torques on the spheres
    of a lattice, if all contacts are springs of the same stiffness.

    A solve has three steps. It transforms the torques, field `pull`, by sines along the height into `modes`, the
    amplitudes of the sines; solves a chain of spheres along one side for each sine; and transforms back, adding the
    result to the field `potential`. Driven spheres stay as they are. On a GPU one kernel does all this. On a CPU the
    BLAS library multiplies by the sines, and a kernel solves the chains.

    On large lattices each column z_0 ... z_n of spheres along the height is *folded* before these products, which
    halves their work, and *unfolded* after them: two *half columns* take its place, that of the sums z_k + z_(n-k) of
    mirror images, and that of the differences z_k - z_(n-k). A sine is even or odd under reflection of the height, so
    half of the sines act on the sums only, the others on the differences.

    The kernels share these arguments (C spin components, R samples, N the shape of the lattice, m free spheres along
    the height):

    modes : (C, R, *N) numbers, flat; scratch of the solve. On a CPU each column along the height is filled up to whole
        blocks by numbers that stay 0. Where columns are folded, the shape is (C, 2, R, columns, half column): all half
        columns of the even sines, then all of the odd ones, with those of a chain one after the other.
    sines : (m, m), the matrix of the sines along the height, flat; on a GPU alone.
    chains : (C, longest side, height), flat; with folded columns (C, 2, longest side, half column): the factors by
        which the elimination of a chain multiplies, for each component, place along the chain, and mode. With periodic
        axes as many numbers follow that close chains to rings.
    count, sites : spheres of all samples, and of one sample. In `chains_on_cpu`, where columns are filled up or folded,
        they count the numbers in `modes` instead, those of one component or of one of its halves.
    stride_x, stride_y : distance in memory, in spheres, from one to its neighbour along x and along y.
    longest : spheres of the longest chain.
    weight : relative stiffness of the springs along the chains."""

    def __init__(self, spec: FieldSpec, stencil: Stencil, folds: bool, kinds: tuple[str, str]):
        """Set the constants for which the kernels are compiled: rows of the fields `pull` and `potential`, spheres of a
        block (worked on together), and which spin components have chains that close to rings.

        spec : names and numbers of components of the fields, in the order of their rows (a row is one number of every
            sphere).
        stencil : spin components, dimension and periodic axes of the lattice.
        folds : True to fold each column of spheres into two half columns, as on large lattices.
        kinds : types of the numbers of the fields and of `modes`, such as "float64", for which kernels are compiled."""
        slot = first_slots(spec)  # first row of each field by name
        self.pull, self.potential = slot["pull"], slot["potential"]
        # row of what the rounding of `potential` leaves out, where that is stored
        self.rest = slot.get("potential_rest", -1)
        self.stencil, self.block, self.components = stencil, stencil.block, stencil.components
        self.ahead, self.folds, self.kinds = AHEAD if self.block == 1 else 1, folds, kinds
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
        chains : (C, longest, height), flat: factors by which the elimination of the chains multiplies.
        row : length of a row of the fields, which has one number of every sphere.
        margin : numbers of a row before the first sphere.
        count : spheres of all replicas (samples solved together).
        stride_x, stride_y : distance in memory from a sphere to its neighbour along x and along y.
        sites : spheres of one replica.
        longest : spheres of the longest chain.
        weight : stiffness of the springs along the chains.
        """
        # sine transform, tile by tile of the matrix product
        for item in range(self.components * self.tiles(count, stride_x, stride_y)):
            tiles, height = self.tiles(count, stride_x, stride_y), self.height(stride_x, stride_y)
            slot, tile = item // tiles, item % tiles
            source = (self.pull + slot) * row + margin
            self.sines_of_tile(values, modes, sines, source, slot * count, 0, tile, count // height, height)
        # chains of all components; `line` is counted within the component whose turn it is
        for item in range(self.lines(count, stride_x, stride_y, sites)):
            line = item
            for slot in ti.static(range(self.components)):
                side, stride = self.chain(slot, stride_x, stride_y, sites)
                if 0 <= line < count // side:
                    height = self.height(stride_x, stride_y)
                    self.chains_of_group(
                        modes, modes, chains, slot, 0, line, count, stride, side, height, longest, weight
                    )
                line -= count // side
        # inverse transform, added to the potentials
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
    def chains_of_group(
        self, modes: ti.template(), blocks: ti.template(), chains: ti.template(), slot: ti.template(), half, group,
        count, stride, side, height, longest, weight,
    ):  # fmt: skip
        """Solve a group of neighbouring chains in place, as many as a block has numbers. A chain is a row of spheres
        along one side of the lattice, with the pulls (then the solutions) of one sine along the height.

        The way forth is Gaussian elimination from the first sphere to the last; the way back is substitution. A ring is
        a chain with one more spring, between its ends: on the way forth the scalar product of the pulls with a vector z
        is summed up, and on the way back z times this sum is subtracted. :mod:`taichi_bearings.lattice.laplacian` makes
        the factors (`chain_factors`) and z (`ring_closures`).

        modes : pulls, flat, replaced by the solutions: (C components, R samples, *N), or folded (see the class).
        blocks : the same memory as vectors, one for each block.
        chains : factors by which the elimination multiplies, flat, (C, longest, height), with folded columns (C, 2,
            longest, height); with periodic axes as many numbers follow, the vectors z.
        slot : number of the spin component.
        half : 1 for half columns of odd sines, else 0.
        group : number of the group of chains, among those of this component (and half) in all samples.
        count : numbers of a component (and half) in `modes`.
        stride : distance in memory from one sphere of a chain to the next.
        side : number of spheres of a chain.
        height : numbers of a column, or half column, in `modes`.
        longest : spheres of the longest chain.
        weight : relative stiffness of the springs along the chains."""
        # where the block begins among the modes and in the tables of factors
        across, halves = stride // self.block, ti.static(2 if self.folds else 1)
        along, number = group % across * self.block, halves * slot + half
        first = number * count + group // across * stride * side + along
        factors = number * longest * height + along % height
        closures = factors + self.components * halves * longest * height
        # forward: each sphere gets its pull and the weighted value of the sphere before, times its factor
        ahead = ti.static(range(self.ahead))
        carried, across_ends = zero(self.block), zero(self.block)
        for begin in range((side + self.ahead - 1) // self.ahead):
            s = [ti.min(begin * self.ahead + u, side - 1) for u in ahead]
            at = [in_range(first + s[u] * stride) for u in ahead]
            read = load_each(modes, at, self.block)
            factor = [load(chains, in_range(factors + s[u] * height), self.block) for u in ahead]
            for u in ti.static(ahead):
                carried = (read[u] + weight * carried) * factor[u]
                if begin * self.ahead + u < side:
                    store(modes, blocks, at[u], self.block, carried)
                    if ti.static(self.closed[slot]):
                        across_ends += read[u] * load(chains, in_range(closures + s[u] * height), self.block)
        # back: each value and the weighted value of the sphere after it, times the factor
        carried = zero(self.block)
        for begin in range((side + self.ahead - 1) // self.ahead):
            s = [ti.max(side - 1 - begin * self.ahead - u, 0) for u in ahead]
            at = [in_range(first + s[u] * stride) for u in ahead]
            read = load_each(modes, at, self.block)
            factor = [load(chains, in_range(factors + s[u] * height), self.block) for u in ahead]
            for u in ti.static(ahead):
                carried = read[u] + weight * factor[u] * carried
                if begin * self.ahead + u < side:
                    new = carried
                    if ti.static(self.closed[slot]):
                        new = carried - across_ends * load(chains, in_range(closures + s[u] * height), self.block)
                    store(modes, blocks, at[u], self.block, new)

    @ti.func
    def place_of_column(self, slot, column, stride_x, stride_y, sites):
        """Return the number of a column of spheres (along the height) in the order of `modes` on a CPU, where the
        columns of a chain stand one after the other.

        slot : number of the spin component, which decides whether its chains run along x or along y.
        column : number of the column in the order of the fields.
        stride_x, stride_y : distance in memory, in spheres, from one to its neighbour along x and along y.
        sites : spheres of one sample."""
        place = column
        for k, side in ti.static(enumerate(self.stencil.coupled_sides)):
            if ti.static(self.stencil.dimension == 3 and side == 0) and slot == k:
                side_x, side_y = sites // stride_x, stride_x // stride_y
                sample, inside = column // (side_x * side_y), column % (side_x * side_y)
                place = (sample * side_y + inside % side_y) * side_x + inside // side_y
        return place

    @ti.kernel
    def fold(
        self, workers: int, values: VALUES, folded: VALUES, blocks: BLOCKS, row: int, margin: int, count: int,
        stride_x: int, stride_y: int, sites: int, half: int,
    ):  # fmt: skip
        """Write the pulls p_0 ... p_n of each column of spheres into `folded` as two half columns: the sums p_k +
        p_(n-k) of mirror images, from the ends of the column, k = 0, to its middle; and the differences p_k - p_(n-k).
        A sphere in the middle is its own mirror image. Blocks are filled up with further sums and differences.

        workers : number of threads; each takes an equal share of the columns.
        values : all fields, flat; `pull` is read.
        folded : (C components, 2, R samples, columns, half) numbers, flat, which are written: all half columns of sums,
            then all of differences, in the order of the chains.
        blocks : the same memory as vectors, one for each block.
        row : length of a row of the fields, which has one number of every sphere.
        margin : numbers of a row before the first sphere.
        count : spheres of all samples.
        stride_x, stride_y : distance in memory from a sphere to its neighbour along x and along y.
        sites : spheres of one sample.
        half : numbers of a half column, whole blocks.
        """
        for item in range(workers * LEAST_CHUNK):
            if item % LEAST_CHUNK == 0:
                self.at_columns(
                    True, item // LEAST_CHUNK, workers, values, folded, blocks, row, margin, count, stride_x, stride_y,
                    sites, half,
                )  # fmt: skip

    @ti.func
    def rounded(self, numbers):
        """Return a vector of numbers rounded to the precision of the modes, which is that of the fields or single
        precision."""
        if ti.static(self.kinds[0] == self.kinds[1]):
            return numbers
        return ti.Vector([ti.cast(numbers[m], ti.f32) for m in ti.static(range(self.block))])

    @ti.kernel
    def unfold(
        self, workers: int, folded: VALUES, values: VALUES, blocks: BLOCKS, row: int, margin: int, count: int,
        stride_x: int, stride_y: int, sites: int, half: int,
    ):  # fmt: skip
        """Add the solution of the Poisson problem to the field `potential` of all spheres. For each column it is given
        as an even and an odd half column: the solution is their sum in the lower half of the column, and their
        difference at the mirror image in the upper half.

        workers : number of threads; each takes an equal share of the columns.
        folded : (C components, 2, R samples, columns, half) numbers, flat: all even half columns, then all odd ones, in
            the order of the chains.
        values : all fields, flat; `potential` is changed.
        blocks : the same memory as vectors, one for each block.
        row : length of a row of the fields, which has one number of every sphere.
        margin : numbers of a row before the first sphere.
        count : spheres of all samples.
        stride_x, stride_y : distance in memory from a sphere to its neighbour along x and along y.
        sites : spheres of one sample.
        half : numbers of a half column, whole blocks.
        """
        for item in range(workers * LEAST_CHUNK):
            if item % LEAST_CHUNK == 0:
                self.at_columns(
                    False, item // LEAST_CHUNK, workers, values, folded, blocks, row, margin, count, stride_x, stride_y,
                    sites, half,
                )  # fmt: skip

    @ti.func
    def at_columns(
        self, folds: ti.template(), worker, workers, values: ti.template(), folded: ti.template(),
        blocks: ti.template(), row, margin, count, stride_x, stride_y, sites, half,
    ):  # fmt: skip
        """Fold or unfold the columns of one thread, an equal share of all.

        folds : True to fold pulls, False to unfold solutions and add them to potentials.
        worker, workers : number of the thread, and number of threads.
        values, folded : all fields, and the folded columns, flat.
        blocks : the one of these two arrays that is written, as vectors, one for each block.
        row, margin, count, stride_x, stride_y, sites, half : see the kernel :meth:`fold`."""
        height = self.height(stride_x, stride_y)
        columns, field = count // height, ti.static(self.pull if folds else self.potential)
        for slot in range(self.components):  # at run time, as a static loop takes twice the time to compile
            for column in range(columns * worker // workers, columns * (worker + 1) // workers):
                low = (field + slot) * row + margin + column * height
                even = (2 * slot * columns + self.place_of_column(slot, column, stride_x, stride_y, sites)) * half
                odd = even + columns * half
                if ti.static(folds):
                    self.fold_column(values, folded, blocks, low, even, odd, height, half)
                else:
                    rest = (self.rest - self.potential) * row  # from a potential to what its rounding leaves out
                    self.unfold_column(folded, values, blocks, low, even, odd, height, rest)

    @ti.func
    def fold_column(
        self, values: ti.template(), folded: ti.template(), blocks: ti.template(), low, even, odd, height, half
    ):
        """Fold one column of spheres: write the sums and the differences of the pulls on two spheres at equal distance
        from its ends.

        values : all fields, flat.
        folded, blocks : the folded columns, flat, and the same memory as vectors, one for each block.
        low : index of the pull on the lowest sphere.
        even, odd : index of the first sum and of the first difference.
        height : spheres along the height.
        half : numbers of a half column."""
        for b in range(half // self.block):
            at = b * self.block
            lower = load(values, in_range(low + at), self.block)
            upper = load(values, in_range(low + height - self.block - at), self.block)
            upper = reversed_block(upper, self.block)
            store(folded, blocks, even + at, self.block, self.rounded(lower + upper))
            store(folded, blocks, odd + at, self.block, self.rounded(lower - upper))

    @ti.func
    def unfold_column(
        self, folded: ti.template(), values: ti.template(), blocks: ti.template(), low, even, odd, height, rest
    ):
        """Add the solution for one column of spheres, given as its even and its odd part, to their potentials.

        folded : the parts of all columns, flat.
        values, blocks : all fields, flat, and the same memory as vectors, one for each block.
        low : index of the potential of the lowest sphere.
        even, odd : index of the first number of the even and of the odd part.
        height : spheres along the height.
        rest : distance from a potential to what its rounding leaves out, if that is stored."""
        half = height // 2
        # spheres of the lower half that are done block by block: none if the upper half does not end with a whole block
        whole = half // self.block * self.block * (height % self.block == 0)
        for b in range(whole // self.block):
            at = b * self.block
            first = load(folded, in_range(even + at), self.block)
            second = load(folded, in_range(odd + at), self.block)
            self.add(values, blocks, in_range(low + at), rest, first + second, self.block)
            upper, end = reversed_block(first - second, self.block), low + height - self.block
            self.add(values, blocks, in_range(end - at), rest, upper, self.block)
        for z in range(whole, half):
            first_one, second_one = folded[even + z], folded[odd + z]
            self.add(values, values, low + z, rest, first_one + second_one, 1)
            self.add(values, values, low + height - 1 - z, rest, first_one - second_one, 1)
        if height % 2 == 1:
            self.add(values, values, low + half, rest, folded[even + half], 1)

    @ti.func
    def add(self, values: ti.template(), blocks: ti.template(), place, rest, change, block: ti.template()):
        """Add numbers to the potentials of neighbouring spheres, in place. If there is a field for what the rounding of
        a potential leaves out, that is updated as well (two-sum of Knuth, then of Dekker).

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block; not used if `block` is 1.
        place : index of the first potential, a multiple of `block`.
        rest : distance from there to what its rounding leaves out; not used where that is not stored.
        change : the numbers, a vector; one number if `block` is 1.
        block : how many spheres."""
        old = load(values, place, block)
        total = old + change
        if ti.static(self.rest >= 0):
            part = total - old
            lost = (old - (total - part)) + (change - part) + load(values, in_range(place + rest), block)
            new = total + lost
            store(values, blocks, in_range(place + rest), block, lost - (new - total))
            total = new
        store(values, blocks, place, block, total)

    @ti.kernel
    def chains_on_cpu(
        self,
        workers: int,
        modes: VALUES,
        blocks: BLOCKS,
        chains: VALUES,
        count: int,
        stride_x: int,
        stride_y: int,
        sites: int,
        longest: int,
        weight: float,
    ):
        """Solve all chains on a CPU, in place. A chain is a row of spheres along one side of the lattice, with the
        pulls (then the solutions) of one sine along the height.

        workers : number of threads; each takes an equal share of the groups of chains (:meth:`chains_of_group`).
        modes : pulls, flat, replaced by the solutions: (C components, R samples, columns, numbers of a column), with an
            axis of 2 after C if columns are folded. A column is filled up to whole blocks. Folded columns of a chain
            stand one after the other: so all chains of a plane fit a processor's second-level cache.
        blocks : the same memory as vectors, one for each block.
        chains : factors by which the elimination of the chains multiplies, flat.
        count : numbers of a component (and half) in `modes`.
        stride_x, stride_y : distance in `modes` from a column to the next along x and along y if none is folded. The
            second, in 2D the first, always is the length of a column or half column.
        sites : numbers of a component (and half) in `modes` that belong to one sample.
        longest : spheres of the longest chain.
        weight : relative stiffness of the springs along the chains."""
        for item in range(workers * LEAST_CHUNK):
            if item % LEAST_CHUNK == 0:
                worker, height = item // LEAST_CHUNK, self.height(stride_x, stride_y)
                for slot in ti.static(range(self.components)):
                    side, stride = self.chain(slot, stride_x, stride_y, sites)
                    if ti.static(self.folds):
                        stride = height
                    groups = count // side // self.block
                    for half in range(ti.static(2 if self.folds else 1)):
                        for group in range(groups * worker // workers, groups * (worker + 1) // workers):
                            self.chains_of_group(
                                modes, blocks, chains, slot, half, group, count, stride, side, height, longest, weight
                            )
