"""Options: what can be given, each declared once, by the run, the method or the law that owns it."""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from numbers import Real
from types import MappingProxyType
from typing import Any

from taichi_bearings.errors import InputError
from taichi_bearings.words import meant, shown

Reader = Callable[[Any], Any]  # turns a given value into the one that is kept, or raises ValueError


class Kind:
    """How the value of an option is read, and which values are allowed.

    read : function that turns a given value into the one that is kept; ValueError, TypeError, KeyError or OverflowError
        if it cannot.
    allowed : words that complete "it must be ...".
    metavar : what stands for the value in help texts.
    known : the words among which the value must be, for suggestions to mistyped ones; empty for numbers and free texts.
    """

    known: Collection[str] = ()

    def __init__(self, read: Reader, allowed: str, metavar: str) -> None:
        """Store the attributes `read`, `allowed` and `metavar`."""
        self.read, self.allowed, self.metavar = read, allowed, metavar

    def named(self, name: str, value: object) -> Any:
        """Return a given value in the form in which it is stored. Raises InputError, which names the option, the value
        and what is allowed, for a value that is not.

        name : name of the option.
        """
        try:
            return self.read(value)
        except (ValueError, TypeError, KeyError, OverflowError):
            try:
                text = ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
            except ValueError:  # more digits than Python writes
                text = shown(value)
            is_list_of_names = self.known and isinstance(value, (list, tuple))  # a list is no name, whatever it holds
            said = shown(value if is_list_of_names else text)
            hint = "" if is_list_of_names else meant(text, self.known)
            raise InputError(f"{name} is {said}; it must be {self.allowed}{hint}") from None


def numbers(convert: Reader, counts: tuple[int, ...]) -> Reader:
    """Return a function that reads several numbers from a text such as 32,32,32 or 32x32x32, or from a list.

    convert : function that reads each of them.
    counts : how many there may be.
    """

    def read(value: Any) -> tuple[Any, ...]:
        """Return the numbers in `value` as a tuple; raise ValueError if there are too many or too few."""
        parts = value.replace("x", ",").split(",") if isinstance(value, str) else list(value)
        if len(parts) not in counts:
            raise ValueError
        return tuple(convert(part) for part in parts)

    return read


def plain(value: object) -> Any:
    """Return a scalar of NumPy as a number of Python, any other value as it is; ValueError for arrays and masked
    numbers.
    """
    if not hasattr(value, "item"):
        return value
    if getattr(value, "ndim", 0) or getattr(value, "mask", False):
        raise ValueError
    return value.item()


def integer(value: Any) -> int:
    """Return a value as a whole number; ValueError for truth values and numbers that are not whole."""
    value = plain(value)
    number = int(value)
    if isinstance(value, bool) or (not isinstance(value, str) and number != value):
        raise ValueError
    return number


def real(value: Any) -> float:
    """Return a value as a float; ValueError for truth values and not-a-number."""
    value = plain(value)
    if isinstance(value, bool):
        raise ValueError
    number = float(value)
    if math.isnan(number):
        raise ValueError
    return number


def _moderate_number(value: object) -> float:
    """Return a value as a float that is 0 or of a size between LEAST_NUMBER and MOST_NUMBER; else ValueError."""
    number = real(value)
    if number and not LEAST_NUMBER <= abs(number) <= MOST_NUMBER:
        raise ValueError
    return number


def _truth(value: object) -> bool:
    """Return a truth value, or that of the texts "true" and "false"; KeyError for others."""
    if isinstance(value, bool):
        return value
    return {"true": True, "false": False}[str(value).lower()]


def bounded(convert: Reader, low: float, high: float = math.inf, open_low: bool = False) -> Reader:
    """Return a function that reads a number and raises ValueError if it is not from `low` to `high`.

    convert : function that reads the number.
    low, high : the limits, which are allowed themselves.
    open_low : True if `low` itself is not allowed.
    """

    def read(value: Any) -> Any:
        """Return the number in `value`; raise ValueError if it is out of range."""
        number = convert(value)
        if not (low < number if open_low else low <= number) or not number <= high:
            raise ValueError
        return number

    return read


def whole(least: int, most: int) -> Kind:
    """Return the kind of whole numbers from `least` to `most`."""
    return Kind(bounded(integer, least, most), f"a whole number from {least:,} to {most:,}", "N")


def _text(value: object) -> str:
    """Return `value` if it is a text that is not empty and can be written in UTF-8; else raise ValueError."""
    if not isinstance(value, str) or not value:
        raise ValueError
    value.encode()  # UnicodeEncodeError, a ValueError, for what is not UTF-8 and so cannot be written down
    return value


def finite_number(name: str, value: object) -> float:
    """Return a real number of Python or NumPy as a float; raise InputError for anything else, truth values and
    infinities too.

    name : name of the argument, for the message.
    value : what was given.
    """
    try:
        number = plain(value)
        if isinstance(number, Real) and not isinstance(number, bool) and math.isfinite(float(number)):
            return float(number)
    except (ValueError, OverflowError):
        pass
    raise InputError(f"{name} is {shown(value)}; it must be a finite number")


class OneOf(Kind):
    """The kind of values that are one of some names.

    names : the names.
    table : holds more names as its keys, and can grow.
    """

    def __init__(self, *names: str, table: Mapping[str, object] = MappingProxyType({})) -> None:
        """Take the names that are allowed: `names`, and the keys of `table`, which may get more later."""
        self.names, self.table = names, table

    def read(self, value: Any) -> str:
        """Return the value if it is one of the names; else ValueError."""
        if value not in self.known:
            raise ValueError
        found: str = value
        return found

    @property
    def known(self) -> tuple[str, ...]:  # type: ignore[override]
        """All names."""
        return (*self.names, *self.table)

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """Words that complete "it must be ..."."""
        return "one of " + ", ".join(self.known)

    @property
    def metavar(self) -> str:  # type: ignore[override]
        """What stands for the value in help texts: the names."""
        return "|".join(self.known)


LEAST_NUMBER, MOST_NUMBER = 1e-15, 1e15  # squares and products of such numbers stay far from overflow, in f32 too
TEXT = Kind(_text, "a text in UTF-8", "TEXT")
FILE = Kind(_text, "the name of a file, in UTF-8", "FILE")
REAL = Kind(_moderate_number, "0 or a number of size 1e-15 to 1e15", "NUMBER")
POSITIVE = Kind(bounded(real, LEAST_NUMBER, MOST_NUMBER), "a positive number from 1e-15 to 1e15", "NUMBER")
NOT_NEGATIVE = Kind(bounded(real, 0, MOST_NUMBER), "0 or a positive number up to 1e15", "NUMBER")
COUNT = whole(1, 2**31)
SEED = Kind(bounded(integer, 0, 2**62), "a whole number, 0 or more and below 2^62", "N")
SHAPE = Kind(numbers(integer, (2, 3)), "two or three whole numbers such as 32,32,32", "NX,NY[,NZ]")
TRUTH = Kind(_truth, "true or false", "")


@dataclass(frozen=True)
class Option:
    """An option that can be given for a run, a method or a law.

    default : value if it is not given; None where it is left to whatever uses the option.
    kind : how the value is read, and which values are allowed.
    help : a sentence on what it means.
    unit : unit of the value; "1" for a pure number.
    methods, laws : functions that return True for a method, or law, that uses it; None if all do.
    dimensions : dimensions of the lattices that use it.
    of_solving : True if it says how a system is solved, not which system.
    not_scanned : why a scan cannot vary it, since it changes no result; "" if it can.
    unset : True if descriptions of a run have None in place of the default, as if the option were not given.
    rare : True if few people need it, so that only `--help-all` shows it.
    """

    default: Any
    kind: Kind
    help: str
    unit: str = "1"
    methods: Callable[[Any], bool] | None = None
    laws: Callable[[Any], bool] | None = None
    dimensions: tuple[int, ...] = (2, 3)
    of_solving: bool = False
    not_scanned: str = ""
    unset: bool = False
    rare: bool = False

    def read(self, name: str, value: Any) -> Any:
        """Return the value of the option in the form in which it is stored. Raises InputError, which names the option,
        the value and what is allowed, for a value that is not.

        name : name of the option.
        value : what was given; None is kept where that is the default.
        """
        return None if value is None and self.default is None else self.kind.named(name, value)


def option(default: Any, kind: Kind, help: str, **facts: Any) -> Any:
    """Return a field of a dataclass that is an :class:`Option`.

    default : value of the option if it is not given.
    kind : how the value is read, and which values are allowed.
    help : a sentence on what the option means.
    facts : further attributes of the Option, by name.
    """
    return field(default=default, metadata={"option": Option(default, kind, help, **facts)})


how = partial(option, of_solving=True)  # an option that says how a system is solved


def options_of(owner: Any) -> dict[str, Option]:
    """Return the options that a dataclass (`owner`, a class or an instance) declares, by name."""
    return {item.name: item.metadata["option"] for item in fields(owner) if "option" in item.metadata}


def chosen(option: str, names: str | None, table: Collection[str]) -> tuple[str, ...]:
    """Return names of a table that a user has chosen.

    option : name of the option, for the InputError that is raised for a name that the table does not have.
    names : the names, separated by commas; None for all of the table.
    table : the names that are known.
    """
    found = tuple(table) if names is None else tuple(dict.fromkeys(names.split(",")))
    for name in found:
        if name not in table:
            raise InputError(f"{option} is {names!r}; {name!r} is none of {', '.join(table)}{meant(name, table)}")
    return found
