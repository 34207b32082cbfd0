"""bearings benchmark"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.main import Group
from taichi_bearings_cli.options import answer, json_option, out_options
from taichi_bearings_cli.progress import Display


@click.group(cls=Group)
def command() -> None:
    """Measure speed and accuracy."""


OF_KERNELS = (click.option("--precision", metavar="f64|f32", help="One only. [default: both, --quick f64]"),)
OF_METHODS = (
    click.option(
        "--law", multiple=True, metavar="LAW", help="coulomb, viscous or coulomb-viscous; repeat for several."
    ),
    click.option("--seed", default="0", show_default=True, metavar="N", help="Seed of the disorder."),
    click.option("--methods", metavar="NAME[,NAME...]", help="Methods to compare. [default: all]"),
    click.option("--peers/--no-peers", default=True, show_default=True, help="Clarabel and SCS too, where installed."),
    click.option("--time-limit", metavar="SECONDS", help="A method and scene. [default: 10, --quick 1, --full 60]"),
)
PARTS_OF_SPEED = (
    click.option("--parts", metavar="NAME[,NAME...]", help="Of kernels, methods, scans, dynamics. [default: all]"),
)


def _options(*own: Any) -> Callable[[Callable[..., None]], Any]:
    """These options and those of every benchmark."""

    def with_options(measured: Callable[..., None]) -> Any:
        for option in reversed((
            *own,
            click.option("--shape", multiple=True, metavar="NX,NY[,NZ]", help="Instead of the usual ones; repeatable."),
            click.option("--threads", metavar="N[,N...]", help="CPUs. [default: 1 and all; --full: 1, 2, 4 ...]"),
            click.option("--quick", "budget", flag_value="quick", help="Small lattices, some minutes at most."),
            click.option("--full", "budget", flag_value="full", help="Up to 128,128,128 and 4096,4096; hours."),
            out_options("Folder for the files. [default: outputs/<time>-benchmark-<id>]"),
            json_option,
            click.pass_context,
        )):  # fmt: skip
            measured = option(measured)
        return measured

    return with_options


@command.command()
@_options(*PARTS_OF_SPEED, *OF_METHODS, *OF_KERNELS)
def speed(context: click.Context, parts: str | None, **asked: Any) -> None:
    """All that is measured, beside other programs; the other commands are parts.

    Times are medians of rounds that time everything once, wall and processor, compilation apart.
    Writes report.md, for each part a CSV, and figures of kernels and methods. Peers that are not installed are named.
    Lattices that do not fit into the memory are left out. Exit code 1 if two runs contradict each other.

    \b
    Examples:
      bearings benchmark speed --quick
      bearings benchmark speed --parts kernels,scans --shape 64,64,64 --threads 1,2
    """
    _measure(context, parts, **asked)


@command.command()
@_options(*OF_KERNELS)
def throughput(context: click.Context, **asked: Any) -> None:
    """Sweeps, time steps and splitting iterations beside NumPy and plain C.

    \b
    Example:
      bearings benchmark throughput --shape 32,32,32 --threads 1,2
    """
    _measure(context, "kernels", **asked)


@command.command()
@_options(*OF_METHODS)
def peers(context: click.Context, **asked: Any) -> None:
    """Methods, scans and dynamics beside Clarabel, SCS, moreau, LAMMPS and YADE.

    \b
    Example:
      bearings benchmark peers --quick
    """
    _measure(context, "methods,scans,dynamics", **asked)


@command.command()
@_options(*OF_METHODS)
def accuracy(context: click.Context, **asked: Any) -> None:
    """Run time against error: every method and two general conic solvers on the same scenes, by the same certificate.

    Writes methods.csv (one row a checkpoint), report.md (time to reach each proven gap) and methods.png. Without
    --shape: 10x10, 32x32, 10x10x10 and 16x16x16 Coulomb, 32x32 and 10x10x10 viscous. Exit code 1 if two runs contradict
    each other: one proves more than the other's power.

    \b
    Examples:
      bearings benchmark accuracy --time-limit 60 --out outputs/accuracy
      bearings benchmark accuracy --shape 24,24,24 --methods gradient-descent --no-peers
    """
    _measure(context, "methods", **asked)


def _measure(
    context: click.Context, parts: str | None, out: Path | None, force: bool, as_json: bool, **asked: Any
) -> None:
    from taichi_bearings_studies.benchmarks.harness import as_json as described
    from taichi_bearings_studies.benchmarks.harness import machine, measure, names, text, write
    from taichi_bearings_studies.benchmarks.table import BENCHMARKS, planned
    from taichi_bearings_studies.report import Files

    from taichi_bearings.options import chosen
    from taichi_bearings.runs.run_directory import default_run_path

    benchmarks = {name: BENCHMARKS[name] for name in chosen("parts", parts, BENCHMARKS)}
    plan, here = planned(**asked), machine()
    files = Files(out or default_run_path("benchmark"), names(benchmarks), force)
    with Display():
        report = measure(benchmarks, plan)
    if not report.rows:
        files.clear()
        for note in report.notes:
            click.echo(f"bearings: {note}", err=True)
        context.exit(130 if report.interrupted else 1)
    written = write(files, benchmarks, report, here)
    words = [text(benchmarks, report, here), *map(str, written)]
    answer(described(report, here, written), as_json, lambda: "\n".join(words))
    context.exit(130 if report.interrupted else 1 if report.faults else 0)
