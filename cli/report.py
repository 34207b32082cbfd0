"""Puts what commands have found into words: rows of the tables of quantities, a line each."""

from collections.abc import Iterable, Mapping
from typing import Any

from taichi_bearings.quantities import Quantity
from taichi_bearings.words import driving_words, listed, sized


def solved(report: Mapping[str, Any]) -> str:
    """Return what was solved by which method, such as ``10x10 coulomb, planar-cut``."""
    return f"{sized(report)} {report['law']}, {report['method']}{driving_words(report)}"


def ends(report: Mapping[str, Any]) -> str:
    """Return how the samples ended, each status once."""
    return ", ".join(sorted(set(listed(report["status"]))))


def lines_of(rows: Iterable[Quantity], report: Mapping[str, Any]) -> list[str]:
    """Return a line for each of these quantities that a report has.

    Of several samples a line has mean, least and largest value, or how many samples something is true of.
    """
    several = isinstance(report.get("seed"), list)
    found = ((row.text, report[row.name]) for row in rows if row.name in report)
    return [line for text, value in found for line in (_of_several if several else _of_one)(text, value)]


def _of_several(text: str, value: Any) -> list[str]:
    """Return a line on the values of several samples; nothing for lists and tables."""
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
    """Return lines on one number, list or table; nothing where there is none."""
    if value is None or value == []:
        return []
    if isinstance(value, list) and isinstance(value[0], dict):
        rows = [list(value[0]), *([_shown(entry) for entry in row.values()] for row in value)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return [f"{text}:", *("  ".join(map(str.rjust, row, widths)) for row in rows)]
    return [f"{text}: {_shown(value, digits=10)}"]


def _shown(value: Any, digits: int = 6) -> str:
    """Return a value in words; entries of a table that are 0 are left out."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_shown(entry)}" for name, entry in value.items() if entry)
    if isinstance(value, list):
        return ", ".join(_shown(entry, digits) for entry in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else f"{value:.{digits}g}"
