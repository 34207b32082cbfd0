"""Copies rows between the memory of a GPU and NumPy, and nothing but these rows."""

from taichi_bearings.compiler import ti


@ti.kernel
def copy_in(values: ti.types.ndarray(ndim=1), rows: ti.types.ndarray(ndim=2), first: int, length: int):
    """Copy rows of numbers from NumPy into an array on the device.

    values : (numbers,), the array on the device, changed.
    rows : (components, sites), the rows.
    first : index in `values` of the first number of the first row.
    length : distance in `values` from the beginning of one row to that of the next.
    """
    for row, place in ti.ndrange(rows.shape[0], rows.shape[1]):
        values[first + row * length + place] = rows[row, place]


@ti.kernel
def copy_out(values: ti.types.ndarray(ndim=1), rows: ti.types.ndarray(ndim=2), first: int, length: int):
    """Copy rows of numbers from an array on the device to NumPy.

    values : (numbers,), the array on the device.
    rows : (components, sites), the rows, filled in.
    first : index in `values` of the first number of the first row.
    length : distance in `values` from the beginning of one row to that of the next.
    """
    for row, place in ti.ndrange(rows.shape[0], rows.shape[1]):
        rows[row, place] = values[first + row * length + place]
