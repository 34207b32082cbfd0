"""What the benchmark of speed has measured as a table, CSV, JSON and figure."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.plots.style import save

from ..plots.roofline import Ceilings, Measured, draw_roofline
from ..report import Files
from .speed import Report
from .timing import COLUMNS, PARTS, Row

NAMES = ("speed.csv", "roofline.png")

Cell = Callable[[Row], str]
TIMES: dict[str, Cell] = {
    "time": lambda row: duration(row.seconds),
    "spread": lambda row: f"{duration(row.quickest)} – {duration(row.slowest)}" if row.quickest is not None else "",
}
PROCESSOR: dict[str, Cell] = {"processor": lambda row: duration(row.seconds_processor)}
CONTACTS: dict[str, Cell] = {"contacts/s": lambda row: millions(row.contact_updates)}
SLOWER: dict[str, Cell] = {"this program is": lambda row: f"{short(row.ratio)} times as fast" if row.ratio else ""}
TABLES: dict[str, dict[str, Cell]] = {
    "memory": {
        "precision": lambda row: row.precision,
        "threads": lambda row: str(row.threads),
        "working set": lambda row: size(row.working_set),
        "bandwidth": lambda row: bandwidth(row.bandwidth),
    },
    "kernels": {
        "": lambda row: row.what,
        "lattice": lambda row: row.size,
        "components": lambda row: str(row.components),
        "precision": lambda row: row.precision,
        "threads": lambda row: str(row.threads),
        **TIMES,
        **PROCESSOR,
        **CONTACTS,
        "bytes": lambda row: size(row.bytes),
        "flop/byte": lambda row: f"{row.operations / row.bytes:.2f}" if row.operations and row.bytes else "",
        "bandwidth": lambda row: bandwidth(row.bandwidth),
        "of": lambda row: bandwidth(row.bandwidth_here),
        "roof": lambda row: f"{row.roof:.0%} ({row.limit})" if row.roof else "",
        "B/sphere": lambda row: f"{row.bytes_per_sphere:.0f}" if row.bytes_per_sphere else "",
        "compile": lambda row: duration(row.seconds_compile),
        "sweep is": lambda row: f"{short(row.ratio)} times as fast" if row.ratio else "",
    },
    "methods": {
        "": lambda row: row.what,
        "lattice": lambda row: row.size,
        "law": lambda row: row.law or "",
        **TIMES,
        **PROCESSOR,
        "gap": lambda row: f"{row.gap:.0e}",
        "ended": lambda row: row.status or "",
        "iterations": lambda row: str(row.iterations),
        **CONTACTS,
        "Gflop/s": lambda row: f"{row.operations / row.seconds / 1e9:.2g}" if row.operations else "",
        "B/sphere": lambda row: f"{row.bytes_per_sphere:.0f}" if row.bytes_per_sphere else "",
        "compile": lambda row: duration(row.seconds_compile),
    },
    "scans": {
        "": lambda row: row.what,
        "lattice": lambda row: row.size,
        "workers": lambda row: str(row.threads),
        "samples/s": lambda row: f"{1 / row.seconds:.3g}",
        "a sample": lambda row: duration(row.seconds),
        "spread": TIMES["spread"],
        "proven": lambda row: f"{row.proven:.0%}" if row.proven is not None else "",
        **SLOWER,
    },
    "dynamics": {
        "": lambda row: row.what,
        "lattice": lambda row: row.size,
        "components": lambda row: str(row.components),
        "threads": lambda row: str(row.threads),
        **TIMES,
        **CONTACTS,
        **SLOWER,
    },
}


def short(value: float) -> str:
    """Three digits, never a power of ten."""
    return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"


def duration(seconds: float | None) -> str:
    if seconds is None:
        return ""
    unit, scale = ("s", 1.0) if seconds >= 1 else ("ms", 1e3) if seconds >= 1e-3 else ("us", 1e6)
    return f"{seconds * scale:.3g} {unit}"


def millions(rate: float | None) -> str:
    return f"{short(rate / 1e6)} M" if rate else ""


def size(count: float | None) -> str:
    if count is None:
        return ""
    power = min(3, int(np.log2(max(count, 1)) // 10))
    return f"{count / 2 ** (10 * power):.4g} {('B', 'KiB', 'MiB', 'GiB')[power]}"


def bandwidth(rate: float | None) -> str:
    return f"{rate / 1e9:.3g} GB/s" if rate else ""


def table(report: Report) -> str:
    """For people: a table a part, then what was left out and what is missing."""
    machine = report.machine
    caches = ", ".join(f"{level} {size(count)}" for level, count in machine["caches"].items())
    head = f"{machine['processor']}, {machine['threads']} threads{', ' + caches if caches else ''}"
    parts = [f"{head}\nLoad at the start {machine['load']:.1f}" if machine["load"] is not None else head]
    for part, title in PARTS.items():
        if rows := report.of(part):
            parts.append(f"{title[0].upper()}{title[1:]}\n{_lines(rows, TABLES[part])}")
    notes = [*report.notes, *(f"Without {name}: {reason}" for name, reason in report.missing.items())]
    return "\n\n".join([*parts, "\n".join(notes)] if notes else parts)


def _lines(rows: Sequence[Row], cells: dict[str, Cell]) -> str:
    """The rows beneath each other; columns that are empty throughout are left out."""
    columns = {title: [cell(row) for row in rows] for title, cell in cells.items()}
    shown = {title: [title, *words] for title, words in columns.items() if any(words)}
    widths = {title: max(map(len, words)) for title, words in shown.items()}
    lines = zip(*([word.ljust(widths[title]) for word in words] for title, words in shown.items()), strict=True)
    return "\n".join("  ".join(line).rstrip() for line in lines)


def write(files: Files, report: Report) -> list[Path]:
    """speed.csv and, where kernels and memory were measured, roofline.png; returns those that were written."""
    csv, figure = files.paths
    rows = [[_plain(value) for value in asdict(row).values()] for row in report.rows]
    write_csv(csv, COLUMNS, rows, [f"{name}: {value}" for name, value in report.machine.items()])
    if not (report.of("kernels") and report.of("memory")):
        return [csv]
    save(figure_of(report), figure)
    return [csv, figure]


def _plain(value: Any) -> Any:
    """For CSV: nothing is an empty cell, a lattice reads 10x10."""
    return "x".join(map(str, value)) if isinstance(value, tuple) else "" if value is None else value


def figure_of(report: Report) -> Any:
    """The kernels in double precision, if there are any, with one thread."""
    rows = [row for row in report.rows if row.part in ("kernels", "memory")]
    precision = "f64" if any(row.precision == "f64" for row in rows) else "f32"
    rows = [row for row in rows if row.precision == precision]
    threads = min(row.threads or 1 for row in rows if row.part == "memory")
    rows = [row for row in rows if row.threads == threads]
    streams = sorted((row for row in rows if row.part == "memory"), key=lambda row: row.working_set or 0.0)
    kernels = [row for row in rows if row.part == "kernels" and row.bytes]
    ceilings = Ceilings(
        np.array([row.working_set for row in streams]),
        np.array([row.bandwidth for row in streams]),
        float(np.median([row.operations_here for row in kernels if row.operations_here])),
        report.machine["caches"],
    )
    measured = [
        Measured(
            row.what,
            row.components or 1,
            (row.operations or 0.0) / (row.bytes or 1.0),
            (row.operations or 0.0) / row.seconds,
            row.bandwidth or 0.0,
            row.working_set or 0.0,
        )
        for row in kernels
    ]
    title = f"{report.machine['processor']}, {precision}, threads {threads}; medians"
    return draw_roofline(measured, ceilings, title)


def as_json(report: Report, files: Sequence[Path]) -> dict[str, Any]:
    """The object of `--json`."""
    return {
        "machine": report.machine,
        "rows": [row.known() for row in report.rows],
        "left_out": report.notes,
        "peers_missing": report.missing,
        "interrupted": report.interrupted,
        "files": [str(path) for path in files],
    }
