"""bearings benchmark"""

import json
from dataclasses import asdict
from pathlib import Path

import click
from taichi_bearings_cli.options import json_option
from taichi_bearings_cli.suggestions import Group


@click.group(cls=Group)
def command() -> None:
    """Measure speed and accuracy."""


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
    from taichi_bearings_cli.progress import Display

    from taichi_bearings.benchmarks.throughput import measure
    from taichi_bearings.errors import InputError
    from taichi_bearings.runs.settings import RunSettings
    from taichi_bearings.runtime import available_threads
    from taichi_bearings.stages import each

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
    with Display():
        rows = [row for number in each(counts, "measuring, thread count") for row in measure(sides, number)]
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


@command.command()
@click.option(
    "--shape", multiple=True, metavar="NX,NY[,NZ]", help="Spheres along each axis; repeat for several scenes."
)
@click.option("--law", multiple=True, metavar="LAW", help="coulomb, viscous or coulomb-viscous; repeat for several.")
@click.option("--seed", default="0", show_default=True, metavar="N", help="Seed of the disorder.")
@click.option("--methods", default=None, metavar="NAME[,NAME...]", help="Methods to compare. [default: all]")
@click.option("--peers/--no-peers", default=True, show_default=True, help="Clarabel and SCS too, where installed.")
@click.option("--time-limit", default="20", show_default=True, metavar="SECONDS", help="For each method and scene.")
@click.option("--threads", default="0", show_default=True, metavar="N", help="CPU threads; 0 for all.")
@click.option(
    "--out", metavar="DIR", default=None, help="Folder for the files. [default: outputs/<time>-accuracy-<id>]"
)
@click.option("--force", is_flag=True, help="Replace existing files.")
@json_option
@click.pass_context
def accuracy(
    context: click.Context,
    shape: tuple[str, ...],
    law: tuple[str, ...],
    methods: str | None,
    peers: bool,
    out: str | None,
    force: bool,
    as_json: bool,
    **of_runs: str,
) -> None:
    """Run time against error: every method and two general conic solvers on the same scenes, by the same certificate.

    Writes accuracy.csv (one row a checkpoint), accuracy.md (time to reach each proven gap) and accuracy.png. Without
    --shape: 10x10, 32x32, 10x10x10 and 16x16x16 Coulomb, 32x32 and 10x10x10 viscous. Exit code 1 if two runs contradict
    each other: one proves more than the other's power.

    \b
    Examples:
      bearings benchmark accuracy --time-limit 60 --out outputs/accuracy
      bearings benchmark accuracy --shape 24,24,24 --methods gradient-descent --no-peers
    """
    from taichi_bearings_cli.progress import Display

    from taichi_bearings.benchmarks.accuracy import choose_methods, choose_scenes, measure_all
    from taichi_bearings.benchmarks.accuracy_report import ReportFiles, summarise, table
    from taichi_bearings.benchmarks.peers import find_peers
    from taichi_bearings.runs.run_directory import default_run_path

    scenes = choose_scenes(shape, law, **of_runs)
    chosen = choose_methods(methods)
    files = ReportFiles(Path(out) if out else default_run_path("accuracy"), force)
    here, missing = find_peers() if peers else ([], {})
    with Display():
        results, interrupted = measure_all(scenes, chosen, here, lambda line: click.echo(line, err=True))
    if not results:
        context.exit(130)
    files.write(results)
    contradictions = [line for result in results for line in result.contradictions()]
    for line in contradictions:
        click.echo(f"bearings: {line}", err=True)
    written = [str(path) for path in files.paths]
    if as_json:
        report = {"scenes": [summarise(result) for result in results], "peers_missing": missing, "files": written}
        click.echo(json.dumps(report, allow_nan=False))
    else:
        click.echo(table(results))
        for name, reason in missing.items():
            click.echo(f"Without {name}: {reason}")
        click.echo("\n".join(written))
    context.exit(130 if interrupted else 1 if contradictions else 0)
