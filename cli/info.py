"""The command `bearings info`."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.options import FILE_PATH, answer, json_option
from taichi_bearings_cli.progress import in_lines

from taichi_bearings.plain_files import Json

LABELS = {
    "device_names": "GPUs",
    "default_arch": "device by default",
    "default_precision": "precision by default",
    "threads": "CPU threads",
    "kernel_cache": "folder of compiled kernels",
    "driven": "driven spheres",
    "bodies": "driven bodies (spheres driven together)",
    "parts": "parts without contact to each other",
    "floating": "parts of several spheres without a driven one",
    "rattlers": "free spheres without contact",
    "free_dangling": "free spheres with one contact",
    "bipartite": "all loops even (neighbours can turn oppositely)",
    "smallest_odd_loop": "contacts of the smallest odd loop",
    "free_motions": "motions without slip, driven spheres at rest",
    "all_motions": "motions without slip, all spheres free",
    "decided_by": "how these motions were counted",
    "bearing_state": "bearing state: can all spin without slip",
    "idle_contacts": "contacts without normal force, counted here too",
}
"""Words for keys of the report that do not say enough by themselves."""


@click.command()
@click.argument("packing", required=False, type=FILE_PATH)
@click.option(
    "--quantities",
    is_flag=True,
    help="List the numbers that files, reports and columns of scans have: name, unit and meaning of each.",
)
@json_option
def command(packing: Path | None, quantities: bool, as_json: bool) -> None:
    """Show versions, devices, precision and cache; or what the file PACKING holds, before anything is solved.

    Of a packing it shows its connected parts, odd loops, and how many motions without any slip it has, which tells
    whether a bearing state exists; contacts without normal force count as all others. docs/packings.md says more.

    \b
    Examples:
      bearings info --json
      bearings info packing.npz
      bearings info --quantities
    """
    if quantities:
        if packing is not None:
            raise click.UsageError("--quantities lists the same for every file; leave out PACKING")
        listed = _quantities()
        answer(listed, as_json, lambda: in_lines(_in_sections(listed)))
        return
    from taichi_bearings import __version__, compiler, runtime
    from taichi_bearings.runs.writing import versions

    if packing is None:
        gpus = {arch: found for arch in runtime.GPUS if (found := runtime.usable(arch, "f32"))}
        names = {gpu: [f"{d.name}{' (software)' * d.is_software}" for d in found] for gpu, found in gpus.items()}
        report: Json = {
            "version": __version__,
            **versions(),
            "devices": ["cpu", *gpus],
            "device_names": names,
            "default_arch": "cpu",
            "default_precision": "f64",
            "threads": runtime.available_threads(),
            "kernel_cache": str(compiler.cache_folder() or "none"),
        }
    else:  # its structure, with what follows for a bearing
        import numpy as np

        from taichi_bearings.analysis.topology import topology_of
        from taichi_bearings.scene.packing import Packing

        one = Packing.load(packing)
        found = asdict(topology_of(one))
        motions = found["all_motions"]
        bearing = "not decided" if motions is None else "yes" if motions else "none: no spins but rest are free of slip"
        report = {"packing": str(packing), "dimension": one.dimension, **found, "bearing_state": bearing}
        if idle := int((np.broadcast_to(one.normal_force, one.contacts) <= 0).sum()):
            report["idle_contacts"] = idle
    labels = {key: LABELS.get(key, key.replace("_", " ")) for key in report}
    widest = max(map(len, labels.values()))
    lines = [f"{labels[key]:{widest}}  {_value_in_words(value)}" for key, value in report.items()]
    answer(report, as_json, lambda: "\n".join(lines))


def _quantities() -> dict[str, dict[str, dict[str, str]]]:
    """Return the quantities that files and reports have: by section and name their unit ("1" for pure numbers) and
    meaning.
    """
    from taichi_bearings.quantities import ANALYSED, CHECK_ROWS, CONTACTS, FINDINGS, OF_SCANS, SAMPLES, SPHERES

    sections = {
        "spheres": SPHERES,
        "contacts": CONTACTS,
        "history": CHECK_ROWS,
        "summary of a run": SAMPLES | FINDINGS,
        "analysis": ANALYSED,
        "columns that only scans have": OF_SCANS,
    }
    return {
        title: {name: {"unit": row.unit, "meaning": row.text} for name, row in rows.items()}
        for title, rows in sections.items()
    }


def _in_sections(quantities: dict[str, dict[str, dict[str, str]]]) -> str:
    """Return a text with a line for each quantity: name, unit and meaning in columns.

    quantities : unit and meaning of each, by section and name.
    """
    lines = []
    for title, rows in quantities.items():
        names, units = max(map(len, rows)), max(len(row["unit"]) for row in rows.values())
        lines += ["", title] if lines else [title]
        lines += [f"  {name:<{names}}  {row['unit']:<{units}}  {row['meaning']}" for name, row in rows.items()]
    return "\n".join(lines)


def _value_in_words(value: Any) -> str:
    """Return a value of the report as a text: yes or no, lists separated by commas, "-" for None, a dictionary of
    device names as "DEVICE: NAME, NAME; ...".
    """
    if isinstance(value, dict):
        return "; ".join(f"{arch}: {', '.join(names)}" for arch, names in value.items()) or "none but the CPU"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(value) if isinstance(value, list) else "-" if value is None else str(value)
