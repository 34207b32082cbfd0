"""Puts what commands have found into words: a line for each quantity of a report.

A report is the object of `--json`. With several samples, most of its values are lists with one entry for each sample.
"""

from collections.abc import Iterable, Iterator
from typing import Any

from taichi_bearings.plain_files import Json
from taichi_bearings.quantities import Quantity
from taichi_bearings.words import driving_words, listed, sized

WIDEST_VALUE = 30
"""Most letters of the column of values; a longer value moves the words after it to the right."""


def solved(report: Json) -> str:
    """Return in words what was solved by which method, such as ``10x10 coulomb, planar-cut``.

    report : report of a run.
    """
    return f"{sized(report)} {report['law']}, {report['method']}{driving_words(report)}"


def ends(report: Json) -> str:
    """Return the statuses with which the samples of a report ended, each once, separated by commas."""
    return ", ".join(sorted(set(listed(report["status"]))))


def lines_of(rows: Iterable[Quantity], report: Json) -> list[str]:
    """Return a line of text for each of some quantities that a report has: what it is, and its value. For several
    samples a line has mean, least and largest value, or how many samples something is true of.

    rows : quantities, each with a name and a text.
    report : object of `--json`, of one sample or of several.
    """
    return [f"{row.text}: {value}{_unit(row)}" for row, value in _values_of(rows, report)]


def columns_of(rows: Iterable[Quantity], report: Json) -> list[str]:
    """Return the lines of :func:`lines_of` in three columns: name in `--json`, value, and what the quantity is, with
    its unit. The lines of a table follow its name.

    rows : quantities, each with a name and a text.
    report : object of `--json`, of one sample or of several.
    """
    rows = list(rows)
    found = list(_values_of(rows, report))
    names = max((len(row.name) for row, _ in found), default=0)
    widths = [len(value) for _, value in found if len(value) <= WIDEST_VALUE]
    lines = [f"{row.name:<{names}}  {value:>{max(widths, default=0)}}  {row.text}{_unit(row)}" for row, value in found]
    tables = () if _is_of_several(report) else (row for row in rows if _is_table(report.get(row.name)))
    return lines + [line for row in tables for line in (f"{row.name}  {row.text}", *_table(report[row.name]))]


def _unit(row: Quantity) -> str:
    """Return the unit of a quantity in brackets, after a space; an empty text for pure numbers and numbers of contacts.

    row : the quantity.
    """
    return "" if row.unit in ("1", "contacts") else f" [{row.unit}]"


def _values_of(rows: Iterable[Quantity], report: Json) -> Iterator[tuple[Quantity, str]]:
    """Yield the quantities that have a value in a report, each with its value as a text; tables are left out.

    rows : quantities.
    report : object of `--json`, of one sample or of several.
    """
    as_text = _of_several if _is_of_several(report) else _of_one
    found = ((row, as_text(report[row.name])) for row in rows if row.name in report)
    return ((row, value) for row, value in found if value)


def _is_of_several(report: Json) -> bool:
    """Return True if a report is on several samples, so that most of its values are lists with one entry for each.

    report : object of `--json`.
    """
    return isinstance(report.get("seed"), list)


def _of_several(value: Any) -> str:
    """Return a quantity of several samples as a text: mean, least and largest value, the value itself if only one
    sample has it, or how many times it is true; an empty text if the values are lists or tables.

    value : for each sample its value, or None.
    """
    found = listed(value)
    values = [one for one in found if one is not None]
    if not values or isinstance(values[0], (dict, list)):
        return ""
    if isinstance(values[0], bool):
        return f"{sum(values)} of {len(found)}"
    some = f" in {len(values)} of {len(found)}" if len(values) < len(found) else ""
    shown = (sum(values) / len(values), min(values), max(values)) if len(values) > 1 else values
    return ", ".join(map(_shown, shown)) + some


def _of_one(value: Any) -> str:
    """Return a quantity of one sample as a text, an empty one for a table or if there is no value.

    value : a number, a list, or a table (a list of dictionaries).
    """
    return "" if value is None or value == [] or _is_table(value) else _shown(value, digits=10)


def _is_table(value: Any) -> bool:
    """Return True if a value is a table: a list of dictionaries with the same keys.

    value : value in a report on one sample.
    """
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)


def _table(value: list[Json]) -> list[str]:
    """Return the lines of a table, the first with the names of its columns.

    value : a dictionary for each line.
    """
    rows = [list(value[0]), *([_shown(entry) for entry in row.values()] for row in value)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.rjust, row, widths)) for row in rows]


def _shown(value: Any, digits: int = 6) -> str:
    """Return a value as a text; entries of a dictionary that are 0 are left out.

    digits : significant digits of a number that is not whole.
    """
    if isinstance(value, dict):
        return ", ".join(f"{name} {_shown(entry)}" for name, entry in value.items() if entry)
    if isinstance(value, list):
        return ", ".join(_shown(entry, digits) for entry in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else f"{value:.{digits}g}"
