"""The command `bearings benchmark`."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from taichi_bearings_cli.options import Choice, answer, json_option, out_options
from taichi_bearings_cli.progress import Display

PARTS = {
    "throughput": "kernels", "peers": "methods,scans,dynamics", "accuracy": "methods", "growth": "growth",
    "speed": None,
}  # fmt: skip
"""What can be measured, and the parts that it consists of; None for those that --parts names."""
USED_BY = (
    {"precision": ("kernels",), "largest": ("growth",)}
    | dict.fromkeys(("law", "methods", "time_limit"), ("methods",))
    | dict.fromkeys(("seed", "peers"), ("methods", "growth"))
)
"""Options that belong to some parts alone, and those parts."""


@click.command()
@click.argument("what", type=Choice(list(PARTS)), metavar="WHAT")
@click.option(
    "--parts",
    metavar="NAME[,NAME...]",
    help="Only for `speed`: parts to measure, of kernels, methods, scans, growth, start and dynamics. [default: all]",
)
@click.option(
    "--law",
    multiple=True,
    metavar="LAW",
    help="Only for the part `methods`: contact law, coulomb, viscous or coulomb-viscous; may be repeated.",
)
@click.option(
    "--seed",
    default="0",
    show_default=True,
    metavar="N",
    help="Only for the parts `methods` and `growth`: seed of the samples.",
)
@click.option(
    "--methods",
    metavar="NAME[,NAME...]",
    help="Only for the part `methods`: names of the methods to compare. [default: all]",
)
@click.option(
    "--peers/--no-peers",
    default=True,
    show_default=True,
    help="Only for the parts `methods` and `growth`: run other solvers too (Clarabel, SCS), if they are installed.",
)
@click.option(
    "--time-limit",
    metavar="SECONDS",
    help="Only for the part `methods`: time limit of a solve. [default: 10, with --quick 1, with --full 60]",
)
@click.option(
    "--precision",
    metavar="f64|f32",
    help="Only for the part `kernels`: double (f64) or single (f32) precision. [default: both, with --quick f64]",
)
@click.option(
    "--largest",
    metavar="N",
    help="Only for the part `growth`: spheres along an edge of the largest cube; up to 64 in a quarter of an hour. "
    "[default: 32, with --quick 24, with --full 64]",
)
@click.option(
    "--shape",
    multiple=True,
    metavar="NX,NY[,NZ]",
    help="Lattice to measure on, such as 32,32,32, instead of the default ones of each part; may be repeated.",
)
@click.option(
    "--threads",
    metavar="N[,N...]",
    help="Numbers of CPU threads to measure with. [default: 1 and all; --full: 1, 2, 4 ...]",
)
@click.option("--quick", "budget", flag_value="quick", help="Measure small lattices only; takes a few minutes.")
@click.option(
    "--full",
    "budget",
    flag_value="full",
    help="Measure large lattices too, up to 128,128,128 and 4096,4096; takes hours.",
)
@out_options("Folder for the files. [default: outputs/<time>-benchmark-<id>]")
@json_option
@click.pass_context
def command(
    context: click.Context, what: str, parts: str | None, out: Path | None, force: bool, as_json: bool, **asked: Any
) -> None:
    """Measure speed and accuracy. WHAT is one of

    \b
    speed       all that is measured, beside other programs; the others are parts of it
    throughput  kernels: sweeps, time steps and splitting iterations beside NumPy and plain C
    peers       methods, scans and dynamics beside Clarabel, SCS, LAMMPS and YADE
    growth      times and memory of a proven minimum against the size of the cube, beside Clarabel: power laws with
                their exponents, and what bounds them
    accuracy    methods: run time against error, every method and two general conic solvers on the same scenes, by
                the same certificate; without --shape 10x10, 32x32, 10x10x10 and 16x16x16 Coulomb, 32x32 and 10x10x10
                viscous

    Times are medians of rounds that time everything once, wall and processor, without compilation. Writes report.md, a
    CSV for each part (of methods one row a checkpoint), and figures of kernels, methods and growth. Programs that are
    not installed, and lattices that do not fit into memory, are left out and named. Exit code 1 if two runs contradict
    each other: one proves a bound above the other's power.

    \b
    Examples:
      bearings benchmark speed --quick
      bearings benchmark speed --parts kernels,scans --shape 64,64,64 --threads 1,2
      bearings benchmark growth --largest 64
      bearings benchmark accuracy --shape 24,24,24 --methods gradient-descent --no-peers
    """
    from taichi_bearings_studies.benchmarks.harness import TEXT, machine, measure, text, write
    from taichi_bearings_studies.benchmarks.harness import as_json as described
    from taichi_bearings_studies.benchmarks.table import BENCHMARKS, planned

    from taichi_bearings.errors import InputError
    from taichi_bearings.files.whole_file import refuse_standing
    from taichi_bearings.options import chosen
    from taichi_bearings.runs.run_directory import default_run_path, writable_folder

    if parts is not None and PARTS[what]:
        raise InputError(
            f"--parts belongs to `bearings benchmark speed`, not to `bearings benchmark {what}`; leave it out"
        )
    benchmarks = {name: BENCHMARKS[name] for name in chosen("parts", PARTS[what] or parts, BENCHMARKS)}
    _refuse_of_other_parts(context, benchmarks, asked)
    plan, here = planned(**asked), machine()
    folder = out or default_run_path("benchmark")
    others = [f"{name}.{ending}" for name in benchmarks for ending in ("csv", "png")]
    refuse_standing([folder / name for name in (TEXT, *others)], force)
    with Display(), writable_folder(folder):
        report = measure(benchmarks, plan)
        written = write(folder, benchmarks, report, here)
    words = [text(benchmarks, report, here), *map(str, written)]
    answer(described(report, here, written), as_json, lambda: "\n".join(words))
    context.exit(130 if report.interrupted else 1 if report.faults or not report.rows else 0)


def _refuse_of_other_parts(context: click.Context, benchmarks: Collection[str], asked: Mapping[str, Any]) -> None:
    """Raise InputError for options that belong only to parts that are not measured, or that exclude each other.

    context : of click, which knows the options that were given.
    benchmarks : names of the parts that are measured.
    asked : values of the options by name.
    """
    from taichi_bearings.errors import InputError

    for name, used in USED_BY.items():
        if not {*used} & {*benchmarks} and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            option, one = name.replace("_", "-"), len(used) == 1
            raise InputError(
                f"--{option} belongs to the part{'s' * (not one)} {' and '.join(used)}, which {'is' if one else 'are'} "
                f"not measured here; leave --{option} out"
            )
    if asked["largest"] and asked["shape"]:
        raise InputError("--largest and --shape both choose lattices; give one of them")
