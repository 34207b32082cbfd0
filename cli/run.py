"""The command `bearings run`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from taichi_bearings_cli.options import FILES, SettingsCommand, answer, json_option, out_options, title_option
from taichi_bearings_cli.progress import Display, in_lines
from taichi_bearings_cli.report import ends, lines_of, solved
from taichi_bearings_cli.verify import describe as describe_verdict

from taichi_bearings import interrupts, leaving
from taichi_bearings.plain_files import Json
from taichi_bearings.progress import duration
from taichi_bearings.quantities import COLUMNS
from taichi_bearings.words import counted, listed, other_contacts

if TYPE_CHECKING:
    from taichi_bearings.runs.result import Result
    from taichi_bearings.runs.settings import RunSettings

# columns from which the line on each sample is made, see `_of_a_sample`
OF_A_SAMPLE = ("power", "gap", "proof", "slipping", "slipless", "tied", "undecided", "unproven", "contacts")
LAST_COLUMNS = (
    "driven_power", "slipless_motions", "largest_slipless_slip", "smallest_slipping_slip",
    "power_normalised", "yields", "yield_torque_lower_bound", "yield_torque", "amplitude",
    "time", "duration",
)  # fmt: skip
"""Columns with which a report ends, where it has them."""


@click.command(cls=SettingsCommand)
@click.argument("scene", required=False, metavar="[SCENE.toml]", type=FILES)
@out_options(
    "Run directory. [default: outputs/<time>-run-<id>]", force="Replace an existing run directory.", kind=FILES
)
@click.option(
    "--resume", metavar="RUN", type=FILES, help="Continue this run from its last checkpoint, in the same directory."
)
@click.option(
    "--verify",
    is_flag=True,
    help="At the end prove power, bounds and contact states anew from the written file, as `bearings verify` does; "
    "exit code 1 if the file claims more.",
)
@click.option("--dry-run", is_flag=True, help="Solve nothing; print the method, and the time and memory to expect.")
@title_option
@json_option
@click.pass_context
def command(
    context: click.Context,
    scene: str | None,
    out: str | None,
    force: bool,
    resume: str | None,
    verify: bool,
    title: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Find the state of least power of one system (or of one for each of several seeds), and write a run directory.

    SCENE.toml has options as keys, with underscores instead of dashes; options on the command line win. A run directory
    or its run.h5 is run again. The directory gets run.h5, summary.json, scene.toml, power_histogram.csv and figures.
    Ctrl-C saves what was reached. With --checkpoint-every even a killed run can be resumed, to the same bits.

    \b
    Exit codes: 0 tolerance or duration reached, 1 not reached (the result is written), 2 bad input, 130 interrupted.

    \b
    Examples:
      bearings run --shape 10,10,10 --seed 3 --tolerance 1e-5
      bearings run scene.toml --method cundall-strack --initial random --out outputs/relaxation
      bearings run --method cundall-strack --duration 10 --record log:1e-4,10,100 --checkpoint-every 60 --out outputs/a
      bearings run --resume outputs/a --duration 20
      bearings run --shape 96,96,96 --tolerance 1e-3 --dry-run
    """
    given = {key: value for key, value in options.items() if value is not None}
    if given.pop("dry_run"):
        return _print_cost(scene, resume, given, as_json)
    with interrupts.keeping():
        with Display() as display:
            try:
                solve, place = _task(scene, out, force, resume, given)
                found = solve(title=title)
            except KeyboardInterrupt as error:
                goes_on = f"`bearings run --resume {error}` goes on from the last checkpoint"
                kept = goes_on if error.args else "nothing is kept"
                raise KeyboardInterrupt(f"bearings: interrupted before a first result was reached; {kept}") from None
            verdict, unverified = _verified(found.path) if verify and not found.interrupted else (None, False)
        summary = found.summary
        for sentence in summary["warnings"] + (_idle_seed(found.asked) if "seed" in given else []):
            click.echo(in_lines(f"bearings: warning: {sentence}", err=True), err=True)

        def words() -> str:
            """Return the report in words, and the verdict of --verify if there is one."""
            report = describe(summary, display.times()) + (UNVERIFIED if unverified else _ending(found))
            return in_lines(f"{report}\n{describe_verdict(verdict)}" if verdict else report)

        answer(summary | ({"verification": verdict} if verdict else {}), as_json, words)
        interrupts.ignore_signals()  # the report is printed
    if found.interrupted or unverified:
        context.exit(leaving.EXIT_CODE)
    # the user has named a directory, or the run.h5 in it that is resumed
    asked = Path(place or found.path).resolve()
    is_where_asked = found.path.resolve() in (asked, asked.parent)
    context.exit(0 if found.reached and is_where_asked and (verdict is None or verdict["verified"]) else 1)


UNVERIFIED = "\n  interrupted: the file is not verified"


def _verified(folder: Path) -> tuple[Json | None, bool]:
    """Return the report of `bearings verify` on a run, None if it is interrupted, and True if it is interrupted.

    folder : the run directory.
    """
    from taichi_bearings.runs.verify import verify

    verdicts: list[Json] = []
    interrupted = interrupts.broken_off(lambda: verdicts.append(verify(folder)))
    return (None, True) if interrupted or not verdicts else (verdicts[0], False)


def _ending(found: "Result") -> str:
    """Return a line on how the result of a run can be continued if it was interrupted; else an empty text."""
    complete = found.reached and not found.solution.interrupted
    return _how_to_go_on(found.path, complete) if found.interrupted else ""


def _how_to_go_on(folder: Path, complete: bool) -> str:
    """Return a line on how an interrupted run can be continued, or what it lacks.

    folder : the run directory.
    complete : True if all samples were solved, so that only figures are missing.
    """
    from taichi_bearings.runs.run_directory import CHECKPOINT_NAME

    if complete:
        return "\n  the result is complete; only figures are missing, which `bearings plot` and `histogram` draw"
    if (folder / CHECKPOINT_NAME).is_file():
        return f"\n  `bearings run --resume {folder}` goes on from the last checkpoint"
    return "\n  this run cannot be resumed; with --checkpoint-every SECONDS it could be"


def _print_cost(scene: str | None, resumed: str | None, given: Json, as_json: bool) -> None:
    """Print the method, and the time and memory to expect, for --dry-run.

    scene : path of the scene file or run directory, None without one.
    resumed : value of --resume, which cannot be combined with --dry-run.
    given : the options that the user gave, by name.
    as_json : True to print one JSON object.
    """
    from taichi_bearings.errors import InputError
    from taichi_bearings.runs.run import prepare

    if resumed:
        raise InputError(
            f"--resume is {resumed!r}: the time that a resumed run will take is not known; leave out --dry-run"
        )
    settings = _settings(scene, given)[0]
    report = prepare(settings).cost.report
    answer(report, as_json, lambda: describe_cost(report, settings.method == "auto"))


def describe_cost(report: Json, is_chosen: bool = False) -> str:
    """Return in words what a run would take.

    report : object of `--dry-run --json`; its `seconds` is None where the time cannot be known before.
    is_chosen : True if the program chose the method; the words then say why it did.
    """
    from taichi_bearings.solvers.table import METHODS

    row = METHODS.get(report["method"])
    why = f" ({row.merit})" if is_chosen and row is not None else ""
    step, steps, seconds = report["seconds_per_step"], report["steps"], report["seconds"]
    words = (
        "not known in advance: it ends when its tolerance is reached"
        if seconds is None
        else f"about {duration(seconds)}"
    )
    if step is not None:
        known = "" if seconds is None else f", {words} in all for {steps:,} steps" if steps else f", {words} in all"
        open_end = (
            "; it ends at rest or within its tolerance, after a number of steps not known in advance"
            if seconds is None
            else ""
        )
        words = f"about {step:.1g} s a step{known}{open_end}"
    return f"method: {report['method']}{why}\ntime: {words}\nmemory: about {report['bytes'] / 1e9:.2f} GB"


def _idle_seed(settings: "RunSettings") -> list[str]:
    """Return a sentence, in a list, if nothing is drawn from the seed of a run with these settings."""
    from taichi_bearings.runs.run import run_kind_of

    return run_kind_of(settings).idle_seed(settings)


def _task(
    scene: str | None, out: str | None, force: bool, resumed: str | None, given: Json
) -> "tuple[Callable[..., Result], str | None]":
    """Return a function that solves what the command line asks for, and the directory that it asks for, None if it
    names none.

    scene : path of the scene file or run directory.
    out, force : values of --out and --force.
    resumed : value of --resume, the run to go on with.
    given : the other options that the user gave, by name.
    """
    from taichi_bearings.errors import InputError
    from taichi_bearings.runs.run import resume, run

    if resumed:
        if scene or out or force:
            raise InputError(
                f"--resume is {resumed!r}: a resumed run keeps its scene and its directory; leave out SCENE, --out, "
                "--force"
            )
        return partial(resume, Path(resumed), given), resumed
    settings, stored_out = _settings(scene, given)
    out = out or stored_out
    return partial(run, settings, Path(out) if out else None, force), out


def _settings(scene: str | None, given: Json) -> "tuple[RunSettings, str | None]":
    """Return the settings of a run, and the directory that the scene file names, None if it names none.

    scene : path of a scene file (TOML) or of a run, None without one.
    given : the options that the user gave, by name; they win over the file.
    """
    from taichi_bearings.errors import InputError
    from taichi_bearings.runs.run_file import refuse_scan
    from taichi_bearings.runs.settings import RunSettings, read_toml
    from taichi_bearings.scene import Scene

    if scene is not None and not scene.endswith(".toml"):
        refuse_scan(Path(scene))
    values = read_toml(Path(scene)) if scene is not None else {}
    if "scan" in values:
        raise InputError(f"{scene} describes a scan, not a run; `bearings scan {scene}` solves it")
    if "coefficients" in given:  # they replace those that the file says how to draw
        values = {key: value for key, value in values.items() if key not in Scene.DRAWN}
    stored_out = values.pop("out", None)
    if values.pop("force", False) is not False:
        raise InputError(
            f"the key force is set in {scene}, but only the command line can allow to overwrite files, by --force"
        )
    if not isinstance(stored_out, str | None):
        raise InputError(f"the key out in {scene} is {stored_out!r}; it must be the name of a directory, in quotes")
    return RunSettings.from_mapping(values | given, scene or "the options"), stored_out


def describe(summary: Json, times: str) -> str:
    """Return a short report of a run in words, some lines.

    summary : the object of `--json`.
    times : a sentence on where the time went.
    """
    drawn, is_packing, seeds = summary["coefficients"] is None, summary["shape"] is None, listed(summary["seed"])
    lines = [f"{solved(summary)}: {ends(summary)}"]
    around = " and ".join(summary.get("periodic", ())) if not is_packing else ""
    shapes = f"; the shapes of its arrays make {around} periodic" if around else ""
    lines += [] if drawn else [f"  coefficients from {summary['coefficients']}{shapes}"]
    kind, names = ("seed", seeds) if drawn else ("sample", range(len(seeds)))
    numbers = (found if isinstance(found := summary.get(key), list) else [found] * len(seeds) for key in OF_A_SAMPLE)
    for number, (name, *found) in enumerate(zip(names, *numbers, strict=True)):
        if number == 10 and len(seeds) > 11:
            lines.append(f"  ... and {len(seeds) - 10} more {kind}s, in summary.json")
            break
        label = "" if len(seeds) == 1 and (is_packing or not drawn) else f"{kind} {name}: "
        lines.append(f"  {label}{_of_a_sample(summary, *found)}")
    if "yields" in summary:
        lines.append("  P and the slipping contacts are those of a top that turns with its imposed spin")
    if len(seeds) > 1:
        lines.append(f"  of {len(seeds)} samples the mean, least and largest value, or in how many it is true:")
    lines += [f"  {line}" for line in lines_of(map(COLUMNS.__getitem__, LAST_COLUMNS), summary)]
    device = f" on {summary['arch']}, {summary['precision']}" if "arch" in summary else ""
    lines += [
        f"  {counted(sum(listed(summary['iterations'])), 'iteration')}{device}; {times}",
        f"  run: {summary['run']}",
    ]
    picture = Path(summary["run"]) / "power_histogram.png"
    return "\n".join([*lines, *([f"  histogram: {picture}"] if picture.exists() else [])])


def _of_a_sample(
    summary: Json, power: Any, gap: Any, proof: str | None, slipping: int, slipless: int, *others: Any
) -> str:
    """Return a line on one sample: power, proven gap, how many contacts slip, and how many of these states are proven.

    summary : summary of the run. The other arguments are the sample's columns in the order of OF_A_SAMPLE; None where a
        number is not finite or not known.
    power, gap : its power, energy/time, and its relative gap.
    proof : "proven" or None, or words that say for which spins alone the lower bound is proven.
    slipping, slipless : numbers of contacts in these states.
    others : numbers of contacts: tied, undecided, with unproven state, and all.
    """
    *doubtful, unproven, contacts = (number or 0 for number in others)
    proven = "its potential proven" if "potential" in summary else "proven"
    within = "exactly" if power == gap == 0 else f"within {'not finite' if gap is None else format(gap, '.1e')}"
    if proof not in (None, "proven"):
        proven, within = within, f"of the least {'potential' if 'potential' in summary else 'power'}, {proof}"
    named = other_contacts(*doubtful)
    kinds = "".join(f", {words.replace(' ', ' is ' if words.startswith('1 ') else ' are ')}" for words in named)
    states = f"{unproven:,} states not proven" if unproven else "all states proven"
    states = "no state proven" if unproven and unproven == contacts else states
    return (
        f"P = {'not finite' if power is None else format(power, '.12g')}, {proven} {within}; of "
        f"{contacts:,} contacts {slipping:,} slip, {slipless:,} do not{kinds}; {states}"
    )
