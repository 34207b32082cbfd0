"""The command `bearings histogram`."""

from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.options import (
    FILE_PATH,
    Choice,
    answer,
    dpi_option,
    json_option,
    out_options,
    title_option,
    width_option,
)
from taichi_bearings_cli.progress import Display


@click.command()
@click.argument("runs", nargs=-1, required=True, metavar="RUN...|SCAN...", type=FILE_PATH)
@click.option(
    "--bins-per-decade", type=click.IntRange(1, 100), default=5, show_default=True,
    help="Number of bins for each factor 10 of power; for a scan 1, 2, 4, 5, 10 or 20.",
)  # fmt: skip
@click.option(
    "--normalise", type=Choice(["none", "mean"]), default="none", show_default=True,
    help="none: take the power of each contact as it is; mean: divide it by the mean over all contacts of its sample.",
)  # fmt: skip
@click.option(
    "--by",
    metavar="KEY",
    default=None,
    help="Draw one histogram for each value of this column of a scan, or setting of a run, into one figure.",
)
@click.option(
    "--where",
    metavar="KEY=VALUE",
    multiple=True,
    help="Use only samples whose column of a scan, or setting of a run, has this value. May be repeated.",
)
@click.option(
    "--format", "ending", type=Choice(["png", "pdf", "svg"]), default="png", show_default=True,
    help="File format of the figure.",
)  # fmt: skip
@width_option
@dpi_option
@title_option
@out_options("Folder for the files. [default: a new one, outputs/<time>-histogram-<id>, named at the end]")
@json_option
def command(runs: tuple[Path, ...], normalise: str, by: str | None, as_json: bool, **asked: Any) -> None:
    """Draw the distribution of the power per contact, pooled over all samples of runs and scans: CSV, HDF5 and a
    figure.

    Only slipping contacts are in bins; the header says how many are slipless (they do not slip at any minimum), tied
    (they slip at some minima only) and undecided. Errors are standard errors over the samples, or the square roots of
    the counts if there is a single sample. docs/figures.md says more.

    \b
    Examples:
      bearings histogram outputs/a outputs/b --bins-per-decade 10 --format pdf --width single
      bearings histogram outputs/my-scan --by distribution --normalise mean
      bearings histogram outputs/my-scan --by shape --where distribution=uniform:0.1,1.0
    """
    from taichi_bearings.plots.page import Page, read_width
    from taichi_bearings.scans.histogram import histogram
    from taichi_bearings.words import counted, other_contacts

    width = asked.pop("width")
    page = Page(
        None if width is None else read_width(width), **{name: asked.pop(name) for name in ("dpi", "title", "ending")}
    )
    with Display():
        report = histogram(runs, normalise=normalise, by=by, page=page, **asked)
    lines = []
    for part in report.get("groups", [report]):
        group = f"{by} {part[by]}" if by else "in all"
        left_out = ", ".join([f"{part['slipless']:,} slipless", *other_contacts(part["tied"], part["undecided"])])
        slipping, samples = part["slipping"], part["census"]
        lines.append(f"{group}: {counted(slipping, 'slipping contact')}; contacts left out: {left_out}; from {samples}")
    if report["pooled_over"]:
        lines.append(f"pooled over all values of {', '.join(report['pooled_over'])}; --by or --where tells them apart")
    if report["slipping"]:
        units = "" if normalise == "none" else f" in units of {report['units']}"
        smallest, largest = report["smallest_power"], report["largest_power"]
        lines.append(f"power of the slipping contacts in bins from {smallest:.2e} to {largest:.2e}{units}")
    where = f"written into the folder {Path(report['files'][0]).parent}:"
    answer(report, as_json, lambda: "\n".join([*lines, where, *report["files"]]))
