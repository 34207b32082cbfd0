"""The command `bearings benchmark`."""

from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from taichi_bearings_cli.options import Choice, answer, json_option, out_options
from taichi_bearings_cli.progress import Display

PARTS = {"throughput": "kernels", "peers": "methods,scans,dynamics", "accuracy": "methods", "speed": None}
"""What can be measured, and the parts that it consists of; None for those that --parts names."""
USED_BY = {"precision": "kernels"} | dict.fromkeys(("law", "seed", "methods", "peers", "time_limit"), "methods")
"""Options that belong to one part alone, and that part."""


@click.command()
@click.argument("what", type=Choice(list(PARTS)), metavar="WHAT")
@click.option(
    "--parts",
    metavar="NAME[,NAME...]",
    help="Only for `speed`: parts to measure, of kernels, methods, scans, growth and dynamics. [default: all]",
)
@click.option(
    "--law",
    multiple=True,
    metavar="LAW",
    help="Only for the part `methods`: contact law, coulomb, viscous or coulomb-viscous; may be repeated.",
)
@click.option(
    "--seed", default="0", show_default=True, metavar="N", help="Only for the part `methods`: seed of the samples."
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
    help="Only for the part `methods`: run the solvers Clarabel and SCS too, if they are installed.",
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
    accuracy    methods: run time against error, every method and two general conic solvers on the same scenes, by
                the same certificate; without --shape 10x10, 32x32, 10x10x10 and 16x16x16 Coulomb, 32x32 and 10x10x10
                viscous

    Times are medians of rounds that time everything once, wall and processor, without compilation. Writes report.md, a
    CSV for each part (of methods one row a checkpoint), and figures of kernels and methods. Programs that are not
    installed, and lattices that do not fit into memory, are left out and named. Exit code 1 if two runs contradict each
    other: one proves more than the other's power.

    \b
    Examples:
      bearings benchmark speed --quick
      bearings benchmark speed --parts kernels,scans --shape 64,64,64 --threads 1,2
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
    for name, part in USED_BY.items():
        if part not in benchmarks and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            option = name.replace("_", "-")
            raise InputError(f"--{option} belongs to the part {part}, which is not measured here; leave --{option} out")
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
