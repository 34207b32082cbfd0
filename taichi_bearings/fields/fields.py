"""The fields of a scene: one array on the device, a row for each number that a site has."""

from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.errors import DeviceError
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.memory import aligned_zeros

FieldSpec = tuple[tuple[str, int], ...]  # (name, number of components); site fields of the flat layout

CPU_BLOCK = 16  # sites a task handles at a time: long enough for SIMD, short enough for registers and for balance
LEAST_WORKER_NUMBERS = 2_000  # site values a worker must have, or meeting the others would cost more than it saves
MOST_FIELD_NUMBERS = 2**30  # in all fields of a scene, so that kernels can index them


def make_layout(replicas: int, shape: tuple[int, ...], periodic: tuple[int, ...] = ()) -> Layout:
    """The flat layout for the running device: blocks for SIMD on a CPU, one site a thread on a GPU."""
    return Layout(replicas, shape, 1 if runtime.current().is_gpu else CPU_BLOCK, periodic)


def number_type() -> np.dtype:
    """Of every number that kernels work on."""
    return np.dtype(np.float64 if runtime.current().precision == "f64" else np.float32)


def on_device(values: np.ndarray, kind: str = "") -> Any:
    """Numbers beside the fields, flat, where kernels read them: on a CPU NumPy's. kind : "i32", or as the fields."""
    running = runtime.current()
    flat = values.ravel().astype(kind.replace("i", "int") or number_type())
    if not running.is_gpu:
        return flat
    from taichi_bearings.compiler import ti

    array = ti.ndarray(getattr(ti, kind or running.precision), flat.size)
    array.from_numpy(flat)
    return array


def one_block() -> Any:
    """What kernels get in the place of blocks on a GPU, where they write site by site."""
    from taichi_bearings.compiler import ti

    return ti.Vector.ndarray(1, getattr(ti, runtime.current().precision), 1)


def first_slots(spec: FieldSpec) -> dict[str, int]:
    """The row at which each field begins."""
    counts = [components for _, components in spec]
    return {name: sum(counts[:n]) for n, (name, _) in enumerate(spec)}


class Fields:
    """Fields named in `spec` on the sites of `layout`, all 0 at first.

    Kernels know the rows of the fields when they are compiled, the length of the rows when they are called: no shape,
    number of replicas or size compiles anything anew. On a CPU the array is NumPy's, which kernels work on in place.

    values : what kernels take: all rows one after the other.
    blocks : on a CPU the same memory in blocks of sites, which kernels write as a whole; on a GPU nothing of use.
    tables : the measures of the layout, for kernels.
    """

    def __init__(self, layout: Layout, spec: FieldSpec) -> None:
        self.layout, self.slot, self.components = layout, first_slots(spec), dict(spec)
        self.rows = sum(self.components.values())
        self.dtype = number_type()
        if self.rows * layout.length > MOST_FIELD_NUMBERS:
            most = MOST_FIELD_NUMBERS // self.rows
            raise DeviceError(f"{layout.sites} spheres are too many here; this method can index about {most}")
        try:
            self.values, self._host = self._allocate()
        except (RuntimeError, MemoryError) as error:
            size = self.rows * layout.length * self.dtype.itemsize
            raise DeviceError(f"{size} bytes of fields do not fit on this device: {error}") from error
        self.blocks = one_block() if self._host is None else self._host.reshape(-1, layout.block)
        self.tables = on_device(np.array(layout.measures), "i32")

    def _allocate(self) -> tuple[Any, np.ndarray | None]:
        count = self.rows * self.layout.length
        if not runtime.current().is_gpu:
            flat = aligned_zeros(count, self.layout.block, self.dtype)
            return flat, flat.reshape(self.rows, -1)
        from taichi_bearings.compiler import ti

        values = ti.ndarray(getattr(ti, runtime.current().precision), count)
        values.fill(0)
        return values, None

    def load(self, name: str, values: np.ndarray) -> None:
        """Set a field from (C, R, *N); margins stay."""
        if self._host is not None:
            self.view(name)[...] = values
            return
        from taichi_bearings.fields.transfer import copy_in

        copy_in(self.values, np.ascontiguousarray(values.reshape(len(values), -1), self.dtype), *self._place(name))

    def read(self, name: str) -> np.ndarray:
        """A field as (C, R, *N), float64."""
        if self._host is not None:
            return self.view(name).astype(np.float64)
        from taichi_bearings.fields.transfer import copy_out

        found = np.zeros((self.components[name], self.layout.sites), self.dtype)
        copy_out(self.values, found, *self._place(name))
        return found.astype(np.float64).reshape(-1, self.layout.replicas, *self.layout.shape)

    def seen(self, name: str) -> np.ndarray:
        """The same to look at: what lies in the memory of a CPU in double precision is not copied."""
        return self.read(name) if self._host is None else self.view(name).astype(np.float64, copy=False)

    def clear(self, name: str) -> None:
        self.load(name, np.zeros((self.components[name], self.layout.replicas, *self.layout.shape)))

    def view(self, name: str) -> np.ndarray:
        """A field in the memory of a CPU as (C, R, *N), not copied."""
        assert self._host is not None
        rows = slice(self.slot[name], self.slot[name] + self.components[name])
        return self._host[rows, self.layout.inside].reshape(-1, self.layout.replicas, *self.layout.shape)

    def _place(self, name: str) -> tuple[int, int]:
        """Where a field begins in `values`, and how far apart its rows are."""
        return self.slot[name] * self.layout.length + self.layout.margin, self.layout.length


def team_size(layout: Layout, components: int) -> int:
    """Workers for kernels that keep `components` numbers a site: 0 on a GPU, else as many threads as pay."""
    running = runtime.current()
    if running.is_gpu:
        return 0
    return max(1, min(running.threads, layout.sites * components // LEAST_WORKER_NUMBERS))
