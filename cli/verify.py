"""The command `bearings verify`."""

from pathlib import Path

import click
from taichi_bearings_cli.options import answer, json_option, run_argument
from taichi_bearings_cli.progress import Display, in_lines
from taichi_bearings_cli.report import ends

from taichi_bearings.errors import printable
from taichi_bearings.plain_files import Json
from taichi_bearings.scene.law import LAWS
from taichi_bearings.words import listed


@click.command()
@run_argument
@json_option
@click.pass_context
def command(context: click.Context, run: Path, as_json: bool) -> None:
    """Check what RUN, a run directory or its run.h5, proves: from that file alone.

    Power, bounds and contact states are judged anew from the spins and the friction in the file, with a bound on every
    rounding, and compared with what the file says. Its checksums are compared too, and coefficients that are drawn from
    seeds. That finds damage and edits. docs/proofs.md says what is proven and what is trusted.

    \b
    Exit codes: 0 the file proves what its summary claims, 1 it does not, 2 it cannot be read.

    \b
    Example:
      bearings run --shape 10,10,10 --out outputs/a
      bearings verify outputs/a
    """
    from taichi_bearings.runs.verify import verify

    with Display() as display:
        report = verify(run)
    answer(report, as_json, lambda: in_lines(describe(report, display.times())))
    context.exit(0 if report["verified"] else 1)


def describe(report: Json, times: str = "") -> str:
    """Return the verdict on a run in words, some lines.

    report : the object of `--json`.
    times : a sentence on where the time went.
    """
    law = LAWS[report["law"]]
    shape = "x".join(map(str, report["shape"])) if report["shape"] else f"packing of {report['spheres']:,} spheres,"
    origin = "those of the seed" if report["coefficients"] == "drawn" else "as the file gives them"
    lines = [f"{shape} {report['law']}, {ends(report)}; coefficients {origin}"]
    keys = ("upper_bound", "lower_bound", "gap", "states_proven", "minimum_is_unique", "unproven_because", "proof")
    seeds = listed(report["seed"])
    columns = [listed(report[name]) for name in keys]
    names = [f"seed {seed}" if report["coefficients"] == "drawn" else f"sample {n}" for n, seed in enumerate(seeds)]
    rows = list(zip(names, *columns, strict=True))
    for sample, power, bound, gap, states, unique, reason, proof in rows[:10]:
        if power is None:
            why = f", because {reason}" if reason else ""
            lines.append(f"  {sample}: neither a power nor a contact state can be proven{why}")
            continue
        if proof == "proven":
            lines.append(f"  {sample}: {bound!r} <= least {law.minimises} <= {power!r}, a relative gap of {gap:.1e}")
        else:
            lines.append(f"  {sample}: least {law.minimises} <= {power!r}; its lower bound {bound!r} is {proof}")
        proven = [f"{states['slipping']:,} slip and {states['slipless']:,} do not at any minimum"]
        if states["tied"]:
            proven.append(f"{states['tied']:,} tied: they slip at some minima and not at others")
        if states["unproven"]:
            proven.append(f"{states['unproven']:,} without a proof" + (f" ({reason})" if reason else ""))
        elif unique:
            proven.append(f"no other slips have the least {law.minimises}")
        lines.append(f"    contacts: {'; '.join(proven)}")
    if len(rows) > 10:
        lines.append(f"  ... and {len(rows) - 10} more samples")
    if isinstance(report["gap"], float):
        balanced = "in balance" if report["balanced"] else "not in balance, for which the lower bound is lowered"
        inside = (
            "within its limits" if report["inside_discs"] else "beyond its limits, for which the lower bound is lowered"
        )
        damped = "friction and damping" if law.has_friction else "damping"
        lines.append(f"  friction: {balanced}, {inside}" if law.is_rate_independent else f"  {damped}: {balanced}")
    lines += [f"contradiction: {sentence}" for sentence in report["contradictions"]]
    lines = [printable(line) for line in lines]  # a line each, whatever the names and words in the file
    verdict, proves = ("verified", "proves") if report["verified"] else ("NOT verified", "does not prove")
    lines.append(f"{verdict} in {report['seconds']:.1f} s: the file {proves} what it claims")
    return "\n".join([*lines, *([times] if times else [])])
