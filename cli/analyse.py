"""bearings analyse"""

import json
from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.options import FILES, json_option

from taichi_bearings.words import counted, share, undecided_kinds


@click.command()
@click.argument("run", metavar="RUN", type=FILES)
@click.option(
    "--threshold", type=float, default=None, metavar="SPEED",
    help="Count contacts that slip no faster as slipless. [default: the contact states of the run]",
)  # fmt: skip
@click.option("--replica", type=click.IntRange(0), default=0, help="Which replica of a block of seeds is drawn.")
@click.option("--figures/--no-figures", default=True, help="Draw the figures. [default: on]")
@click.option(
    "--out", metavar="DIR", type=FILES, default=None, help="Folder for analysis.h5 and figures. [default: into the run]"
)
@click.option("--force", is_flag=True, help="Replace existing files in --out.")
@json_option
def command(
    run: str, threshold: float | None, replica: int, figures: bool, out: str | None, force: bool, as_json: bool
) -> None:
    """Structure of RUN, a run directory or its run.h5: what slips, what does not, and how that hangs together.

    \b
    minimum cut   the lightest interface of two rigid domains, its power and how far below it the run is
    network       slipless contacts: what they reach, whether and by how many paths they join bottom and top
    domains       spheres that slipless contacts make turn alike, and the driven plane they are locked to
    bottlenecks   the contacts that most of the shortest paths use
    forces        friction of the slipless contacts and the torque that flows from top to bottom

    Writes the group /analysis into run.h5 and figures beside it. docs/structure.md defines every number.

    \b
    Example:
      bearings run --shape 10,10,10 --spin-bottom 0.1 --out outputs/a
      bearings analyse outputs/a
    """
    from taichi_bearings_cli import STARTED
    from taichi_bearings_cli.progress import Display

    from taichi_bearings.runs.analyse import analyse

    with Display(STARTED) as display:
        report = analyse(Path(run), Path(out) if out else None, force, replica, threshold, figures)
    click.echo(json.dumps(report, allow_nan=False) if as_json else describe(report, display.times()))


def describe(report: dict[str, Any], times: str) -> str:
    """The report for people; of several samples the distribution of the main numbers. times : where the time went."""
    shape = "x".join(map(str, report["shape"]))
    lines = [f"{shape} {report['law']}, {report['method']}; contact states: {_states(report)}"]
    ended = [report["status"]] if isinstance(report["status"], str) else report["status"]
    if open_ends := [status for status in ended if status != "certified"]:
        lines.append(f"not certified, {len(open_ends)} of {len(ended)} ({', '.join(sorted(set(open_ends)))})")
    if isinstance(report["seed"], list):
        lines += _distributions(report)
    else:
        for title, found in (
            ("minimum cut", _interface(report)),
            ("slipless network", _network(report)),
            ("rigid domains", _domains(report)),
            ("bottlenecks", _bottlenecks(report)),
            ("forces", _forces(report)),
            ("by slip threshold", _thresholds(report)),
        ):
            lines += [title, *(f"  {line}" for line in found)]
    lines.append(times)
    return "\n".join([*lines, *report["files"]])


def _states(report: dict[str, Any]) -> str:
    if report["states"] == "threshold":
        return f"slipless up to a slip of {report['threshold']:g}"
    return {"proven": "proven", "decided": "decided by slip and friction, not proven"}[report["states"]]


def _distributions(report: dict[str, Any]) -> list[str]:
    """Mean and range over the samples."""
    import numpy as np

    lines = [f"{len(report['seed'])} samples, seeds {report['seed'][0]} ... {report['seed'][-1]}: mean, least, largest"]
    for key, words in (
        ("power", "P"),
        ("power_over_cut", "P / P_cut"),
        ("slipless_fraction", "slipless contacts, share"),
        ("reached_fraction", "free spheres they touch, share"),
        ("spanning_fraction", "free spheres joined to both planes, share"),
        ("disjoint_paths", "paths that share no contact"),
        ("busiest_link_share", "pairs through the busiest contact, share"),
        ("domains", "rigid domains"),
    ):
        values = np.array([value for value in report[key] if value is not None], dtype=float)
        if len(values):
            some = f", of {len(values)} of {len(report[key])} samples" if len(values) < len(report[key]) else ""
            lines.append(f"  {words}: {values.mean():.6g}, {values.min():.6g}, {values.max():.6g}{some}")
    for key, words in (
        ("spans", "joined bottom and top by slipless contacts"),
        ("cut_is_unique", "had a unique minimum cut"),
        ("slipping_contacts_are_the_cut", "slipped at the minimum cut and nowhere else"),
    ):
        lines.append(f"  {sum(report[key])} of {len(report[key])} {words}")
    return lines


def _interface(report: dict[str, Any]) -> list[str]:
    alone = "unique" if report["cut_is_unique"] else "not unique: others weigh the same"
    if report["next_cut_over_cut"] is not None:
        alone += f"; the next one dissipates {report['next_cut_over_cut'] - 1:.2e} more"
    lines = [f"P_cut = {report['power_minimum_cut']:.10g} over {report['cut_contacts']:,} contacts, {alone}"]
    if report["power_over_cut"] is not None:
        lines.append(f"P / P_cut = {report['power_over_cut']:.10g}")
    same = "" if report["slipping_contacts_are_the_cut"] else "not "
    return [*lines, f"the contacts that slip are {same}those of the cut"]


def _network(report: dict[str, Any]) -> list[str]:
    total = report["slipless"] + report["slipping"] + report["undecided"]
    kinds = undecided_kinds(*(report[name] for name in ("undecided", "critical", "tied_contacts")))
    open_ = ", ".join(kinds) or "0 undecided"
    lines = [
        f"{report['slipless']:,} of {total:,} contacts are slipless ({share(report['slipless_fraction'])}), "
        f"{open_}; pieces: {report['components']:,}",
        f"they touch {share(report['reached_fraction'], 4)} of the free spheres",
    ]
    if not report["spans"]:
        return [*lines, "they do not join bottom and top"]
    planes = ", ".join(f"{count} across {axis}" for count, axis in zip(report["planes_crossed"], "xy", strict=False))
    return [
        *lines,
        f"they join bottom and top, with {share(report['spanning_fraction'], 4)} of the free spheres in that piece",
        f"shortest path {counted(report['shortest_path'], 'contact')}, through planes: {planes}; "
        f"paths that share no contact: {report['disjoint_paths']:,}",
    ]


def _domains(report: dict[str, Any]) -> list[str]:
    spheres = report["free_spheres_locked_to"]
    kinds = {name: count for name, count in report["domains_locked_to"].items() if count}
    words = ", ".join(f"{name} {count:,} ({spheres[name]:,})" for name, count in kinds.items())
    only = {True: "no other slips have the least power", False: "other slips have the least power too", None: ""}
    return [
        f"{report['domains']:,} domains; by what they are locked to, with their free spheres: {words}",
        f"largest one not locked to a plane: {counted(report['largest_intermediate_domain'], 'sphere')}",
        *filter(None, [only[report["minimum_is_unique"]]]),
    ]


def _bottlenecks(report: dict[str, Any]) -> list[str]:
    if not report["spans"]:
        return ["none: nothing joins bottom and top"]
    load = report["path_concentration"]
    sources, of_all = report["betweenness_sources"], report["betweenness_all_sources"]
    exact = "" if report["betweenness_is_exact"] else f" (estimated from {sources} of {of_all} spheres)"
    lines = [
        f"{report['connected_pairs']:,} pairs of a bottom and a top sphere, on average "
        f"{report['mean_distance']:.1f} contacts apart{exact}",
        f"busiest contact: {share(report['busiest_link_share'])} of the pairs; half the load is on {load['half']:,} of "
        f"{load['loaded']:,} contacts in use",
        f"contacts that part bottom and top alone: {report['parting_links']}; fewest that do together: "
        f"{report['disjoint_paths']:,}; bridges {report['bridges']:,}, articulation spheres "
        f"{report['articulation_spheres']:,}",
        f"as a network of equal resistors: {report['resistance']:.4g}, at most "
        f"{share(report['busiest_link_current'])} of the current through one contact",
        "contact (lower sphere, axis)      pairs  current",
    ]
    for link in report["most_loaded"][:5]:
        where = f"({', '.join(map(str, link['contact']))}) {'xyz'[link['axis']]}"
        alone = "  parts the planes" if link["parts_the_planes"] else "  bridge" if link["is_bridge"] else ""
        error = "" if report["betweenness_is_exact"] else f"  +- {link['share_error']:.2%}"
        lines.append(f"{where:30}  {share(link['share'], 2):>7}  {share(link['current'], 2):>7}{error}{alone}")
    return lines


def _forces(report: dict[str, Any]) -> list[str]:
    lines = []
    if "driving_torque" in report:
        torque = ", ".join(f"{value:.8g}" for value in report["driving_torque"])
        lines.append(
            f"torque from top to bottom, by component: {torque}; slipless contacts carry "
            f"{share(report['slipless_share_of_torque'])} of it from layer to layer"
        )
    if report.get("mean_saturation") is not None:
        lines.append(
            f"slipless contacts bear {share(report['mean_saturation'])} of their limit of friction on average; "
            f"{report['slipless_within_1_percent']:,} are within 1 % of slipping"
        )
    if not report["undecided"]:
        free = report["self_stress_states"]
        lines.append(f"their forces are {'unique' if free == 0 else f'open in {free:,} states of self-stress'}")
    return lines or ["unknown: the run has none of them, or its contacts are not decided"]


def _thresholds(report: dict[str, Any]) -> list[str]:
    lines = ["threshold / (R jump)   slipless  domains  largest intermediate  spans  reached"]
    for row in report["by_threshold"]:
        lines.append(
            f"{row['threshold']:20.0e}  {row['slipless']:9,}  {row['domains']:7,}  {row['largest_intermediate']:20,}  "
            f"{'yes' if row['spans'] else 'no':>5}  {row['reached_fraction']:.5f}"
        )
    return lines
