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
    from taichi_bearings import __version__, runtime
    from taichi_bearings.studies.run import versions

    report = {
        "version": __version__,
        **versions(),
        "devices": ["cpu", *(["cuda"] if runtime.has_cuda() else [])],
        "default_arch": "cpu",
        "default_precision": "f64",
        "threads": runtime.available_threads(),
        "kernel_cache": str(runtime.cache_folder() / "taichi"),
    }
    if as_json:
        click.echo(json.dumps(report))
        return
    for key, value in report.items():
        click.echo(f"{key.replace('_', ' '):18} {', '.join(value) if isinstance(value, list) else value}")
