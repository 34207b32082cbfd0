"""Torque balance of equal springs, a Poisson problem, in the fields of operator splitting on any device.

On a GPU all of it is one launch. On a CPU the products with sines are those of the BLAS library, plane by plane, so
that no number depends on what else is solved at the time, nor on how many threads share the planes.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import Fields, FieldSpec, on_device, team_size
from taichi_bearings.kernels.balance import balance_kernels
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.lattice.laplacian import chain_eigenvalues, chain_factors, chain_modes
from taichi_bearings.numerics.blas import one_thread

SHARED_BY_BLAS = 32  # spheres along the height from which the BLAS library would use threads of its own

IN_CACHE = 65_536  # numbers that are still in the second cache when they are added to others


class TorqueBalance:
    """Adds u to the field `potential`: sum over axes a of weight_a (-Laplace_a) u = `pull`, u = 0 on driven planes.

    What is added is small once the springs nearly balance, and so is its rounding error.

    weights : one an axis, those sideways alike.
    """

    def __init__(self, spec: FieldSpec, stencil: Stencil, weights: tuple[float, ...], fields: Fields) -> None:
        self.fields, self.kernels, self.weight = fields, balance_kernels(spec, stencil), weights[0]
        shape, layout = fields.layout.shape, fields.layout
        self.modes, held = chain_modes(shape[-1] - 2, is_held=True), np.zeros(shape[-1])
        held[1:-1] = weights[-1] * chain_eigenvalues(shape[-1] - 2, is_held=True)
        sides = [shape[axis] for axis in stencil.coupled_sides]
        chains = np.zeros((len(sides), max(sides), shape[-1]))
        for slot, side in enumerate(sides):
            chains[slot, :side, 1:-1] = chain_factors(side, held[1:-1], self.weight)
        self.chains = self._table(chains)
        self.measures = self.kernels.measures(layout, max(sides))
        if runtime.current().is_gpu:
            self.sines, self.workers = on_device(self.modes), 0
            return
        self.sines, self.workers = self.modes.astype(fields.dtype), team_size(layout, stencil.components)
        self.each: Callable[..., Iterable[None]] = ThreadPoolExecutor(self.workers).map if self.workers > 1 else map

    def _table(self, rows: np.ndarray) -> Any:
        """Rows along the height for the kernels, continued from their begin by a block."""
        return on_device(np.take(rows, np.arange(rows.shape[-1] + self.fields.layout.block), axis=-1, mode="wrap"))

    def begin(self) -> AbstractContextManager[None]:
        """In which many solves are made."""
        alone = self.workers == 0 or len(self.modes) < SHARED_BY_BLAS
        return nullcontext() if alone else one_thread()

    def solve(self) -> None:
        """Change the spins of the free spheres so that the springs balance."""
        values = self.fields.values
        if self.workers == 0:
            self.kernels.on_gpu(values, self.sines, self.chains, *self.measures, self.weight)
            return
        self._share(self._to_modes)
        self.kernels.chains_on_cpu(self.workers, values, self.chains, *self.measures, self.weight)
        self._share(self._from_modes)

    def _share(self, task: Callable[[slice], None]) -> None:
        """Do it to all planes of the height and a side, a share a thread."""
        count = len(self._planes("modes")[0])
        ends = [count * n // self.workers for n in range(self.workers + 1)]
        list(self.each(task, map(slice, ends[:-1], ends[1:])))

    def _planes(self, name: str) -> list[np.ndarray]:
        """The free spheres of a field, one array (planes, side, free height) a component."""
        planes = (-1, *self.fields.layout.shape[-2:])
        return [component.reshape(planes)[..., 1:-1] for component in self.fields.view(name)]

    def _to_modes(self, part: slice) -> None:
        for pull, modes in zip(self._planes("pull"), self._planes("modes"), strict=True):
            np.matmul(pull[part], self.sines, out=modes[part])

    def _from_modes(self, part: slice) -> None:
        for modes, potential in zip(self._planes("modes"), self._planes("potential"), strict=True):
            few = max(1, IN_CACHE // modes[0].size)
            for first in range(part.start, part.stop, few):
                now = slice(first, min(first + few, part.stop))
                potential[now] += np.matmul(modes[now], self.sines)
