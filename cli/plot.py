"""bearings plot"""

from pathlib import Path
from typing import Any

import click

STRUCTURE = (
    "domains", "network", "plane_cuts", "cut_surface", "bottlenecks", "torque_flow", "thresholds", "load_distribution",
)  # fmt: skip
KINDS = ("spins", "power", "history", "energy", *STRUCTURE, "scan")


@click.command()
@click.argument("kind", type=click.Choice(KINDS), metavar="KIND")
@click.argument("run", metavar="RUN")
@click.option("--replica", type=click.IntRange(0), default=0, help="Which replica of a block of seeds.")
@click.option(
    "--time", type=float, default=None, help="spins: the snapshot nearest to this simulated time, and what slips in it."
)
@click.option("--y", metavar="COLUMN[/COLUMN]", default=None, help="scan: a number, or the ratio of the means of two.")
@click.option("--x", metavar="COLUMN", default=None, help="scan: what it is drawn against.")
@click.option("--by", metavar="COLUMN", multiple=True, help="scan: a curve for each value. May be repeated.")
@click.option("--where", metavar="KEY=VALUE", multiple=True, help="scan: only these samples. May be repeated.")
@click.option(
    "--bars", type=click.Choice(["standard-error", "quartiles", "bootstrap"]), default=None,
    help="scan: mean and standard error, median and quartiles, or mean and 95 % interval. "
    "[default: standard-error; for a ratio bootstrap]",
)  # fmt: skip
@click.option(
    "--collapse", metavar="A,B", default=None, help="scan: y L^-A against x L^B, a curve for each size L (the height)."
)
@click.option("--log", type=click.Choice(["x", "y", "xy"]), default=None, help="scan: logarithmic axes.")
@click.option("--out", metavar="FILE", default=None, help="PNG, PDF or SVG. [default: KIND.png in the run directory]")
@click.option("--force", is_flag=True, help="Replace an existing file.")
def command(
    kind: str, run: str, replica: int, time: float | None, out: str | None, force: bool, **of_scan: Any
) -> None:
    """Draw one figure from RUN, a run directory or its run.h5. KIND is one of

    \b
    spins    the spins as colour; 3D: from outside and two cuts
    power    where the power is dissipated
    history  power, lower bound and gap as the run went on
    energy   a dynamics: energy injected, dissipated, kinetic, in springs, and what the books miss

    and the figures of `bearings analyse`:

    \b
    domains            rigid domains: where they are, how large, how they turn
    network            slipless contacts, a path from bottom to top and its spins
    plane_cuts         cuts along the planes that hold most of the path
    cut_surface        the minimum cut and the contacts that slip
    bottlenecks        how the paths from bottom to top crowd
    torque_flow        friction of the slipless contacts and the torque they carry
    thresholds         what a slip threshold would have made of the contacts
    load_distribution  how the paths crowd over all replicas

    and, with the directory of a scan as RUN,

    \b
    scan         any column of scan.csv, or L, against any other, with error bars; the points are
                 written beside the figure as CSV, with how many of how many samples are in each

    \b
    Examples:
      bearings plot spins outputs/my-run --out spins.png
      bearings plot scan outputs/my-scan --y power --x spin_bottom --by shape
      bearings plot scan outputs/my-scan --y power/power_minimum_cut --x L --where law=coulomb
      bearings plot scan outputs/my-scan --y power --x spin_bottom --collapse 1.5,0 --log y
    """
    from taichi_bearings.errors import InputError
    from taichi_bearings.files.whole_file import refuse_standing
    from taichi_bearings.plots.style import refuse_ending, save
    from taichi_bearings.runs.figures import draw_figure
    from taichi_bearings.runs.run import settings_of
    from taichi_bearings.runs.run_file import read_run_file

    if kind == "scan":
        _plot_scan(Path(run), Path(out) if out else None, force, **of_scan)
        return
    if given := [name for name, value in of_scan.items() if value]:
        raise InputError(f"--{given[0]} belongs to `bearings plot scan`, not to `bearings plot {kind}`")
    stored = read_run_file(Path(run))
    path = Path(out) if out else stored.path.parent / f"{kind}.png"
    refuse_ending(path)
    refuse_standing([path], force or out is None)
    save(draw_figure(kind, stored.solution, replica, time, settings_of(stored).slip_threshold), path)
    click.echo(path)


def _plot_scan(
    scan: Path, out: Path | None, force: bool, y: str | None, x: str | None, collapse: str | None, **rest: Any
) -> None:
    from taichi_bearings.errors import InputError
    from taichi_bearings.scans.figure import Request, plot_scan

    if y is None or x is None:
        raise InputError("`bearings plot scan` needs --y and --x, the names of columns")
    exponents = None
    if collapse is not None:
        try:
            a, b = map(float, collapse.split(","))
        except ValueError:
            raise InputError(f"collapse is {collapse!r}; it must be two exponents such as 1.5,0") from None
        exponents = (a, b)
    request = Request(y, x, rest["by"], rest["where"], rest["bars"], exponents, rest["log"] or "")
    click.echo("\n".join(map(str, plot_scan(scan, request, out, force, click.echo))))
