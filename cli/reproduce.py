"""The command `bearings reproduce`."""

from pathlib import Path

import click
from taichi_bearings_cli.options import answer, json_option, out_options, title_option
from taichi_bearings_cli.progress import Display

from taichi_bearings.plain_files import Json


@click.command()
@click.argument("figures", nargs=-1, metavar="[FIGURE...]")
@click.option(
    "--seed",
    type=click.IntRange(0, 2**62),
    default=0,
    show_default=True,
    help="Seed of the first sample; the next ones have the seeds after it.",
)
@click.option(
    "--samples", type=click.IntRange(1, 100_000), default=None,
    help="Number of samples for each statistical claim. [default: 200, with --quick 20]",
)  # fmt: skip
@click.option("--quick", is_flag=True, help="Quick version of about four minutes: fewer samples, sizes and iterations.")
@title_option
@out_options("Folder for the files. [default: outputs/<time>-reproduce-<id>]")
@json_option
@click.pass_context
def command(
    context: click.Context,
    figures: tuple[str, ...],
    seed: int,
    samples: int | None,
    quick: bool,
    out: Path | None,
    as_json: bool,
    **asked: bool,
) -> None:
    """Draw figures of the paper, with a verdict for each of its claims about them. FIGURE is one of these; without
    one, all but the questions beyond the paper are drawn.

    \b
    fig1  stationary states of 10x10 discs, viscous and Coulomb, and how often the interface of the two bearing states
          is the minimum cut; for the latter --samples is multiplied by five
    fig2  P(t) of a 3x3x3 Coulomb bearing from random spins and from the minimum cut, with springs (Cundall-Strack) and
          without (rigid limit), and the spins at both ends
    fig3  a 10x10x10 Coulomb bearing whose slipless contacts join bottom and top: spheres, network, a path, its spins
    fig4  the sample of fig3, cut along the planes that hold most of the path
    supplement
          the power of the contacts of 32x32x32 spheres: 10^6 iterations of plain gradient descent beside the certified
          minimum, and which decades of the descent's powers are real
    network
          the claims about Figs. 3 and 4 over samples from 3x3x3 to 32x32x32: P_min / P_cut, slipless network, rigid
          domains, and how these depend on the slip threshold
    distributions, drivings, parameters
          other distributions of the friction coefficients, other imposed bearing states, other K, A and F_n
    exponents, surfaces, odd-loops, yield, limits
          questions beyond the paper: how interfaces of discs fluctuate, those of spheres and their minima, how many odd
          contacts stop a bearing, which torques a bearing holds, and what shares, networks and domains are in large
          samples

    Writes FIGURE.png, FIGURE.pdf, FIGURE.csv, and the report as report.html (one file, figures inside) and report.json,
    anew after each figure. The same command with the same --out goes on with the figures that are missing,
    and adds others. A claim is confirmed, refined (it holds with a condition or a correction), refuted, or has too few
    samples for a verdict; for each the report has the sample size, the uncertainty, what the verdict rests on, and what
    was chosen after looking. The whole command takes about 20 minutes on two cores, with --quick four minutes.

    \b
    Exit codes: 0 no claim is refuted, 1 one is, 2 bad input, 130 interrupted (figures that are done are kept).

    \b
    Example:
      bearings reproduce --quick --out outputs/paper
    """
    from taichi_bearings_studies.paper.claims import QUICK_SAMPLES, SAMPLES, Effort
    from taichi_bearings_studies.paper.reproduce import reproduce

    from taichi_bearings.runs.run_directory import default_run_path

    folder = out or default_run_path("reproduce")
    with Display() as display:
        effort = Effort(seed, samples or (QUICK_SAMPLES if quick else SAMPLES), quick)
        report = reproduce(figures, folder, effort, tell=lambda line: click.echo(line, err=True), **asked)
    answer(report, as_json, lambda: describe(report, display.times()))
    if (missing := ", ".join(report["missing"])) and not as_json:
        click.echo(f"not computed yet: {missing}; the same command with --out {folder} continues", err=True)
    context.exit(130 if report["interrupted"] else 1 if report["refuted"] else 0)


def describe(report: Json, times: str) -> str:
    """Return all claims with their verdicts, and the files written, in words.

    report : the object of `--json`.
    times : a sentence on where the time went.
    """
    lines = list[str]()
    for found in report["figures"].values():
        for claim in found["claims"]:
            rests = "" if claim["kind"] == "samples" else f" ({claim['kind']})"
            lines += [f"{claim['verdict']:9}  {claim['claim']}{rests}", f"           {claim['finding']}"]
        lines += found["files"]
    return "\n".join([*lines, *report["files"], times])
