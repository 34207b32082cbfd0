"""bearings export"""

from pathlib import Path

import click
from taichi_bearings_cli.options import answer, json_option, out_options, replica_option, run_argument
from taichi_bearings_cli.progress import Display


@click.command()
@run_argument
@replica_option
@out_options("The file. [default: run.vtkhdf in the run directory]", "FILE", "Replace an existing file.")
@json_option
def command(run: Path, replica: int, out: Path | None, force: bool, as_json: bool) -> None:
    """RUN, a run directory or its run.h5, as a VTKHDF file for ParaView 5.12 or later.

    \b
    points  the spheres: spin, rigid domain and what that is locked to, piece of the slipless network,
            betweenness, side of the minimum cut; with periodic sides also images of the first ones behind the last
    lines   the contacts: slip, power, force, state, proven or not, coefficient, betweenness,
            on the minimum cut, on the path, on the backbone
    steps   the snapshots of a dynamics and its end

    The structure is that of `bearings analyse`, if that was run, else it is computed. docs/pictures.md says more.

    \b
    Example:
      bearings export outputs/my-run --out my-run.vtkhdf
    """
    from taichi_bearings.export.vtkhdf import export

    with Display():
        report = export(run, out, force, replica)
    steps = f", {report['steps']} time steps" if report["steps"] > 1 else ""
    size = f"{report['bytes'] / 1e6:.1f} MB"
    images = f" and {report['images']:,} images" if "images" in report else ""
    drawn = f"{report['points']:,} spheres{images}, {report['lines']:,} contacts{steps}; {size}"
    answer(report, as_json, lambda: f"{report['file']}: {drawn}")
