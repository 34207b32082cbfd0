"""The Poisson problem of an iteration of operator splitting: which change of the spins balances all torques.

Letters: C spin components, R samples, N spheres (shape of the lattice), nz spheres along the height.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import Fields, FieldSpec, on_device, team_size
from taichi_bearings.kernels.balance import BalanceKernels
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import made_once
from taichi_bearings.lattice.laplacian import chain_eigenvalues, chain_factors, chain_modes, ring_closures
from taichi_bearings.memory import aligned_zeros
from taichi_bearings.numerics.blas import one_thread

SHARED_BY_BLAS = 32  # spheres along the height from which the BLAS library would use threads of its own
PRODUCT_TYPE = np.float32  # precision of the products with sines on a CPU
CACHED_NUMBERS = 65_536  # numbers of a product that are still in the second-level cache of a processor when it is read

Pieces = list[tuple[int, np.ndarray, np.ndarray]]
"""Tuples of three: number of a matrix of sines; some columns of pulls or potentials, and the same columns of the modes,
arrays (columns, nz). Where columns are folded, these are half columns."""


class TorqueBalance:
    """Solves the Poisson problem of an iteration, and adds its solution u to the field `potential`.

    The problem is: sum over axes a of weight_a (-Laplace_a) u = `pull`, with u = 0 on the driven planes. A spin
    component is coupled along the height and one other axis only. So a sine transform of each *column* (the spheres
    along the height) separates the *modes*, one for each sine. The equations of a mode are those of a *chain* of
    spheres along the other axis, a ring if that is periodic. They are tridiagonal, and solved by elimination.

    On a GPU one launch of a kernel does it all. On a CPU the BLAS library multiplies by the sines, which are even or
    odd under reflection of the height. Columns of large lattices are *folded* there into two *half columns*, which
    halves the products: sums of two spheres equally far from bottom and top for even sines, differences for odd ones.

    fields : the fields of the method.
    kernels : the kernels of the solve.
    weight : stiffness of the springs sideways.
    products : type of the numbers in the products with the sines on a CPU: single precision, or that of the fields if
        that is less.
    folds : True if columns are folded.
    sines : on a GPU the matrix (nz - 2, nz - 2) of the sine transform, flat. On a CPU square matrices with a row for
        each sphere (driven ones have 0) and a column for each sine: one matrix, (1, nz, nz); or, for folded columns,
        one of the even and one of the odd sines for the lower half of a column, padded by 0 to whole blocks.
    inverse : on a CPU the matrices of the inverse transform.
    column : how many numbers `modes` has for a column or, if folded, half column; on a CPU whole blocks of numbers.
    chains : flat, inverse pivots by which the chains, one for each mode, are solved.
    modes, folded : flat, the transformed field, where solutions replace pulls; and the half columns of the field.
    measures : whole numbers by which kernels find spheres: length of a row in memory, strides and the like.
    workers : number of threads that share the columns (of spheres along the height); 0 on a GPU.
    each : function like `map` that shares its calls among these threads.
    given, found : the `Pieces` of each thread, with columns of the pulls, or of the potentials. Where columns are
        folded, both have half columns of `folded`.
    is_rough : True if the products are less precise than the fields.
    is_small : True if a column is so short that the BLAS library would use no threads of its own.
    """

    def __init__(
        self, spec: FieldSpec, stencil: Stencil, weights: tuple[float, ...], fields: Fields, folds: bool = False
    ) -> None:
        """Compute the sines of the transform along the height, and the factors by which the chains of spheres along the
        other axis are solved; on a CPU share the columns among threads, and compile the kernels.

        spec : pairs (name of a field, number of its components).
        stencil : spin components, dimension and periodic axes of the lattice.
        weights : relative stiffness of the springs along each axis of the lattice, one number each; all axes but the
            height have the same.
        fields : the numbers of the fields; `pull` will be read, and `potential` changed.
        folds : True to fold columns on a CPU, which saves time on large lattices.
        """
        layout, height, self.weight = fields.layout, fields.layout.shape[-1], weights[0]
        self.fields, on_gpu = fields, runtime.current().is_gpu
        self.products = min(np.dtype(PRODUCT_TYPE), fields.dtype, key=lambda kind: kind.itemsize)
        self.workers = team_size(layout, stencil.components)
        self.folds = folds and not on_gpu
        self.kernels = made_once(BalanceKernels, spec, stencil, self.folds, (fields.dtype.name, self.products.name))
        # sines and eigenvalues of the free spheres of a column; half column of each mode, and its place there
        modes, held = chain_modes(height - 2, is_held=True), weights[-1] * chain_eigenvalues(height - 2, is_held=True)
        number, self.column = np.arange(height - 2), -(-height // layout.block) * layout.block
        place = np.zeros_like(number), number + 1
        if on_gpu:
            self.sines: Any = on_device(modes)
        elif self.folds:
            self.sines, self.inverse = self._halves(modes)
            self.column, place = len(self.sines[0]), (number % 2, number // 2)
        else:  # products of whole rows are faster than shorter ones
            self.sines = self.inverse = np.pad(modes, 1).astype(self.products)[None]
        sides, halves = [layout.shape[axis] for axis in stencil.coupled_sides], 2 if self.folds else 1
        factors, columns = self._factors(sides, (*place, held), stencil), layout.sites // height
        if on_gpu:
            self.chains, self.modes = on_device(factors), on_device(np.zeros(len(sides) * layout.sites))
        else:
            self.chains = factors.astype(self.products).ravel()
            self.modes = aligned_zeros(len(sides) * halves * columns * self.column, layout.block, self.products)
        self.measures = self.kernels.measures(layout, max(sides))
        self.each: Callable[..., Iterable[None]] = ThreadPoolExecutor(self.workers).map if self.workers > 1 else map
        self.is_rough = self.workers > 0 and self.products != fields.dtype
        self.is_small = height < SHARED_BY_BLAS
        if self.folds:
            self.folded = aligned_zeros(len(self.modes), layout.block, self.products)
            half_columns = list(self.folded.reshape(2 * len(sides), -1, self.column))
            self.given = self.found = self._shares(half_columns, np.repeat(sides, 2).tolist())
        elif self.workers:
            sides = [layout.shape[-2]] * len(sides)
            self.given, self.found = (self._shares(list(fields.view(name)), sides) for name in ("pull", "potential"))
        self._compile()

    def _compile(self) -> None:
        """Compile the kernels of a CPU: the kernel of the chains for the type of the modes, the others for the type of
        the fields. Kernels of a GPU are compiled when they are first called."""
        if self.workers:
            with runtime.computing_in(self.products.name):
                self._solve_chains(0)
        if self.folds:
            with runtime.computing_in(self.fields.dtype.name):
                self._fold(0)
                self._unfold(0)

    def _halves(self, modes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrices that transform half columns, and those of the inverse transform, (2, n, n) each: for the
        even sines, then for the odd ones.

        A matrix of the transform has a row for each sphere of the lower half, the driven one first, a column for each
        sine, and 0 beyond, up to n, whole blocks. The row of a sphere in the middle is halved, as folding doubles it.

        modes : (nz - 2, nz - 2), the sines, one in each column, at the free spheres.
        """
        height, block = len(modes) + 2, self.fields.layout.block
        middle = (height - 1) // 2  # the last sphere that is not above its mirror image
        found = np.zeros((2, *(-(-(middle + 1) // block) * block,) * 2))
        for parity, size in ((0, middle), (1, height // 2 - 1)):
            sines = modes[:size, parity::2]
            found[parity, 1 : size + 1, : sines.shape[1]] = sines
        inverse = found.transpose(0, 2, 1).astype(self.products)
        if height % 2:
            found[0, middle] /= 2
        return found.astype(self.products), inverse

    def _factors(self, sides: list[int], held: tuple[np.ndarray, ...], stencil: Stencil) -> np.ndarray:
        """Return the factors by which the chains are solved, (kinds, C, halves, longest side, numbers of a column).

        The kinds are inverse pivots and, with periodic axes, numbers that close rings. There are 2 halves if columns
        are folded, else 1. The last two axes are the sphere of a chain and the place of a mode in a (half) column.

        sides : number of spheres of a chain, for each spin component.
        held : of each mode, (nz - 2,), its half column, its place there, and the stiffness by which it holds its chain.
        stencil : spin components and periodic axes of the lattice.
        """
        numbers = (chain_factors, ring_closures)[: 2 if stencil.periodic else 1]
        half, place, stiffness = held
        chains = np.zeros((len(numbers), len(sides), 2 if self.folds else 1, max(sides), self.column))
        for kind, number in enumerate(numbers):
            for slot, side in enumerate(sides):
                chains[kind, slot, half, :side, place] = number(side, stiffness, self.weight).T
        return chains

    def begin(self) -> AbstractContextManager[None]:
        """Return the context in which `solve` is called. It limits the BLAS library to one thread where the threads of
        this object share the columns. It changes nothing on a GPU, or in lattices so low that BLAS uses one thread
        anyway.
        """
        return nullcontext() if self.workers == 0 or self.is_small else one_thread()

    def solve(self) -> None:
        """Change the spins of the free spheres so that the springs balance.

        On a CPU the sine transforms are products of matrices, in which each column of spheres is a row of its own. So
        its result does not depend on what else is solved, nor on how many threads share the columns. The products are
        in single precision, which is twice as fast. That suffices, because the solution is only a change of the spins,
        small in the end, and the next iteration makes up for the rounding.
        """
        if self.workers == 0:
            layout, values = self.fields.layout, self.fields.values
            rows = layout.length, layout.margin
            self.kernels.on_gpu(values, self.modes, self.sines, self.chains, *rows, *self.measures, self.weight)
            return
        if self.folds:
            self._fold(self.workers)
        list(self.each(self._to_modes, self.given))
        self._solve_chains(self.workers)
        list(self.each(self._from_modes, self.found))
        if self.folds:
            self._unfold(self.workers)

    @property
    def _places(self) -> tuple[int, ...]:
        """Whole numbers by which kernels find a column in the fields, in their order: length of a row of the fields;
        margin of the fields; number of spheres of all samples; distances in memory to the neighbours along x and along
        y; number of spheres of a sample; and numbers of a half column."""
        layout = self.fields.layout
        return layout.length, layout.margin, *self.measures[:-1], self.column

    def _fold(self, workers: int) -> None:
        """Write the half columns of the pulls into `folded`: sums and differences of spheres that mirror each other.

        workers : number of threads; 0 to compile the kernel without any work.
        """
        blocks = self.folded.reshape(-1, self.fields.layout.block)
        self.kernels.fold(workers, self.fields.values, self.folded, blocks, *self._places)

    def _unfold(self, workers: int) -> None:
        """Add the solution, of which `folded` has the half columns, to the potentials of the spheres.

        workers : number of threads; 0 to compile the kernel without any work.
        """
        self.kernels.unfold(workers, self.folded, self.fields.values, self.fields.blocks, *self._places)

    def _solve_chains(self, workers: int) -> None:
        """Solve the chains of all modes in place.

        workers : number of threads; 0 to compile the kernel without any work.
        """
        # numbers and distances of spheres, as they are in `modes`: `column` numbers for the nz spheres of a column
        layout, (*lengths, longest) = self.fields.layout, self.measures
        lengths = [length // layout.shape[-1] * self.column for length in lengths]
        if len(layout.shape) == 2:
            lengths[2] = 1  # the neighbour along the height
        modes = self.modes, self.modes.reshape(-1, layout.block)
        self.kernels.chains_on_cpu(workers, *modes, self.chains, *lengths, longest, self.weight)

    def _shares(self, fields: list[np.ndarray], sides: list[int]) -> list[Pieces]:
        """Return for each thread its pieces: columns of the fields, with the same columns of the modes. A piece has the
        columns of some whole planes, so few that they fit into the cache.

        fields : the columns of each spin component, an array whose last axis is the height; if folded, two arrays for
            each component, its two kinds of half columns.
        sides : number of columns in a plane, for each of these arrays.
        """
        shares: list[Pieces] = [[] for _ in range(self.workers)]
        of_modes = self.modes.reshape(len(fields), -1, self.column)[..., : len(self.sines[0])]
        for number, (side, field, modes) in enumerate(zip(sides, fields, of_modes, strict=True)):
            columns = field.reshape(len(modes), -1)
            planes, few = len(columns) // side, max(1, CACHED_NUMBERS // (side * self.column))
            for worker, share in enumerate(shares):
                first, last = (planes * n // self.workers for n in (worker, worker + 1))
                parts = [slice(n * side, min(n + few, last) * side) for n in range(first, last, few)]
                share += [(number % len(self.sines), columns[part], modes[part]) for part in parts]
        return shares

    def _to_modes(self, pieces: Pieces) -> None:
        """Write the sine transform of some columns of the pulls into the same columns of the modes, in place.

        pieces : matrices of sines by number, columns of the pulls, and the same columns of the modes.
        """
        for number, pulls, modes in pieces:
            np.matmul(pulls.astype(self.products, copy=False), self.sines[number], out=modes)

    def _from_modes(self, pieces: Pieces) -> None:
        """Add the inverse sine transform of some columns of the modes to the same columns of the potentials, in place.
        Where columns are folded, write it into the folded columns instead.

        pieces : matrices of sines by number, columns of the potentials, and the same columns of the modes.
        """
        for number, columns, modes in pieces:
            if self.folds:
                np.matmul(modes, self.inverse[number], out=columns)
            else:
                columns += np.matmul(modes, self.inverse[number])
