"""The command `bearings info`."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
from taichi_bearings_cli.options import FILE_PATH, answer, json_option

LABELS = {
    "device_names": "GPUs",
    "default_arch": "device by default",
    "default_precision": "precision by default",
    "threads": "CPU threads",
    "kernel_cache": "folder of compiled kernels",
    "driven": "driven spheres",
    "bodies": "driven bodies (spheres driven together)",
    "parts": "parts without contact to each other",
    "floating": "parts without a driven sphere",
    "rattlers": "free spheres without contact",
    "free_dangling": "free spheres with one contact",
    "bipartite": "all loops even (neighbours can turn oppositely)",
    "smallest_odd_loop": "contacts of the smallest odd loop",
    "free_motions": "motions without slip, driven spheres at rest",
    "all_motions": "motions without slip, all spheres free",
    "decided_by": "how these motions were counted",
    "bearing_state": "bearing state: can all spin without slip",
}
"""Words for keys of the report that do not say enough by themselves."""


@click.command()
@click.argument("packing", required=False, type=FILE_PATH)
@json_option
def command(packing: Path | None, as_json: bool) -> None:
    """Show versions, devices, precision and cache; or what the file PACKING holds, before anything is solved.

    Of a packing it shows its connected parts, odd loops, and how many motions without any slip it has, which tells
    whether a bearing state exists. docs/packings.md says more.

    \b
    Examples:
      bearings info --json
      bearings info packing.npz
    """
    from taichi_bearings import __version__, compiler, runtime
    from taichi_bearings.runs.writing import versions

    if packing is None:
        gpus = {arch: found for arch in runtime.GPUS if (found := runtime.usable(arch, "f32"))}
        names = {gpu: [f"{d.name}{' (software)' * d.is_software}" for d in found] for gpu, found in gpus.items()}
        report: dict[str, Any] = {
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
        from taichi_bearings.analysis.topology import topology_of
        from taichi_bearings.scene.packing import Packing

        one = Packing.load(packing)
        found = asdict(topology_of(one))
        motions = found["all_motions"]
        bearing = "not decided" if motions is None else "yes" if motions else "none: no spins but rest are free of slip"
        report = {"packing": str(packing), "dimension": one.dimension, **found, "bearing_state": bearing}
    labels = {key: LABELS.get(key, key.replace("_", " ")) for key in report}
    widest = max(map(len, labels.values()))
    lines = [f"{labels[key]:{widest}}  {_value_in_words(value)}" for key, value in report.items()]
    answer(report, as_json, lambda: "\n".join(lines))


def _value_in_words(value: Any) -> str:
    """Return a value of the report as a text: yes or no, lists separated by commas, "-" for None, a dictionary of
    device names as "DEVICE: NAME, NAME; ...".
    """
    if isinstance(value, dict):
        return "; ".join(f"{arch}: {', '.join(names)}" for arch, names in value.items()) or "none but the CPU"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(value) if isinstance(value, list) else "-" if value is None else str(value)
