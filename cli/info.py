"""bearings info"""

import json

import click
from taichi_bearings_cli.options import json_option


@click.command()
@json_option
def command(as_json: bool) -> None:
    """Versions, devices, precision and cache.

    \b
    Example:
      bearings info --json
    """
    from taichi_bearings import __version__, compiler, runtime
    from taichi_bearings.runs.run import versions
    from taichi_bearings.runtime import GPUS

    gpus = {arch: found for arch in GPUS if (found := runtime.usable(arch, "f32"))}
    report = {
        "version": __version__,
        **versions(),
        "devices": ["cpu", *gpus],
        "device_names": {
            arch: [f"{device.name}{' (software)' if device.is_software else ''}" for device in found]
            for arch, found in gpus.items()
        },
        "default_arch": "cpu",
        "default_precision": "f64",
        "threads": runtime.available_threads(),
        "kernel_cache": str(compiler.cache_folder() or "none"),
    }
    if as_json:
        click.echo(json.dumps(report))
        return
    for key, value in report.items():
        if isinstance(value, dict):
            value = "; ".join(f"{arch}: {', '.join(names)}" for arch, names in value.items()) or "none but the CPU"
        click.echo(f"{key.replace('_', ' '):18} {', '.join(value) if isinstance(value, list) else value}")
