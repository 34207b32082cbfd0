"""Puts what commands have found into words: a line for each quantity of a report.

A report is the object of `--json`. With several samples, most of its values are lists with one entry for each sample.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from taichi_bearings.quantities import Quantity
from taichi_bearings.words import driving_words, listed, sized


def solved(report: Mapping[str, Any]) -> str:
    """Return in words what was solved by which method, such as ``10x10 coulomb, planar-cut``.

    report : report of a run.
    """
    return f"{sized(report)} {report['law']}, {report['method']}{driving_words(report)}"


def ends(report: Mapping[str, Any]) -> str:
    """Return the statuses with which the samples of a report ended, each once, separated by commas."""
    return ", ".join(sorted(set(listed(report["status"]))))


def lines_of(rows: Iterable[Quantity], report: Mapping[str, Any]) -> list[str]:
    """Return a line of text for each of some quantities that a report has. For several samples a line has mean, least
    and largest value, or how many samples something is true of.

    rows : quantities, each with a name and a text.
    report : object of `--json`, of one sample or of several.
    """
    several = isinstance(report.get("seed"), list)
    found = ((row.text, report[row.name]) for row in rows if row.name in report)
    return [line for text, value in found for line in (_of_several if several else _of_one)(text, value)]


def _of_several(text: str, value: Any) -> list[str]:
    """Return a line on a quantity of several samples, in a list; an empty list if their values are lists or tables.

    text : what the quantity is.
    value : for each sample its value, or None.
    """
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
    """Return a list of lines on a quantity of one sample: one line, several for a table, none if there is no value.

    text : what the quantity is.
    value : a number, a list, or a table (a list of dictionaries).
    """
    if value is None or value == []:
        return []
    if isinstance(value, list) and isinstance(value[0], dict):
        rows = [list(value[0]), *([_shown(entry) for entry in row.values()] for row in value)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return [f"{text}:", *("  ".join(map(str.rjust, row, widths)) for row in rows)]
    return [f"{text}: {_shown(value, digits=10)}"]


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
