"""The command `bearings plot`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from taichi_bearings_cli.options import (
    Choice,
    dpi_option,
    out_options,
    replica_option,
    replica_shown,
    run_argument,
    title_option,
    width_option,
)

if TYPE_CHECKING:
    from taichi_bearings.plots.page import Page

STRUCTURE_KINDS = ("domains", "network")
PLOT_KINDS = ("spins", "power", "coefficients", "history", "energy", *STRUCTURE_KINDS, "scan")


@click.command()
@click.argument("kind", type=Choice(PLOT_KINDS), metavar="KIND")
@run_argument
@replica_option
@click.option(
    "--time",
    type=float,
    default=None,
    help="Only for KIND spins: draw the snapshot nearest to this simulated time, with the contacts that slip in it.",
)
@click.option(
    "--y",
    metavar="COLUMN[/COLUMN]",
    default=None,
    help="Only for KIND scan: column of scan.csv on the y axis, or A/B for the mean of A over the mean of B.",
)
@click.option(
    "--x",
    metavar="COLUMN",
    default=None,
    help="Only for KIND scan: column of scan.csv on the x axis, or L, the height.",
)
@click.option(
    "--by",
    metavar="COLUMN",
    multiple=True,
    help="Only for KIND scan: draw one curve for each value of this column. May be repeated.",
)
@click.option(
    "--where",
    metavar="KEY=VALUE",
    multiple=True,
    help="Only for KIND scan: use only samples whose column KEY has this VALUE. May be repeated.",
)
@click.option(
    "--log",
    type=Choice(["x", "y", "xy"]),
    default=None,
    help="Only for KIND scan: make the x axis, the y axis or both logarithmic.",
)
@width_option
@dpi_option
@title_option
@click.option(
    "--plane",
    "planes",
    metavar="AXIS=N",
    multiple=True,
    help="Only in 3D: lattice plane to show, such as y=5. May be repeated.",
)
@click.option(
    "--view",
    metavar="ELEVATION,AZIMUTH",
    default=None,
    help="Only in 3D: elevation and azimuth of the viewer in degrees, such as 22,-55.",
)
@out_options(
    "PNG, PDF or SVG. [default: KIND.pdf in the run directory; KIND.png if the PDF had more than 1 MB]", "FILE",
    "Replace an existing file.",
)  # fmt: skip
def command(kind: str, run: Path, replica: int, time: float | None, out: Path | None, force: bool, **more: Any) -> None:
    """Draw one figure from RUN, a run directory or its run.h5. KIND is one of

    \b
    spins         the spins as colour; 3D: from outside and two cuts
    power         where the power is dissipated
    coefficients  the friction (or damping) of every contact, as drawn or given
    history       power, lower bound and gap as the run went on
    energy        a dynamics: energy put in, dissipated, kinetic, in springs, and the error of their balance

    and the figures of `bearings analyse`:

    \b
    domains      rigid domains: where they are and how they rotate
    network      contacts without slip, a path through them from bottom to top, and its spins

    and, with the directory of a scan as RUN,

    \b
    scan         any column of scan.csv, or L (the height), against any other, with error bars; the points
                 are written beside the figure as CSV, with how many of how many samples are in each

    \b
    Examples:
      bearings plot spins outputs/my-run --out spins.png
      bearings plot power outputs/my-run --plane z=5 --plane x=0 --width single --out power.pdf
      bearings plot scan outputs/my-scan --y power --x L --by distribution
      bearings plot scan outputs/my-scan --y power --x L --log xy
      bearings plot scan outputs/my-scan --y power/power_minimum_cut --x L --where law=coulomb
    """
    from taichi_bearings.errors import InputError
    from taichi_bearings.plots.page import Page, read_plane, read_view, read_width

    width, dpi, planes, seen, title = (more.pop(name) for name in ("width", "dpi", "planes", "view", "title"))
    page = Page(
        None if width is None else read_width(width),
        dpi,
        tuple(dict.fromkeys(map(read_plane, planes))),
        None if seen is None else read_view(seen),
        title,
    )
    if kind == "scan":
        from taichi_bearings.scans.figure import Request, plot_scan

        if more["y"] is None or more["x"] is None:
            raise InputError("`bearings plot scan` needs --y and --x, the names of columns")
        if planes or seen:
            words = f"--{'plane' if planes else 'view'} belongs to figures of runs, not to `bearings plot scan`"
            raise InputError(words)
        request = Request(**more | {"log": more["log"] or ""})
        click.echo("\n".join(map(str, plot_scan(run, request, out, force, click.echo, page))))
    else:
        if given := [name for name, value in more.items() if value]:
            raise InputError(f"--{given[0]} belongs to `bearings plot scan`, not to `bearings plot {kind}`")
        _plot_run(kind, run, replica, time, out, force, page)


def _plot_run(
    kind: str, run: Path, replica: int, time: float | None, out: Path | None, force: bool, page: "Page"
) -> None:
    """Draw a figure of a run, write it, and print its path.

    kind : one of PLOT_KINDS but "scan".
    run : directory of the run, or its run.h5.
    replica : which sample, counted from 0.
    time : simulated time of the snapshot to draw, None for the end.
    out : path of the figure, None for one in the run directory.
    force : replace an existing file.
    page : size, resolution, planes and view of the figure, a :class:`taichi_bearings.plots.page.Page`.
    """
    from taichi_bearings.files.whole_file import refuse_ending
    from taichi_bearings.plots.style import ENDINGS, save, save_small
    from taichi_bearings.runs.figures import draw_figure
    from taichi_bearings.runs.run_file import opened_to_draw, replica_drawn

    refuse_ending(out, *ENDINGS)
    with opened_to_draw(run, out, kind, force, replica) as (stored, path):
        figure = draw_figure(kind, stored.solution, replica, time, stored.asked.slip_threshold, page)
        if out:
            save(figure, out)
        click.echo(out or save_small(figure, path))
        if kind != "history" and (which := replica_shown(replica_drawn(stored, replica))):  # a history is of all
            click.echo(f"bearings: {kind}{which}", err=True)
