"""What commands have found, for people: rows of the tables of quantities, a line each."""

from collections.abc import Iterable, Mapping
from typing import Any

from taichi_bearings.quantities import Quantity
from taichi_bearings.words import driving_words, listed, sized


def solved(report: Mapping[str, Any]) -> str:
    """What was solved by which method: ``10x10 coulomb, planar-cut``."""
    return f"{sized(report)} {report['law']}, {report['method']}{driving_words(report)}"


def ends(report: Mapping[str, Any]) -> str:
    """How the samples ended, each way once."""
    return ", ".join(sorted(set(listed(report["status"]))))


def rows_told(rows: Iterable[Quantity], report: Mapping[str, Any]) -> list[str]:
    """The numbers that a report has of these rows; of several samples mean, least and largest, or of how many."""
    several = isinstance(report.get("seed"), list)
    told = ((row.text, report[row.name]) for row in rows if row.name in report)
    return [line for text, value in told for line in (_of_several if several else _of_one)(text, value)]


def _of_several(text: str, value: Any) -> list[str]:
    """Nothing for lists and tables."""
    found = listed(value)
    values = [one for one in found if one is not None]
    if not values or isinstance(values[0], (dict, list)):
        return []
    if isinstance(values[0], bool):
        return [f"{text}: {sum(values)} of {len(found)}"]
    some = f", of {len(values)} of {len(found)} samples" if len(values) < len(found) else ""
    spread = ", ".join(_shown(number) for number in (sum(values) / len(values), min(values), max(values)))
    return [f"{text}: {spread}{some}"]


def _of_one(text: str, value: Any) -> list[str]:
    """A number, list or table; nothing where there is none."""
    if value is None or value == []:
        return []
    if isinstance(value, list) and isinstance(value[0], dict):
        rows = [list(value[0]), *([_shown(entry) for entry in row.values()] for row in value)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return [f"{text}:", *("  ".join(map(str.rjust, row, widths)) for row in rows)]
    return [f"{text}: {_shown(value, digits=10)}"]


def _shown(value: Any, digits: int = 6) -> str:
    """For people: entries of a table that are 0 are left out."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_shown(entry)}" for name, entry in value.items() if entry)
    if isinstance(value, list):
        return ", ".join(_shown(entry, digits) for entry in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else f"{value:.{digits}g}"
