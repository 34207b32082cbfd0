"""The command `bearings scan`."""

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.options import FILE_PATH, answer, json_option, options_in
from taichi_bearings_cli.progress import ScanDisplay

from taichi_bearings import interrupts
from taichi_bearings.copies import begun_early
from taichi_bearings.errors import InputError, printable
from taichi_bearings.plain_files import Json
from taichi_bearings.progress import duration
from taichi_bearings.runs.settings import SCAN_OPTIONS
from taichi_bearings.words import counted


@click.command(params=options_in(SCAN_OPTIONS))
@click.argument("scan", metavar="SCAN", type=FILE_PATH)
@click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE",
    help="Set an option of `run` for all samples, such as law=viscous, or vary it by a list or range, such as "
    "\"scan.seed=[1, 2]\" or \"scan.seed={start=0, stop=9}\"; this wins over the file. May be repeated.",
)  # fmt: skip
@click.option(
    "--workers",
    type=click.IntRange(1),
    default=None,
    help="Largest number of processes. [default: one for each processor]",
)
@click.option(
    "--scheduler", metavar="ADDRESS", default=None,
    help="Solve on the Dask cluster with this scheduler: an address such as tcp://node:8786, or a scheduler file.",
)  # fmt: skip
@click.option(
    "--part",
    metavar="I/N",
    default=None,
    help="Divide the samples into N parts and solve only part I, as one job of a job array does; --merge combines all.",
)
@click.option("--merge", is_flag=True, help="Solve nothing; combine all parts in the folder into scan.h5, scan.csv.")
@click.option(
    "--dry-run", is_flag=True, help="Solve nothing; print the number of samples, and the time and memory to expect."
)
@click.option(
    "--out", metavar="DIR", type=FILE_PATH,
    help="Folder of the scan; if it holds a scan, what is missing is solved. [default: outputs/<time>-scan-<id>]",
)  # fmt: skip
@json_option
@click.pass_context
def command(context: click.Context, scan: Path, dry_run: bool, as_json: bool, **asked: Any) -> None:
    """Solve many systems. SCAN is a TOML file with keys of `run` and a table [scan] with a list or a range for each key
    that varies; or the folder of a scan, which is continued.

    The folder gets scan.csv and scan.h5, one row a sample: the scanned keys, power, lower_bound, gap, status, ... and
    the distribution of power. The same scan into the same folder again solves only what is missing or has failed; a
    scan with more samples extends it. The options --analyse, --keep-states and --sample-timeout, which can stand in the
    file too, apply whenever the scan is continued; samples that lack what they ask for are solved again. A sample that
    fails is tried twice and named; the others go on.

    \b
    Exit codes: 0 all reached, 1 a sample failed or stopped short, 2 bad input, 130 interrupted (what is done is kept).

    \b
    Example of a file SCAN.toml:
      shape = [10, 10]
      [scan]
      seed = { start = 0, stop = 1000 }
      distribution = ["uniform:0.1,1.0", "uniform:0.5,0.6"]

    \b
    Examples:
      bearings scan SCAN.toml --dry-run
      bearings scan SCAN.toml --out outputs/scan
      bearings scan outputs/scan
      bearings scan SCAN.toml --out outputs/scan --set "scan.seed={start=0, stop=2000}"
      bearings scan SCAN.toml --scheduler tcp://node:8786
      bearings scan SCAN.toml --out outputs/scan --part 3/100; bearings scan outputs/scan --merge
    """
    solves_here = not (dry_run or asked["merge"] or asked["scheduler"])
    with interrupts.keeping(), begun_early() if solves_here else nullcontext():
        code = _solve(scan, dry_run, as_json, asked)
    context.exit(code)


def _solve(scan: Path, dry_run: bool, as_json: bool, asked: Json) -> int:
    """Solve, merge or estimate a scan, print the report, and return the exit code of the command `bearings scan`.

    scan : its file SCAN.toml, or the folder of a scan that is continued.
    dry_run : True to print the time and memory to expect only.
    as_json : True to print one JSON object.
    asked : the other options of the command by name.
    """
    from taichi_bearings.runs.run_directory import default_run_path
    from taichi_bearings.scans import scan as study
    from taichi_bearings.scans.cluster import connected
    from taichi_bearings.scans.parts import Part
    from taichi_bearings.scans.plan import read_plan

    path, folder = scan / "scan.toml" if scan.is_dir() else scan, asked["out"]
    folder = scan if scan.is_dir() and folder is None else folder  # the scan continues where it is
    merge, one_part, scheduler = asked["merge"], asked["part"] is not None, asked["scheduler"] is not None
    if scheduler and asked["workers"] is not None:
        raise InputError("with --scheduler the Dask cluster provides the workers; leave out --workers")
    if merge and (one_part or scheduler):
        raise InputError("--merge only combines what is solved; leave out --part and --scheduler")
    if folder is None and (merge or (one_part and not dry_run)):
        raise _without_folder(scan)
    folder, workers = folder or default_run_path("scan"), asked["workers"] or 0
    part = Part.parse(asked["part"]) if one_part else None
    plan = read_plan(path, asked["overrides"], {name: asked[name] for name in SCAN_OPTIONS if asked[name] is not None})
    if dry_run:
        expected = study.estimate(plan, folder, workers, part)
        answer(expected, as_json, lambda: describe_estimate(expected))
        return 0
    if merge:
        report = study.merge(plan, folder)
    else:
        with ScanDisplay() as display, connected(asked["scheduler"]) as client:
            report = study.scan(plan, folder, workers, display, client=client, part=part)
    answer(report, as_json, lambda: describe(report))
    interrupts.ignore_signals()  # the report is printed
    done = report["reached"] == report["samples"] and not report["lacking"]
    return 130 if report["interrupted"] else 0 if done else 1


def _without_folder(scan: Path) -> InputError:
    """Return the error for --part or --merge without a folder.

    scan : the path that the user gave.
    """
    if scan.suffix != ".toml" and not scan.exists():  # probably the mistyped name of a folder
        return InputError(
            f"there is no {scan}; --part and --merge need the folder of a scan, or its file and --out DIR"
        )
    return InputError("--part and --merge need --out DIR, the same for all parts")


def describe_estimate(expected: Json) -> str:
    """Return in words what a scan would do.

    expected : the object of `--dry-run --json`.
    """
    lines = [f"{counted(expected['samples'], 'sample')} over {', '.join(expected['scanned']) or 'nothing'}"]
    if expected["missing"] < expected["samples"]:
        lines[0] += f", of which {expected['missing']:,} are missing"
    time = "unknown" if expected["seconds"] is None else f"about {duration(expected['seconds'])}"
    workers = counted(expected["workers"], "worker")
    lines.append(f"time: {time} with {workers} (within a factor of three on an idle computer)")
    gigabytes = expected["bytes"] / 1e9
    lines.append(f"memory: about {gigabytes:.1f} GB")
    return "\n".join(lines)


def describe(report: Json) -> str:
    """Return the report of a scan in words, some lines.

    report : the object of `--json`.
    """
    done, failed, missing, lacking = (report[name] for name in ("done", "failed", "missing", "lacking"))
    again, incomplete = f"bearings scan {report['scan']}", report.get("incomplete_parts", [])
    now = f"{report['solved_now']:,} of them now, " if report["solved_now"] < done else ""
    have, lack = ("has" if report["warned"] == 1 else "have"), ("lacks" if lacking == 1 else "lack")
    unanalysed = 0 if lacking else report["unanalysed"]
    removed = ", ".join(Path(name).name for name in report["removed"])
    lines = {  # a line, and what makes it worth saying
        f"{done:,} of {report['samples']:,} samples have a result, {now}in {report['seconds']:.1f} s": True,
        f"{counted(done - report['reached'], 'sample')} stopped short of what was asked for: see the column status": (
            done > report["reached"]
        ),
        f"{counted(failed, 'sample')} failed:": failed,
        **{printable(f"  {item['sample']}: {item['error']}"): True for item in report["failures"][:10]},
        f"  ... and {failed - 10:,} more: see the column error": failed > 10,
        f"{counted(report['warned'], 'sample')} {have} warnings: see the column `warnings`": report["warned"],
        **{f"part {item['part']} lacks {counted(item['missing'], 'sample')}": True for item in incomplete[:20]},
        f"... and {len(incomplete) - 20:,} more parts": len(incomplete) > 20,
        f"{counted(missing, 'sample')} {'is' if missing == 1 else 'are'} missing": missing,
        f"{counted(lacking, 'sample')} {lack} the analysis or the full state that was asked for": lacking,
        f"{counted(unanalysed, 'sample')} without the numbers of --analyse that the others have; "
        f"`{again} --analyse` adds them": unanalysed,
        f"`{again}` solves what is missing or has failed": failed or missing or lacking,
        f"removed figures that showed an earlier state of the scan: {removed}": removed,
    }
    return "\n".join([*(line for line, is_worth in lines.items() if is_worth), *report["files"]])
