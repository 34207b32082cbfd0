"""bearings analyse"""

from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.options import answer, json_option, out_options, run_argument, title_option
from taichi_bearings_cli.progress import Display

REPORTED = ("power", "slipless", "slipping", "undecided", "critical", "tied_contacts", "minimum_is_unique")
"""What the report begins with, by the names of columns."""


@click.command()
@run_argument
@click.option(
    "--threshold", type=float, default=None, metavar="SPEED",
    help="Count contacts that slip no faster as slipless. [default: the contact states of the run]",
)  # fmt: skip
@click.option("--replica", type=click.IntRange(0), default=0, help="Which replica of a block of seeds is drawn.")
@click.option("--figures/--no-figures", default=True, help="Draw the figures. [default: on]")
@title_option
@out_options("Folder for analysis.h5 and figures. [default: into the run]", force="Replace existing files in --out.")
@json_option
def command(run: Path, as_json: bool, **asked: Any) -> None:
    """Structure of RUN, a run directory or its run.h5: what slips, what does not, and how that hangs together.

    \b
    minimum cut   the lightest interface of two rigid domains, its power and how far below it the run is
    network       slipless contacts: what they reach, whether and by how many paths they join bottom and top
    domains       spheres that slipless contacts make turn alike, and the driven plane they are locked to
    bottlenecks   the contacts that most of the shortest paths use
    forces        friction of the slipless contacts and the torque that flows from top to bottom

    Writes the group /analysis into run.h5 and figures beside it. docs/structure.md defines every number.

    \b
    Example:
      bearings run --shape 10,10,10 --spin-bottom 0.1 --out outputs/a
      bearings analyse outputs/a
    """
    from taichi_bearings.runs.analysis import analyse

    with Display() as display:
        report = analyse(run, **asked)
    told = _describe_packing if report["shape"] is None else describe
    answer(report, as_json, lambda: told(report, display.times()))


def _describe_packing(report: dict[str, Any], times: str) -> str:
    """The report of a packing for people."""
    from taichi_bearings.quantities import COLUMNS

    lines = [f"{report['spheres']:,} spheres, {report['law']}, {report['method']}; contact states: {_states(report)}"]
    lines += [
        f"  {line}"
        for name, value in report.items()
        if name in COLUMNS and name not in ("status", "method", "law", "shape", "version", "seconds")
        for line in _lines(COLUMNS[name].text, value, several=False)
    ]
    return "\n".join([*lines, times, *report["files"]])


def describe(report: dict[str, Any], times: str) -> str:
    """The report for people, section by section; of several samples mean and range. times : where the time went."""
    from taichi_bearings.quantities import COLUMNS, STRUCTURE
    from taichi_bearings.words import driving_words

    shape, seeds, spans = "x".join(map(str, report["shape"])), report["seed"], report["spans"]
    several = isinstance(seeds, list)
    lines = [f"{shape} {report['law']}, {report['method']}{driving_words(report)}; contact states: {_states(report)}"]
    ended = [report["status"]] if isinstance(report["status"], str) else report["status"]
    if open_ends := [status for status in ended if status != "certified"]:
        lines.append(f"not certified, {len(open_ends)} of {len(ended)} ({', '.join(sorted(set(open_ends)))})")
    if several:
        lines.append(f"{len(seeds)} samples, seeds {seeds[0]} ... {seeds[-1]}: mean, least, largest; or how many")
    for title, rows in {"contacts": [COLUMNS[name] for name in REPORTED], **STRUCTURE}.items():
        told = {row: report[row.name] for row in rows if row.name in report}
        found = [line for row, value in told.items() for line in _lines(row.text, value, several)]
        if title == "bottlenecks" and not (any(spans) if several else spans):
            found = ["none: slipless contacts do not join bottom and top"]
        lines += [title, *(f"  {line}" for line in found)] if found else []
    return "\n".join([*lines, times, *report["files"]])


def _states(report: dict[str, Any]) -> str:
    if report["states"] == "threshold":
        return f"slipless up to a slip of {report['threshold']:g}"
    return {"proven": "proven", "decided": "decided by slip and friction, not proven"}[report["states"]]


def _lines(text: str, value: Any, several: bool) -> list[str]:
    """A number, list or table of one sample, or a number of several samples with its spread; empty if there is none."""
    if several:
        values = [one for one in value if one is not None]
        if not values or isinstance(values[0], (dict, list)):
            return []
        if isinstance(values[0], bool):
            return [f"{text}: {sum(values)} of {len(value)}"]
        some = f", of {len(values)} of {len(value)} samples" if len(values) < len(value) else ""
        spread = ", ".join(_shown(number) for number in (sum(values) / len(values), min(values), max(values)))
        return [f"{text}: {spread}{some}"]
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
