"""Options shared by commands; those of a run come from the one table in runs/settings.py."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import click

from taichi_bearings.runs.settings import Kind, RunSettings


def run_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add every setting of a run as an option. Values stay text here: RunSettings reads and checks them."""
    for item in reversed(fields(RunSettings)):
        kind: Kind = item.metadata["kind"]
        name = "--" + item.name.replace("_", "-")
        text = item.metadata["help"]
        if isinstance(item.default, bool):
            both = f"{name}/--no-{item.name.replace('_', '-')}"
            shown = f"{text} [default: {'on' if item.default else 'off'}]"
            decorate = click.option(both, item.name, default=None, help=shown)
        else:
            if item.default is not None:
                shown = ",".join(map(str, item.default)) if isinstance(item.default, tuple) else str(item.default)
                text = f"{text} [default: {shown}]"
            decorate = click.option(name, item.name, default=None, metavar=kind.metavar, help=text)
        function = decorate(function)
    return function


json_option = click.option("--json", "as_json", is_flag=True, help="Print exactly one JSON object on stdout.")
