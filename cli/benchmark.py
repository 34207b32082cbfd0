"""bearings benchmark"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.main import Group
from taichi_bearings_cli.options import answer, json_option, out_options
from taichi_bearings_cli.progress import Display


@click.group(cls=Group)
def command() -> None:
    """Measure speed and accuracy."""


shape_option = click.option(
    "--shape", multiple=True, metavar="NX,NY[,NZ]", help="Lattice instead of the usual ones; repeat for several."
)


def _speed_options(measured: Callable[..., None]) -> Any:
    """The options of all commands that measure speed."""
    for option in reversed((
        shape_option,
        click.option("--threads", metavar="N[,N...]", help="Thread counts. [default: 1 and all; --full: 1, 2, 4 ...]"),
        click.option("--precision", metavar="f64|f32", help="One precision only. [default: both, --quick f64]"),
        click.option("--quick", "budget", flag_value="quick", help="Small lattices, about two minutes."),
        click.option("--full", "budget", flag_value="full", help="Up to 128,128,128 and 4096,4096; an hour or more."),
        out_options("Folder for the files. [default: outputs/<time>-speed-<id>]"),
        json_option,
        click.pass_context,
    )):  # fmt: skip
        measured = option(measured)
    return measured


@command.command()
@click.option("--parts", metavar="NAME[,NAME...]", help="Of memory, kernels, methods, scans, dynamics. [default: all]")
@_speed_options
def speed(context: click.Context, **asked: Any) -> None:
    """Time of every kernel and method beside what the machine allows, and beside other programs.

    Times are medians of rounds that time everything once, wall and processor, compilation apart; bytes and operations
    are counted. Writes speed.csv and roofline.png. Peers that are not installed are named. Lattices that do not fit
    into the memory are left out.

    \b
    Examples:
      bearings benchmark speed --quick
      bearings benchmark speed --parts kernels,memory --shape 64,64,64 --threads 1,2
    """
    _measure_speed(context, **asked)


def _measure_speed(
    context: click.Context,
    parts: str | None,
    budget: str | None,
    out: Path | None,
    force: bool,
    as_json: bool,
    **asked: Any,
) -> None:
    from taichi_bearings_studies.benchmarks import speed_report
    from taichi_bearings_studies.benchmarks.speed import BUDGETS, chosen_parts, chosen_threads, measure, only
    from taichi_bearings_studies.report import Files

    from taichi_bearings.runs.run_directory import default_run_path

    chosen, usual = chosen_parts(parts), BUDGETS[budget or "usual"]
    threads, plan = chosen_threads(asked["threads"], usual), only(usual, asked["shape"], asked["precision"])
    files = Files(out or default_run_path("speed"), speed_report.NAMES, force)
    with Display():
        report = measure(plan, chosen, threads)
    if not report.rows:
        files.clear()
        context.exit(130 if report.interrupted else 1)
    written = speed_report.write(files, report)
    words = [speed_report.table(report), "", *map(str, written)]
    answer(speed_report.as_json(report, written), as_json, lambda: "\n".join(words))
    context.exit(130 if report.interrupted else 0)


for name, parts, text in (
    (
        "throughput",
        "memory,kernels",
        "Sweeps, time steps and splitting iterations beside NumPy, plain C and the memory",
    ),
    ("peers", "methods,scans,dynamics", "Methods, scans and dynamics beside Clarabel, moreau, SCS, LAMMPS and YADE"),
):
    example = f"\b\nExample:\n  bearings benchmark {name} --quick"
    command.command(name, help=f"{text}: a part of `speed`.\n\n{example}")(
        _speed_options(partial(_measure_speed, parts=parts))
    )


@command.command()
@shape_option
@click.option("--law", multiple=True, metavar="LAW", help="coulomb, viscous or coulomb-viscous; repeat for several.")
@click.option("--seed", default="0", show_default=True, metavar="N", help="Seed of the disorder.")
@click.option("--methods", default=None, metavar="NAME[,NAME...]", help="Methods to compare. [default: all]")
@click.option("--peers/--no-peers", default=True, show_default=True, help="Clarabel and SCS too, where installed.")
@click.option("--time-limit", default="20", show_default=True, metavar="SECONDS", help="For each method and scene.")
@click.option("--threads", default="0", show_default=True, metavar="N", help="CPU threads; 0 for all.")
@out_options("Folder for the files. [default: outputs/<time>-accuracy-<id>]")
@json_option
@click.pass_context
def accuracy(
    context: click.Context,
    shape: tuple[str, ...],
    law: tuple[str, ...],
    methods: str | None,
    peers: bool,
    out: Path | None,
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
    from taichi_bearings_studies.benchmarks.accuracy import choose_methods, choose_scenes, measure_all
    from taichi_bearings_studies.benchmarks.accuracy_report import NAMES, summarise, table, write
    from taichi_bearings_studies.benchmarks.peers import find_peers
    from taichi_bearings_studies.report import Files

    from taichi_bearings.runs.run_directory import default_run_path

    scenes = choose_scenes(shape, law, **of_runs)
    chosen = choose_methods(methods)
    files = Files(out or default_run_path("accuracy"), NAMES, force)
    here, missing = find_peers() if peers else ([], {})
    with Display():
        results, interrupted = measure_all(scenes, chosen, here, lambda line: click.echo(line, err=True))
    if not results:
        context.exit(130)
    write(files, results)
    contradictions = [line for result in results for line in result.contradictions()]
    for line in contradictions:
        click.echo(f"bearings: {line}", err=True)
    written = [str(path) for path in files.paths]
    report = {"scenes": [summarise(result) for result in results], "peers_missing": missing, "files": written}
    words = [table(results), *(f"Without {name}: {reason}" for name, reason in missing.items()), *written]
    answer(report, as_json, lambda: "\n".join(words))
    context.exit(130 if interrupted else 1 if contradictions else 0)
