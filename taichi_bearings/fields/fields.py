"""The fields of a scene: one array on the device, with a row for each number that a site has.

Letters: C components of a field, R replicas, N shape of the lattice or number of spheres, E contacts.
"""

from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike

from taichi_bearings import runtime
from taichi_bearings.errors import DeviceError
from taichi_bearings.lattice.layout import Layout, Rows
from taichi_bearings.memory import aligned_zeros

if TYPE_CHECKING:
    from taichi_bearings.fields.lists import Lists

FieldSpec = tuple[tuple[str, int], ...]  # (name, number of components); site fields of the flat layout

CPU_BLOCK = 16  # sites that a CPU works on together: enough for SIMD, few enough for registers and for even shares
LEAST_WORKER_NUMBERS = 2_000  # with fewer numbers a worker waits longer for the others than it helps
MOST_FIELD_NUMBERS = 2**30  # most numbers in all fields of a scene, so that kernels can index them


def block_size() -> int:
    """Return how many sites a kernel works on together: a block for SIMD on a CPU, one site a thread on a GPU."""
    return 1 if runtime.current().is_gpu else CPU_BLOCK


def number_type() -> np.dtype:
    """Return the type of every number that kernels work on: double or single, as the precision of the runtime says."""
    return np.dtype(np.float64 if runtime.current().precision == "f64" else np.float32)


def on_device(values: np.ndarray, kind: DTypeLike | None = None) -> Any:
    """Return a flat copy of an array where kernels can read it: an array of NumPy on a CPU, of Taichi on a GPU.

    values : numbers, of any shape; the copy has them in C order.
    kind : type of the numbers there, such as np.int32; by default the precision of the runtime.
    """
    running = runtime.current()
    flat = values.ravel().astype(number_type() if kind is None else kind)
    if not running.is_gpu:
        return flat
    from taichi_bearings.compiler import ti

    array = ti.ndarray(getattr(ti, running.precision if kind is None else np.dtype(kind).name), flat.size)
    array.from_numpy(flat)
    return array


def one_block() -> Any:
    """Return a small array that kernels get on a GPU in place of the view of the fields by blocks, which only CPUs
    use.
    """
    from taichi_bearings.compiler import ti

    return ti.Vector.ndarray(1, getattr(ti, runtime.current().precision), 1)


def first_slots(spec: FieldSpec) -> dict[str, int]:
    """Return by name the row at which each field begins.

    spec : names and numbers of components of the fields, in order.
    """
    counts = [components for _, components in spec]
    return {name: sum(counts[:n]) for n, (name, _) in enumerate(spec)}


class Fields:
    """The numbers of all spheres, or spheres and contacts, that kernels work on, in one array on the device; all 0 at
    first.

    A field has a name and C components; each component is a row of numbers. A spec lists names and components. Kernels
    know the rows of the fields when they are compiled, and the length of the rows when they are called. So no shape,
    number of samples or size compiles anything anew. On a CPU the array is NumPy's, which kernels work on in place.

    values : the array that kernels get: the rows of all fields, one after the other.
    blocks : on a CPU the same memory as an array (blocks, sites of a block), so that kernels can write a block at once;
        on a GPU an array that is not used.
    tables : the integers `measures` of the layout, where kernels can read them.
    layout : how the spheres and contacts follow each other in a row.
    dtype : type of the numbers.
    """

    def __init__(self, layout: "Layout | Lists", spec: Any, kind: DTypeLike | None = None) -> None:
        """Allocate the fields.

        layout : a `Layout` of lattices, or `Lists` of spheres and contacts.
        spec : name and number of components of each field; with `Lists` a pair, for spheres and for contacts.
        kind : type of the numbers, used on a CPU alone; by default that of the precision of the runtime.

        Raises DeviceError if the numbers are more than kernels can index, or do not fit into the memory.
        """
        self.layout: Any = layout  # users of strides ask it for other things than users of lists
        self.dtype, count = number_type() if kind is None else np.dtype(kind), 0
        self._place: dict[str, tuple[int, int, Rows]] = {}  # of a field: index of its first number, C, row layout
        for names, rows in self.layout.parts(spec):
            for name, components in names:
                self._place[name] = count, components, rows
                count += components * rows.length
        if count > MOST_FIELD_NUMBERS:
            most = MOST_FIELD_NUMBERS
            raise DeviceError(
                f"{layout.sites} spheres need {count} numbers in one array, which can have at most {most}; take "
                "fewer spheres"
            )
        try:
            self.values, self._host = self._allocate(count)
        except (RuntimeError, MemoryError) as error:
            size = count * self.dtype.itemsize
            raise DeviceError(f"arrays of {size} bytes do not fit into the memory of this device: {error}") from error
        self.blocks = one_block() if self._host is None else self._host.reshape(-1, layout.block)
        self.tables = on_device(np.array(layout.measures), np.int32)

    @property
    def names(self) -> list[str]:
        """Names of the fields."""
        return list(self._place)

    def _allocate(self, count: int) -> tuple[Any, np.ndarray | None]:
        """Return an array of `count` zeros that kernels take and, on a CPU, the same array for NumPy, else None."""
        if not runtime.current().is_gpu:
            host = aligned_zeros(count, self.layout.block, self.dtype)
            return host, host
        from taichi_bearings.compiler import ti

        values = ti.ndarray(getattr(ti, runtime.current().precision), count)
        values.fill(0)
        return values, None

    def part(self, number: int) -> "Fields":
        """Return the fields of one of several samples, which share the memory of this object. The layout must be
        `Lists`, in which samples stand one after the other.

        number : number of the sample, from 0.
        """
        found = copy(self)
        found._place = {
            name: (first, components, rows._replace(margin=number * (rows.length // self.layout.copies)))
            for name, (first, components, rows) in self._place.items()
        }
        return found

    def load(self, name: str, values: np.ndarray) -> None:
        """Set a field to given values; numbers in the margins of its rows stay.

        name : name of the field, which has C components.
        values : (C, R samples, *N spheres) on a lattice; in `Lists` (C, 1, N spheres) or (C, 1, E contacts).
        """
        first, components, rows = self._place[name]
        given = values.reshape(components, int(np.prod(rows.shape)))[:, rows.order]
        if self._host is not None:
            self._inside(name)[...] = given
            return
        from taichi_bearings.fields.transfer import copy_in

        copy_in(self.values, np.ascontiguousarray(given, self.dtype), first + rows.margin, rows.length)

    def read(self, name: str) -> np.ndarray:
        """Return a field as an array in double precision: (C components, R samples, *N spheres) of a lattice; of a
        packing (C, 1, N spheres) of spheres or (C, 1, E contacts) of contacts.

        name : name of the field.
        """
        first, components, rows = self._place[name]
        if self._host is not None:
            stored = self._inside(name)
        else:
            from taichi_bearings.fields.transfer import copy_out

            stored = np.zeros((components, int(np.prod(rows.shape))), self.dtype)
            copy_out(self.values, stored, first + rows.margin, rows.length)
        found = np.empty(stored.shape)
        found[:, rows.order] = stored
        return found.reshape(components, *rows.shape)

    def clear(self, name: str) -> None:
        """Set all numbers of the field `name` to 0."""
        _, components, rows = self._place[name]
        self.load(name, np.zeros((components, *rows.shape)))

    def view(self, name: str) -> np.ndarray:
        """Return a field of a lattice as an array (C components, R samples, *N spheres) in the memory of a CPU, not
        copied.

        name : name of the field.
        """
        return self._inside(name).reshape(-1, *self._place[name][2].shape)

    def _inside(self, name: str) -> np.ndarray:
        """Return a view of a field in the memory of a CPU: (C components, spheres or contacts), without the margins of
        its rows, in the order in which they stand there.

        name : name of the field.
        """
        assert self._host is not None
        first, components, rows = self._place[name]
        whole = self._host[first : first + components * rows.length].reshape(components, rows.length)
        return whole[:, rows.margin : rows.margin + int(np.prod(rows.shape))]


def team_size(layout: "Layout | Lists", components: int) -> int:
    """Return how many threads it pays to use for kernels that work on `components` numbers of each sphere; 0 on a GPU.

    layout : how the spheres, of all samples, follow each other in memory.
    """
    running = runtime.current()
    if running.is_gpu:
        return 0
    return max(1, min(running.threads, layout.sites * components // LEAST_WORKER_NUMBERS))
