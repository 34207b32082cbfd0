"""Allocate, load, read back and free Taichi fields; keep them, and their compiled kernels, for the next scene."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.errors import DeviceError
from taichi_bearings.lattice.layout import Layout

FieldSpec = tuple[tuple[str, int], ...]  # (name, number of components); site fields of the flat layout

CPU_BLOCK = 16  # sites a task handles at a time: long enough for SIMD, short enough for registers and for balance
LEAST_SHARE = 2_000  # site values a worker must have, or meeting the others would cost more than it saves
IDLE_BYTES = 256 * 2**20  # fields kept for the next scene; the least recently used go first


def make_layout(replicas: int, shape: tuple[int, ...]) -> Layout:
    """The flat layout for the running device: blocks for SIMD on a CPU, one site a thread on a GPU."""
    if runtime.current().is_gpu:
        return Layout(replicas, shape, block=1)
    return Layout(replicas, shape, block=CPU_BLOCK)


class Workspace:
    """Fields of one set of names with room for any layout up to `capacity` sites.

    Reused for the next scene with the same names, so that nothing is compiled or allocated again.
    """

    def __init__(self, spec: FieldSpec, capacity: int) -> None:
        import taichi as ti

        self.spec, self.capacity = spec, capacity
        self.fields: dict[str, Any] = {}
        self.busy = False
        self.layout: Layout
        self._kernels: dict[Any, Any] = {}
        builder = ti.FieldsBuilder()
        for name, components in spec:
            field = ti.Vector.field(components, float)
            for component in range(components):  # structure of arrays: inner loops run along memory
                builder.dense(ti.i, capacity).place(field.get_scalar_field(component))
            self.fields[name] = field
        self.fields["arrived"] = ti.field(ti.i32)  # where a team of workers counts itself
        builder.place(self.fields["arrived"])
        try:
            self._tree = builder.finalize()
        except RuntimeError as error:
            raise DeviceError(f"{self.bytes} bytes of fields do not fit on this device: {error}") from error

    @property
    def bytes(self) -> int:
        width = 8 if runtime.current().precision == "f64" else 4
        return self.capacity * width * sum(components for _, components in self.spec)

    def load(self, name: str, values: np.ndarray) -> None:
        """Copy (C, R, *N) into a field, zeros into its margins."""
        precision = np.float64 if runtime.current().precision == "f64" else np.float32
        self.fields[name].from_numpy(self.layout.flatten(values, self.capacity).astype(precision, copy=False))

    def read(self, name: str) -> np.ndarray:
        """A field as (C, R, *N), float64."""
        return self.layout.unflatten(self.fields[name].to_numpy())

    def clear(self, name: str) -> None:
        self.fields[name].fill(0)

    def kernels(self, factory: Callable[..., Any], *configuration: Any) -> Any:
        """``factory(fields, *configuration)``, made once for these fields and then reused."""
        key = (factory, configuration)
        if key not in self._kernels:
            self._kernels[key] = factory(self.fields, *configuration)
        return self._kernels[key]

    def destroy(self) -> None:
        self._kernels.clear()
        self.fields.clear()
        self._tree.destroy()


_pool: list[Workspace] = []


@contextmanager
def borrow(layout: Layout, spec: FieldSpec) -> Iterator[Workspace]:
    """Fields for `layout`: those of an earlier scene if they fit, else new ones."""
    fitting = [w for w in _pool if not w.busy and w.spec == spec and _fits(layout, w.capacity)]
    workspace = fitting[-1] if fitting else None  # the most recently used, whose kernels are the likeliest to serve
    if workspace is None:
        workspace = Workspace(spec, layout.length)
        _pool.append(workspace)
    workspace.layout, workspace.busy = layout, True
    try:
        yield workspace
    finally:
        workspace.busy = False
        _pool.remove(workspace)
        _pool.append(workspace)  # most recently used last
        while sum(w.bytes for w in _pool if not w.busy) > IDLE_BYTES:
            _release(next(w for w in _pool if not w.busy))


def _fits(layout: Layout, capacity: int) -> bool:
    """Big enough, and not so big that moving it to and fro would cost more than compiling anew."""
    return layout.length <= capacity <= max(8 * layout.length, 100_000)


def release_all() -> None:
    """Free every field that is not in use."""
    for workspace in [w for w in _pool if not w.busy]:
        _release(workspace)


def _release(workspace: Workspace) -> None:
    _pool.remove(workspace)
    workspace.destroy()


def team_size(layout: Layout, components: int) -> int:
    """Workers for kernels that keep `components` numbers a site: 0 on a GPU, else as many threads as pay."""
    running = runtime.current()
    if running.is_gpu:
        return 0
    return max(1, min(running.threads, layout.sites * components // LEAST_SHARE))
