"""Torque balance of equal springs, a Poisson problem, in the fields of operator splitting on any device.

On a GPU all of it is one launch. On a CPU the products with sines are those of the BLAS library, plane by plane, so
that no number depends on what else is solved at the time, nor on how many threads share the planes. They are in single
precision, which is twice as fast: what is solved for is a change, and the next change makes up for its rounding.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from itertools import repeat
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import Fields, FieldSpec, on_device, team_size
from taichi_bearings.kernels.balance import balance_kernels
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.lattice.laplacian import chain_eigenvalues, chain_factors, chain_modes, ring_closures
from taichi_bearings.numerics.blas import one_thread

SHARED_BY_BLAS = 32  # spheres along the height from which the BLAS library would use threads of its own

PRODUCT_TYPE = np.float32  # numbers that are multiplied on a CPU
CACHED_NUMBERS = 65_536  # numbers that are still in the second cache when they are added to others

Planes = list[tuple[np.ndarray, np.ndarray]]


class TorqueBalance:
    """Adds u to the field `potential`: sum over axes a of weight_a (-Laplace_a) u = `pull`, u = 0 on driven planes.

    What is added is small once the springs nearly balance, and so is its rounding error.

    weights : one an axis, those sideways alike.
    """

    def __init__(self, spec: FieldSpec, stencil: Stencil, weights: tuple[float, ...], fields: Fields) -> None:
        self.fields, self.kernels, self.weight = fields, balance_kernels(spec, stencil), weights[0]
        shape, layout = fields.layout.shape, fields.layout
        self.products = min(np.dtype(PRODUCT_TYPE), fields.dtype, key=lambda kind: kind.itemsize)
        modes, held = chain_modes(shape[-1] - 2, is_held=True), np.zeros(shape[-1])
        held[1:-1] = weights[-1] * chain_eigenvalues(shape[-1] - 2, is_held=True)
        sides = [shape[axis] for axis in stencil.coupled_sides]
        numbers = (chain_factors, ring_closures)[: 2 if stencil.periodic else 1]
        chains = np.zeros((len(numbers), len(sides), max(sides), shape[-1]))
        for kind, number in enumerate(numbers):
            for slot, side in enumerate(sides):
                chains[kind, slot, :side, 1:-1] = number(side, held[1:-1], self.weight)
        padded = np.arange(shape[-1] + layout.block)  # rows go on from their begin for a block
        self.chains = self._numbers(np.take(chains, padded, axis=-1, mode="wrap").ravel())
        self.modes = self._numbers(np.zeros(len(sides) * layout.sites + layout.block))
        self.measures = self.kernels.measures(layout, max(sides))
        on_gpu = runtime.current().is_gpu
        # on a CPU 0 for driven spheres: rows that are whole are worth more than the products that are not needed
        self.sines = self._numbers(modes if on_gpu else np.pad(modes, 1))
        self.workers = team_size(layout, stencil.components)
        self.each: Callable[..., Iterable[None]] = ThreadPoolExecutor(self.workers).map if self.workers > 1 else map
        self.is_rough = self.workers > 0 and self.products != fields.dtype
        self.is_small = shape[-1] < SHARED_BY_BLAS
        if self.workers:
            self.pulls, self.potentials = self._shares("pull"), self._shares("potential")

    def _numbers(self, values: np.ndarray) -> Any:
        """Numbers beside the fields: on a GPU as precise as these."""
        return on_device(values) if runtime.current().is_gpu else values.astype(self.products)

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
        list(self.each(_to_modes, self.pulls, repeat(self.sines)))
        self.kernels.chains_on_cpu(self.workers, self.modes, self.chains, *self.measures, self.weight)
        list(self.each(_from_modes, self.potentials, repeat(self.sines)))

    def _shares(self, name: str) -> list[Planes]:
        """The spheres of a field and their modes, a few planes across a side at a time, a list a thread."""
        layout = self.fields.layout
        planes, room = (-1, *layout.shape[-2:]), self.modes[: -layout.block].reshape(-1, layout.sites)
        shares: list[Planes] = [[] for _ in range(self.workers)]
        for parts in zip(self.fields.view(name), room, strict=True):
            field, modes = (part.reshape(planes) for part in parts)
            few = max(1, CACHED_NUMBERS // field[0].size)
            for worker, share in enumerate(shares):
                first, last = (len(field) * n // self.workers for n in (worker, worker + 1))
                share += [
                    (field[n : min(n + few, last)], modes[n : min(n + few, last)]) for n in range(first, last, few)
                ]
        return shares


def _to_modes(planes: Planes, sines: np.ndarray) -> None:
    for pull, modes in planes:
        np.matmul(pull.astype(sines.dtype, copy=False), sines, out=modes)


def _from_modes(planes: Planes, sines: np.ndarray) -> None:
    for potential, modes in planes:
        potential += np.matmul(modes, sines)
