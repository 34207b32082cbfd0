"""The command `bearings stress`."""

from pathlib import Path

import click
from taichi_bearings_cli.options import FILE_PATH, answer, json_option
from taichi_bearings_cli.progress import Display


@click.command()
@click.option(
    "--quick", is_flag=True, help="Quick version: two or three values per parameter, smaller samples, about a minute."
)
@click.option(
    "--only",
    metavar="AXIS[,AXIS...]",
    help="Parameters to take to their extremes, such as contrast,zeros. [default: all]",
)
@click.option("--method", metavar="NAME[,NAME...]", help="Names of the methods to try. [default: all, and auto]")
@click.option("--law", metavar="LAW[,LAW...]", help="Contact laws to try. [default: all]")
@click.option(
    "--seed",
    default=0,
    show_default=True,
    metavar="N",
    type=click.IntRange(0),
    help="Seed of the first sample; the next ones have the seeds after it.",
)
@click.option("--time-limit", type=click.FloatRange(0, min_open=True), metavar="SECONDS",
              help="Time limit of a solve; some parameters take a multiple. [default: 2, with --quick 1]")  # fmt: skip
@click.option(
    "--workers",
    default=0,
    metavar="N",
    type=click.IntRange(0),
    help="Number of processes. [default: one for each processor]",
)
@click.option(
    "--out",
    metavar="DIR",
    type=FILE_PATH,
    help="Folder of the report; a report that it holds already is continued. [default: outputs/<time>-stress-<id>]",
)
@json_option
@click.pass_context
def command(
    context: click.Context,
    only: str | None,
    method: str | None,
    law: str | None,
    time_limit: float | None,
    workers: int,
    out: Path | None,
    as_json: bool,
    **of_cells: int,
) -> None:
    """Try every method, law, dimension, precision and device at extreme inputs, judged by exact truths.

    Each axis is a parameter that is taken to its extremes; a cell is one of its values for one method, law and device.
    Writes stress.csv (one row a cell), summary.json, and a map for each axis (PNG and PDF). Finished cells are kept in
    the folder: the same command continues after a kill, and judges them again. Exit code 1 if an answer is wrong
    without saying so, or a cell crashes; docs/limits.md says what is tried and how it is judged.

    \b
    Examples:
      bearings stress --quick
      bearings stress --only contrast,zeros --method interior-point,gradient-descent --out outputs/stress
    """
    from taichi_bearings_studies.stress.axes import AXES, ROWS, cells_of, rows_of
    from taichi_bearings_studies.stress.report import lines_of, open_sweep

    from taichi_bearings.options import chosen
    from taichi_bearings.runs.run_directory import default_run_path
    from taichi_bearings.runtime import available_threads
    from taichi_bearings.scene.law import LAWS

    quick = bool(of_cells["quick"])
    rows = rows_of(chosen("method", method, ROWS), chosen("law", law, LAWS))
    cells = cells_of(rows, chosen("only", only, AXES), of_cells["seed"], quick, time_limit or (1.0 if quick else 2.0))
    with Display(), open_sweep(out or default_run_path("stress"), cells) as sweep:
        finished = sweep.run(workers or available_threads(), lambda line: click.echo(line, err=True))
        paths = sweep.write()
    wrong = [f"{cell['outcome'].upper()} {cell['key']}: {cell['reason']}" for cell in sweep.red]
    words = [*lines_of(sweep.summary()), *wrong, str(sweep.folder)]
    answer(sweep.summary() | {"files": [str(path) for path in paths]}, as_json, lambda: "\n".join(words))
    context.exit(130 if not finished else 1 if sweep.red else 0)
