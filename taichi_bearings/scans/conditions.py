"""Chooses samples by conditions KEY=VALUE on their columns, and names the values of columns as such conditions do."""

from collections.abc import Mapping, Sequence

import numpy as np

from taichi_bearings.analysis.statistics import groups
from taichi_bearings.errors import InputError
from taichi_bearings.words import meant

LONGEST_NUMBER = 8  # letters of a number from which on it is rounded to six digits
LISTS_OF_NUMBERS = ("direction", "top", "bottom")  # settings that are lists of numbers, but no numbers of spheres


def meeting(conditions: Sequence[str], table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return a mask (samples,) of the samples that meet all conditions; perhaps all False, though each alone is met.

    conditions : texts KEY=VALUE: a sample must have this value in the column KEY. Texts are compared without regard to
        capital letters, numbers to the last bit.
    table : values (samples,) of columns, by name; at least one.

    Raises InputError for what is no such condition, and for one that no sample meets.
    """
    chosen = np.ones(len(next(iter(table.values()))), dtype=bool)
    for condition in conditions:
        key, equals, value = condition.partition("=")
        if key in table and not equals:
            some = named(key, table[key].tolist()[0])
            raise InputError(f"--where {condition!r} cannot be used; it must be KEY=VALUE, such as {key}={some}")
        if key not in table:
            raise InputError(
                f"--where {condition!r} cannot be used; it must be KEY=VALUE with a KEY of {', '.join(table)}"
                f"{meant(key, table)}"
            )
        values = table[key]
        if values.dtype == object or values.dtype == bool:
            # texts are compared as tables have them and as `named` writes them
            found = np.array([value.lower() in (str(v).lower(), named(key, v).lower()) for v in values.tolist()])
        else:
            try:
                found = values == float(value)
            except ValueError:
                raise InputError(
                    f"--where {condition!r} cannot be used; the column {key} holds numbers, so VALUE must be one"
                ) from None
        if not found.any():
            known = [named(key, v) for (v,) in groups(table, [key])]
            some = ", ".join(known[:20]) + " ..." * (len(known) > 20)
            raise InputError(f"--where {condition!r} selects no sample; {key} is one of {some}{meant(value, known)}")
        chosen &= found
    return chosen


def named(key: str, value: object) -> str:
    """Return a value of a column as figures and options name it.

    key : name of the column.
    value : text or number in the column. Vectors, which tables write with x between their numbers, get commas, and a
        semicolon before the rate C of a bearing state.

    >>> named("direction", "1x1x0"), named("top", "1x1x0x0.2"), named("shape", "4x4"), named("damping", 3162.27766)
    ('1,1,0', '1,1,0;0.2', '4x4', '3162.28')
    """
    if key in LISTS_OF_NUMBERS and isinstance(value, str):
        numbers = value.split("x")
        return ",".join(numbers[:3]) + "".join(f";{rate}" for rate in numbers[3:])
    text = str(value)
    return f"{value:g}" if isinstance(value, float) and len(text) > LONGEST_NUMBER else text
