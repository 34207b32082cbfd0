"""The command `bearings view`."""

from pathlib import Path

import click
from taichi_bearings_cli.options import analyse_option, answer, json_option, out_options, replica_option, run_argument
from taichi_bearings_cli.progress import Display


@click.command()
@run_argument
@replica_option
@analyse_option
@click.option("--open", "opened", is_flag=True, help="Open the page in the browser at once.")
@out_options("Page to write. [default: view.html in the run directory]", "FILE", "Replace an existing file.")
@json_option
def command(run: Path, replica: int, analyse: bool, opened: bool, out: Path | None, force: bool, as_json: bool) -> None:
    """Make an interactive 3D page of RUN, a run directory or its run.h5: one HTML file for any browser, without a
    network.

    Spheres, slipless network and slipping contacts are layers to switch; of a run that was analysed, or with --analyse,
    so are minimum cut, rigid domains, a path and the bottlenecks. Slice them, move the slip threshold and the least
    power, point at a sphere or a contact for its numbers. Of a dynamics with snapshots the page opens at the first one
    and plays them. docs/figures.md says more.

    \b
    Example:
      bearings analyse outputs/my-run
      bearings view outputs/my-run --open
    """
    import webbrowser

    from taichi_bearings.view.view import view

    with Display():
        report = view(run, out, force, replica, analyse)
    structure = "" if report["analysed"] else "; without cut, domains, path and bottlenecks, which --analyse adds"
    answer(report, as_json, lambda: f"{report['file']} ({report['bytes'] / 1e6:.1f} MB){structure}")
    if opened:
        webbrowser.open(Path(report["file"]).resolve().as_uri())
