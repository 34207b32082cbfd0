"""bearings histogram"""

import json
from pathlib import Path

import click
from taichi_bearings_cli.options import json_option


@click.command()
@click.argument("runs", nargs=-1, required=True, metavar="RUN...")
@click.option("--bins-per-decade", type=click.IntRange(1, 100), default=5, show_default=True, help="Width of the bins.")
@click.option(
    "--out", metavar="DIR", default=None, help="Folder for the files. [default: outputs/<time>-histogram-<id>]"
)
@click.option("--force", is_flag=True, help="Replace existing files.")
@json_option
def command(runs: tuple[str, ...], bins_per_decade: int, out: str | None, force: bool, as_json: bool) -> None:
    """Distribution of the power per contact, pooled over RUN..., as CSV, HDF5 and PNG.

    Only slipping contacts are binned; slipless and undecided ones are counted in the header.

    \b
    Example:
      bearings histogram outputs/a outputs/b --bins-per-decade 10 --out outputs --force
    """
    from taichi_bearings.analysis.histogram import power_histogram, write_csv, write_hdf5
    from taichi_bearings.errors import FileError, InputError
    from taichi_bearings.files.run_file import read_run_file
    from taichi_bearings.plots.histogram import draw_histogram
    from taichi_bearings.plots.style import save
    from taichi_bearings.studies.run_directory import default_run_path

    stored = [read_run_file(Path(run)) for run in runs]
    if len({run.path.resolve() for run in stored}) < len(stored):
        raise InputError(f"the runs {', '.join(runs)} name the same run twice")
    laws = sorted({str(run.attributes["law"]) for run in stored})
    if len(laws) > 1:
        raise InputError(f"the runs have different laws ({', '.join(laws)}); pool runs of one law")
    folder = Path(out) if out else default_run_path("histogram")
    paths = {ending: folder / f"power_histogram.{ending}" for ending in ("csv", "h5", "png")}
    standing = [path for path in paths.values() if path.exists()]
    if standing and not force:
        raise FileError(f"{standing[0]} already exists; choose another --out or add --force")
    histogram = power_histogram(
        [values for run in stored for values in run.power],
        [values for run in stored for values in run.state],
        max(float(run.attributes["slip_threshold"]) for run in stored),
        bins_per_decade,
        samples=sum(len(run.spin) for run in stored),
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_csv(histogram, paths["csv"])
        write_hdf5(histogram, paths["h5"])
        save(draw_histogram(histogram), paths["png"])
    except OSError as error:
        raise FileError(f"{folder} cannot be written: {error.strerror or error}") from None
    report = {
        "slipping": histogram.slipping,
        "slipless": histogram.slipless,
        "undecided": histogram.undecided,
        "samples": histogram.samples,
        "smallest_power": float(histogram.edges[0]) if histogram.slipping else None,
        "largest_power": float(histogram.edges[-1]) if histogram.slipping else None,
        "files": [str(path) for path in paths.values()],
    }
    if as_json:
        click.echo(json.dumps(report))
        return
    span = f" from {histogram.edges[0]:.2e} to {histogram.edges[-1]:.2e}" if histogram.slipping else ""
    click.echo(f"{histogram.slipping:,} slipping contacts{span}, {histogram.slipless:,} slipless")
    click.echo("\n".join(report["files"]))
