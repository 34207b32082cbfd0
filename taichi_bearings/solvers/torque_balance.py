"""Torque balance of equal springs, a Poisson problem, in the fields of operator splitting on any device.

On a GPU all of it is one launch. On a CPU the products with sines are those of the BLAS library, plane by plane, so
that no number depends on what else is solved at the time, nor on how many threads share the planes. They are in single
precision, which is twice as fast: what is solved for is a change, and the next change makes up for its rounding.
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
        modes, held = chain_modes(shape[-1] - 2, is_held=True), np.zeros(shape[-1])
        held[1:-1] = weights[-1] * chain_eigenvalues(shape[-1] - 2, is_held=True)
        sides = [shape[axis] for axis in stencil.coupled_sides]
        chains = np.zeros((len(sides), max(sides), shape[-1]))
        for slot, side in enumerate(sides):
            chains[slot, :side, 1:-1] = chain_factors(side, held[1:-1], self.weight)
        padded = np.arange(shape[-1] + layout.block)  # rows go on from their begin for a block
        self.chains = self._numbers(np.take(chains, padded, axis=-1, mode="wrap").ravel())
        self.modes = self._numbers(np.zeros(len(sides) * layout.sites + layout.block))
        self.measures = self.kernels.measures(layout, max(sides))
        self.sines = self._numbers(modes)
        self.workers = team_size(layout, stencil.components)
        self.each: Callable[..., Iterable[None]] = ThreadPoolExecutor(self.workers).map if self.workers > 1 else map
        self.is_rough = self.workers > 0 and fields.dtype == np.float64
        self.is_small = len(modes) < SHARED_BY_BLAS

    def _numbers(self, values: np.ndarray) -> Any:
        """Numbers beside the fields: on a GPU as precise as these."""
        return on_device(values) if runtime.current().is_gpu else values.astype(np.float32)

    def begin(self) -> AbstractContextManager[None]:
        """In which many solves are made."""
        return nullcontext() if self.workers == 0 or self.is_small else one_thread()

    def solve(self) -> None:
        """Change the spins of the free spheres so that the springs balance."""
        layout = self.fields.layout
        if self.workers == 0:
            values, places = self.fields.values, (layout.length, layout.margin)
            self.kernels.on_gpu(values, self.modes, self.sines, self.chains, *places, *self.measures, self.weight)
            return
        self._by_planes("pull", self._to_modes)
        self.kernels.chains_on_cpu(self.workers, self.modes, self.chains, *self.measures, self.weight)
        self._by_planes("potential", self._from_modes)

    def _by_planes(self, name: str, task: Callable[[np.ndarray, np.ndarray], None]) -> None:
        """Do it to the free spheres of a field and their modes, a few planes across a side at a time."""
        layout = self.fields.layout
        planes, room = (-1, *layout.shape[-2:]), self.modes[: -layout.block].reshape(-1, layout.sites)
        both = [
            tuple(part.reshape(planes)[..., 1:-1] for part in parts)
            for parts in zip(self.fields.view(name), room, strict=True)
        ]
        count, few = len(both[0][0]), max(1, IN_CACHE // both[0][0][0].size)

        def share(worker: int) -> None:
            last = count * (worker + 1) // self.workers
            for field, modes in both:
                for first in range(count * worker // self.workers, last, few):
                    task(field[first : min(first + few, last)], modes[first : min(first + few, last)])

        list(self.each(share, range(self.workers)))

    def _to_modes(self, pull: np.ndarray, modes: np.ndarray) -> None:
        np.matmul(pull.astype(np.float32, copy=False), self.sines, out=modes)

    def _from_modes(self, potential: np.ndarray, modes: np.ndarray) -> None:
        potential += np.matmul(modes, self.sines)
