"""Numbers and arrays that users bring: checked, and copied so that nobody else can change them later."""

from math import isfinite
from numbers import Real
from typing import Any

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.options import plain
from taichi_bearings.words import shown


def finite_number(name: str, value: Any) -> float:
    """A real number of Python or NumPy as a float; InputError for texts, truth values and what no float holds."""
    try:
        number = plain(value)
        if isinstance(number, Real) and not isinstance(number, bool) and isfinite(float(number)):
            return float(number)
    except (ValueError, OverflowError):
        pass
    raise InputError(f"{name} is {shown(value)}; it must be a finite number")


def own_array(name: str, values: Any) -> np.ndarray:
    """A read-only copy in float64. name : in the plural, for the InputError about what is not real or is masked."""
    try:
        array = np.asanyarray(values)
    except ValueError:
        raise InputError(f"{name} are lists of unequal lengths; they must be an array of real numbers") from None
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name} are of type {array.dtype}; they must be real numbers")
    if np.ma.is_masked(array):
        raise InputError(f"{name} have masked entries; every entry must be a number")
    with np.errstate(over="ignore"):  # of longer floats; infinities are refused later
        copy = np.array(array, dtype=np.float64, order="C", subok=False)
    copy.setflags(write=False)
    return copy
