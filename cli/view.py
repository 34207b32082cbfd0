"""bearings view"""

import json
from pathlib import Path

import click
from taichi_bearings_cli.options import FILES, json_option


@click.command()
@click.argument("run", metavar="RUN", type=FILES)
@click.option("--replica", type=click.IntRange(0), default=0, help="Which replica of a block of seeds.")
@click.option("--open", "opened", is_flag=True, help="Show it in the browser at once.")
@click.option(
    "--out", metavar="FILE", type=FILES, default=None, help="The page. [default: view.html in the run directory]"
)
@click.option("--force", is_flag=True, help="Replace an existing file.")
@json_option
def command(run: str, replica: int, opened: bool, out: str | None, force: bool, as_json: bool) -> None:
    """An interactive 3D page of RUN, a run directory or its run.h5: one HTML file for any browser, without a network.

    Spheres, slipless network, slipping contacts, minimum cut, rigid domains, a path and the bottlenecks are layers to
    switch. Slice them, move the slip threshold and the least power, point at a sphere or a contact for its numbers, and
    play the snapshots of a dynamics. The structure is that of `bearings analyse`, if that was run, else it is computed.
    docs/pictures.md says more.

    \b
    Example:
      bearings view outputs/my-run --open
    """
    import webbrowser

    from taichi_bearings_cli.progress import Display

    from taichi_bearings.view.view import view

    with Display():
        report = view(Path(run), Path(out) if out else None, force, replica)
    click.echo(json.dumps(report) if as_json else f"{report['file']} ({report['bytes'] / 1e6:.1f} MB)")
    if opened:
        webbrowser.open(Path(report["file"]).resolve().as_uri())
