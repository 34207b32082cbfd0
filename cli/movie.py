"""The command `bearings movie`."""

from pathlib import Path

import click
from taichi_bearings_cli.options import answer, json_option, out_options, replica_option, run_argument, title_option
from taichi_bearings_cli.progress import Display


@click.command()
@run_argument
@click.option("--fps", type=float, default=4.0, show_default=True, help="Number of snapshots shown in a second.")
@replica_option
@title_option
@out_options("MP4 or GIF to write. [default: movie.mp4 in the run directory]", "FILE", "Replace an existing file.")
@json_option
def command(run: Path, fps: float, replica: int, title: bool, out: Path | None, force: bool, as_json: bool) -> None:
    """Make a film of the snapshots of RUN, a run directory or its run.h5: spins and slipping contacts, one after the
    other.

    The run is a dynamics with --snapshots. MP4 needs ffmpeg; without it the film is a GIF. Each snapshot is shown for
    the same time, whatever the simulated time between them, which stands in its title.

    \b
    Example:
      bearings run --shape 10,10 --method rigid-limit --initial random --duration 2 \\
        --snapshots log:1e-3,2,40 --out outputs/a
      bearings movie outputs/a --fps 10
    """
    from taichi_bearings.runs.movie import movie

    with Display():
        report = movie(run, out, force, replica, fps, title)
    size = f"{report['bytes'] / 1e6:.1f} MB"
    is_second_choice = out is None and report["file"].endswith(".gif")
    why = "; a GIF, because there is no ffmpeg here, which MP4 needs" if is_second_choice else ""
    answer(report, as_json, lambda: f"{report['file']}: {report['frames']} snapshots; {size}{why}")
