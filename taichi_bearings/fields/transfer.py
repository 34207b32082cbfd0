"""Copies rows between the memory of a GPU and NumPy, and nothing but these rows."""

from taichi_bearings.compiler import ti


@ti.kernel
def copy_in(values: ti.types.ndarray(ndim=1), rows: ti.types.ndarray(ndim=2), first: int, length: int):
    """Write rows (C components, n) of NumPy to `values` on the device, the first one from the index `first` on, each
    `length` after the one before."""
    for row, place in ti.ndrange(rows.shape[0], rows.shape[1]):
        values[first + row * length + place] = rows[row, place]


@ti.kernel
def copy_out(values: ti.types.ndarray(ndim=1), rows: ti.types.ndarray(ndim=2), first: int, length: int):
    """Read rows (C components, n) for NumPy from `values` on the device: the first one from the index `first` on, each
    `length` after the one before."""
    for row, place in ti.ndrange(rows.shape[0], rows.shape[1]):
        rows[row, place] = values[first + row * length + place]
