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

Pieces = list[tuple[np.ndarray, np.ndarray]]
"""Pairs of some columns of pulls or potentials and the same columns of the modes, arrays (columns, nz)."""


class TorqueBalance:
    """Solves the Poisson problem of an iteration, and adds its solution u to the field `potential`.

    The problem is: sum over axes a of weight_a (-Laplace_a) u = `pull`, with u = 0 on the driven planes. A spin
    component is coupled along the height and one other axis only. A sine transform along the height separates the
    *modes*, one for each sine. The equations of a mode are those of a *chain* of spheres along the other axis (a ring
    if that is periodic): tridiagonal, and solved by elimination, with factors that are computed once. On a GPU the
    solve is one launch of a kernel. On a CPU the BLAS library multiplies by the sines. A sine is even or odd under
    reflection of the height: even sines act on sums of two spheres equally far from bottom and top, odd ones on
    differences. Columns of large lattices are *folded* into these sums and differences, which halves the products.

    fields : the fields of the method.
    kernels : the kernels of the solve.
    weight : stiffness of the springs sideways.
    products : type of the numbers in the products with the sines on a CPU: single precision, or that of the fields if
        that is less.
    folds : True if columns are folded.
    sines : on a GPU the matrix (nz - 2, nz - 2) of the sine transform, flat. On a CPU a list of square matrices with a
        row for each sphere (driven ones have 0) and a column for each sine: one matrix (nz, nz); or, for folded
        columns, one of the even and one of the odd sines for the lower half of a column, padded by 0 to whole blocks.
    inverse : on a CPU a list of the matrices of the inverse transform.
    column : numbers of a column in `modes`, on a CPU whole blocks.
    chains : flat, inverse pivots by which the chains, one for each mode, are solved.
    modes, folded : flat, the transformed field, where solutions replace pulls; and the field with its columns folded
        into sums and differences.
    measures : whole numbers by which kernels find spheres: length of a row in memory, strides and the like.
    workers : number of threads that share the columns (of spheres along the height); 0 on a GPU.
    each : function like `map` that shares its calls among these threads.
    given, found : for each thread a list of pairs: some columns of the pulls, or of the potentials, and the same
        columns of `modes`. Where columns are folded, both pulls and solutions are in `folded`.
    is_rough : True if the products are less precise than the fields.
    is_small : True if a column is so short that the BLAS library would use no threads of its own.
    """

    def __init__(
        self, spec: FieldSpec, stencil: Stencil, weights: tuple[float, ...], fields: Fields, folds: bool = False
    ) -> None:
        """Prepare the solution: the sines of the transform along the height, and the factors `chains` of the
        tridiagonal equations along the other axis, one chain of spheres for each sine (a *mode*). On a CPU share the
        columns of the lattice among threads. The class says what each attribute is.

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
        # modes and eigenvalues of the chain of free spheres along the height, and where modes stand in a row
        modes, held = chain_modes(height - 2, is_held=True), weights[-1] * chain_eigenvalues(height - 2, is_held=True)
        number, self.column = np.arange(height - 2), -(-height // layout.block) * layout.block
        place = number + 1
        if on_gpu:
            self.sines: Any = on_device(modes)
        elif self.folds:
            self.sines, self.inverse = self._halves(modes)
            self.column = sum(map(len, self.sines))
            place = number % 2 * len(self.sines[0]) + number // 2
        else:  # products of whole rows are faster than shorter ones
            self.sines = self.inverse = [np.pad(modes, 1).astype(self.products)]
        sides = [layout.shape[axis] for axis in stencil.coupled_sides]
        factors, columns = self._factors(sides, (place, held), stencil), layout.sites // height
        if on_gpu:
            self.chains, self.modes = on_device(factors), on_device(np.zeros(len(sides) * layout.sites))
        else:
            self.chains = factors.astype(self.products).ravel()
            self.modes = aligned_zeros(len(sides) * columns * self.column, layout.block, self.products)
        self.measures = self.kernels.measures(layout, max(sides))
        self.each: Callable[..., Iterable[None]] = ThreadPoolExecutor(self.workers).map if self.workers > 1 else map
        self.is_rough = self.workers > 0 and self.products != fields.dtype
        self.is_small = height < SHARED_BY_BLAS
        if self.folds:
            self.folded = aligned_zeros(len(self.modes), layout.block, self.products)
            self.given = self.found = self._shares(list(self.folded.reshape(len(sides), -1, self.column)), sides)
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

    def _halves(self, modes: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the matrices of the even and the odd sines for the lower half of a column, and those of the inverse
        transform: two lists of two square matrices, filled up to whole blocks by 0. A sphere in the middle counts half
        in the first ones, as folding adds it to itself.

        modes : (nz - 2, nz - 2), the sines, one in each column, at the free spheres.
        """
        # rows are the spheres of the lower half, the driven one first; columns are the even or the odd sines
        height, block = len(modes) + 2, self.fields.layout.block
        forward, back = list[np.ndarray](), list[np.ndarray]()
        for parity, size in ((0, height - height // 2), (1, height // 2)):
            found = np.zeros((-(-size // block) * block,) * 2)
            found[1:size, : len(modes[parity::2])] = modes[: size - 1, parity::2]
            back.append(found.T.astype(self.products))
            if parity == 0 and height % 2:
                found[size - 1] /= 2
            forward.append(found.astype(self.products))
        return forward, back

    def _factors(self, sides: list[int], held: tuple[np.ndarray, np.ndarray], stencil: Stencil) -> np.ndarray:
        """Return the numbers by which the chains are solved, (1, C, longest side, numbers of a column): inverse pivots
        by spin component, sphere of a chain, and place in a column of modes; 0 where there is no mode. With periodic
        axes as many numbers that close rings follow, so that the shape is (2, C, ...).

        sides : spheres of a chain of each spin component.
        held : (nz - 2,) each, the place of each mode in its column, and the stiffness by which it holds its chain.
        stencil : spin components and periodic axes of the lattice.
        """
        numbers = (chain_factors, ring_closures)[: 2 if stencil.periodic else 1]
        place, stiffness = held
        chains = np.zeros((len(numbers), len(sides), max(sides), self.column))
        for kind, number in enumerate(numbers):
            for slot, side in enumerate(sides):
                chains[kind, slot, :side, place] = number(side, stiffness, self.weight).T
        return chains

    def begin(self) -> AbstractContextManager[None]:
        """Return the context in which `solve` is called. It limits the BLAS library to one thread where the threads of
        this object share the columns. It changes nothing on a GPU, or in lattices so low that BLAS uses one thread
        anyway.
        """
        return nullcontext() if self.workers == 0 or self.is_small else one_thread()

    def solve(self) -> None:
        """Change the spins of the free spheres so that the springs balance.

        On a CPU the sine transform of some columns is two products of the BLAS library, in which each column is a row.
        So the result for a column does not depend on what else is solved, nor on how many threads share the columns.
        The products are in single precision, which is twice as fast. That suffices, because the solution is only a
        change of the spins, small in the end, and the next iteration makes up for the rounding.
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
        y; number of spheres of a sample; and of a folded column, how many of its numbers are sums, and how many numbers
        it has."""
        layout = self.fields.layout
        return layout.length, layout.margin, *self.measures[:-1], len(self.sines[0]), self.column

    def _fold(self, workers: int) -> None:
        """Write the pulls into `folded`, column by column.

        workers : number of threads; 0 to compile the kernel without any work.
        """
        blocks = self.folded.reshape(-1, self.fields.layout.block)
        self.kernels.fold(workers, self.fields.values, self.folded, blocks, *self._places)

    def _unfold(self, workers: int) -> None:
        """Add the solution, given by `folded` columns, to the potentials.

        workers : number of threads; 0 to compile the kernel without any work.
        """
        self.kernels.unfold(workers, self.folded, self.fields.values, self.fields.blocks, *self._places)

    def _solve_chains(self, workers: int) -> None:
        """Solve the chains of all modes in place.

        workers : number of threads; 0 to compile the kernel without any work.
        """
        layout, (*lengths, longest) = self.fields.layout, self.measures
        lengths = [length // layout.shape[-1] * self.column for length in lengths]
        if len(layout.shape) == 2:
            lengths[2] = 1  # the neighbour along the height
        modes = self.modes, self.modes.reshape(-1, layout.block)
        self.kernels.chains_on_cpu(workers, *modes, self.chains, *lengths, longest, self.weight)

    def _shares(self, fields: list[np.ndarray], sides: list[int]) -> list[Pieces]:
        """Divide the columns among the threads. Return for each thread a list of pairs (some columns of the fields, the
        same columns of the modes). A pair has some whole planes, so few that they fit into the cache.

        fields : of each spin component the columns, an array whose last axis is the height.
        sides : of each spin component the number of columns in a plane.
        """
        shares: list[Pieces] = [[] for _ in range(self.workers)]
        of_modes = self.modes.reshape(len(sides), -1, self.column)
        for side, field, modes in zip(sides, fields, of_modes, strict=True):
            columns = field.reshape(len(modes), -1)
            planes, few = len(columns) // side, max(1, CACHED_NUMBERS // (side * self.column))
            for worker, share in enumerate(shares):
                first, last = (planes * n // self.workers for n in (worker, worker + 1))
                parts = [slice(n * side, min(n + few, last) * side) for n in range(first, last, few)]
                share += [(columns[part], modes[part]) for part in parts]
        return shares

    def _to_modes(self, pieces: Pieces) -> None:
        """Write the sine transform of some columns of the pulls into the same columns of the modes, in place.

        pieces : pairs (columns of the pulls, the same columns of the modes), arrays (columns, nz or more).
        """
        for pulls, modes in pieces:
            first = 0
            for sines in self.sines:
                part = np.s_[:, first : first + len(sines)]
                np.matmul(pulls[part].astype(sines.dtype, copy=False), sines, out=modes[part])
                first += len(sines)

    def _from_modes(self, pieces: Pieces) -> None:
        """Add the inverse sine transform of some columns of the modes to the same columns of the potentials, in place.
        Where columns are folded, write it into the folded columns instead: of each column the part of the even sines,
        then that of the odd ones.

        pieces : pairs (columns of the potentials, the same columns of the modes), arrays (columns, nz or more).
        """
        for columns, modes in pieces:
            first = 0
            for sines in self.inverse:
                part = np.s_[:, first : first + len(sines)]
                if self.folds:
                    np.matmul(modes[part], sines, out=columns[part])
                else:
                    columns += np.matmul(modes[part], sines)
                first += len(sines)
