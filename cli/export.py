"""The command `bearings export`."""

from pathlib import Path

import click
from taichi_bearings_cli.options import (
    Choice,
    analyse_option,
    answer,
    json_option,
    out_options,
    replica_option,
    run_argument,
)
from taichi_bearings_cli.progress import Display


@click.command()
@run_argument
@replica_option
@analyse_option
@click.option(
    "--format",
    "form",
    type=Choice(["vtkhdf", "cbf", "fclib"]),
    default="vtkhdf",
    help="vtkhdf: a file for ParaView; cbf, fclib: the minimisation problem for other solvers. [default: vtkhdf]",
)
@out_options("File to write. [default: run.vtkhdf, problem.cbf or problem.hdf5 in the run directory]", "FILE",
             "Replace an existing file.")  # fmt: skip
@json_option
def command(run: Path, replica: int, analyse: bool, form: str, out: Path | None, force: bool, as_json: bool) -> None:
    """Write RUN, a run directory or its run.h5, as a VTKHDF file for ParaView 5.12 or later; or its least power as a
    problem for other solvers, in the conic benchmark format (cbf) or as the frictional contact library has it (fclib).

    \b
    VTKHDF has
    points  the spheres: spin; with periodic sides also images of the first ones behind the last. Of a run that
            was analysed: rigid domain and what that is locked to, piece of the slipless network, betweenness,
            side of the minimum cut
    lines   the contacts: slip, power, force, state, proven or not, coefficient. Of a run that was analysed:
            betweenness, on the minimum cut, on the path, on the backbone
    steps   the snapshots of a dynamics and its end

    docs/figures.md says more.

    \b
    Examples:
      bearings export outputs/my-run --out my-run.vtkhdf
      bearings export outputs/my-run --format cbf
    """
    from taichi_bearings.errors import InputError
    from taichi_bearings.export.problems import export_problem
    from taichi_bearings.export.vtkhdf import export

    if analyse and form != "vtkhdf":
        raise InputError(f"--analyse is given, but a file in the format {form} cannot hold what it finds; leave it out")
    with Display():
        report = (
            export(run, out, force, replica, analyse)
            if form == "vtkhdf"
            else export_problem(run, form, out, force, replica)
        )
    if form == "vtkhdf":
        steps = f", {report['steps']} time steps" if report["steps"] > 1 else ""
        images = f" and {report['images']:,} images" if "images" in report else ""
        size = f"{report['lines']:,} contacts{steps}; {report['bytes'] / 1e6:.1f} MB"
        structure = "" if report["analysed"] else "; without the structure of the run, which --analyse adds"
        words = f"{report['points']:,} spheres{images}, {size}{structure}"
    else:
        words = f"{report['unknowns']:,} unknown spins, {report['contacts']:,} contacts"
    answer(report, as_json, lambda: f"{report['file']}: {words}")
