"""What can be given: an option is declared once, by the run, the method or the law that owns it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

from taichi_bearings.errors import InputError


@dataclass(frozen=True)
class Kind:
    """How a value is read and what is allowed, in words that complete "it must be ..."."""

    read: Callable[[Any], Any]
    allowed: str
    metavar: str
    choices: tuple[str, ...] = ()


def numbers(convert: Callable[[Any], Any], counts: tuple[int, ...]) -> Callable[[Any], Any]:
    def read(value: Any) -> tuple:
        parts = value.replace("x", ",").split(",") if isinstance(value, str) else list(value)
        if len(parts) not in counts:
            raise ValueError
        return tuple(convert(part) for part in parts)

    return read


def integer(value: Any) -> int:
    if isinstance(value, bool) or (isinstance(value, float) and not value.is_integer()):
        raise ValueError
    return int(value)


def real(value: Any) -> float:
    if isinstance(value, bool):
        raise ValueError
    number = float(value)
    if math.isnan(number):
        raise ValueError
    return number


def _signed(value: Any) -> float:
    number = real(value)
    if number and not LEAST <= abs(number) <= MOST:
        raise ValueError
    return number


def _truth(value: Any) -> bool:
    if isinstance(value, bool):
        return value
    return {"true": True, "false": False}[str(value).lower()]


def bounded(convert: Callable[[Any], Any], low: float, high: float = math.inf, open_low: bool = False) -> Callable:
    def read(value: Any) -> Any:
        number = convert(value)
        if not (low < number if open_low else low <= number) or not number <= high:
            raise ValueError
        return number

    return read


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError
    value.encode()  # UnicodeEncodeError, a ValueError, for what is not UTF-8 and so cannot be written down
    return value


def one_of(*choices: str) -> Kind:
    def read(value: Any) -> str:
        if value not in choices:
            raise ValueError
        return value

    return Kind(read, "one of " + ", ".join(choices), "|".join(choices), choices)


LEAST, MOST = 1e-15, 1e15  # squares and products of such numbers stay far from overflow, in f32 too
TEXT = Kind(_text, "a text in UTF-8", "TEXT")
FILE = Kind(_text, "the name of a file, in UTF-8", "FILE")
REAL = Kind(_signed, "0 or a number of size 1e-15 to 1e15", "NUMBER")
POSITIVE = Kind(bounded(real, LEAST, MOST), "a positive number from 1e-15 to 1e15", "NUMBER")
NOT_NEGATIVE = Kind(bounded(real, 0, MOST), "0 or a positive number up to 1e15", "NUMBER")
COUNT = Kind(bounded(integer, 1, 2**31), "a whole number, 1 or more", "N")
SEED = Kind(bounded(integer, 0, 2**62), "a whole number, 0 or more and below 2^62", "N")
TRUTH = Kind(_truth, "true or false", "")


@dataclass(frozen=True)
class Option:
    """One thing that can be given.

    default : None where it is left to what uses it. unit : "1" for a pure number.
    laws : True for one that uses it; None for all. of_solving : it says how a system is solved, not which one it is.
    unset : wherever a run is described None stands for the default, as if it were not given.
    """

    default: Any
    kind: Kind
    help: str
    unit: str = "1"
    laws: Callable[[Any], bool] | None = None
    of_solving: bool = False
    unset: bool = False

    def read(self, name: str, value: Any) -> Any:
        """The value as it is kept; InputError names it and what is allowed."""
        if value is None and self.default is None:
            return None
        try:
            return self.kind.read(value)
        except (ValueError, TypeError, KeyError, OverflowError):
            shown = ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
            raise InputError(f"{name} is {shown!r}; it must be {self.kind.allowed}") from None


def option(default: Any, kind: Kind, help: str, **facts: Any) -> Any:
    """A field of a dataclass that is an :class:`Option`, whose other facts can be given by name."""
    return field(default=default, metadata={"option": Option(default, kind, help, **facts)})


def options_of(owner: Any) -> dict[str, Option]:
    """The options that a dataclass declares, by name."""
    return {item.name: item.metadata["option"] for item in fields(owner)}
