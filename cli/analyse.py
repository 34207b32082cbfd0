"""The command `bearings analyse`."""

from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.options import answer, json_option, out_options, run_argument, title_option
from taichi_bearings_cli.progress import Display, in_lines
from taichi_bearings_cli.report import columns_of, solved

from taichi_bearings.plain_files import Json

REPORTED = ("power", "slipless", "slipping", "tied", "undecided", "minimum_is_unique")
"""Columns with which the report begins."""


@click.command()
@run_argument
@click.option(
    "--threshold", type=float, default=None, metavar="SPEED",
    help="Treat contacts that slip no faster than this as not slipping. [default: the contact states of the run]",
)  # fmt: skip
@click.option(
    "--replica",
    type=click.IntRange(0),
    default=0,
    help="Number of the sample to draw, counted from 0, if the run solved several seeds together.",
)
@click.option(
    "--figures/--no-figures", default=True, help="Draw the figures of network and rigid domains. [default: on]"
)
@title_option
@out_options("Folder for analysis.h5 and figures. [default: into the run]", force="Replace existing files in --out.")
@json_option
def command(run: Path, as_json: bool, **asked: Any) -> None:
    """Find the structure of RUN, a run directory or its run.h5: which contacts slip, and what the others join.

    A contact is slipless if the two spheres roll on each other without slip.

    \b
    minimum cut   the least power if every sphere turned with the bottom or with the top, and the run's power over that
    network       slipless contacts: what they reach, whether and by how many paths they join bottom and top
    domains       spheres that slipless contacts make rotate alike, and the driven plane they are locked to
    bottlenecks   the contacts that most of the shortest slipless paths from bottom to top run through
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
    answer(report, as_json, lambda: in_lines(describe(report, display.times())))


def describe(report: Json, times: str) -> str:
    """Return the structure of a run in words, section by section.

    report : the object of `--json`.
    times : a sentence on where the time went.
    """
    from taichi_bearings.quantities import COLUMNS, STRUCTURE
    from taichi_bearings.words import counted, listed

    named = {"proven": "proven", "decided": "not all proven, the others decided by slip and friction"}
    states = named.get(report["states"])
    states = states or f"slipless up to a slip of {report['threshold']:g}"
    lines = [f"{solved(report)}; contact states: {states}"]
    ended, seeds = listed(report["status"]), listed(report.get("seed"))
    if open_ends := [status for status in ended if status != "certified"]:
        statuses = ", ".join(sorted(set(open_ends)))
        lines.append(
            f"not certified (least power or potential not proven within the tolerance): {len(open_ends)} of "
            f"{counted(len(ended), 'sample')} ({statuses})"
        )
    if len(seeds) > 1:
        drawn = "" if report.get("coefficients") else f", seeds {seeds[0]} to {seeds[-1]}"
        lines.append(
            f"{len(seeds)} samples{drawn}: of each number its mean, least and largest value; of each "
            "fact in how many samples it is true"
        )
    for title, rows in {"contacts": [COLUMNS[name] for name in REPORTED], **STRUCTURE}.items():
        found = columns_of(rows, report)
        if title == "bottlenecks" and not any(listed(report["spans"])):
            found = ["none: slipless contacts do not join bottom and top"]
        lines += [title, *(f"  {line}" for line in found)] if found else []
    return "\n".join([*lines, times, *report["files"]])
