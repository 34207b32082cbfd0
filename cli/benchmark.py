"""bearings benchmark"""

import json
from dataclasses import asdict

import click
from taichi_bearings_cli.options import json_option


@click.group()
def command() -> None:
    """Measure speed, as ratios within one run."""


@command.command()
@click.option("--shape", default="32,32,32", show_default=True, metavar="NX,NY,NZ", help="Cubic lattice.")
@click.option("--threads", default=None, metavar="N[,N...]", help="Thread counts. [default: 1 and all]")
@json_option
def throughput(shape: str, threads: str | None, as_json: bool) -> None:
    """Time of one sweep and one time step, and the ratio to vectorised NumPy in the same process.

    \b
    Example:
      bearings benchmark throughput --shape 32,32,32 --threads 1,2
    """
    from taichi_bearings.errors import InputError
    from taichi_bearings.runtime import available_threads
    from taichi_bearings.studies.settings import RunSettings
    from taichi_bearings.studies.throughput import measure

    sides = RunSettings(shape=shape).shape  # type: ignore[arg-type]
    if len(sides) != 3:
        raise InputError(f"shape is {shape!r}; the throughput benchmark needs three numbers")
    most = available_threads()
    try:
        counts = [int(word) for word in threads.split(",")] if threads else sorted({1, most})
    except ValueError:
        raise InputError(f"threads is {threads!r}; it must be whole numbers such as 1,2") from None
    if not all(1 <= number <= most for number in counts):
        raise InputError(f"threads is {threads!r}; this process may use 1 to {most}")
    rows = [row for number in counts for row in measure(sides, number)]
    if as_json:
        click.echo(json.dumps({"shape": list(sides), "rows": [asdict(row) for row in rows]}))
        return
    click.echo(f"{'':22} {'components':>10} {'threads':>8} {'time':>10} {'contacts/s':>12} {'NumPy / this':>13}")
    for row in rows:
        ratio = f"{row.ratio:.1f}" if row.ratio is not None else ""
        click.echo(
            f"{row.what:22} {row.components:>10} {row.threads:>8} {row.seconds * 1e6:>7.1f} us"
            f" {row.contact_updates / 1e6:>10.0f} M {ratio:>13}"
        )
