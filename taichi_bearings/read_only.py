"""Makes arrays that cannot be written into, so that what is said of an answer stays true of its arrays."""

from collections.abc import Callable, Mapping
from functools import cached_property, wraps
from typing import Any, TypeVar

import numpy as np

Value = TypeVar("Value")


def read_only(value: Value) -> Value:
    """Make the arrays in a value unwritable, also those in tuples, lists and mappings, and return the value."""
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, (tuple, list)):
        for part in value:
            read_only(part)
    elif isinstance(value, Mapping):
        for part in value.values():
            read_only(part)
    return value


def cached_read_only(method: Callable[[Any], Value]) -> "cached_property[Value]":
    """Return a property that is computed once, and whose arrays cannot be written into.

    method : the method that computes it.
    """

    @wraps(method)
    def found(owner: object) -> Value:
        """Compute the value of the property of an object (`owner`), and make its arrays unwritable."""
        return read_only(method(owner))

    return cached_property(found)
