"""What benchmarks have measured as tables, CSV, JSON and figures: one writer for all."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from taichi_bearings.files.whole_file import write_csv, write_text
from taichi_bearings.plots.style import save

from ..report import Files, environment, load, markdown
from .harness import Benchmark, Cells, Report, Row

TEXT = "report.md"


def names(chosen: Mapping[str, Benchmark]) -> list[str]:
    """Of all files that these benchmarks may write."""
    figures = [f"{name}.png" for name, one in chosen.items() if one.figure]
    return [TEXT, *(f"{name}.csv" for name in chosen), *figures]


def machine() -> dict[str, Any]:
    """The machine, what runs on it, and how busy it is."""
    return {**environment(), "load": load()}


def text(chosen: Mapping[str, Benchmark], report: Report, here: Mapping[str, Any]) -> str:
    """For people: the machine, a table a benchmark, then what was left out and what is missing."""
    parts = [f"{here['processor']}, {here['threads']}; load {here['load']}"]
    parts += [
        f"### {name}\n{chosen[name].title}.\n\n{_table(rows, chosen[name].cells)}" for name, rows in report.rows.items()
    ]
    notes = [*report.faults, *report.notes, *(f"Without {name}: {why}" for name, why in report.missing.items())]
    return "\n\n".join([*parts, "\n".join(f"* {note}" for note in notes)] if notes else parts) + "\n"


def _table(rows: Sequence[Row], cells: Cells) -> str:
    """The rows beneath each other; columns that are empty throughout are left out."""
    columns = [[title, *map(cell, rows)] for title, cell in cells.items()]
    return markdown(list(zip(*(words for words in columns if any(words[1:])), strict=True)))


def write(files: Files, chosen: Mapping[str, Benchmark], report: Report, here: Mapping[str, Any]) -> list[Path]:
    """The tables, all numbers of each benchmark, and its figure if it has one; returns what was written."""
    written = [files.folder / TEXT]
    write_text(written[0], text(chosen, report, here))
    notes = [f"{name}: {value}" for name, value in here.items()]
    for name, rows in report.rows.items():
        lines = [line for row in rows for line in _lines(row)]
        columns = list(dict.fromkeys(key for line in lines for key in line))
        written.append(files.folder / f"{name}.csv")
        write_csv(written[-1], columns, [[line.get(key, "") for key in columns] for line in lines], notes)
        draw = chosen[name].figure
        if draw:
            written.append(files.folder / f"{name}.png")
            save(draw(rows), written[-1])
    return written


def _lines(row: Row) -> Iterator[Row]:
    """A line a checkpoint where a row has lists; a lattice reads 10x10, and what has parts is left to the JSON."""
    plain = {key: "x".join(map(str, of)) if isinstance(of, tuple) else of for key, of in row.items()}
    lists = {key: of for key, of in plain.items() if isinstance(of, list)}
    same = {key: "" if of is None else of for key, of in plain.items() if not isinstance(of, (list, dict))}
    for values in zip(*lists.values(), strict=True) if lists else [()]:
        yield same | dict(zip(lists, values, strict=True))


def as_json(report: Report, here: Mapping[str, Any], files: Sequence[Path]) -> dict[str, Any]:
    """The object of `--json`."""
    return {
        "machine": here, **report.rows, "left_out": report.notes,
        "contradictions": report.faults, "peers_missing": report.missing, "interrupted": report.interrupted,
        "files": [str(path) for path in files],
    }  # fmt: skip
