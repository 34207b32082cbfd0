"""Writes what all studies report: tables, numbers in words, and the machine that numbers come from."""

import os
import platform
from collections.abc import Sequence
from pathlib import Path

from taichi_bearings import runtime
from taichi_bearings.runs.writing import versions
from taichi_bearings.version import VERSION


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown text, its columns padded so that it reads as plain text, too.

    rows : texts of all cells; the first row has the titles.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [rows[0], ["-" * width for width in widths], *rows[1:]]
    padded = ([word.ljust(width) for word, width in zip(line, widths, strict=True)] for line in lines)
    return "\n".join(f"| {' | '.join(words)} |" for words in padded)


def short(value: float) -> str:
    """Return a value as text: with three significant digits below 1000, as a whole number with thousands separators
    from 1000 on. Below 1e-4, and from 999.5 to below 1000, Python's format adds a power of ten, as in "1.23e-05".
    """
    return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"


def duration(seconds: float | None) -> str:
    """Return seconds in words, with a unit that suits them (s, ms or us); a dash for None."""
    if seconds is None:
        return "–"
    unit, scale = ("s", 1.0) if seconds >= 1 else ("ms", 1e3) if seconds >= 1e-3 else ("us", 1e6)
    return f"{seconds * scale:.3g} {unit}"


def scaled(rate: float) -> str:
    """Return a rate (number a second) in millions, in words."""
    return f"{short(rate / 1e6)} M"


def processor() -> str:
    """Return the name of this machine's processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        lines = []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return (named or [platform.processor() or platform.machine() or "unknown"])[0]


def load() -> float | None:
    """Return how many processes want a processor now, as a mean over the last minute; None where the system does not
    say.
    """
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def environment() -> dict[str, str]:
    """Return the machine and the programs, in words by name; nothing that would identify the machine or its owner."""
    return {
        "taichi_bearings": VERSION,
        **versions(),
        "system": f"{platform.system()}, {platform.machine()}",
        "processor": processor(),
        "cores": str(os.cpu_count() or 1),
        "threads": f"{runtime.available_threads()}, double precision",
    }
