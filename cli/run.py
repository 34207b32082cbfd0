"""bearings run"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.options import FILES, SettingsCommand, answer, json_option, out_options
from taichi_bearings_cli.progress import Display, in_lines
from taichi_bearings_cli.verify import describe as describe_verdict

from taichi_bearings.scene.law import LAWS
from taichi_bearings.words import counted, driving_words, undecided_kinds


@click.command(cls=SettingsCommand)
@click.argument("scene", required=False, metavar="[SCENE.toml]", type=FILES)
@out_options(
    "Run directory. [default: outputs/<time>-run-<id>]", force="Replace an existing run directory.", kind=FILES
)
@click.option("--resume", metavar="RUN", type=FILES, help="Go on with a run that has a checkpoint, in its directory.")
@click.option(
    "--verify", is_flag=True, help="Check the written file as `bearings verify` does; exit code 1 if it fails."
)
@json_option
@click.pass_context
def command(
    context: click.Context,
    scene: str | None,
    out: str | None,
    force: bool,
    resume: str | None,
    verify: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Solve one scene (or a block of seeds) and write a run directory.

    SCENE.toml holds the same keys as the options, dashes as underscores; options win. A run directory or its run.h5
    serves too: it is run again. The directory gets run.h5, summary.json, scene.toml, power_histogram.csv and figures.
    Ctrl-C saves what was reached. With --checkpoint-every even a killed run can be resumed, to the same bits.

    \b
    Exit codes: 0 reached, 1 not reached (the result is written), 2 bad input, 130 interrupted.

    \b
    Examples:
      bearings run --shape 10,10,10 --seed 3 --tolerance 1e-5
      bearings run scene.toml --method cundall-strack --initial random --out outputs/relaxation
      bearings run --method cundall-strack --duration 10 --record log:1e-4,10,100 --checkpoint-every 60 --out outputs/a
      bearings run --resume outputs/a --duration 20
    """
    given = {key: value for key, value in options.items() if value is not None}
    verdict: dict[str, Any] | None = None
    with Display() as display:
        try:
            solve, place = _task(scene, out, force, resume, given)
            found = solve()
        except KeyboardInterrupt as error:
            goes_on = f"`bearings run --resume {error}` goes on from the last checkpoint"
            kept = goes_on if error.args else "nothing is kept"
            raise KeyboardInterrupt(f"bearings: interrupted before a first result was reached; {kept}") from None
        if verify and not found.interrupted:
            from taichi_bearings.runs.verify import verify as verdict_of

            verdict = verdict_of(found.path)
    summary = found.summary
    for sentence in summary["warnings"]:
        click.echo(in_lines(f"bearings: warning: {sentence}", err=True), err=True)

    def words() -> str:
        told = (describe_packing if summary["shape"] is None else describe)(summary, display.times())
        return in_lines(f"{told}\n{describe_verdict(verdict)}" if verdict else told)

    answer(summary | ({"verification": verdict} if verdict else {}), as_json, words)
    if found.interrupted:
        context.exit(130)
    asked = Path(place or found.path).resolve()  # of a directory, or of the run.h5 in it that is resumed
    is_there = found.path.resolve() in (asked, asked.parent)
    reached = all(status.reached for status in found.status)
    context.exit(0 if reached and is_there and (verdict is None or verdict["verified"]) else 1)


def _task(
    scene: str | None, out: str | None, force: bool, resumed: str | None, given: dict[str, Any]
) -> tuple[Callable[[], Any], str | None]:
    """What solves the scene of a file with these options, or goes on with a run; and where its directory is asked to
    be."""
    from taichi_bearings.errors import InputError
    from taichi_bearings.runs.run import resume, run
    from taichi_bearings.runs.run_file import refuse_scan
    from taichi_bearings.runs.settings import RunSettings, read_toml
    from taichi_bearings.scene import Scene

    if resumed:
        if scene or out or force:
            raise InputError(f"resume is {resumed!r}: a resumed run keeps its scene and its directory; leave them out")
        return partial(resume, Path(resumed), given), resumed
    if scene and not scene.endswith(".toml"):
        refuse_scan(Path(scene))
    values = read_toml(Path(scene)) if scene else {}
    if "scan" in values:
        raise InputError(f"{scene} describes a scan, not a run; `bearings scan {scene}` solves it")
    if "coefficients" in given:  # the file stored how it drew its own
        values = {key: value for key, value in values.items() if key not in Scene.DRAWN}
    stored_out = values.pop("out", None)
    if values.pop("force", False) is not False:
        raise InputError(f"force in {scene}: a file replaces nothing; give --force on the command line")
    if not isinstance(stored_out, str | None):
        raise InputError(f"out is {stored_out!r}; it must be a text")
    out = out or stored_out
    settings = RunSettings.from_mapping(values | given, scene or "the options")
    return partial(run, settings, Path(out) if out else None, force), out


def describe(summary: dict[str, Any], times: str) -> str:
    """A short summary for people. times : where the time went."""
    shape = "x".join(map(str, summary["shape"]))
    status = summary["status"] if isinstance(summary["status"], str) else ", ".join(sorted(set(summary["status"])))
    lines = [f"{shape} {summary['law']}, {summary['method']}{driving_words(summary)}: {status}"]
    if summary["coefficients"]:
        lines.append(f"  coefficients from {summary['coefficients']}")
    seeds = summary["seed"] if isinstance(summary["seed"], list) else [summary["seed"]]
    least = "its potential proven" if "potential" in summary else "proven"
    kind = "sample" if summary["coefficients"] else "seed"
    keys = ("power", "gap", "slipping", "slipless", "undecided", "critical")
    known = [summary.get("tied_contacts") or [0] * len(seeds), *(summary[key] for key in keys)]
    names = range(len(seeds)) if summary["coefficients"] else seeds
    rows = zip(names, *(v if isinstance(v, list) else [v] for v in known), strict=True)
    for number, (name, tied, power, gap, slipping, slipless, undecided, critical) in enumerate(rows):
        if number == 10 and len(seeds) > 11:
            lines.append(f"  ... and {len(seeds) - 10} more {kind}s, in summary.json")
            break
        label = "" if summary["coefficients"] and len(seeds) == 1 else f"{kind} {name}: "
        within = "exactly" if power == gap == 0 else f"within {_number(gap, '.1e')}"
        lines.append(
            f"  {label}P = {_number(power, '.12g')}, {least} {within}; of {summary['contacts']:,} contacts "
            f"{slipping:,} slip, {slipless:,} do not, {_others(undecided, critical, tied)}"
        )
    if len(seeds) == 1:
        lines += [f"  {line}" for line in _separation(summary)]
    lines += [f"  {line}" for line in _under_torque(summary)]
    if "duration" in summary and summary["time"] < summary["duration"] * (1 - 1e-9):
        lines.append(f"  simulated {summary['time']:.6g} of {summary['duration']:.6g}")
    if "power_normalised" in summary and len(seeds) == 1:
        lines.append(f"  P / (F_n R omega_T) = {summary['power_normalised']:.12g}")
    lines.append(
        f"  {counted(summary['iterations'], 'iteration')} on {summary['arch']}, {summary['precision']}; {times}"
    )
    return "\n".join([*lines, f"  run: {summary['run']}", *_picture(summary)])


def describe_packing(summary: dict[str, Any], times: str) -> str:
    """A short summary of a packing."""
    seeds = summary["seed"] if isinstance(summary["seed"], list) else [summary["seed"]]
    each = [summary]
    if len(seeds) > 1:
        each = [{key: values[n] if isinstance(values, list) and len(values) == len(seeds) else values
                 for key, values in summary.items()} for n in range(len(seeds))]  # fmt: skip
    lines = [
        f"{summary['spheres']:,} spheres, {summary['driven_spheres']:,} of them driven, {summary['law']}, "
        f"{summary['method']}{driving_words(summary)}: {', '.join(sorted({one['status'] for one in each}))}"
    ]
    shown = each if len(seeds) <= 11 else each[:10]
    for seed, one in zip(seeds, shown, strict=False):
        lines += _packing_lines(one, f"seed {seed}: " if len(seeds) > 1 else "")
    lines += [f"  ... and {len(each) - len(shown)} more seeds, in summary.json"] if len(shown) < len(each) else []
    return "\n".join([*lines, f"  {times}", f"  run: {summary['run']}", *_picture(summary)])


def _packing_lines(summary: dict[str, Any], label: str) -> list[str]:
    """Of one replica."""
    within = "exactly" if summary["gap"] == 0 else f"within {summary['gap']:.1e}"
    proven = {"proven": f"proven {within}"}.get(summary["proof"], f"{within}, {summary['proof']}")
    motions = summary["slipless_motions"]
    free = "not decided" if motions is None else f"{motions:,}"
    states = "the contact states are proven"
    if summary["unproven"]:
        states = f"of {summary['contacts'] - summary['unproven']:,} contacts it is proven what they are called"
    lines = [
        f"  {label}P = {summary['power']:.12g}, {proven}; of {summary['contacts']:,} contacts "
        f"{summary['slipping']:,} slip, {summary['slipless']:,} do not, "
        f"{_others(summary['undecided'], summary['critical'], 0)}",
        f"  {states}; slipless motions beside: {free}",
    ]
    beside = f"  contacts between driven spheres dissipate {summary['driven_power']:.12g} beside"
    return [*lines, beside] if summary["driven_power"] else lines


def _picture(summary: dict[str, Any]) -> list[str]:
    picture = Path(summary["run"]) / "power_histogram.png"
    return [f"  histogram: {picture}"] if picture.exists() else []


def _under_torque(summary: dict[str, Any]) -> list[str]:
    """What a torque on the top does, where one is asked for."""
    if "yields" not in summary:
        return []
    if isinstance(summary["yields"], list):
        return [f"the torque moves {sum(summary['yields'])} of {counted(len(summary['yields']), 'sample')}"]
    low, high, amplitude = (summary[key] for key in ("yield_torque_lower_bound", "yield_torque", "amplitude"))
    if summary["spin_bottom"]:
        moves = "it moves" if summary["yields"] else "it is not proven to move"
        return [f"the top begins to turn at torques of {low:.12g} to {high:.12g}, the bottom turns: {moves}"]
    between = "" if f"{low:.12g}" == f"{high:.12g}" else f"{low:.12g} to "
    holds = f"friction holds torques of up to {between}{high:.12g}" if high > 0 else "friction holds no torque"
    if not summary["yields"]:
        return [f"{holds}: {'this one is held' if amplitude == 0 else 'whether it holds this one is not proven'}"]
    runs_away = not LAWS[summary["law"]].flows or summary["power"] == 0
    unknown = "nothing limits the motion" if runs_away else "the strength of its motion is not known"
    motion = unknown if amplitude is None else f"the strength of its motion is {amplitude:.12g}"
    when = summary.get("time_at_yield")
    moves = "moves" if when is None else f"begins to turn at {summary['torque_at_yield']:.6g}, at the time {when:.6g}"
    return [f"{holds}: the top {moves}, and {motion}"]


def _others(undecided: int, critical: int, tied: int) -> str:
    """What the contacts are that neither slip nor rest for certain."""
    named = undecided_kinds(undecided, critical, tied) or ["0 undecided"]
    return ", ".join(words.replace(" ", " is " if words.startswith("1 ") else " are ") for words in named)


def _separation(summary: dict[str, Any]) -> list[str]:
    """How far apart the slips of slipping and slipless contacts are."""
    largest, smallest = summary["largest_slipless_slip"], summary["smallest_slipping_slip"]
    if not LAWS[summary["law"]].holds or largest is None or smallest is None:
        return []
    slow = f"slip at most {largest:.1e}" if largest > 0 else "do not slip at all"
    words = f"slipless contacts {slow}, slipping ones at least {smallest:.1e}"
    if summary["states_proven"]:
        return [f"{words}; the contact states are proven"]
    if summary["separation_decades"] is None:
        return [f"{words}; not certified, so this says little of a minimum"]
    if summary["separation_decades"] >= 1:
        words = f"{words}: {summary['separation_decades']:.1f} decades apart"
    if summary["unproven"] == 0:
        return [words, "what each contact is called is proven"]
    proven = summary["contacts"] - summary["unproven"]
    return [words, *([f"of {proven:,} contacts it is proven what they are called"] if proven else [])]


def _number(value: float | None, form: str) -> str:
    return "not finite" if value is None else format(value, form)
