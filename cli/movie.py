"""bearings movie"""

import json
from pathlib import Path

import click
from taichi_bearings_cli.options import FILES, json_option


@click.command()
@click.argument("run", metavar="RUN", type=FILES)
@click.option("--fps", type=float, default=4.0, show_default=True, help="Snapshots shown in a second.")
@click.option("--replica", type=click.IntRange(0), default=0, help="Which replica of a block of seeds.")
@click.option(
    "--out", metavar="FILE", type=FILES, default=None, help="MP4 or GIF. [default: movie.mp4 in the run directory]"
)
@click.option("--force", is_flag=True, help="Replace an existing file.")
@json_option
def command(run: str, fps: float, replica: int, out: str | None, force: bool, as_json: bool) -> None:
    """A film of the snapshots of RUN, a run directory or its run.h5: the spins, and what slips, one after the other.

    The run is a dynamics with --snapshots. MP4 needs ffmpeg; without it the film is a GIF. Each snapshot is shown for
    the same time, whatever time lies between them: its title has it.

    \b
    Example:
      bearings run --shape 10,10 --method rigid-limit --initial random --duration 2 \\
        --snapshots log:1e-3,2,40 --out outputs/a
      bearings movie outputs/a --fps 10
    """
    from taichi_bearings_cli.progress import Display

    from taichi_bearings.runs.movie import movie

    with Display():
        report = movie(Path(run), Path(out) if out else None, force, replica, fps)
    size = f"{report['bytes'] / 1e6:.1f} MB"
    click.echo(json.dumps(report) if as_json else f"{report['file']}: {report['frames']} snapshots; {size}")
